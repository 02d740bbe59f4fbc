"""A simulated KITTI data set: read back by the KITTI reader, scored by KITTI's protocol, resumed to the same bytes."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("embreex")

from farfield.datasets import open_dataset
from farfield.datasets.kitti.object import Kitti
from farfield.errors import FarfieldError
from farfield.geometry.boxes import wrap_angle_rad
from farfield.metrics import Detections
from farfield.simulation import simulate_frame
from farfield.simulation.recording import record


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in (folder / "training").rglob("*.*")}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("kitti") / "mini"
    assert record("kitti-sim-mini", out, workers=1).verdicts == ("written",) * 4
    return out


def test_it_is_kitti_and_reads_back_as_simulated(written: Path) -> None:
    data = open_dataset(written)
    assert isinstance(data, Kitti)
    assert data.frame_ids == ("000000", "000001", "001000", "001001")
    frame, expected = data[3], simulate_frame("kitti-sim-mini", sequence=1, index=1)
    np.testing.assert_array_equal(frame.cloud().points_m, expected.cloud().points_m)
    np.testing.assert_array_equal(frame.cloud().intensity, expected.cloud().intensity)
    found, drawn = frame.annotation, expected.annotation
    assert found is not None
    assert drawn is not None
    assert len(found) == len(drawn) > 3
    np.testing.assert_allclose(found.boxes.centre_m, drawn.boxes.centre_m, atol=1e-9)
    np.testing.assert_allclose(found.boxes.size_m, drawn.boxes.size_m, atol=1e-9)
    np.testing.assert_allclose(wrap_angle_rad(found.boxes.yaw_rad - drawn.boxes.yaw_rad), 0, atol=1e-9)
    np.testing.assert_array_equal(found.boxes.label, drawn.boxes.label)
    assert found.extent == drawn.extent == "full"
    np.testing.assert_array_equal(found.details["occlusion"], drawn.details["occlusion"])
    np.testing.assert_allclose(found.details["box_px"], drawn.details["box_px"], atol=1e-6)
    np.testing.assert_allclose(found.details["truncation"], drawn.details["truncation"], atol=1e-5)
    one, other = frame.cameras["camera"], expected.cameras["camera"]
    np.testing.assert_array_equal(one.matrix, other.matrix)
    np.testing.assert_allclose(one.camera_T_lidar, other.camera_T_lidar)
    assert (one.width_px, one.height_px) == (other.width_px, other.height_px)


def test_kittis_protocol_scores_it_by_difficulty(written: Path) -> None:
    data = open_dataset(written)
    annotations = {frame.key: frame.annotation for frame in data if frame.annotation is not None}
    perfect = {key: a.boxes.replace(score=np.ones(len(a))) for key, a in annotations.items()}
    details = {key: {"box_px": a.details["box_px"]} for key, a in annotations.items()}
    found = Detections(boxes=perfect, annotations=annotations, prediction_details=details)
    result = found.score("kitti", label="vehicle")
    assert result.counts["annotated"] > 10
    for difficulty in ("moderate", "hard"):
        # KITTI samples fewer than 41 recalls where fewer than 41 boxes must be found
        assert (result.figures[f"ap/3d_r40/{difficulty}"] or 0) > 0.9
    worst = Detections(boxes={}, annotations=annotations).score("kitti", label="vehicle")
    assert worst.figures["ap/3d_r40/moderate"] == 0.0


def test_whole_drives_are_held_out(written: Path) -> None:
    data = open_dataset(written)
    assert (written / "ImageSets" / "train.txt").read_text().split() == ["000000", "000001"]
    assert [frame.frame_id for frame in data.split("val")] == ["001000", "001001"]


def test_resumed_it_has_the_same_bytes(written: Path) -> None:
    before = contents(written)
    assert len(before) == 12
    (written / "training" / "label_2" / "001000.txt").unlink()
    assert record("kitti-sim-mini", written, workers=1).verdicts == ("written",)
    assert contents(written) == before


def test_without_a_cloud_there_is_no_kitti(tmp_path: Path) -> None:
    with pytest.raises(FarfieldError, match="expected lidar among them"):
        record("kitti-sim-mini", tmp_path / "none", sensors="camera", workers=1)
    with pytest.raises(FarfieldError, match="expected some of lidar, camera"):
        record("kitti-sim-mini", tmp_path / "none", sensors="gaussian")
