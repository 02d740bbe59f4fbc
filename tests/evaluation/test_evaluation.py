import json
from pathlib import Path

import numpy as np
import pytest

from farfield.errors import FileFormatError
from farfield.evaluation.record import Evaluation, FrameView
from farfield.geometry.boxes import Boxes

PARTS = ("centre_m", "size_m", "yaw_rad", "label", "score", "track_id", "point_count")


def _same(a: Boxes | None, b: Boxes | None) -> bool:
    if a is None or b is None:
        return a is b
    pairs = [(getattr(a, part), getattr(b, part)) for part in PARTS]
    return all((x is None and y is None) or np.array_equal(x, y) for x, y in pairs)


def test_evaluation_survives_the_disk(evaluation: Evaluation, tmp_path: Path) -> None:
    path = evaluation.save(tmp_path / "run")
    for again in (Evaluation.load(path), Evaluation.load(path.parent)):
        assert again.title == evaluation.title
        assert again.results == json.loads(json.dumps(evaluation.results))
        assert again.provenance == evaluation.provenance
        assert again.objects == evaluation.objects
        assert len(again.frames) == len(evaluation.frames)
    for old, new in zip(evaluation.frames, again.frames, strict=True):
        assert new.title == old.title
        assert new.frame.key == old.frame.key
        assert _same(new.frame.boxes, old.frame.boxes)
        assert isinstance(new.predictions, dict)
        assert all(_same(new.predictions[name], boxes) for name, boxes in old.by_cloud.items())
        for name in ("gaussian", "uniform"):
            assert np.array_equal(new.frame.cloud(name).points_m, old.frame.cloud(name).points_m)
        assert new.frame.images["camera"].shape == old.frame.images["camera"].shape
        assert np.array_equal(new.frame.cameras["camera"].matrix, old.frame.cameras["camera"].matrix)


def test_single_predictions_and_none_survive(evaluation: Evaluation, tmp_path: Path) -> None:
    frame, boxes = evaluation.frames[0].frame, evaluation.frames[0].by_cloud["gaussian"]
    views = [FrameView(frame=frame, predictions=boxes), FrameView(frame=frame)]
    Evaluation(results={}, frames=views).save(tmp_path)
    loaded = Evaluation.load(tmp_path).frames
    assert isinstance(loaded[0].predictions, Boxes)
    assert loaded[1].predictions is None
    assert list(loaded[0].by_cloud) == ["gaussian"]


@pytest.mark.parametrize("name", ["../secret", "a/b", "", ".."])
def test_frame_names_cannot_leave_the_folder(evaluation: Evaluation, tmp_path: Path, name: str) -> None:
    path = evaluation.save(tmp_path)
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"frames": [name]}))
    with pytest.raises(FileFormatError, match="frames"):
        Evaluation.load(path)


@pytest.mark.parametrize("damage", ["labels", "clouds", "cache", "camera"])
def test_damaged_frames_give_one_clear_error(evaluation: Evaluation, tmp_path: Path, damage: str) -> None:
    path = evaluation.save(tmp_path)
    frame = tmp_path / "frames" / "0000.json"
    content = json.loads(frame.read_text())
    if damage == "labels":
        content["labels"]["annotated"].pop()
    elif damage == "clouds":
        content["clouds"].append("third")
    elif damage == "camera":
        content["cameras"]["camera"]["matrix"] = [[1, 2], [3, 4]]
    else:
        cache = tmp_path / "frames" / "0000.ffcloud"
        cache.write_bytes(cache.read_bytes()[:-9])
    frame.write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match="0000"):
        Evaluation.load(path)


def test_scores_that_are_not_numbers_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="JSON"):
        Evaluation(results={"a": {"dds": float("nan")}}).save(tmp_path)
    assert not (tmp_path / "evaluation.json").exists()
