"""K-Radar's sheets (Figures 8, 21, 22): camera, radar map and LiDAR of one moment, by weather, and two detectors.

The grid's own simulated sets have no camera: a few of their roads are simulated anew with one, by day, in a small set a
weather. Of recorded data, each weather shows a frame of its own, of one kind of road where there is one. The sheets
count and dash the objects that the LiDAR has no return of.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Int

from farfield.datasets import Dataset
from farfield.datasets.base import Indices
from farfield.detectors.runtime import Detector
from farfield.evaluation import detect
from farfield.evaluation.report_data import confident, of_classes
from farfield.figures.birds_eye import Window, draw_birdseye, draw_boxes, in_window
from farfield.figures.camera import box_lines
from farfield.figures.radar import cube_extent, power_levels
from farfield.figures.style import ANNOTATED, INK, MUTED, POINT, PREDICTED, RULE, figure_uri, house_style, new_figure
from farfield.frame import Boxes, Cloud
from farfield.geometry.boxes import BOX_MARGIN_M, count_points_in_boxes
from farfield.inspection.radar_frame import RadarLook, look_at
from farfield.metrics.centre.matching import found_by
from farfield.pages.template import PageImage
from farfield.papers.grid import BudgetSettings
from farfield.papers.locations import DataLocation
from farfield.radar.axes import CUBE_X_M, CUBE_Y_M
from farfield.radar.views import NEAREST_M, PRODUCTS
from farfield.vocabulary.conditions import WEATHERS
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.kradar import REGIONS_M
from farfield.vocabulary.scores import SHOWN_SCORE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOST = "#9c36b5"
"""Colour of objects without any LiDAR return."""
WINDOW_M: Window = (0.0, 76.0, -14.0, 14.0)
SCORE_MIN = SHOWN_SCORE
_POWER = "Greys"  # the colours of boxes have to stand out on it
_BRIGHT, _BRIGHT_LOST = "#22b8e6", "#e599f7"  # the same blue and purple, light enough for a night's picture
_DASHED = (0, (2.2, 1.4))
_DPI = 125
ROADS = 5
"""Roads that are simulated in every weather; the fullest are shown. The fifth is the preset's second in a town."""
DRY, WET = ("normal", "overcast", "fog"), ("rain", "sleet", "light_snow", "heavy_snow")
"""Weathers of Figures 21 and 22."""
DETECTORS = {"on_radar": ("rtnh", "radar", "RTNH"), "on_lidar": ("pointpillars", "os2-64", "PointPillars")}
"""Run, cloud and name of both detectors of Figures 21 and 22."""
_SENSORS, _TIME, _LIDAR, _REFERENCE = "os2-64,cells,cam-front", "day", "os2-64", "radar"
_TRIED = 8  # frames of a recorded drive
_DIGITS = 8
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


# A sheet and its counts


@dataclass(frozen=True, eq=False, kw_only=True)
class RadarSheet:
    """One moment in the radar's coordinates.

    Args:
        look: Camera, radar map, boxes and conditions.
        cloud: The LiDAR's points.
        returns: How many of them are in each annotated box, shape (n,).
        on_radar: Boxes of the detector on the radar, or None.
        on_lidar: Boxes of the detector on the LiDAR, or None.
    """

    look: RadarLook
    cloud: Cloud
    returns: Int[np.ndarray, " n"]
    on_radar: Boxes | None = None
    on_lidar: Boxes | None = None

    @property
    def weather(self) -> str:
        """Its weather."""
        return self.look.conditions.get("weather", "")

    @property
    def boxes(self) -> Boxes:
        """The annotated boxes."""
        return Boxes.empty() if self.look.boxes is None else self.look.boxes

    def facts(self, window_m: Window, labels: Collection[str] | None = None) -> dict[str, Any]:
        """Counts of the objects inside a window, as JSON values.

        Args:
            window_m: x from, x to, y from, y to.
            labels: Classes that count; all if None.

        Returns:
            ``annotated``, ``without_return``, and for each detector that there is ``found``, ``found_without_return``
            and ``wrong``: objects with a box of score 0.3 or more within 2 m, and boxes without an object of any class.
        """
        inside = in_window(self.boxes.centre_m, window_m) & of_classes(self.boxes, labels)
        objects, lost = self.boxes[inside], self.returns[inside] == 0
        counts: dict[str, Any] = {"annotated": len(objects), "without_return": int(lost.sum())}
        for name, boxes in (("on_radar", self.on_radar), ("on_lidar", self.on_lidar)):
            if boxes is not None:
                detections = confident(boxes, SCORE_MIN)
                detections = detections[in_window(detections.centre_m, window_m)]
                matched = found_by(detections, objects) >= 0
                counts[name] = {
                    "found": int(matched.sum()),
                    "found_without_return": int((matched & lost).sum()),
                    "wrong": len(detections) - int((found_by(detections, self.boxes) >= 0).sum()),
                }
        return counts


@dataclass(frozen=True, kw_only=True)
class SheetGroup:
    """The sheets of one figure of the paper.

    Args:
        title: Its heading.
        words: What is shown, and what it was made of.
        sheets: Its sheets, by weather.
        region_m: Where its detectors look, or None where there are none.
        labels: Classes that they look for.
        detectors: What they are called: on the radar, on the LiDAR.
    """

    title: str
    words: str
    sheets: Sequence[RadarSheet] = ()
    region_m: Window | None = None
    labels: Collection[str] | None = None
    detectors: Mapping[str, str] = field(default_factory=dict)

    def facts(self) -> list[dict[str, Any]]:
        """What each sheet counts, as JSON values."""
        return [
            {
                "weather": sheet.weather,
                "sequence": sheet.look.key[0],
                "frame": sheet.look.key[1],
                "simulated": sheet.look.simulated,
                **sheet.facts(self.region_m or WINDOW_M, self.labels),
            }
            for sheet in self.sheets
        ]

    def pictures(self) -> list[PageImage]:
        """Its sheets as pictures with captions."""
        return [
            PageImage(
                figure_uri(sheet_picture(sheet, region_m=self.region_m, detectors=self.detectors), "jpg", dpi=_DPI),
                f"Camera, radar map and LiDAR of one moment in {_weather(sheet)}, with boxes",
                self._caption(sheet, facts),
                heading=_weather(sheet).capitalize(),
            )
            for sheet, facts in zip(self.sheets, self.facts(), strict=True)
        ]

    def _caption(self, sheet: RadarSheet, facts: Mapping[str, Any]) -> str:
        where = "in the corridor" if self.region_m else "in view"
        lost = facts["without_return"]
        (only,) = self.labels if self.labels and len(self.labels) == 1 else ("object",)
        what = only.replace("_", " ") + ("" if facts["annotated"] == 1 else "s")
        text = f"{facts['annotated'] or 'No'} annotated {what} {where}, {lost or 'none'} without any LiDAR return."
        for name in ("on_radar", "on_lidar"):
            if name in facts:
                text += f" {_words(self.detectors.get(name, name), facts[name], lost)}"
        key = f"sequence {facts['sequence']}, frame {facts['frame']}"
        return f"{text} {'Simulated' if sheet.look.simulated else 'Recorded'}: {key}."


def _words(name: str, counts: Mapping[str, int], lost: int) -> str:
    text = f"{name} finds {counts['found'] or 'none'}"
    if lost:
        text += f", {counts['found_without_return'] or 'none'} of those without return"
    if counts["wrong"]:
        text += f"; {counts['wrong']} of its boxes {'has' if counts['wrong'] == 1 else 'have'} no object"
    return f"{text}."


def _weather(sheet: RadarSheet) -> str:
    return sheet.weather.replace("_", " ") or "unknown weather"


# Which frames are shown


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


# Drawing a sheet


def sheet_picture(
    sheet: RadarSheet,
    *,
    window_m: Window = WINDOW_M,
    region_m: Window | None = None,
    detectors: Mapping[str, str] | None = None,
) -> "Figure":
    """Draw a sheet: the camera left, the radar map right above the LiDAR, both from above, forward to the right.

    Args:
        sheet: The moment.
        window_m: What is shown from above: x from, x to, y from, y to.
        region_m: Outlined: where the detectors look.
        detectors: What the detectors are called, by ``on_radar`` and ``on_lidar``.
    """
    with house_style():
        figure = new_figure(12.4, 5.0)
        columns = figure.add_gridspec(1, 2, width_ratios=[1.0, 1.12])
        panels = columns[1].subgridspec(2, 1)
        _draw_camera(figure.add_subplot(columns[0]), sheet, window_m)
        radar, lidar = figure.add_subplot(panels[0]), figure.add_subplot(panels[1])
        _draw_power(radar, sheet, window_m)
        draw_birdseye(lidar, sheet.cloud, window_m=window_m, point_size=1.6, rings_m=())
        lidar.set_title(f"LiDAR: {count_of(len(sheet.cloud), 'point', spec=',')} of the os2-64")
        for axes, detections in ((radar, sheet.on_radar), (lidar, sheet.on_lidar)):
            _draw_objects(axes, sheet, detections, region_m)
            axes.set(xlim=window_m[:2], ylim=window_m[2:], aspect="equal", ylabel="y left (m)")
            axes.set_yticks(np.arange(np.ceil(window_m[2] / 10), np.floor(window_m[3] / 10) + 1) * 10.0)
            axes.set_xticks(np.arange(np.ceil(window_m[0] / 10), np.floor(window_m[1] / 10) + 1) * 10.0)
        radar.set_xlabel("")
        figure.legend(
            handles=_legend(sheet, detectors or {}, region=region_m is not None), loc="outside lower center", ncols=6
        )
    return figure


def _draw_objects(axes: "Axes", sheet: RadarSheet, detections: Boxes | None, region_m: Window | None) -> None:
    from matplotlib.patches import Rectangle

    lost = sheet.returns == 0
    draw_boxes(axes, sheet.boxes[~lost], ANNOTATED, line_width=1.9, order=4)
    draw_boxes(axes, sheet.boxes[lost], LOST, line_width=1.9, order=4, dashes=_DASHED)
    if detections is not None:
        draw_boxes(axes, confident(detections, SCORE_MIN), PREDICTED, line_width=1.2, order=5)
    if region_m is not None:
        x_from, x_to, y_from, y_to = region_m
        corridor = Rectangle((x_from, y_from), x_to - x_from, y_to - y_from, fill=False, ec=INK, lw=0.9, ls=(0, (1, 3)))
        axes.add_patch(corridor)


def _draw_power(axes: "Axes", sheet: RadarSheet, window_m: Window) -> None:
    values = sheet.look.views.bird_db
    ahead = (max(window_m[0], NEAREST_M) <= CUBE_X_M) & (window_m[1] >= CUBE_X_M)
    beside = (window_m[2] <= CUBE_Y_M) & (window_m[3] >= CUBE_Y_M)
    low, high = power_levels(values[np.ix_(beside, ahead)])
    axes.set_facecolor(RULE)
    extent = cube_extent(CUBE_X_M, CUBE_Y_M)
    axes.imshow(values, origin="lower", extent=extent, cmap=_POWER, vmin=low, vmax=high, aspect="auto")
    axes.set_title(f"Radar: mean power over height, {low:.0f} to {high:.0f} dB, dark is strong")


def _draw_camera(axes: "Axes", sheet: RadarSheet, window_m: Window) -> None:
    from matplotlib.collections import LineCollection

    axes.set_axis_off()
    image, camera = sheet.look.image, sheet.look.camera
    if image is None:
        axes.text(0.5, 0.5, "no camera image", ha="center", va="center", color=MUTED, transform=axes.transAxes)
        return
    height, width = image.shape[:2]
    axes.imshow(image, interpolation="antialiased")
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    axes.set_title("Camera" if camera else "Camera without a calibration: no boxes")
    if camera is None:
        return
    lost, shown = sheet.returns == 0, in_window(sheet.boxes.centre_m, window_m)
    for chosen, colour, style in ((~lost, _BRIGHT, "-"), (lost, _BRIGHT_LOST, _DASHED)):
        lines = box_lines(sheet.boxes[chosen & shown], camera)
        axes.add_collection(LineCollection(lines, colors=colour, linewidths=1.1, linestyles=[style]))


def _legend(sheet: RadarSheet, detectors: Mapping[str, str], *, region: bool) -> list[Any]:
    from matplotlib.lines import Line2D

    entries = [
        Line2D([], [], color=POINT, marker=".", ls="none", ms=5, label="LiDAR point"),
        Line2D([], [], color=ANNOTATED, lw=2.0, label="annotated"),
        Line2D([], [], color=LOST, lw=2.0, ls=_DASHED, label="annotated, without any LiDAR return"),
    ]
    if sheet.on_radar is not None or sheet.on_lidar is not None:
        names = [name for name in (detectors.get("on_radar"), detectors.get("on_lidar")) if name]
        entries.append(Line2D([], [], color=PREDICTED, lw=1.3, label=f"found by {' or '.join(names)}"))
    if region:
        entries.append(Line2D([], [], color=INK, lw=0.9, ls=(0, (1, 3)), label="where they look"))
    return entries
