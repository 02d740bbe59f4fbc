"""One moment in several weathers: the radar's power and the LiDAR's points from above, with the boxes of both."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from farfield.errors import ConfigError
from farfield.evaluation.objects import confident, of_classes
from farfield.evaluation.record import FrameView
from farfield.figures.birds_eye import draw_birdseye, draw_boxes
from farfield.figures.power_map import ANNOTATED_ON_MAP, PREDICTED_ON_MAP, SECOND, draw_power
from farfield.figures.style import ANNOTATED, INK, PATTERNS, house_style, new_figure
from farfield.frame import Boxes
from farfield.vocabulary.kradar import REGIONS_M
from farfield.vocabulary.scores import SHOWN_SCORE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LABEL = "vehicle"
_CORRIDOR_M = REGIONS_M["narrow"]
_WINDOW_M = (0.0, 76.0, -14.0, 14.0)
_DASHES = (0, (2.2, 1.2))


def weathers_picture(views: Sequence[FrameView], *, radar: str, lidar: str) -> "Figure":
    """Draw the same moment in several weathers, a column each: radar above, LiDAR below.

    Args:
        views: The moment, a view a weather, with predictions of both clouds and the radar's power.
        radar: Name of the radar's cloud.
        lidar: Name of the LiDAR's cloud.

    Raises:
        ConfigError: If a view lacks the radar's power or predictions of one of the clouds.
    """
    for view in views:
        if view.radar_db is None or not {radar, lidar} <= set(view.by_cloud):
            raise ConfigError(f"{view.title}: expected the radar's power and boxes of {radar} and {lidar}")
    width = 6.4 * len(views)
    with house_style():
        figure = new_figure(width, 5.6, fixed=True)
        grid = figure.subplots(2, len(views), squeeze=False, sharex=True, sharey=True)
        figure.subplots_adjust(
            left=0.55 / width, right=1 - 0.1 / width, top=0.945, bottom=0.135, wspace=0.03, hspace=0.13
        )
        for column, view in enumerate(views):
            _draw_radar(grid[0, column], view, radar, lidar)
            _draw_lidar(grid[1, column], view, lidar)
            grid[0, column].set_xlabel("")
            if column:
                for axes in grid[:, column]:
                    axes.set_ylabel("")
        _weathers_legend(figure, radar, lidar)
    return figure


def _draw_radar(axes: "Axes", view: FrameView, radar: str, lidar: str) -> None:
    assert view.radar_db is not None
    draw_power(axes, view.radar_db)
    _corridor(axes, "white")
    _boxes(axes, _asked(view.frame.boxes), ANNOTATED_ON_MAP, 2.0, 4)
    _boxes(axes, _shown(view, lidar), SECOND, 1.3, 5, _DASHES)
    _boxes(axes, _shown(view, radar), PREDICTED_ON_MAP, 1.1, 6)
    axes.set(xlim=_WINDOW_M[:2], ylim=_WINDOW_M[2:], aspect="equal", ylabel="y left (m)")
    axes.set_title(f"{_weather(view)}: 4D radar, power from above")


def _draw_lidar(axes: "Axes", view: FrameView, lidar: str) -> None:
    cloud = view.frame.cloud(lidar)
    draw_birdseye(axes, cloud, window_m=_WINDOW_M, rings_m=(), point_size=1.2)
    _corridor(axes, INK)
    _boxes(axes, _asked(view.frame.boxes), ANNOTATED, 2.0, 4)
    _boxes(axes, _shown(view, lidar), PATTERNS[1], 1.2, 5)
    axes.set_title(f"{_weather(view)}: LiDAR, {len(cloud):,} points")


def _weather(view: FrameView) -> str:
    return view.frame.conditions.get("weather", "weather not known").replace("_", " ").capitalize()


def _asked(boxes: Boxes | None) -> Boxes | None:
    return None if boxes is None else boxes[of_classes(boxes, (_LABEL,))]


def _shown(view: FrameView, cloud: str) -> Boxes | None:
    predicted = view.by_cloud[cloud]
    return None if predicted is None else confident(predicted, SHOWN_SCORE)


def _boxes(axes: "Axes", boxes: Boxes | None, colour: str, width: float, order: int, dashes: Any = "-") -> None:
    if boxes is not None:
        draw_boxes(axes, boxes, colour, line_width=width, order=order, dashes=dashes)


def _corridor(axes: "Axes", colour: str) -> None:
    x_from, x_to, y_from, y_to, _, _ = _CORRIDOR_M
    axes.plot(
        [x_from, x_to, x_to, x_from], [y_from, y_from, y_to, y_to], color=colour, lw=0.8, ls=(0, (1, 3)), zorder=3
    )


def _weathers_legend(figure: "Figure", radar: str, lidar: str) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    dark: Any = {"facecolor": "#1d1033", "linewidth": 1.6}
    entries = [
        Patch(**dark, edgecolor=ANNOTATED_ON_MAP, label="annotated: on the map"),
        Line2D([], [], color=ANNOTATED, lw=2.2, label="on the points"),
        Patch(**dark, edgecolor=PREDICTED_ON_MAP, label=f"detected with {radar}, score {SHOWN_SCORE:g} or more"),
        Patch(**dark, edgecolor=SECOND, linestyle=_DASHES, label=f"with LiDAR ({lidar}), likewise: on the map"),
        Line2D([], [], color=PATTERNS[1], lw=1.3, label="on the points"),
        Line2D([], [], color=INK, lw=0.9, ls=(0, (1, 3)), label="the corridor that is scored"),
    ]
    figure.legend(handles=entries, loc="lower center", ncols=len(entries), handlelength=1.6, columnspacing=1.4)
