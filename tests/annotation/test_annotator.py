"""A data set annotated without a browser: opened, boxes added and changed, undone, checked, fitted and saved."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from edited_drives import ANN, CAR

from farfield.annotation.annotator import Annotator, Gesture
from farfield.annotation.edits import add_box, set_box
from farfield.annotation.errors import RefusedError
from farfield.annotation.saving import MARK
from farfield.annotation.store import redo, undo
from farfield.datasets import open_dataset
from farfield.errors import ConfigError
from farfield.frame import Boxes

SEDAN = (4.5, 1.9, 1.6)


def folder_of_sweeps(folder: Path) -> Path:
    """Two sweeps of a car's two sides on flat ground, in the layout of one's own files."""
    folder.mkdir()
    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.uniform(2, 30, (4000, 1)), rng.uniform(-12, 12, (4000, 1)), np.full((4000, 1), -1.7)])
    along, across = np.linspace(-2.2, 2.2, 60), np.linspace(-0.9, 0.9, 30)
    heights = np.linspace(-1.4, -0.2, 8)
    side = np.array([(15 + x, 4.05, z) for x in along for z in heights])
    back = np.array([(12.8, 5 + y, z) for y in across for z in heights])
    points = np.vstack([ground, side, back])
    for number in range(2):
        sweep = np.column_stack([points, np.zeros(len(points))]).astype(np.float32)
        np.save(folder / f"{number:04d}.npy", sweep)
    return folder


def test_a_data_set_is_annotated_without_a_browser(tmp_path: Path):
    with Annotator(open_dataset(folder_of_sweeps(tmp_path / "own")), extent="full", out=tmp_path / "out") as annotator:
        store, key = annotator.store, annotator.store.keys[0]
        # add a box where a click finds the car, and shift it to where it is wrong
        fit = annotator.fit(0, Gesture(kind="click", at=(13.5, 4.2), class_name="vehicle"))
        assert np.hypot(fit.box[0] - 15, fit.box[1] - 5) < 0.5
        value = {"label": "vehicle", "box": list(fit.box), "state": "edited"}
        store.edit(ANN, "e1", "box.add", partial(add_box, key=key, name="n1", value=value)).saved.result(5)
        assert annotator.check(0) == []
        base = store.row(key, "n1").version
        lifted = [*fit.box[:2], fit.box[2] + 1, *fit.box[3:]]
        store.edit(ANN, "e2", "box.set", partial(set_box, key=key, name="n1", base=base, value={"box": lifted}))
        assert {issue.check for issue in annotator.check(0)} >= {"ground"}
        # take the shift back, do it again, take it back
        undo(store, ANN, "u1")
        redo(store, ANN, "u2")
        undo(store, ANN, "u3")
        assert store.row(key, "n1").label.box == pytest.approx(fit.box)
        # save, in the usual folder and in another format
        summary = annotator.save(ANN, "s1")
        assert (summary.files, summary.folder) == (1, "out")
        (labels,) = (path for path in (tmp_path / "out").rglob("*") if path.is_file() and path.name != MARK)
        assert "vehicle" in labels.read_text()
        assert annotator.save(ANN, "s2", format="openlabel").folder == "labels-openlabel"
        with pytest.raises(ConfigError, match="name of a folder"):
            annotator.save(ANN, "s3", folder="..")


def test_what_was_annotated_is_there_when_it_is_opened_again(tmp_path: Path):
    data = open_dataset(folder_of_sweeps(tmp_path / "own"))
    value = {"label": "vehicle", "box": CAR, "state": "edited"}
    with Annotator(data, extent="full") as annotator:
        plan = partial(add_box, key=annotator.store.keys[1], name="n1", value=value)
        annotator.store.edit(ANN, "e1", "box.add", plan)
    with Annotator(data) as annotator:
        assert [row.label.box for row in annotator.store.rows(annotator.store.keys[1])] == [tuple(CAR)]
        assert undo(annotator.store, ANN, "u1").record.changes[0].new is None
    with pytest.raises(RefusedError, match=r"declare|said"), Annotator(data, edits=tmp_path / "other") as annotator:
        annotator.store.edit(ANN, "e1", "box.add", partial(add_box, key=annotator.store.keys[0], name="n", value=value))


def test_detections_become_proposals_where_no_box_is(tmp_path: Path):
    with Annotator(open_dataset(folder_of_sweeps(tmp_path / "own")), extent="full") as annotator:
        centres = np.array([[15.0, 5.0, -0.9], [25.0, -5.0, -0.9], [20.0, 0.0, 0.0]])
        labels = ["vehicle", "vehicle", "ship"]
        scores = np.array([0.9, 0.8, 0.7])
        boxes = Boxes(centre_m=centres, size_m=np.tile(SEDAN, (3, 1)), yaw_rad=np.zeros(3), label=labels, score=scores)
        result = annotator.propose(ANN, "p1", 0, boxes, "run")
        assert result is not None
        assert [row.label.state for row in annotator.store.rows(annotator.store.keys[0])] == ["proposed"] * 2
        assert annotator.propose(ANN, "p2", 0, boxes, "run") is None


def test_a_gesture_that_lacks_numbers_is_refused():
    with pytest.raises(ConfigError, match="a drag needs 4 numbers"):
        Gesture(kind="drag", at=(1.0, 2.0), class_name="vehicle")
    with pytest.raises(ConfigError, match="a box and no numbers"):
        Gesture(kind="refit", class_name="vehicle")
