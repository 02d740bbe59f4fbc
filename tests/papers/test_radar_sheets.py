"""Sheets of K-Radar from boxes and maps made by hand."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch")

from farfield.figures.style import ANNOTATED, PREDICTED
from farfield.frame import Boxes, Cloud
from farfield.inspection.radar_frame import RadarLook
from farfield.papers.sheets import LOST, WINDOW_M, RadarSheet, SheetGroup, sheet_picture
from farfield.radar.axes import CUBE_SHAPE
from farfield.radar.views import RadarViews

CORRIDOR = (0.0, 72.0, -6.4, 6.4)


def boxes_at(*places: tuple[float, float], label: str = "vehicle", score: float | None = None) -> Boxes:
    n = len(places)
    return Boxes(
        centre_m=np.array([(x, y, 0.0) for x, y in places]).reshape(-1, 3),
        size_m=np.tile([4.5, 2.0, 1.6], (n, 1)),
        yaw_rad=np.zeros(n),
        label=label,
        score=None if score is None else np.full(n, score),
    )


@pytest.fixture
def sheet(rng: np.random.Generator) -> RadarSheet:
    """Three vehicles and a lorry: the second and the lorry have no return, the third is outside the corridor."""
    heights, across, along = CUBE_SHAPE
    bird, front, side = (
        rng.random(shape, dtype=np.float32) for shape in ((across, along), (heights, across), (heights, along))
    )
    annotated = boxes_at((20, 0), (40, 2), (30, 10), (60, -2))
    annotated = annotated.replace(label=["vehicle", "vehicle", "vehicle", "large_vehicle"])
    look = RadarLook(
        key=("7", "00001_00002"),
        conditions={"weather": "light_snow"},
        views=RadarViews(products=("cells",), bird_db=bird, front_db=front, side_db=side),
        boxes=annotated,
        simulated=True,
    )
    cloud = Cloud(rng.uniform([0, -14, -2], [76, 14, 1], size=(200, 3)).astype(np.float32))
    return RadarSheet(look=look, cloud=cloud, returns=np.array([9, 0, 3, 0]))


def detected(sheet: RadarSheet) -> RadarSheet:
    """The radar finds both vehicles of the corridor, and one of nothing; the LiDAR finds the lorry."""
    on_radar = boxes_at((20.5, 0), (41, 2), (5, 5), (39, 1), score=0.9)
    unsure = on_radar.replace(score=np.array([0.9, 0.9, 0.9, 0.2]))
    return replace(sheet, on_radar=unsure, on_lidar=boxes_at((60, -2), score=0.5))


def test_objects_count_by_class_window_and_returns(sheet: RadarSheet) -> None:
    assert sheet.facts(WINDOW_M) == {"annotated": 4, "without_return": 2}
    assert detected(sheet).facts(CORRIDOR, ("vehicle",)) == {
        "annotated": 2,
        "without_return": 1,
        "on_radar": {"found": 2, "found_without_return": 1, "wrong": 1},
        "on_lidar": {"found": 0, "found_without_return": 0, "wrong": 0},  # a box on a lorry is none of nothing
    }


def test_what_has_no_return_is_dashed_and_detectors_are_drawn_apart(sheet: RadarSheet) -> None:
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_hex

    camera, radar, lidar = sheet_picture(detected(sheet), region_m=CORRIDOR).axes
    assert [text.get_text() for text in camera.texts] == ["no camera image"]
    for axes, predicted in ((radar, 3), (lidar, 1)):
        drawn = [each for each in axes.collections if isinstance(each, PolyCollection)]
        assert [(to_hex(each.get_edgecolor()), len(each.get_paths())) for each in drawn] == [
            (ANNOTATED, 2),
            (LOST, 2),
            (PREDICTED, predicted),
        ]
        dashes = [each.get_linestyle()[0][1] for each in drawn]
        assert dashes[0] is None
        assert dashes[1] is not None
        assert len(axes.patches) == 1  # the corridor
    plain = sheet_picture(sheet)
    assert not plain.axes[1].patches
    assert len(plain.legends[0].get_texts()) == 3


def test_captions_say_what_was_found_and_that_it_is_simulated(sheet: RadarSheet) -> None:
    names = {"on_radar": "RTNH", "on_lidar": "PointPillars"}
    group = SheetGroup(
        title="t", words="w", sheets=[detected(sheet)], region_m=CORRIDOR, labels=("vehicle",), detectors=names
    )
    (picture,) = group.pictures()
    assert picture.heading == "Light snow"
    assert picture.caption == (
        "2 annotated vehicles in the corridor, 1 without any LiDAR return. RTNH finds 2, 1 of those without return; 1 "
        "of its boxes has no object. PointPillars finds none, none of those without return. Simulated: sequence 7, "
        "frame 00001_00002."
    )
    recorded = replace(sheet, look=replace(sheet.look, simulated=False), returns=np.array([1, 1, 1, 1]))
    (other,) = SheetGroup(title="t", words="w", sheets=[recorded]).pictures()
    assert other.caption == (
        "4 annotated objects in view, none without any LiDAR return. Recorded: sequence 7, frame 00001_00002."
    )
