"""How far an exported file and its network agree, output by output and box by box."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from farfield.detectors.exporting.graphs import Graph
from farfield.detectors.onnx.detector import OnnxDetector
from farfield.detectors.onnx.readings import Reading, Tensors
from farfield.detectors.runtime import Detector
from farfield.detectors.trained import cloud_rows
from farfield.frame import Cloud
from farfield.geometry.boxes import Boxes, wrap_angle_rad

PARITY, SAME_SHARE, SAME_M, SAME_RAD = 1e-5, 0.999, 1e-3, 1e-4
"""Largest difference of an output to the largest number of it; share of boxes that agree, and within what."""


@dataclass(frozen=True)
class CloudParity:
    """How far file and network agree on one cloud.

    Args:
        cloud: Its name.
        points: Its points.
        largest: Largest difference of an output over the largest number of it, with and without graph optimisation.
        boxes: Boxes that the network gives.
        same: Share of them that the file gives too.
    """

    cloud: str
    points: int
    largest: float
    boxes: int
    same: float

    @property
    def holds(self) -> bool:
        """Whether they agree as well as they must; one box at the edge of a threshold may differ."""
        return self.largest <= PARITY and (self.same >= SAME_SHARE or round((1 - self.same) * self.boxes) <= 1)


def ask(graph: Graph, blank: Mapping[str, Any], notes: list[Tensors], tensors: Tensors) -> Tensors:
    """Ask the network in PyTorch as the file is asked, and note what went in."""
    notes.append(tensors)
    with torch.no_grad():
        outputs = graph({name: torch.from_numpy(values) for name, values in filled(tensors, blank).items()})
    return {name: values.numpy() for name, values in zip(graph.outputs, outputs, strict=True)}


def filled(tensors: Tensors, blank: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Inputs in the order of the graph's; those of its other half have no rows."""
    none = {name: np.zeros((0, *sides), dtype=dtype) for name, (dtype, sides) in blank.items() if name not in tensors}
    return {name: np.ascontiguousarray(tensors[name]) if name in tensors else none[name] for name in blank}


def blank_inputs(reading: Reading, graph: Graph) -> dict[str, tuple[str, tuple[int, ...]]]:
    """Number type and sides of every input, also of those that the weights decide."""
    network: Any = getattr(graph, "network", None)
    widths = {} if network is None else {"map": network.channels, "semantic": network.channels}
    if network is not None:
        widths["extra"] = 4 + len(network.config.class_names)
    blank = reading.blank().items()
    return {
        name: (dtype, tuple(widths[name] if side is None else side for side in sides)) for name, (dtype, sides) in blank
    }


def compared(name: str, cloud: Cloud, detector: Detector, graph: Graph, files: tuple[OnnxDetector, ...]) -> CloudParity:
    """Compare a cloud's outputs, input by input the same, and its boxes from end to end."""
    reading, notes, answers = files[0].record.reading, list[Tensors](), list[Tensors]()
    points = cloud_rows(cloud, reading.columns)
    blank = blank_inputs(reading, graph)
    reading.detect(points, partial(_noted, partial(ask, graph, blank, notes), answers))
    largest = 0.0
    for tensors, answer in zip(notes, answers, strict=True):
        for file in files:
            largest = max(largest, _difference(answer, file.run(tensors)))
    expected, got = detector(cloud), files[0](cloud)
    return CloudParity(name, len(cloud), largest, len(expected), same_share(expected, got))


def _noted(answer: Any, answers: list[Tensors], tensors: Tensors) -> Tensors:
    answers.append(answer(tensors))
    return answers[-1]


def _difference(expected: Tensors, got: Tensors) -> float:
    """Largest difference of an output over its largest number; infinite where the outputs are not of one kind.

    Which candidates are chosen may differ where their scores are equal within rounding, as on an empty map; those that
    both chose are compared, anchor by anchor. Of decoded boxes one in a thousand may differ: a number on the edge
    between two bins or headings falls to either side.
    """
    rows = {name: (expected[name], got[name]) for name in got}
    if "index" in rows:
        _, ours, theirs = np.intersect1d(*rows.pop("index"), return_indices=True)
        scores = rows["scores"]
        alone = np.concatenate([np.delete(scores[0], ours), np.delete(scores[1], theirs)])
        if alone.max(initial=0.0) > max(scores[0].min(), scores[1].min()) + PARITY * max(scores[0].max(), 1e-6):
            return float("inf")
        rows = {name: (one[ours], other[theirs]) for name, (one, other) in rows.items()}
    largest = 0.0
    for name, (one, other) in rows.items():
        if one.shape != other.shape:
            return float("inf")
        if not one.size or one.dtype.kind != "f":
            continue
        away = np.abs(one.astype(np.float64) - other)
        if name in ("boxes", "proposed"):  # a yaw of pi is one of -pi
            away[:, 6] = np.abs(wrap_angle_rad(one[:, 6].astype(np.float64) - other[:, 6]))
            away = np.sort(away.max(1))[: int(np.ceil(SAME_SHARE * len(away)))]
        largest = max(largest, float(away.max() / max(float(np.abs(one).max()), 1e-6)))
    return largest


def same_share(expected: Boxes, got: Boxes) -> float:
    """Share of boxes that stand among others too, within 1 mm and 1e-4 rad, of one label; 1 where there are none.

    Args:
        expected: Boxes.
        got: The others; where they are more, the share is of them.
    """
    most = max(len(expected), len(got))
    if not most:
        return 1.0
    if not min(len(expected), len(got)):
        return 0.0
    one, other = _numbers(expected), _numbers(got)
    away = np.abs(one[:, None, :6] - other[None, :, :6]).max(2)
    turned = np.abs(wrap_angle_rad(one[:, None, 6] - other[None, :, 6]))
    alike = np.asarray(expected.label)[:, None] == np.asarray(got.label)[None]
    return float(((away <= SAME_M) & (turned <= SAME_RAD) & alike).any(1).sum() / most)


def _numbers(boxes: Boxes) -> Float[np.ndarray, "n 7"]:
    return np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad])
