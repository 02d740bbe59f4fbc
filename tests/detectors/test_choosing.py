"""Which of its boxes a detector keeps, chosen without training it again."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from small import small_detector

import farfield
from farfield.detectors.runtime import Detector
from farfield.errors import ConfigError
from farfield.frame import Cloud

SHIPPED = "pointpillars-cirrus-sim"


@pytest.fixture(scope="module")
def points() -> Cloud:
    """Three cars' worth of points on a plane."""
    rng = np.random.default_rng(4)
    ground = np.column_stack([rng.uniform(3, 60, 4000), rng.uniform(-12, 12, 4000), rng.normal(-2, 0.03, 4000)])
    cars = [rng.uniform(-1, 1, (400, 3)) * [2.2, 0.9, 0.75] + [x, y, -1.2] for x, y in ((12, 0), (25, 4), (40, -5))]
    return Cloud(np.concatenate([ground, *cars]).astype(np.float32))


def loaded(**options) -> Detector:
    return farfield.load_detector(SHIPPED, device="cpu", precision="fp32", **options)


def test_a_lower_and_a_higher_threshold_both_count(points):
    usual, eager, strict = (loaded(**o)(points) for o in ({}, {"score_threshold": 0.01}, {"score_threshold": 0.3}))
    assert len(eager) > len(usual) > len(strict) > 0
    assert 0.01 <= eager.score.min() < 0.05 <= usual.score.min()
    assert strict.score.min() >= 0.3
    assert loaded(score_threshold=0.3).config.score_threshold == 0.3


def test_overlap_and_number_of_boxes_count(points):
    usual, crowded = loaded()(points), loaded(nms_iou=0.9)(points)
    assert len(crowded) > len(usual)
    assert len(loaded(max_boxes=2)(points)) == 2


def test_classes_are_chosen_and_renamed(points):
    every = loaded(score_threshold=0.01)(points)
    some = loaded(score_threshold=0.01, classes=["pedestrian"])
    assert some.class_names == ("pedestrian",)
    assert set(some(points).label) == {"pedestrian"} < set(every.label)
    assert len(some(points)) == (every.label == "pedestrian").sum()
    cars = loaded(score_threshold=0.01, classes={"vehicle": "car", "large_vehicle": "car"})
    assert cars.class_names == ("car",)
    assert set(cars(points).label) == {"car"}
    assert len(cars(points)) == np.isin(every.label, ["vehicle", "large_vehicle"]).sum()


def test_the_number_counts_boxes_of_the_chosen_classes(points):
    every = loaded(score_threshold=0.01)(points)
    rare = next(name for name in ("pedestrian", "bicycle") if name in set(every.label))
    assert every.label[0] != rare, "the best box is of another class"
    first = loaded(score_threshold=0.01, classes=(rare,), max_boxes=1)(points)
    assert len(first) == 1
    assert first.score[0] == every.score[every.label == rare][0]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"classes": ("car",)}, "vehicle, large_vehicle, pedestrian, bicycle"),
        ({"classes": ()}, "at least one class"),
        ({"score_threshold": 1.5}, "score_threshold"),
        ({"nms_iou": -0.1}, "nms_iou"),
        ({"max_boxes": 0}, "max_boxes"),
    ],
)
def test_what_cannot_be_is_refused(options, words):
    with pytest.raises(ConfigError, match=words):
        loaded(**options)


def test_a_changed_configuration_is_refused():
    detector = loaded()
    changed = detector.config.model_copy(update={"score_threshold": 0.9})
    for owner in (detector, detector.network):
        with pytest.raises(ConfigError, match=r"load_detector\(.*score_threshold="):
            owner.config = changed
    assert detector.network.config.score_threshold == 0.05


def test_what_is_kept_decides_the_identity(points):
    usual = loaded()
    assert usual.digest() == loaded().digest()
    others = [loaded(**o).digest() for o in ({"max_boxes": 3}, {"classes": ["vehicle"]}, {"score_threshold": 0.2})]
    assert len({usual.digest(), *others}) == 4


@pytest.mark.parametrize("name", ["pointpillars", "pointrcnn", "rtn", "rtnh", "second", "sparsecentre", "voxelnet"])
def test_every_detector_takes_them(name):
    limits = {"score_threshold": 0.77, "nms_iou": 0.31, "max_boxes": 7}
    kept = Detector(small_detector(name), device="cpu", precision="fp32", **limits)
    holders = [module.config for module in kept.network.modules() if hasattr(module, "config")]
    holders = [config for config in holders if hasattr(config, "score_threshold")]
    assert holders
    assert {(each.score_threshold, each.nms_iou, each.max_boxes) for each in holders} == {(0.77, 0.31, 7)}


def test_repr_says_what_it_is():
    said = repr(loaded())
    for word in ("pointpillars-cirrus-sim", "pointpillars", "vehicle, large_vehicle, pedestrian, bicycle", "250 m"):
        assert word in said
    assert "score" in said
    assert "car" in repr(loaded(classes={"vehicle": "car"}))
