"""The frames of K-Radar's sheets: one road in every weather, and what two detectors find there (Figures 8, 21, 22).

The grid's own simulated sets have no camera: a few of their roads are simulated anew with one, by day, in a small set a
weather. Of recorded data, each weather shows a frame of its own, of one kind of road where there is one.
"""

import hashlib
import json
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farfield.datasets import Dataset, open_dataset
from farfield.datasets.base import Indices
from farfield.detectors.runtime import Detector
from farfield.evaluation import detect
from farfield.figures.birds_eye import Window, in_window
from farfield.frame import Boxes, Frame
from farfield.geometry.boxes import BOX_MARGIN_M, count_points_in_boxes
from farfield.inspection.radar_frame import look_at
from farfield.papers.grid import BudgetSettings, SimulatedSet
from farfield.papers.places import DataLocation, simulate
from farfield.papers.radar_sheets import WINDOW_M, RadarSheet, SheetGroup
from farfield.radar.views import PRODUCTS
from farfield.vocabulary.conditions import WEATHERS
from farfield.vocabulary.kradar import REGIONS_M

if TYPE_CHECKING:
    from farfield.jobs.runs import Progress

ROADS = 5
"""Roads that are simulated in every weather; the fullest are shown. The fifth is the preset's second in a town."""
DRY, WET = ("normal", "overcast", "fog"), ("rain", "sleet", "light_snow", "heavy_snow")
"""Weathers of Figures 21 and 22."""
DETECTORS = {"on_radar": ("rtnh", "radar", "RTNH"), "on_lidar": ("pointpillars", "os2-64", "PointPillars")}
"""Run, cloud and name of both detectors of Figures 21 and 22."""
_SENSORS, _TIME, _LIDAR, _REFERENCE = "os2-64,cells,cam-front", "day", "os2-64", "radar"
_TRIED = 8  # frames of a recorded drive
_DIGITS = 8


@dataclass(frozen=True, eq=False)
class SheetFrame:
    """A frame of a data set in the radar's coordinates."""

    data: Dataset
    index: int

    def objects(self, window_m: Window) -> int:
        """Number of annotated objects inside a window."""
        boxes = self.data[self.index].boxes
        return 0 if boxes is None else int(in_window(boxes.centre_m, window_m).sum())


ByWeather = Mapping[str, SheetFrame]


def sheet_places(settings: BudgetSettings, folder: Path) -> dict[str, DataLocation]:
    """The small sets of the sheets by weather: roads of the set whose statistics are taken first, with a camera.

    Args:
        settings: The budget.
        folder: Where simulated sets stand.
    """
    base = settings.sets[settings.statistics_on[0]]
    places: dict[str, DataLocation] = {}
    for weather in WEATHERS:
        changes = {"sequences": min(ROADS, base.sequences), "frames": 1, "sensors": _SENSORS, "weather": weather}
        wanted = base.model_copy(update=changes)
        said = hashlib.sha256(json.dumps([wanted.model_dump(mode="json"), _TIME]).encode()).hexdigest()[:_DIGITS]
        places[weather] = DataLocation(
            path=folder / f"sheets-{weather}-{said}", simulated=wanted, options={"reference": _REFERENCE}
        )
    return places


def simulate_sheet(wanted: SimulatedSet, path: Path, **how: Any) -> None:
    """Simulate the set of one weather, by day; called again it goes on."""
    simulate(wanted, path, time=_TIME, **how)


def measure_sheet(places: Mapping[str, DataLocation], folder: Path) -> float:
    """Core seconds that a frame of the sheets takes; 0 where none is simulated.

    Args:
        places: The places.
        folder: One frame is put there, twice.
    """
    place = next(iter(places.values()), None)
    if place is None or place.simulated is None:
        return 0.0
    one = place.simulated.model_copy(update={"sequences": 1})
    simulate_sheet(one, folder / "sheet-first", workers=1)  # what a process makes once is no frame's
    began = time.process_time()
    simulate_sheet(one, folder / "sheet", workers=1)
    return time.process_time() - began


def provide_sheets(
    places: Mapping[str, DataLocation],
    *,
    workers: int = 0,
    progress: "Progress" = iter,
    report: Callable[[str], object] | None = None,
) -> None:
    """Simulate the frames of the sheets that are not there; arguments as of ``provide``."""
    for place in places.values():
        if place.simulated is not None:
            simulate_sheet(place.simulated, place.path, workers=workers, progress=progress, report=report)


def simulated_moments(places: Mapping[str, DataLocation]) -> list[ByWeather]:
    """The simulated roads, each in every weather; in the order of their names."""
    opened = {weather: place.opened() for weather, place in places.items()}
    roads = sorted({sequence for data in opened.values() for sequence in data.sequences})
    return [
        {
            weather: SheetFrame(data, data.sequences.index(road))
            for weather, data in opened.items()
            if road in data.sequences
        }
        for road in roads
    ]


def recorded_moments(place: DataLocation, windows_m: Sequence[Window]) -> list[ByWeather]:
    """Of a recorded data set the frame of each weather that has most objects, one for each window.

    Frames are of the kind of road that is there in most weathers, where a weather has it. Weathers without a frame that
    holds annotations, LiDAR and radar are left out.

    Args:
        place: The data set.
        windows_m: Where objects count.
    """
    whole = open_dataset(place.path, **{**place.options, "reference": _REFERENCE})
    data = whole.split(place.split) if place.split else whole
    drives = [_candidates(data, indices) for indices in data.drive_indices().values()]
    there = [(data[tried[0]].conditions, tried) for tried in drives if tried]
    pairs = {(conditions.get("road", ""), conditions.get("weather", "")) for conditions, _ in there}
    common = Counter(road for road, _ in sorted(pairs)).most_common(1)
    road = common[0][0] if common else ""
    by_weather: dict[str, list[tuple[bool, Sequence[int]]]] = {weather: [] for weather in WEATHERS}
    for conditions, tried in there:
        by_weather.get(conditions.get("weather", ""), []).append((conditions.get("road") == road, tried))
    return [
        {weather: fullest(_of_road(data, tried), window_m) for weather, tried in by_weather.items() if tried}
        for window_m in windows_m
    ]


def _candidates(data: Dataset, indices: Indices) -> list[int]:
    """Some frames of a drive, spread evenly, that have all that a sheet shows but perhaps the camera."""
    annotated = [int(index) for index in indices if data.has_annotation(int(index))]
    spread = sorted({number * len(annotated) // _TRIED for number in range(_TRIED)}) if annotated else []
    return [annotated[place] for place in spread if _whole(data[annotated[place]])]


def _whole(frame: Frame) -> bool:
    return _LIDAR in frame.clouds and any(product in frame.radar for product in PRODUCTS)


def _of_road(data: Dataset, drives: Sequence[tuple[bool, Sequence[int]]]) -> list[SheetFrame]:
    """Frames of the drives on the common kind of road; of all where there is none on it."""
    chosen = [tried for common, tried in drives if common] or [tried for _, tried in drives]
    return [SheetFrame(data, index) for tried in chosen for index in tried]


def fullest(moments: Sequence[SheetFrame], window_m: Window) -> SheetFrame:
    """The frame with most annotated objects inside a window; among equals the first."""
    return max(moments, key=lambda moment: moment.objects(window_m))


def sheets_of(
    places: Mapping[str, DataLocation], data: DataLocation | None, weights: Mapping[str, Path], settings: BudgetSettings
) -> list[SheetGroup]:
    """The sheets of Figures 8, 21 and 22.

    Args:
        places: The simulated frames by weather.
        data: The user's frames; None takes the simulated ones.
        weights: Weights of the first seed by run; Figures 21 and 22 need both of :data:`DETECTORS`.
        settings: The budget, whose score names the detectors' region and classes.
    """
    x_from, x_to, y_from, y_to, *_ = REGIONS_M[settings.score.settings.get("region", "narrow")]
    corridor: Window = (x_from, x_to, y_from, y_to)
    if data is None:
        whole, narrow = two_roads(simulated_moments(places), corridor)
    else:
        whole, narrow = recorded_moments(data, (WINDOW_M, corridor))
    if not whole:
        return [SheetGroup(title="Figures 8, 21 and 22", words="No annotated frame has both LiDAR and radar.")]
    groups = [_road_by_weather(whole, simulated=data is None)]
    detectors = {side: Detector.load(weights[run]) for side, (run, *_) in DETECTORS.items() if run in weights}
    if len(detectors) < len(DETECTORS):
        names = " and ".join(name for _, _, name in DETECTORS.values())
        words = f"They need {names} of the first seed, which are not finished."
        return [*groups, SheetGroup(title="Figures 21 and 22: two detectors", words=words)]
    labels = tuple(settings.score.settings.get("classes", ()))
    for number, weathers, what in ((21, DRY, "without"), (22, WET, "with")):
        shown = [sheet_of(narrow[weather], detectors) for weather in weathers if weather in narrow]
        if shown:
            groups.append(
                SheetGroup(
                    title=f"Figure {number}: two detectors in weather {what} precipitation",
                    words=_DETECTED,
                    sheets=shown,
                    region_m=corridor,
                    labels=labels or None,
                    detectors={side: name for side, (_, _, name) in DETECTORS.items()},
                )
            )
    return groups


_DETECTED = (
    "Boxes of the detectors of the first seed with a score of 0.3 or more: RTNH above, on the radar, PointPillars "
    "below, on the os2-64. They look inside the dotted corridor alone and learnt vehicles; vehicles there are counted, "
    "found if a box lies within 2 m."
)
_SAME_ROAD = (
    "Simulated, by day: one road of the sets above with the same traffic at the same moment; only the weather differs. "
    "The ice and snow on the LiDAR's window are inputs of the simulation. What neither sensor sees is not annotated."
)
_OWN_ROADS = (
    "Of each weather the frame with most annotated objects among some of every drive, of one kind of road where there "
    "is one."
)


def _road_by_weather(chosen: ByWeather, *, simulated: bool) -> SheetGroup:
    order = [weather for weather in WEATHERS if weather in chosen]
    return SheetGroup(
        title="Figure 8: the same road by weather" if simulated else "Figure 8: roads by weather",
        words=_SAME_ROAD if simulated else _OWN_ROADS,
        sheets=[sheet_of(chosen[weather], {}) for weather in order],
    )


def two_roads(roads: Sequence[ByWeather], corridor: Window) -> tuple[ByWeather, ByWeather]:
    """The road with most objects in view, and of the others that with most inside the corridor.

    The first stands for the second too where no other has half as many objects there.

    Args:
        roads: Roads by weather.
        corridor: Where the detectors look.
    """
    counts = [next(iter(road.values())).objects(WINDOW_M) for road in roads]
    first = counts.index(max(counts))
    rest = [road for place, road in enumerate(roads) if place != first] or list(roads)
    inside = [next(iter(road.values())).objects(corridor) for road in rest]
    second = rest[inside.index(max(inside))]
    enough = next(iter(roads[first].values())).objects(corridor) / 2
    return roads[first], second if max(inside) >= max(enough, 1) else roads[first]


def sheet_of(moment: SheetFrame, detectors: Mapping[str, Detector]) -> RadarSheet:
    """A frame with what its LiDAR has of each object, and what detectors find in it.

    Args:
        moment: The frame.
        detectors: By ``on_radar`` and ``on_lidar``.
    """
    data, index = moment.data, moment.index
    look, cloud = look_at(data, index), data[index].cloud(_LIDAR)
    boxes = Boxes.empty() if look.boxes is None else look.boxes
    found = {side: _found(detectors[side], moment, DETECTORS[side][1]) for side in detectors}
    returns = count_points_in_boxes(cloud.points_m, boxes, margin_m=BOX_MARGIN_M)
    return RadarSheet(look=look, cloud=cloud, returns=returns, **found)


def _found(detector: Detector, moment: SheetFrame, cloud: str) -> Boxes:
    found = detect(detector, moment.data.select([moment.index]), cloud=cloud)
    return next(iter(found.boxes.values()))
