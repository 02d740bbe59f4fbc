"""Errors that all matched pairs share are named with their size, by files and by ``ff.evaluate`` alike."""

import re
from collections.abc import Callable

import numpy as np
import pytest

import farfield as ff
from farfield.frame import Boxes, Frame
from farfield.geometry.poses import pose_from_yaw
from farfield.metrics.sanity import one_sided

By = dict[tuple[str, str], Boxes]
KINDS = np.array([[4.5, 1.9, 1.6], [4.2, 1.8, 1.5], [5.1, 2.1, 1.9]])


def _labels(frames: int = 10, count: int = 9, seed: int = 0) -> By:
    rng = np.random.default_rng(seed)
    made = {}
    for number in range(frames):
        x, y = np.tile([12.0, 40.0, 75.0], 3), np.repeat([-12.0, 0.0, 12.0], 3)
        centre_m = np.column_stack([x, y, np.full(count, -0.9)]) + rng.uniform(-4, 4, (count, 3)) * [1, 1, 0.05]
        made["drive", f"{number:03d}"] = Boxes(
            centre_m=centre_m,
            size_m=KINDS[rng.integers(0, 3, count)],
            yaw_rad=rng.uniform(-3, 3, count),
            label="vehicle",
        )
    return made


def _good(labels: By, seed: int = 1) -> By:
    """Predictions with the errors of a good detector."""
    rng, made = np.random.default_rng(seed), {}
    for key, boxes in labels.items():
        made[key] = boxes.replace(
            centre_m=boxes.centre_m + rng.normal(0, 0.12, boxes.centre_m.shape),
            size_m=boxes.size_m * np.exp(rng.normal(0, 0.03, boxes.size_m.shape)),
            yaw_rad=boxes.yaw_rad + rng.normal(0, np.deg2rad(2), len(boxes)),
            score=rng.uniform(0.3, 1, len(boxes)),
        )
    return made


def _notes(predictions: By, labels: By) -> tuple[str, ...]:
    frames = [
        Frame.of(np.zeros((1, 4)), boxes, sequence=sequence, frame_id=frame)
        for (sequence, frame), boxes in labels.items()
    ]
    return ff.evaluate(predictions, frames, region="none", range_bins_m=(0, 250)).notes


def _each(change: Callable[[Boxes], Boxes]) -> Callable[[By], By]:
    return lambda boxes: {key: change(part) for key, part in boxes.items()}


def _half(change: Callable[[Boxes], np.ndarray]) -> Callable[[Boxes], Boxes]:
    def changed(boxes: Boxes) -> Boxes:
        size_m = np.array(boxes.size_m)
        size_m[::2] = change(boxes)[::2]
        return boxes.replace(size_m=size_m)

    return changed


def _shift(*offset_m: float) -> Callable[[By], By]:
    return _each(lambda boxes: boxes.replace(centre_m=boxes.centre_m + np.array(offset_m)))


def _swapped(boxes: By) -> By:
    first, second = ("drive", "002"), ("drive", "007")
    return {**boxes, first: boxes[second], second: boxes[first]}


WRONG = {
    "x": (_shift(1.5, 0, 0), r"stand \+1\.[45]\d m in x"),
    "left": (_shift(0, -2.5, 0), r"moved by [-+]0\.\d m in x and \+2\.5 m in y"),
    "z": (_shift(0, 0, 1.7), r"\+1\.[67]\d m in z"),
    "turned": (_each(lambda b: b.transform(pose_from_yaw(np.deg2rad(3)))), r"turned by -3\.0 degrees about"),
    "headings": (
        _each(lambda b: b.replace(yaw_rad=b.yaw_rad - np.deg2rad(3))),
        r"error of the predicted boxes: -3\.\d deg",
    ),
    "rear": (
        _each(
            lambda b: b.replace(
                centre_m=b.centre_m
                - b.size_m[:, :1] / 2 * np.column_stack([np.cos(b.yaw_rad), np.sin(b.yaw_rad), 0 * b.yaw_rad])
            )
        ),
        r"-2\.\d\d m ahead",
    ),
    "feet": (_each(lambda b: b.replace(size_m=b.size_m / 0.3048)), r"3\.\d+ times .* predicted sizes are in feet"),
    "places in feet": (_each(lambda b: b.replace(centre_m=b.centre_m / 0.3048)), "feet"),
    "long": (_each(lambda b: b.replace(size_m=b.size_m * [1.3, 1, 1])), r"length 1\.\d+ times"),
    "half swapped": (
        _each(_half(lambda b: b.size_m[:, [1, 0, 2]])),
        r"in \d+ of \d+ pairs the predicted length and width",
    ),
    "height": (_each(lambda b: b.replace(size_m=b.size_m[:, [0, 2, 1]])), r"predicted width and height"),
    "rolled": (_each(lambda b: b.replace(size_m=b.size_m[:, [2, 0, 1]])), "exchanged"),
    "frames": (_swapped, r"boxes of frame drive 002 lie on the annotated ones of frame drive 007"),
    "missing": (
        lambda b: {key: part for key, part in b.items() if int(key[1]) % 2},
        "5 of 10 frames with annotated boxes",
    ),
}


def _frames_moved(boxes: By) -> By:
    moved = _shift(1.5, 0, 0)(boxes)
    return {key: moved[key] if int(key[1]) % 2 else part for key, part in boxes.items()}


def _frames_in(order: Callable[[int], int]) -> Callable[[By], By]:
    return lambda boxes: {key: boxes["drive", f"{order(int(key[1])):03d}"] for key in boxes}


def _dense(boxes: Boxes) -> Boxes:
    near = boxes.replace(centre_m=boxes.centre_m + np.array([0.3, 0.1, 0]))
    return Boxes.concatenate([boxes, near.replace(score=boxes.score * 0.9)])


def _first_worst(boxes: By) -> By:
    """False alarms with the scores of the best, and boxes that are right with low ones."""
    return {
        key: Boxes.concatenate(
            [
                part.replace(score=1 - part.score),
                part.replace(centre_m=part.centre_m + np.array([4, 4, 0]), score=part.score),
            ]
        )
        for key, part in boxes.items()
    }


PITCH = np.eye(4)
PITCH[:3, :3] = [[np.cos(0.02), 0, np.sin(0.02)], [0, 1, 0], [-np.sin(0.02), 0, np.cos(0.02)]]
BROTHERS = {
    "factor": (_each(lambda b: b.replace(centre_m=b.centre_m * 1.03)), r"1\.03 times as far from the sensor"),
    "cells": (_each(lambda b: b.replace(centre_m=b.centre_m * 6)), r"multiplied by 0\.16[67]"),
    "x backward": (_each(lambda b: b.replace(centre_m=b.centre_m * [-1, 1, 1])), "x pointed backward"),
    "x and y": (_each(lambda b: b.replace(centre_m=b.centre_m[:, [1, 0, 2]])), "x and y were exchanged"),
    "far": (_shift(8, 0, 0), r"moved by -8\.0 m in x"),
    "a third of a turn": (_each(lambda b: b.transform(pose_from_yaw(2.1))), r"turned by -120\.\d degrees about"),
    "pitch": (_each(lambda b: b.transform(PITCH)), r"rise by -1\.\d degrees along x"),
    "some frames": (_frames_moved, r"in 5 of 10 frames .* motion of the frame's own"),
    "backwards": (_frames_in(lambda number: 9 - number), "opposite order"),
    "two later": (_frames_in(lambda number: (number + 2) % 10), "of 2 frames before"),
    "any order": (
        _frames_in(lambda number: (3, 7, 0, 9, 1, 8, 5, 2, 6, 4)[number]),
        "frames that were looked at are another's",
    ),
    "one for all": (_frames_in(lambda number: 0), "9 of 10 frames have the predicted boxes of another frame"),
    "45 degrees": (
        _each(lambda b: b.replace(yaw_rad=b.yaw_rad + np.pi / 4)),
        r"median heading error of the predicted boxes: \+4[45]\.\d deg",
    ),
    "degrees": (_each(lambda b: b.replace(yaw_rad=np.rad2deg(b.yaw_rad))), "headings bear no relation"),
    "one heading": (_each(lambda b: b.replace(yaw_rad=0 * b.yaw_rad)), "have one heading"),
    "one size": (
        _each(lambda b: b.replace(size_m=0 * b.size_m + [4.5, 1.9, 1.6])),
        "one length, one width, one height",
    ),
    "whole metres": (_each(lambda b: b.replace(centre_m=np.rint(b.centre_m))), "predicted x, y are whole numbers"),
    "not suppressed": (_each(_dense), r"stand within a better one of their class"),
    "left": (_each(lambda b: b[b.centre_m[:, 1] > 0]), "no predicted box lies to the right"),
    "no boxes": (lambda b: {k: p if int(k[1]) % 2 else p[:0] for k, p in b.items()}, "5 of 10 frames .* no predicted"),
    "scores": (_first_worst, "has the higher score in"),
    "yes or no": (_each(lambda b: b.replace(score=np.rint(b.score))), "have 2 scores"),
    "numbered": (_each(lambda b: b.replace(label="3")), "relabel=3:vehicle counts them as it"),
}


@pytest.mark.parametrize("name", BROTHERS)
def test_brothers_of_those_errors_are_named(name: str) -> None:
    change, words = BROTHERS[name]
    notes = _notes(change(_good(_labels())), _labels())
    assert any(re.search(words, note) for note in notes), notes


@pytest.mark.parametrize(
    ("settings", "noted"),
    [
        ({"region": "none"}, True),
        ({"region": "window", "window_m": (0, "inf", -50, 50), "range_bins_m": (0, 250)}, False),
        ({"region": "window", "window_m": (-50, 250, -50, 50), "range_bins_m": (0, "inf")}, True),
        ({"region": "wide"}, False),
        ({"region": [0.0, 72.0, -16.0, 16.0, -2.0, 7.6]}, False),
        ({"region": "range", "range_bins_m": (400, 500)}, False),
        ({}, True),
    ],
)
def test_a_side_without_boxes_is_named_where_it_is_scored(settings: dict[str, object], noted: bool) -> None:
    """A detector that looks ahead was asked for the side behind, which its score leaves out."""
    around = {
        (key[0], f"{key[1]}{side}"): boxes.transform(pose_from_yaw(turn))
        for key, boxes in _labels().items()
        for side, turn in (("a", 0.0), ("b", np.pi))
    }
    ahead = {key: boxes[boxes.centre_m[:, 0] > 0] for key, boxes in around.items()}
    notes = list(one_sided(ahead, around, settings))
    assert any("behind the sensor" in note for note in notes) == noted, notes


@pytest.mark.parametrize("noise_m", [0.6, 1.5])
@pytest.mark.parametrize("seed", range(4))
def test_bad_predictions_are_not_called_wrong_ones(seed: int, noise_m: float) -> None:
    labels, rng = _labels(seed=seed), np.random.default_rng(seed)
    bad = {
        key: b.replace(centre_m=b.centre_m + rng.normal(0, noise_m, b.centre_m.shape) * [1, 1, 0.3])
        for key, b in _good(labels, seed + 100).items()
    }
    assert not [note for note in _notes(bad, labels) if "aIoU" not in note and "AP there" not in note]


@pytest.mark.parametrize("name", WRONG)
def test_a_systematic_error_is_named_with_its_size(name: str) -> None:
    change, words = WRONG[name]
    notes = _notes(change(_good(_labels())), _labels())
    assert any(re.search(words, note) for note in notes), notes


@pytest.mark.parametrize("seed", range(8))
def test_good_predictions_have_no_such_note(seed: int) -> None:
    labels = _labels(seed=seed)
    assert _notes(_good(labels, seed + 100), labels) == ()
    few = {key: boxes[np.arange(len(boxes)) % 3 > 0] for key, boxes in _good(labels, seed).items()}
    assert _notes(few, labels) == ()


def test_labels_that_stand_twice_are_said() -> None:
    labels = _labels()
    twice = {key: Boxes.concatenate([boxes, boxes]) for key, boxes in labels.items()}
    assert any("90 of 180 annotated boxes stand there twice" in note for note in _notes(_good(labels), twice))


def test_one_class_by_two_names_is_said_on_either_side() -> None:
    labels = _labels()
    half = {key: b.replace(label=["Car", "vehicle", "Car"] * 3) for key, b in labels.items()}
    assert any("relabel=Car:vehicle" in note for note in _notes(_good(labels), half))
    assert any("predicted boxes are" in note for note in _notes(_good(half), labels))
    apart = {key: b.replace(label=["truck", "bus", "bus"] * 3) for key, b in labels.items()}
    assert _notes(_good(apart), apart) == ()


def test_real_detections_lie_in_frames_of_their_own(real_detections) -> None:
    detections, _ = real_detections
    words = ("exchanged", "turned", "stand ", "times the annotated", "factor")
    assert not [note for note in detections.notes if any(word in note for word in words)]
