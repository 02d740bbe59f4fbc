"""K-Radar's sheets: which frames are simulated and shown, from end to end, and of data that the user gives."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("torch")
pytest.importorskip("embreex")

from tinygrid import tiny_kradar

from farfield.datasets import open_dataset
from farfield.figures.birds_eye import Window
from farfield.papers import Reproduction, load_grid
from farfield.papers.locations import DataLocation
from farfield.papers.sheets import WINDOW_M, SheetFrame, sheet_locations, sheets_of, two_roads
from farfield.vocabulary.conditions import WEATHERS

CORRIDOR = (0.0, 72.0, -6.4, 6.4)


@pytest.mark.parametrize("budget", list(load_grid("kradar").budgets))
def test_roads_of_the_statistics_are_simulated_anew_with_a_camera(budget: str, tmp_path: Path) -> None:
    settings = load_grid("kradar").budgets[budget]
    locations = sheet_locations(settings, tmp_path)
    assert tuple(locations) == WEATHERS
    base = settings.sets[settings.statistics_on[0]]
    made = [place.simulated for place in locations.values() if place.simulated is not None]
    assert {(each.seed, each.preset, each.frames) for each in made} == {(base.seed, base.preset, 1)}
    assert all(each.sequences <= 5 and "cam-front" in str(each.sensors) for each in made)
    assert [each.weather for each in made] == list(WEATHERS)
    assert len({place.path for place in locations.values()}) == len(WEATHERS)


def test_the_page_alone_shows_them_where_all_is_simulated(tmp_path: Path) -> None:
    assert Reproduction.of("cirrus", out=tmp_path).sheet_locations == {}
    assert Reproduction.of("kradar", out=tmp_path, data=tmp_path).sheet_locations == {}


class Counted(SheetFrame):
    """A moment with so many objects in view and in the corridor."""

    def __init__(self, in_view: int, inside: int) -> None:
        object.__setattr__(self, "counts", {WINDOW_M: in_view, CORRIDOR: inside})

    def objects(self, window_m: Window) -> int:
        return int(self.counts[window_m])


@pytest.mark.parametrize(
    ("counts", "chosen"),
    [
        ([(9, 4), (30, 20), (5, 12), (8, 10)], (1, 2)),  # another road, however few it has in view
        ([(9, 4), (30, 20), (5, 9)], (1, 1)),  # less than half as many inside
        ([(3, 0), (2, 0)], (0, 0)),
        ([(7, 3)], (0, 0)),
    ],
)
def test_the_fullest_road_is_shown_and_another_if_it_is_full_enough(
    counts: list[tuple[int, int]], chosen: tuple[int, int]
) -> None:
    roads = [{"normal": Counted(*each)} for each in counts]
    found = two_roads(roads, CORRIDOR)
    assert tuple(next(n for n, road in enumerate(roads) if road is each) for each in found) == chosen


def summary(out: Path) -> dict[str, Any]:
    return dict(json.loads((out / "reproduction.json").read_text()))


@pytest.mark.slow
@pytest.mark.whole
def test_the_sheets_of_a_tiny_grid(tmp_path: Path) -> None:
    out = tmp_path / "out"
    reproduction = tiny_kradar(out)
    measured = reproduction.outline()
    assert json.loads((out / "measured.json").read_text())["sheet_s"] > 0
    page = reproduction.run().read_text()
    groups = summary(out)["sheets"]
    weathers = [[frame["weather"] for frame in group["frames"]] for group in groups]
    assert weathers == [list(WEATHERS), list(WEATHERS[:3]), list(WEATHERS[3:])]
    assert len({frame["sequence"] for frame in groups[0]["frames"]}) == 1  # one road
    lost = {frame["weather"]: frame["without_return"] for frame in groups[0]["frames"]}
    assert lost["sleet"] > lost["normal"]
    assert all({"on_radar", "on_lidar"} <= set(frame) for group in groups[1:] for frame in group["frames"])
    for words in (
        "Figure 8: the same road by weather",
        "Figure 21: two detectors in weather without precipitation",
        "Figure 22: two detectors in weather with precipitation",
        "Not run at this budget: rtn resnet50, rtn resnext101, rtn mean.",
    ):
        assert words in page, words
    assert page.count("Simulated: sequence") == page.count("data:image/jpeg") == 2 * len(WEATHERS)

    (lost_set,) = out.glob("data/sheets-fog-*")
    shutil.rmtree(lost_set)
    reproduction.run(page_only=True)  # what is lost is simulated anew, to the same
    assert summary(out)["sheets"] == groups
    assert reproduction.outline() == measured

    (recorded,) = out.glob("data/sheets-sleet-*")
    (own,) = sheets_of({}, DataLocation(path=recorded), {}, reproduction.settings)[:1]
    assert own.title == "Figure 8: roads by weather"
    assert [frame["weather"] for frame in own.facts()] == ["sleet"]
    missing = sheets_of({}, DataLocation(path=recorded), {}, reproduction.settings)[1]
    assert "RTNH and PointPillars of the first seed, which are not finished" in missing.words
    boxes = [len(frame.boxes) for frame in open_dataset(recorded, reference="radar") if frame.boxes is not None]
    assert 0 < own.sheets[0].facts(WINDOW_M)["annotated"] <= max(boxes)
