"""A radar's pictures: one frame with all its views, its power from above, and one moment in several weathers."""

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Float

from farfield.errors import ConfigError, DatasetError
from farfield.evaluation.record import FrameView
from farfield.evaluation.report_data import confident, of_classes
from farfield.figures.birds_eye import draw_birdseye, draw_boxes, draw_rings, fitting_window
from farfield.figures.camera import box_lines
from farfield.figures.style import ANNOTATED, INK, MUTED, PATTERNS, PREDICTED, RULE, house_style, new_figure
from farfield.frame import Boxes, Frame
from farfield.inspection.radar_frame import RadarLook
from farfield.radar.axes import CUBE_STEP_M, CUBE_X_M, CUBE_Y_M, CUBE_Z_M, KRADAR_AXES
from farfield.radar.views import PRODUCTS, PolarPeaks, radar_views
from farfield.vocabulary.conditions import CONDITIONS
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.kradar import REGIONS_M
from farfield.vocabulary.scores import SHOWN_SCORE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

_ASIDE_M, _LOW_M, _HIGH_M = 50.0, -6.0, 14.0
ANNOTATED_ON_MAP, PREDICTED_ON_MAP = "#3ddbd9", "#ffd43b"
"""Colours of boxes that stand out from the map's dark ground."""
SECOND = "#ff8cc6"
"""Colour of a second detector's boxes on a map."""
_POWER_COLOURS, _VELOCITY_COLOURS = "magma", "coolwarm"
_SPAN_M_S = KRADAR_AXES.velocity_span_m_s / 2
STANDING_M_S = 0.4
_DIM_DB, _BRIGHT_DB = 0.4, 1.4  # above the floor: where a velocity begins to show, and where it shows fully
_GROUND = "#f4f6f8"


def radar_picture(look: RadarLook) -> "Figure":
    """Draw a frame; what it lacks is left out and said."""
    with house_style():
        figure = new_figure(12.6, 11.5)
        figure.suptitle(frame_words(look), x=0.01, ha="left", fontsize=11, color=MUTED)
        rows = figure.add_gridspec(2, 1, height_ratios=[1.0, 1.42])
        top = rows[0].subgridspec(2, 2, width_ratios=[1.28, 1.0])
        below = rows[1].subgridspec(1, 3)
        _draw_camera(figure.add_subplot(top[:, 0]), look)
        front, side = figure.add_subplot(top[0, 1]), figure.add_subplot(top[1, 1])
        _draw_front(front, look)
        _draw_side(side, look)
        bird, doppler, polar = (figure.add_subplot(below[0, column]) for column in range(3))
        image = _draw_bird(bird, look)
        figure.colorbar(image, ax=bird, location="bottom", label="mean power, dB", shrink=0.9, aspect=30)
        dots = _draw_doppler(doppler, look)
        measured = "as measured, wrapped" if look.velocity_m_s is None else "over ground"
        velocity = f"radial velocity {measured}, m/s"
        figure.colorbar(dots, ax=doppler, location="bottom", label=velocity, shrink=0.9, aspect=30)
        _draw_polar(figure, polar, look)
    return figure


def frame_words(look: RadarLook) -> str:
    """Which frame it is, and in which conditions."""
    conditions = ", ".join(look.conditions[kind].replace("_", " ") for kind in CONDITIONS if kind in look.conditions)
    parts = [f"sequence {look.key[0]}, frame {look.key[1]}", conditions, f"from {' and '.join(look.views.products)}"]
    return "; ".join(part for part in [*parts, "simulated" * look.simulated] if part)


def power_levels(power_db: Float[np.ndarray, "_ _"]) -> tuple[float, float]:
    """Where a map's colours begin and end: near its floor and near its strongest echoes, 6 dB apart or more."""
    finite_db = power_db[np.isfinite(power_db)]
    floor_db, peak_db = np.percentile(finite_db, [20.0, 99.8]) if finite_db.size else (0.0, 1.0)
    return float(floor_db), float(max(peak_db, floor_db + 6.0))


def cube_extent(u_m: Float[np.ndarray, " u"], v_m: Float[np.ndarray, " v"]) -> tuple[float, float, float, float]:
    """Edges of a map of the cube's cells with these centres on the horizontal and the vertical axis, metres."""
    half_m = CUBE_STEP_M / 2
    return u_m[0] - half_m, u_m[-1] + half_m, v_m[0] - half_m, v_m[-1] + half_m


def draw_power(
    axes: "Axes",
    power_db: Float[np.ndarray, "v u"],
    u_m: Float[np.ndarray, " u"] = CUBE_X_M,
    v_m: Float[np.ndarray, " v"] = CUBE_Y_M,
    *,
    aspect: Literal["auto", "equal"] = "equal",
    ground: str = "black",
) -> "AxesImage":
    """Draw a map of the power in K-Radar's cube, from its floor to its strongest echoes: the way of every radar map.

    Args:
        axes: Where to draw.
        power_db: The power in dB; NaN where there is none.
        u_m: Centres of its columns on the horizontal axis, metres (default: x from above).
        v_m: Centres of its rows on the vertical axis (default: y from above).
        aspect: Whether a metre is as long on both axes.
        ground: Colour where there is no power.
    """
    floor_db, peak_db = power_levels(power_db)
    axes.set_facecolor(ground)
    return axes.imshow(
        power_db,
        origin="lower",
        extent=cube_extent(u_m, v_m),
        cmap=_POWER_COLOURS,
        vmin=floor_db,
        vmax=peak_db,
        aspect=aspect,
    )


def _dots(axes: "Axes", across: np.ndarray, along: np.ndarray, velocity: np.ndarray, size: Any) -> Any:
    """Echoes coloured by velocity."""
    return axes.scatter(
        across,
        along,
        c=velocity,
        s=size,
        cmap=_VELOCITY_COLOURS,
        vmin=-_SPAN_M_S,
        vmax=_SPAN_M_S,
        edgecolors=INK,
        linewidths=0.4,
    )


def _coloured(look: RadarLook, echoes: PolarPeaks) -> tuple[np.ndarray, np.ndarray]:
    """Velocity that colours each echo, and which of them move; all do where nothing says how the radar moves."""
    over_ground = look.over_ground_m_s
    if over_ground is None:
        return echoes.wrapped_m_s, ~echoes.side_lobe
    return over_ground, ~echoes.side_lobe & (np.abs(over_ground) > STANDING_M_S)


def _draw_camera(axes: "Axes", look: RadarLook) -> None:
    from matplotlib.collections import LineCollection

    axes.set_axis_off()
    if look.image is None:
        axes.text(0.5, 0.5, "no camera image", ha="center", va="center", color=MUTED, transform=axes.transAxes)
        return
    height, width = look.image.shape[:2]
    axes.imshow(look.image, interpolation="antialiased")
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    if look.camera is None:
        axes.set_title("Camera without a calibration of its size: nothing is projected")
        return
    axes.set_title("Camera with boxes and the echoes' peaks")
    if look.boxes is not None:
        axes.add_collection(LineCollection(box_lines(look.boxes, look.camera), colors=ANNOTATED_ON_MAP, linewidths=1.1))
    echoes = look.views.echoes
    if echoes is not None:
        velocity, moving = _coloured(look, echoes)
        pixels, _, visible = look.camera.project(echoes.points_m.astype(np.float64))
        visible &= echoes.peak
        standing, shown = visible & ~moving & ~echoes.side_lobe, visible & moving
        axes.scatter(
            pixels[standing, 0], pixels[standing, 1], s=9, color="white", edgecolors=INK, linewidths=0.4, alpha=0.85
        )
        _dots(axes, pixels[shown, 0], pixels[shown, 1], velocity[shown], 22)


def _outline(axes: "Axes", look: RadarLook, across: int, along: int, *, colour: str = ANNOTATED_ON_MAP) -> None:
    """The annotated boxes' extents in a plane; axes 0 to 2 are x, y and z."""
    if look.boxes is None or not len(look.boxes):
        return
    corners = look.boxes.corners_m()
    for box in corners:
        if box[:, 0].min() < 0:
            continue
        if {across, along} == {0, 1}:
            ring = box[[0, 1, 2, 3, 0]][:, [across, along]]
        else:
            (left, low), (right, high) = (edge(box[:, [across, along]], axis=0) for edge in (np.min, np.max))
            ring = np.array([[left, low], [right, low], [right, high], [left, high], [left, low]])
        axes.plot(*ring.T, color=colour, lw=0.9)


def _draw_front(axes: "Axes", look: RadarLook) -> None:
    draw_power(axes, look.views.front_db, CUBE_Y_M, CUBE_Z_M, aspect="auto", ground=RULE)
    _outline(axes, look, 1, 2)
    axes.set(xlim=(_ASIDE_M, -_ASIDE_M), ylim=(_LOW_M, _HIGH_M), xlabel="y (m), left is positive", ylabel="z (m)")
    axes.set_title("BFS-2D from the front: strongest power over x")


def _draw_side(axes: "Axes", look: RadarLook) -> None:
    draw_power(axes, look.views.side_db, CUBE_X_M, CUBE_Z_M, aspect="auto", ground=RULE)
    _outline(axes, look, 0, 2)
    axes.set(xlim=(0, CUBE_X_M[-1]), ylim=(_LOW_M, _HIGH_M), xlabel="x (m), ahead", ylabel="z (m)")
    axes.set_title("BFS-2D from the side: strongest power over y")


def _draw_bird(axes: "Axes", look: RadarLook) -> Any:
    image = draw_power(axes, look.views.bird_db.T, CUBE_Y_M, CUBE_X_M, aspect="auto", ground=RULE)
    _outline(axes, look, 1, 0)
    _frame_ahead(axes)
    axes.set_title("BEV-2D: mean power over height")
    return image


def _frame_ahead(axes: "Axes") -> None:
    axes.set(xlim=(_ASIDE_M, -_ASIDE_M), ylim=(0, CUBE_X_M[-1]))
    axes.set(xlabel="y (m), left is positive", ylabel="x (m), ahead")


def _draw_doppler(axes: "Axes", look: RadarLook) -> Any:
    """Echoes from above, coloured by velocity: those that stand small and pale, those that move on top."""
    axes.set_facecolor(_GROUND)
    _frame_ahead(axes)
    echoes = look.views.echoes
    axes.set_title("Echoes: CFAR detections and their Doppler")
    if echoes is None:
        axes.text(0.5, 0.5, "no polar map: no Doppler", ha="center", color=MUTED, transform=axes.transAxes)
        return _dots(axes, np.zeros(0), np.zeros(0), np.zeros(0), 1)
    velocity, moving = _coloured(look, echoes)
    x, y = echoes.points_m[:, 0], echoes.points_m[:, 1]
    marked, standing = echoes.side_lobe, ~echoes.side_lobe & ~moving
    axes.scatter(y[marked], x[marked], s=5, marker="x", color="#adb5bd", linewidths=0.6, label="may be side lobes")
    if look.velocity_m_s is not None:
        axes.scatter(y[standing], x[standing], s=5, color=MUTED, linewidths=0, label="standing")
    size = np.where(echoes.peak, 24, 6)[moving]
    dots = _dots(axes, y[moving], x[moving], velocity[moving], size)
    _outline(axes, look, 1, 0, colour=ANNOTATED)
    axes.legend(loc="lower left", markerscale=1.6, handletextpad=0.1, borderaxespad=0.2)
    return dots


def _draw_polar(figure: "Figure", axes: "Axes", look: RadarLook) -> None:
    """Range and azimuth: power as brightness, wrapped velocity as colour."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize, to_rgb

    views = look.views
    axes.set_title("Doppler by range and azimuth, wrapped")
    axes.set(xlabel="azimuth (degrees), left is positive", ylabel="range (m)")
    if views.polar_db is None or views.wrapped_m_s is None:
        axes.text(0.5, 0.5, "no polar map", ha="center", color=MUTED, transform=axes.transAxes)
        return
    above_db = views.polar_db - np.nanmedian(views.polar_db[KRADAR_AXES.range_m > 15.0])
    share = np.clip((above_db - _DIM_DB) / (_BRIGHT_DB - _DIM_DB), 0.0, 1.0)[..., None]
    colours = colormaps[_VELOCITY_COLOURS](views.wrapped_m_s / (2 * _SPAN_M_S) + 0.5)[..., :3]
    ground = np.array(to_rgb(_GROUND))
    azimuth = KRADAR_AXES.azimuth_deg
    axes.imshow(
        colours * share + ground * (1 - share),
        origin="lower",
        extent=(azimuth[0] - 0.5, azimuth[-1] + 0.5, 0.0, float(KRADAR_AXES.range_m[-1])),
        aspect="auto",
    )
    axes.set(xlim=(azimuth[-1], azimuth[0]), ylim=(0, float(KRADAR_AXES.range_m[-1])))
    scale = ScalarMappable(Normalize(-_SPAN_M_S, _SPAN_M_S), _VELOCITY_COLOURS)
    figure.colorbar(scale, ax=axes, location="bottom", label="radial velocity as measured, m/s", shrink=0.9, aspect=30)


# A radar's power from above, with the annotated boxes: of its products, or of its points where there are no others.

_STRENGTHS = {"rcs_dbsm": "RCS, dBsm", "power": "power, dB over 1e13", "snr_db": "SNR, dB"}


def radar_map(frame: Frame, predictions: Boxes | None = None) -> "Figure":
    """Draw a radar's power from above.

    K-Radar's products are drawn as the mean power over the heights of its wide region (BEV-2D), in dB over 1e13; of a
    frame without them the points of its first radar cloud, by their strength.

    Args:
        frame: A frame; with products, in the radar's coordinates.
        predictions: Predicted boxes.

    Raises:
        DatasetError: If the frame has nothing of a radar, or is in another sensor's coordinates.
    """
    if frame.radar and frame.reference != "radar" and any(name in frame.radar for name in PRODUCTS):
        raise DatasetError(
            f"frame {frame.key}: expected the radar's coordinates, got {frame.reference}'s. "
            "Open the data set with reference='radar'"
        )
    views = radar_views(frame.radar) if frame.radar else None
    with house_style():
        figure = new_figure(10.5, 6.0)
        axes = figure.add_subplot()
        axes.set_facecolor(RULE)
        if views is None:
            drawn, what, made_of = _points(axes, frame)
        else:
            drawn, what = _draw_product(axes, views.bird_db), "mean power over height, dB over 1e13"
            made_of = " and ".join(views.products)
        outline = ANNOTATED if views is None else ANNOTATED_ON_MAP
        for boxes, colour in ((frame.boxes, outline), (predictions, PREDICTED)):
            if boxes is not None:
                draw_boxes(axes, boxes, colour, line_width=1.2, order=4)
        figure.colorbar(drawn, ax=axes, location="right", label=what, shrink=0.9)
        conditions = ", ".join(value.replace("_", " ") for value in frame.conditions.values())
        axes.set(xlabel="x ahead (m)", ylabel="y left (m)", aspect="equal")
        axes.set_title("; ".join(filter(None, [f"{frame.sequence}, {frame.frame_id}", conditions, f"from {made_of}"])))
    return figure


def _draw_product(axes: "Axes", bird_db: Float[np.ndarray, "y x"]) -> "AxesImage":
    """The power from above; where cells of a region leave the rest of the cube empty, no more than what they fill."""
    image = draw_power(axes, bird_db, ground=RULE)
    filled = np.isfinite(bird_db)
    x_m, y_m = CUBE_X_M[filled.any(axis=0)], CUBE_Y_M[filled.any(axis=1)]
    if len(x_m) and len(y_m):
        axes.set(xlim=(max(x_m[0], 0.0), x_m[-1]), ylim=(y_m[0], y_m[-1]))
    return image


def _points(axes: "Axes", frame: Frame) -> tuple[Any, str, str]:
    """The points of the first radar cloud, coloured by their strength."""
    name = next((n for n in frame.clouds if n in frame.sensors and frame.sensors[n].kind == "radar"), None)
    if name is None:
        present = ", ".join([*frame.radar, *frame.clouds, *frame.images]) or "nothing"
        raise DatasetError(
            f"frame {frame.key}: there is no radar: expected one of {', '.join(PRODUCTS)} or a radar's cloud, found "
            f"{present}"
        )
    cloud = frame.cloud(name)
    column = next((candidate for candidate in _STRENGTHS if candidate in cloud.columns), "z_m")
    values = cloud.column(column)
    if column == "power":
        values = 10 * np.log10(np.maximum(values, 1e-9))
    x, y, _ = cloud.points_m.T
    drawn = axes.scatter(x, y, c=values, s=9, cmap=_POWER_COLOURS, linewidths=0)
    left, right, low, high = fitting_window(cloud, frame.boxes)
    axes.set(xlim=(left, right), ylim=(low, high))
    return drawn, _STRENGTHS.get(column, "height, m"), f"the cloud {name}"


# A radar frame's power from above, with boxes.

_OTHERS = "#adb5bd"
_DETECTOR_COLOURS = (("yellow", PREDICTED_ON_MAP), ("pink", SECOND))
_MAP_ASIDE_M = 40.0


def power_map(
    power_db: Float[np.ndarray, "y x"],
    *,
    annotated: Boxes | None = None,
    predicted: Boxes | Mapping[str, Boxes] | None = None,
    labels: Collection[str] | None = None,
    rings_m: Sequence[float] = (),
) -> "Figure":
    """Draw the power, x (forward) to the right and y (left) upwards.

    Args:
        power_db: What :func:`farfield.evaluation.report_data.power_from_above` gives.
        annotated: Annotated boxes.
        predicted: Predicted boxes; of two detectors by the clouds that they read.
        labels: Classes that were asked for; annotated boxes of others are grey.
        rings_m: Ranges to mark by arcs; the outermost ends the picture.
    """
    reach_m = min(max(rings_m, default=CUBE_X_M[-1]), float(CUBE_X_M[-1]))
    sets = predicted if isinstance(predicted, Mapping) else {} if predicted is None else {"": predicted}
    with house_style():
        figure = new_figure(11.0, 0.9 + 9.6 * 2 * _MAP_ASIDE_M / (1.12 * reach_m))
        axes = figure.add_subplot()
        shown = draw_power(axes, power_db)
        window = (0.0, reach_m, -_MAP_ASIDE_M, _MAP_ASIDE_M)
        draw_rings(axes, window, rings_m, colour="white")
        if annotated is not None:
            counts = of_classes(annotated, labels)
            draw_boxes(axes, annotated[~counts], _OTHERS, line_width=0.8, order=3)
            draw_boxes(axes, annotated[counts], ANNOTATED_ON_MAP, line_width=1.8, order=4)
        for index, (boxes, (_, colour)) in enumerate(zip(sets.values(), _DETECTOR_COLOURS, strict=False)):
            draw_boxes(axes, boxes, colour, line_width=1.0, order=5 + index)
        axes.set(xlim=window[:2], ylim=window[2:], xlabel="x forward (m)", ylabel="y left (m)")
        axes.set_title("; ".join(["Blue-green: annotated", *_legend_words(list(sets))]))
        figure.colorbar(shown, ax=axes, label="mean power, dB", shrink=0.8, pad=0.02)
    return figure


def _legend_words(clouds: Sequence[str]) -> list[str]:
    """Whose predictions have which colour."""
    return [
        f"{colour_name}: predicted{f' from {cloud}' if cloud else ''}"
        for cloud, (colour_name, _) in zip(clouds, _DETECTOR_COLOURS, strict=False)
    ]


# One moment in several weathers: the radar's power and the LiDAR's points from above, with the boxes of both.

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
    axes.set_title(f"{_weather(view)}: LiDAR, {count_of(len(cloud), 'point', spec=',')}")


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
