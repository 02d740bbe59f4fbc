"""Scores on Open Sweeps: places that were learnt from are named, doubtful objects and those of few points ignored."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import farfield as ff
from farfield.datasets.contents import frame_digests
from farfield.datasets.open_sweeps import INDEX, ROOT, OpenSweeps
from farfield.detectors.info import DetectorInfo
from farfield.evaluation.leakage import leakage_warning, seen_in_training
from farfield.frame import Boxes
from farfield.metrics import score

SIMULATED: dict[str, Any] = {"experiment": {"data": {"simulate": {"preset": "cirrus-sim"}}}}


def test_weights_of_simulated_frames_saw_no_place() -> None:
    data = OpenSweeps()
    assert DetectorInfo(provenance=SIMULATED).open_places == ()
    assert seen_in_training(data, SIMULATED, set(data.keys)) == ("none of the 12 frames, by the places it names", 0)
    assert DetectorInfo().open_places is None
    assert seen_in_training(data, {}, set(data.keys))[1] == 0


@pytest.mark.parametrize(
    "provenance",
    [
        {"open_sweeps": ["corner"]},
        {"streams": {"donors": {"open_sweeps": ["corner"]}, "simulated": {}}},
        {**SIMULATED, "adapted": {"open_sweeps": ["corner"]}},
        {"start": {"open_sweeps": ["corner"]}},
    ],
    ids=["named", "a stream", "adapted", "its start"],
)
def test_weights_that_saw_a_place_are_marked_on_all_its_sweeps(provenance: dict[str, Any]) -> None:
    data = OpenSweeps()
    assert DetectorInfo(provenance=provenance).open_places == ("corner",)
    words, common = seen_in_training(data, provenance, set(data.keys))
    assert (words, common) == ("8 of 12 frames, of the place corner", 8)
    assert "learnt from" in leakage_warning(words, common)[0]
    others = data.split("not-corner")
    assert seen_in_training(others, provenance, set(others.keys)) == ("none of the 4 frames, by the places it names", 0)
    turned = data.split("corner").turned(90)
    assert seen_in_training(turned, provenance, set(turned.keys)) == ("all 8 frames, of the place corner", 8)


def copied(folder: Path, *names: str, location: str) -> OpenSweeps:
    """Sweeps of the package in another folder, at a place of another name."""
    folder.mkdir()
    entries = [e for e in json.loads((ROOT / INDEX).read_text())["open_sweeps"] if e["name"] in names]
    for entry in entries:
        shutil.copy(ROOT / f"{entry['name']}.sweep", folder / f"x-{entry['name']}.sweep")
        entry.update(name=f"x-{entry['name']}", location=location)
    (folder / INDEX).write_text(json.dumps({"open_sweeps": entries}))
    return OpenSweeps(folder)


def test_a_copy_of_other_names_is_recognised_with_its_place(tmp_path: Path) -> None:
    data = OpenSweeps()
    one = data.select([data.frame_ids.index("os-2-32")])
    stream = {"open_sweeps": ["corner"], "frame_digests": " ".join(frame_digests(one))}
    copy = copied(tmp_path / "copy", "os-2-32", "os-1-32", location="elsewhere")
    words, common = seen_in_training(copy, {"streams": {"labelled": stream}}, set(copy.keys))
    assert (words, common) == ("all 4 frames, of the place elsewhere", 4)


def test_places_of_ones_own_sweeps_are_not_those_of_the_package(tmp_path: Path) -> None:
    own = copied(tmp_path / "own", "os-1-128", location="corner")
    assert seen_in_training(own, {"open_sweeps": ["corner"]}, set(own.keys))[1] == 0


def test_both_directions_of_a_sweep_are_one_measurement() -> None:
    digests = frame_digests(OpenSweeps())
    assert digests[0::2] == digests[1::2]
    assert len(set(digests)) == 6
    assert all(digest.startswith("sweep:") for digest in digests)


def boxes(x_m: float, label: str, points: int, score: float | None = None) -> Boxes:
    """One box ahead."""
    centre_m, size_m = np.array([[x_m, 0.0, 0.0]]), np.array([[4.5, 1.8, 1.5]])
    scores = None if score is None else np.array([score])
    counts = np.array([points])
    return Boxes(centre_m=centre_m, size_m=size_m, yaw_rad=np.zeros(1), label=[label], score=scores, point_count=counts)


@pytest.mark.parametrize(("label", "points"), [("vehicle", 4), ("unknown", 4), ("unknown", 40)])
def test_doubtful_and_thin_objects_are_neither_right_nor_wrong_to_find(label: str, points: int) -> None:
    annotated = Boxes.concatenate([boxes(20.0, "vehicle", 50), boxes(40.0, label, points)])
    predicted = Boxes.concatenate([boxes(40.0, "vehicle", 0, 0.9), boxes(20.0, "vehicle", 0, 0.8)])
    result = score({("", "a"): predicted}, {("", "a"): annotated}, protocol="open-sweeps")
    assert result.figures["ap/2.0"] == pytest.approx(1.0)
    assert result.counts["annotated"] == 1
    assert result.counts["ignored"] == 1


def test_an_object_on_the_seam_is_found_once_and_nothing_is_false() -> None:
    ahead, back = ("", "a"), ("", "a-back")
    car, far = boxes(0.286, "vehicle", 50), boxes(20.0, "vehicle", 50)
    annotated = {ahead: Boxes.concatenate([car, far]), back: Boxes.concatenate([boxes(-0.286, "vehicle", 50)])}
    predicted = {
        ahead: Boxes.concatenate([boxes(-0.05, "vehicle", 0, 0.9), boxes(20.0, "vehicle", 0, 0.5)]),
        back: boxes(0.05, "vehicle", 0, 0.9),
    }
    result = score(predicted, annotated, protocol="open-sweeps")
    assert result.figures["ap/2.0"] == pytest.approx(1.0)
    assert (result.counts["annotated"], result.counts["ignored"]) == (2, 1)
    alone = score({ahead: boxes(-1.0, "vehicle", 0, 0.9)}, {ahead: far}, protocol="open-sweeps")
    assert alone.counts["predictions"] == 0


def annotated_boxes(frame: ff.Frame) -> Boxes:
    """A detector that finds what is annotated."""
    assert frame.boxes is not None
    return frame.boxes.replace(score=np.ones(len(frame.boxes)))


def test_a_function_is_scored_by_place() -> None:
    result = ff.evaluate(annotated_boxes, OpenSweeps(), protocol="open-sweeps")
    assert result.protocol == "open-sweeps"
    assert result.figures["ap/2.0"] == pytest.approx(1.0)
    assert result.counts["annotated"] > 60
    assert result.grouped_by == "sequences"
