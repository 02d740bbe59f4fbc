import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partialmethod
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from farfield.errors import ConfigError, FileFormatError
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
    frame = next((tmp_path / "frames").glob("*0000.json"))
    content = json.loads(frame.read_text())
    if damage == "labels":
        content["labels"]["annotated"].pop()
    elif damage == "clouds":
        content["clouds"].append("third")
    elif damage == "camera":
        content["cameras"]["camera"]["matrix"] = [[1, 2], [3, 4]]
    else:
        cache = frame.with_suffix(".ffcloud")
        cache.write_bytes(cache.read_bytes()[:-9])
    frame.write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match="0000"):
        Evaluation.load(path)


def test_scores_that_are_not_numbers_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="JSON"):
        Evaluation(results={"a": {"dds": float("nan")}}).save(tmp_path)
    assert not (tmp_path / "evaluation.json").exists()


def test_an_interrupted_second_evaluation_leaves_the_first_or_is_whole(
    evaluation: Evaluation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped at every file that it writes or removes, as by SIGKILL."""
    frame = evaluation.frames[0].frame
    boxes = evaluation.frames[0].by_cloud["gaussian"]
    assert boxes is not None
    moved = [FrameView(frame=frame, predictions={"gaussian": boxes.replace(centre_m=boxes.centre_m + 1)})]
    second = Evaluation(results=evaluation.results, provenance={"detector": "second"}, frames=moved)
    stops, done = 0, False
    while not done:
        folder = tmp_path / str(stops)
        evaluation.save(folder)
        (folder / "report.html").write_text("page of the first")
        (folder / "timing.json").write_text("{}")
        with monkeypatch.context() as patch:
            _stop_after(patch, stops)
            try:
                second.save(folder)
                done = True
            except KeyboardInterrupt:
                stops += 1
        loaded = Evaluation.load(folder)
        whole = second if loaded.provenance == second.provenance else evaluation
        assert loaded.provenance == whole.provenance
        assert len(loaded.frames) == len(whole.frames)
        for old, new in zip(whole.frames, loaded.frames, strict=True):
            assert all(_same(new.by_cloud[name], boxes) for name, boxes in old.by_cloud.items())
        assert whole is evaluation or not (folder / "report.html").exists()
        assert whole is evaluation or not (folder / "timing.json").exists()
    assert stops >= 4
    names = {path.name[:12] for path in (folder / "frames").iterdir()}
    assert names == {json.loads((folder / "evaluation.json").read_text())["frames"][0]}
    first = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    second.save(folder)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == first


def _stop_after(patch: pytest.MonkeyPatch, count: int) -> None:
    """Let so many files be replaced or removed, and none after them."""
    left = iter(range(count))
    for name in ("replace", "unlink"):
        patch.setattr(Path, name, partialmethod(_change, left, getattr(Path, name)))


def _change(path: Path, left: Iterator[int], own: Callable[..., Any], *args: object, **keywords: object) -> object:
    if (not path.name.endswith(".part") or args) and next(left, None) is None:
        raise KeyboardInterrupt
    return own(path, *args, **keywords)


def test_nobody_else_s_files_are_swept_out(evaluation: Evaluation, tmp_path: Path) -> None:
    """A folder of a film's pictures is called frames too, and its pictures 0001.jpg."""
    own = [tmp_path / "frames" / name for name in ("0001.jpg", "0001.json", "202411270001.jpg", "0000_left.jpg")]
    own[0].parent.mkdir()
    for path in own:
        path.write_bytes(b"somebody's")
    evaluation.save(tmp_path)
    replace(evaluation, title="another").save(tmp_path)
    assert [path.read_bytes() for path in own] == [b"somebody's"] * len(own)
    names = json.loads((tmp_path / "evaluation.json").read_text())["frames"]
    left = {path.name[:12] for path in (tmp_path / "frames").iterdir() if path not in own}
    assert left == set(names)


def test_a_link_in_the_evaluation_s_place_is_refused_before_anything_goes(
    evaluation: Evaluation, tmp_path: Path
) -> None:
    (tmp_path / "report.html").write_text("a page")
    (tmp_path / "aim").write_text("{}")
    (tmp_path / "evaluation.json").symlink_to(tmp_path / "aim")
    with pytest.raises(ConfigError, match="a symbolic link"):
        evaluation.save(tmp_path)
    assert (tmp_path / "report.html").read_text() == "a page"
