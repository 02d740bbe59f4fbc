"""The frames of K-Radar's sheets: one road in every weather, and what two detectors find there (Figures 8, 21, 22).

The grid's own simulated sets have no camera: a few of their roads are simulated anew with one, by day, in a small set a
weather. Of recorded data, each weather shows a frame of its own, of one kind of road where there is one.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from farfield.datasets import Dataset
from farfield.datasets.base import Indices
from farfield.detectors.runtime import Detector
from farfield.evaluation import detect
from farfield.figures.birds_eye import Window, in_window
from farfield.frame import Boxes
from farfield.geometry.boxes import BOX_MARGIN_M, count_points_in_boxes
from farfield.inspection.radar_frame import look_at
from farfield.papers.grid import BudgetSettings
from farfield.papers.locations import DataLocation
from farfield.papers.radar_sheets import WINDOW_M, RadarSheet, SheetGroup
from farfield.radar.views import PRODUCTS
from farfield.vocabulary.conditions import WEATHERS
from farfield.vocabulary.kradar import REGIONS_M

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


def sheet_locations(settings: BudgetSettings, folder: Path) -> dict[str, DataLocation]:
    """The small sets of the sheets by weather: roads of the first set of statistics, by day, with a camera.

    Args:
        settings: The budget.
        folder: Where simulated sets stand.
    """
    base = settings.sets[settings.statistics_on[0]]
    locations: dict[str, DataLocation] = {}
    for weather in WEATHERS:
        changes = {"sequences": min(ROADS, base.sequences), "frames": 1, "sensors": _SENSORS, "weather": weather}
        simulated = base.model_copy(update=changes)
        settings_of_set = json.dumps([simulated.model_dump(mode="json"), _TIME])
        digest = hashlib.sha256(settings_of_set.encode()).hexdigest()[:_DIGITS]
        locations[weather] = DataLocation(
            path=folder / f"sheets-{weather}-{digest}",
            simulated=simulated,
            options={"reference": _REFERENCE},
            time=_TIME,
        )
    return locations


def simulated_moments(locations: Mapping[str, DataLocation]) -> list[ByWeather]:
    """The simulated roads, each in every weather; in the order of their names."""
    sets = {weather: location.open() for weather, location in locations.items()}
    roads = sorted({sequence for data in sets.values() for sequence in data.sequences})
    return [
        {
            weather: SheetFrame(data, data.sequences.index(road))
            for weather, data in sets.items()
            if road in data.sequences
        }
        for road in roads
    ]


def recorded_moments(location: DataLocation, windows_m: Sequence[Window]) -> list[ByWeather]:
    """Of a recorded data set the frame of each weather that has most objects, one for each window.

    Frames are of the kind of road that is there in most weathers, where a weather has it. Weathers without a frame that
    holds annotations, LiDAR and radar are left out.

    Args:
        location: The data set.
        windows_m: Where objects count.
    """
    data = location.open(reference=_REFERENCE)
    # some frames of each drive, and the conditions of the drive
    drives = [indices for indices in (_candidates(data, drive) for drive in data.drive_indices().values()) if indices]
    conditions = [data[indices[0]].conditions for indices in drives]
    # the kind of road that is there in most weathers
    pairs = {(of_drive.get("road", ""), of_drive.get("weather", "")) for of_drive in conditions}
    common = Counter(road for road, _ in sorted(pairs)).most_common(1)
    by_weather: dict[str, list[SheetFrame]] = {}
    for weather in WEATHERS:
        of_weather = [
            (of_drive.get("road") == common[0][0], indices)
            for of_drive, indices in zip(conditions, drives, strict=True)
            if of_drive.get("weather") == weather
        ]
        on_common = [indices for is_common, indices in of_weather if is_common]
        indices = [index for drive in on_common or [indices for _, indices in of_weather] for index in drive]
        if indices:
            by_weather[weather] = [SheetFrame(data, index) for index in indices]
    # the fullest frame of each weather
    return [{weather: fullest(frames, window_m) for weather, frames in by_weather.items()} for window_m in windows_m]


def _candidates(data: Dataset, indices: Indices) -> list[int]:
    """Some frames of a drive, spread evenly, that have all that a sheet shows but perhaps the camera."""
    annotated = [int(index) for index in indices if data.has_annotation(int(index))]
    spread = sorted({number * len(annotated) // _TRIED for number in range(_TRIED)}) if annotated else []
    candidates = []
    for index in (annotated[rank] for rank in spread):
        frame = data[index]
        if _LIDAR in frame.clouds and any(product in frame.radar for product in PRODUCTS):
            candidates.append(index)
    return candidates


def fullest(moments: Sequence[SheetFrame], window_m: Window) -> SheetFrame:
    """The frame with most annotated objects inside a window; among equals the first."""
    return max(moments, key=lambda moment: moment.objects(window_m))


def sheets_of(
    locations: Mapping[str, DataLocation],
    data: DataLocation | None,
    weights: Mapping[str, Path],
    settings: BudgetSettings,
) -> list[SheetGroup]:
    """The sheets of Figures 8, 21 and 22.

    Args:
        locations: The simulated frames by weather.
        data: The user's frames; None takes the simulated ones.
        weights: Weights of the first seed by run; Figures 21 and 22 need both of :data:`DETECTORS`.
        settings: The budget, whose score names the detectors' region and classes.
    """
    x_from, x_to, y_from, y_to, *_ = REGIONS_M[settings.score.settings.get("region", "narrow")]
    corridor: Window = (x_from, x_to, y_from, y_to)
    if data is None:
        in_view, narrow = two_roads(simulated_moments(locations), corridor)
    else:
        in_view, narrow = recorded_moments(data, (WINDOW_M, corridor))
    if not in_view:
        return [SheetGroup(title="Figures 8, 21 and 22", words="No annotated frame has both LiDAR and radar.")]
    # Figure 8: a road by weather
    figure_8 = SheetGroup(
        title="Figure 8: the same road by weather" if data is None else "Figure 8: roads by weather",
        words=_SAME_ROAD if data is None else _OWN_ROADS,
        sheets=[sheet_of(in_view[weather], {}) for weather in WEATHERS if weather in in_view],
    )
    detectors = {side: Detector.load(weights[run]) for side, (run, *_) in DETECTORS.items() if run in weights}
    if len(detectors) < len(DETECTORS):
        names = " and ".join(name for _, _, name in DETECTORS.values())
        words = f"They need {names} of the first seed, which are not finished."
        return [figure_8, SheetGroup(title="Figures 21 and 22: two detectors", words=words)]
    # Figures 21 and 22: two detectors
    groups = [figure_8]
    labels = tuple(settings.score.settings.get("classes", ()))
    for number, weathers, preposition in ((21, DRY, "without"), (22, WET, "with")):
        sheets = [sheet_of(narrow[weather], detectors) for weather in weathers if weather in narrow]
        if sheets:
            groups.append(
                SheetGroup(
                    title=f"Figure {number}: two detectors in weather {preposition} precipitation",
                    words=_DETECTED,
                    sheets=sheets,
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


def two_roads(roads: Sequence[ByWeather], corridor: Window) -> tuple[ByWeather, ByWeather]:
    """The road with most objects in view, and of the others that with most inside the corridor.

    The first stands for the second too where no other has half as many objects there.

    Args:
        roads: Roads by weather.
        corridor: Where the detectors look.
    """
    counts = [next(iter(road.values())).objects(WINDOW_M) for road in roads]
    first = counts.index(max(counts))
    rest = [road for index, road in enumerate(roads) if index != first] or list(roads)
    inside = [next(iter(road.values())).objects(corridor) for road in rest]
    second = rest[inside.index(max(inside))]
    enough = next(iter(roads[first].values())).objects(corridor) / 2
    return roads[first], second if max(inside) >= max(enough, 1) else roads[first]


def sheet_of(moment: SheetFrame, detectors: Mapping[str, Detector]) -> RadarSheet:
    """A frame with the number of LiDAR returns of each object, and the boxes of detectors.

    Args:
        moment: The frame.
        detectors: By ``on_radar`` and ``on_lidar``.
    """
    data, index = moment.data, moment.index
    look, cloud = look_at(data, index), data[index].cloud(_LIDAR)
    boxes = Boxes.empty() if look.boxes is None else look.boxes
    by_side = {}
    for side, detector in detectors.items():
        detections = detect(detector, data.select([index]), cloud=DETECTORS[side][1])
        by_side[side] = next(iter(detections.boxes.values()))
    returns = count_points_in_boxes(cloud.points_m, boxes, margin_m=BOX_MARGIN_M)
    return RadarSheet(look=look, cloud=cloud, returns=returns, **by_side)
