"""nuScenes' result JSON: what was written is read again, and damaged files are named."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from farfield import cli
from farfield.errors import FileFormatError
from farfield.files.nuscenes import read_results
from farfield.geometry.boxes import Boxes
from farfield.metrics.box_files import read, read_predictions
from farfield.metrics.detections import Detections
from farfield.tracking.writing import write_nuscenes_tracks


def tracks() -> Detections:
    boxes = {}
    for frame in range(6):
        boxes["", f"{frame}"] = Boxes(
            centre_m=np.array([[10.0 + frame, 2, 1], [30, -5 + 0.5 * frame, 1]]),
            size_m=np.array([[4.0, 2, 1.5], [0.6, 0.5, 1.7]]),
            yaw_rad=np.array([0.3, -2.0]),
            label=["car", "pedestrian"],
            score=np.array([0.9, 0.5]),
            track_id=np.array([0, 1]),
            velocity_m_s=np.array([[2.0, 0, 0], [0, 1, 0]]),
        )
    boxes["", "6"] = Boxes.empty(scored=True)
    return Detections(boxes=boxes, annotations={})


def test_what_is_written_is_read_again_and_scores_whole(tmp_path: Path) -> None:
    path = tmp_path / "tracks.json"
    write_nuscenes_tracks(path, tracks())
    again = read_predictions(path, format="nuscenes")
    assert set(again.boxes) == set(tracks().boxes)
    for key, wanted in tracks().boxes.items():
        got = again.boxes[key]
        np.testing.assert_allclose(got.centre_m, wanted.centre_m)
        np.testing.assert_allclose(got.size_m, wanted.size_m)
        np.testing.assert_allclose(got.yaw_rad, wanted.yaw_rad)
        if len(wanted):
            np.testing.assert_array_equal(got.track_id, wanted.track_id)
            assert got.label.tolist() == wanted.label.tolist()
    found = read(path, path, format="nuscenes")
    assert found.score("nuscenes-tracking", label="car").figures["tracking/AMOTA"] == pytest.approx(1.0)
    out = tmp_path / "scores.json"
    arguments = [str(path), str(path), "--format", "nuscenes", "--protocol", "nuscenes-tracking", "--label", "car"]
    assert cli.main(["score", *arguments, "--json", str(out)]) == 0
    assert json.loads(out.read_text())["tracking"]["AMOTP"] == pytest.approx(0.0)


def test_detections_become_tracks(tmp_path: Path) -> None:
    path, out = tmp_path / "tracks.json", tmp_path / "again.json"
    write_nuscenes_tracks(path, tracks())
    text = path.read_text().replace("tracking_name", "detection_name").replace("tracking_score", "detection_score")
    path.write_text(text)
    assert read_predictions(path, format="nuscenes").boxes["", "0"].track_id is None
    arguments = ["track", str(path), "--format", "nuscenes", "--step-s", "0.5", "--out", str(out)]
    assert cli.main(arguments) == 0
    results = read_results(out)
    assert {name for found in results.values() for name in found.track} == {":0", ":1"}


@pytest.mark.parametrize(
    "change",
    [
        {"translation": [1, 2]},
        {"size": [1, -1, 1]},
        {"rotation": [0, 0, 0, 0]},
        {"rotation": None},
        {"tracking_score": "high"},
        {"tracking_score": float("nan")},
        {"translation": [1, 2, 1e30]},
        {"tracking_id": 5},
        {"velocity": [1]},
    ],
)
def test_a_wrong_box_is_named(tmp_path: Path, change: dict[str, Any]) -> None:
    path = tmp_path / "tracks.json"
    write_nuscenes_tracks(path, tracks())
    tree = json.loads(path.read_text())
    tree["results"]["3"][1] |= change
    path.write_text(json.dumps(tree))
    with pytest.raises(FileFormatError, match="sample 3, box 1"):
        read_results(path)


def test_a_velocity_of_nan_is_not_known(tmp_path: Path) -> None:
    """As nuScenes' own tools write it, which is no JSON."""
    path = tmp_path / "tracks.json"
    write_nuscenes_tracks(path, tracks())
    tree = json.loads(path.read_text())
    tree["results"]["3"][1]["velocity"] = [float("nan")] * 2
    path.write_text(json.dumps(tree))
    assert "NaN" in path.read_text()
    assert np.isnan(read_results(path)["3"].velocity_m_s[1]).all()


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"results": []}', '{"results": {"a": 1}}', "[" * 100_000])
def test_what_is_no_result_file_is_said(tmp_path: Path, text: str) -> None:
    path = tmp_path / "tracks.json"
    path.write_text(text)
    with pytest.raises(FileFormatError):
        read_results(path)
