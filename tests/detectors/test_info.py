"""What a detector states of itself, and what is known of a plain function."""

from functools import partial

import pytest

torch = pytest.importorskip("torch")

from small import small_detector

from farfield.detectors.info import DetectorInfo, FunctionDetector, as_detector, describe
from farfield.detectors.runtime import Detector
from farfield.frame import Boxes, Frame

FRAME = Frame(sequence="s", frame_id="0")


def nothing(frame):
    return Boxes.empty(scored=True)


class Thrifty:
    """An object that is called like a function and states some facts."""

    class_names = ("tram",)
    kind = "radar"
    reach_m = 80.0

    def __call__(self, frame):
        return nothing(frame)

    def digest(self):
        return "abc"


def test_a_detector_is_described_by_its_record():
    provenance = {"experiment": {"data": {"clouds": ["os2-64"], "options": {"reference": "radar"}}}}
    network = small_detector("pointpillars", score_threshold=0.2, max_boxes=7)
    detector = Detector(network, provenance=provenance, precision="fp32", device="cpu", name="mine")
    info = describe(detector)
    assert as_detector(detector) is detector
    assert info == DetectorInfo(
        name="mine",
        network="PointPillars",
        classes=tuple(network.config.class_names),
        sensor="lidar",
        columns=detector.columns,
        learnt_clouds=("os2-64",),
        reference="radar",
        reach_m=64.0,
        provenance=provenance,
        precision="fp32",
        score_threshold=0.2,
        nms_iou=network.config.nms_iou,
        max_boxes=7,
    )
    some = Detector(network, precision="fp32", device="cpu", classes={network.config.class_names[0]: "car"})
    assert some.info.classes == ("car",)


def test_of_a_plain_function_only_its_name_is_known():
    detector = as_detector(nothing)
    assert detector.info == DetectorInfo(name="nothing")
    assert detector.digest() is None
    assert detector.with_cloud("lidar") is detector
    assert len(detector(FRAME)) == 0
    assert describe(partial(nothing)) == DetectorInfo()


def test_an_object_says_what_it_knows_and_a_record_overrules_it():
    detector = as_detector(Thrifty())
    assert detector.info == DetectorInfo(classes=("tram",), sensor="radar", reach_m=80.0)
    assert detector.digest() == "abc"
    stated = DetectorInfo(name="mine", classes=("car",))
    assert describe(FunctionDetector(Thrifty(), stated)) is stated
