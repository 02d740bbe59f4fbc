"""Argoverse 2's tables of cuboids: tables made by pyarrow alone, damage, and what is written read back."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from farfield.errors import ConfigError, FileFormatError
from farfield.files.argoverse2_boxes import read_argoverse2_boxes, write_argoverse2_boxes
from farfield.geometry.boxes import Boxes
from farfield.metrics.box_files import read, read_predictions
from farfield.metrics.submissions import argoverse2_part, stamp_of

pyarrow = pytest.importorskip("pyarrow")
feather = pytest.importorskip("pyarrow.feather")

ROW: dict[str, Any] = {
    "tx_m": 10.0, "ty_m": -2.0, "tz_m": 0.5, "length_m": 4.5, "width_m": 2.0, "height_m": 1.5,
    "qw": 0.0, "qx": 0.0, "qy": 0.0, "qz": 1.0, "score": 0.5,
    "log_id": "log-a", "timestamp_ns": 315966265259836000, "category": "REGULAR_VEHICLE",
}  # fmt: skip


def write(path: Path, rows: list[dict[str, Any]], **options: Any) -> Path:
    feather.write_feather(pyarrow.table({name: [row[name] for row in rows] for name in rows[0]}), path, **options)
    return path


@pytest.mark.parametrize("compression", ["uncompressed", "lz4", "zstd"])
def test_columns_are_those_of_the_kit(tmp_path: Path, compression: str) -> None:
    later = {**ROW, "timestamp_ns": ROW["timestamp_ns"] + 100_000_000, "category": "DOG", "qw": 1.0, "qz": 0.0}
    path = write(tmp_path / "a.feather", [ROW, later, {**ROW, "tx_m": 20.0}], compression=compression)
    found = read_argoverse2_boxes(path)
    assert found.centre_m[:, 0].tolist() == [10.0, 10.0, 20.0]
    assert found.size_m[0].tolist() == [4.5, 2.0, 1.5]
    assert found.yaw_rad.tolist() == pytest.approx([np.pi, 0.0, np.pi])
    assert found.score is not None
    assert found.points is None
    boxes = read_predictions(path, format="argoverse2").boxes
    assert {key: len(part) for key, part in boxes.items()} == {
        ("log-a", "315966265259836000"): 2,
        ("log-a", "315966265359836000"): 1,
    }
    assert boxes["log-a", "315966265359836000"].label.tolist() == ["DOG"]
    with_points = {name: value for name, value in ROW.items() if name != "score"} | {"num_interior_pts": 7}
    labels = write(tmp_path / "b.feather", [with_points])
    both = read(path, labels, format="argoverse2")
    assert both.reference == "ego"
    assert both.annotated["log-a", "315966265259836000"].point_count.tolist() == [7]


def test_what_is_written_is_read_back(tmp_path: Path, rng: np.random.Generator) -> None:
    boxes = Boxes(
        centre_m=rng.normal(0, 80, (30, 3)),
        size_m=rng.uniform(0.5, 5, (30, 3)),
        yaw_rad=rng.uniform(-3, 3, 30),
        label=rng.choice(["REGULAR_VEHICLE", "PEDESTRIAN"], 30),
        score=rng.random(30),
    )
    keys = [("log-a", "315966265259836000"), ("log-b", "315966265359836000")]
    path = tmp_path / "out.feather"
    assert write_argoverse2_boxes(path, [argoverse2_part(key, boxes) for key in keys]) == 60
    assert feather.read_table(path).num_rows == 60
    found = read_predictions(path, format="argoverse2").boxes
    for key in keys:
        for name in ("centre_m", "size_m", "score"):
            np.testing.assert_array_equal(getattr(found[key], name), getattr(boxes, name))
        np.testing.assert_allclose(found[key].yaw_rad, boxes.yaw_rad, atol=1e-15)
        assert found[key].label.tolist() == boxes.label.tolist()
    ours = argoverse2_part(keys[0], boxes.replace(label="large_vehicle"))
    assert set(ours.category.tolist()) == {"LARGE_VEHICLE"}
    assert len(argoverse2_part(keys[0], boxes.replace(label="cone of mine"))) == 0
    for name in ("000007", "scan", "12"):
        with pytest.raises(ConfigError, match="expected a stamp"):
            stamp_of(("log", name))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"tx_m": float("nan")}, "tx_m"),
        ({"length_m": 0.0}, "length, width, height"),
        ({"score": float("inf")}, "score"),
        ({"qw": 5.0}, "quaternion of length 1"),
        ({"qx": 1.0, "qz": 0.0}, "stands upright"),
        ({"timestamp_ns": -1}, "timestamp_ns"),
        ({"timestamp_ns": 0.5}, "timestamp_ns"),
        ({"category": 4}, "category"),
        ({"category": "x" * 300}, "300"),
        ({"num_interior_pts": -2}, "num_interior_pts"),
        ({"ty_m": "far"}, "ty_m"),
    ],
)
def test_impossible_rows_are_refused_by_name(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    path = write(tmp_path / "a.feather", [{**ROW, **change}])
    with pytest.raises(FileFormatError, match=words) as caught:
        read_argoverse2_boxes(path)
    assert "a.feather" in str(caught.value)


def test_missing_columns_and_cut_files_are_refused(tmp_path: Path) -> None:
    bare = {name: value for name, value in ROW.items() if name != "log_id"}
    with pytest.raises(FileFormatError, match="none of log_id"):
        read_argoverse2_boxes(write(tmp_path / "a.feather", [bare]))
    path = write(tmp_path / "b.feather", [ROW] * 50)
    data = path.read_bytes()
    for end in range(0, len(data), 97):
        path.write_bytes(data[:end])
        with pytest.raises(FileFormatError):
            read_argoverse2_boxes(path)


def test_a_real_log_is_scored_in_its_own_categories(shared_real: Path, tmp_path: Path) -> None:
    from farfield.datasets import open_dataset
    from farfield.evaluation import read_detections

    folder = shared_real / "argoverse2" / "val"
    data = open_dataset(folder, classes="argoverse2")
    parts = []
    for index, key in enumerate(data.keys):
        boxes = data[index].boxes
        held = boxes[boxes.point_count > 0]
        parts.append(argoverse2_part(key, held.replace(score=np.ones(len(held)))))
    path = tmp_path / "perfect.feather"
    write_argoverse2_boxes(path, parts)
    result = read_detections(path, folder, format="argoverse2").score("argoverse2")
    assert len(result.settings["classes"]) == 26
    assert result.figures["ap/mean_of_present/cds"] == pytest.approx(1.0)
    assert result.figures["ap/mean_of_present/ate"] == pytest.approx(0.0, abs=1e-9)
    assert result.counts["annotated_out_of_range"] > 0
    assert result.counts["annotated_without_points"] > 0
