"""Sheets of K-Radar: camera, radar map and LiDAR of one moment, and what the LiDAR has no return of."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Int

from farfield.evaluation.report_data import confident, of_classes
from farfield.figures.birds_eye import Window, draw_birdseye, draw_boxes, in_window
from farfield.figures.camera import box_lines
from farfield.figures.radar import cube_extent, power_levels
from farfield.figures.style import ANNOTATED, INK, MUTED, POINT, PREDICTED, RULE, figure_uri, house_style, new_figure
from farfield.frame import Cloud
from farfield.geometry.boxes import Boxes
from farfield.inspection.radar_frame import RadarLook
from farfield.metrics.centre.matching import found_by
from farfield.pages.template import PageImage
from farfield.radar.axes import CUBE_X_M, CUBE_Y_M
from farfield.radar.views import NEAREST_M
from farfield.vocabulary.scores import SHOWN_SCORE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOST = "#9c36b5"
"""Colour of objects without any LiDAR return."""
WINDOW_M: Window = (0.0, 76.0, -14.0, 14.0)
SCORE_MIN = SHOWN_SCORE
_POWER = "Greys"  # the colours of boxes have to stand out on it
_DASHED = (0, (2.2, 1.4))
_DPI = 125


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
        lidar.set_title(f"LiDAR: {len(sheet.cloud):,} points of the os2-64")
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


_BRIGHT, _BRIGHT_LOST = "#22b8e6", "#e599f7"  # the same blue and purple, light enough for a night's picture


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
