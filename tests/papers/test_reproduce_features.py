"""Features before and after: axes and the probe on rows whose answer is known."""

import numpy as np
import pytest

pytest.importorskip("torch")

from farfield.detectors import DETECTORS, build_detector
from farfield.detectors.runtime import Detector
from farfield.frame import Annotation, Boxes, Cloud, Frame
from farfield.papers.feature_maps import principal, probe_accuracy


def clouds(shift: float, count: int = 400) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    second = np.arange(count) % 2 == 1
    return rng.standard_normal((count, 5)) + shift * second[:, None], second, np.arange(count) // 50


def test_the_probe_tells_what_lies_apart_and_nothing_else() -> None:
    assert probe_accuracy(*clouds(3.0)) > 0.98
    assert abs(probe_accuracy(*clouds(0.0)) - 0.5) < 0.1
    values, second, frame = clouds(3.0)
    assert probe_accuracy(values, second & (frame % 2 == 0), frame) is None  # the other frames have one domain only
    constant = np.column_stack([values, np.ones(len(values))])
    assert probe_accuracy(constant, second, frame) > 0.98


def test_axes_are_those_of_most_variance_whatever_the_unit() -> None:
    rng = np.random.default_rng(1)
    along = rng.standard_normal(500)
    values = np.column_stack([along, along + 0.01 * rng.standard_normal(500), 0.3 * rng.standard_normal(500)])
    axes = principal(values * np.array([1.0, 1000.0, 1.0]))
    assert abs(np.corrcoef(axes[:, 0], along)[0, 1]) > 0.999
    assert axes[:, 0].var() > axes[:, 1].var()
    assert np.allclose(principal(values), principal(values.copy()))


def test_features_are_those_of_cells_with_points() -> None:
    from farfield.adaptation.probes import occupied_features

    config = DETECTORS["pointpillars"].config_class(
        grid={"range_m": 32.0, "half_width_m": 8.0, "cell_m": 0.5}, widths=(8, 8, 8), depths=(0, 0, 0), neck_width=8
    )
    detector = Detector(build_detector(config, seed=0), precision="fp32")
    points = np.array([[5.2, 0.1, 0.0], [5.3, 0.1, 0.0], [20.2, -3.1, 0.0]], dtype=np.float32)
    frame = Frame.of(Cloud(points, np.zeros(3, dtype=np.float32)), Annotation(boxes=Boxes.empty()))
    seen = occupied_features(detector, [frame, frame], next(iter(frame.clouds)))
    assert seen.values.shape == (4, detector.network.channels)
    assert seen.frame.tolist() == [0, 0, 1, 1]
    assert sorted(set(np.round(seen.range_m).tolist())) == pytest.approx([5.0, 20.0], abs=2.0)
