"""One radar frame as a picture: camera, power from above, front and side, Doppler, and the detected echoes."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from farfield.figures.camera import box_lines
from farfield.figures.style import ANNOTATED, INK, MUTED, RULE, house_style, new_figure
from farfield.inspection.radar_frame import RadarLook
from farfield.radar.axes import KRADAR_AXES
from farfield.radar.grid import CUBE_STEP_M, CUBE_X_M, CUBE_Y_M, CUBE_Z_M
from farfield.radar.views import PolarPeaks
from farfield.vocabulary.conditions import CONDITIONS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HALF_STEP_M = CUBE_STEP_M / 2
_ASIDE_M, _LOW_M, _HIGH_M = 50.0, -6.0, 14.0
_POWER, _VELOCITY = "magma", "coolwarm"
_BOX = "#3ddbd9"
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
        bird, doppler, polar = (figure.add_subplot(below[0, place]) for place in range(3))
        image = _draw_bird(bird, look)
        figure.colorbar(image, ax=bird, location="bottom", label="mean power, dB", shrink=0.9, aspect=30)
        dots = _draw_doppler(doppler, look)
        figure.colorbar(dots, ax=doppler, location="bottom", label=_velocity_words(look), shrink=0.9, aspect=30)
        _draw_polar(figure, polar, look)
    return figure


def frame_words(look: RadarLook) -> str:
    """Which frame it is, and in which conditions."""
    said = ", ".join(look.conditions[kind].replace("_", " ") for kind in CONDITIONS if kind in look.conditions)
    parts = [f"sequence {look.key[0]}, frame {look.key[1]}", said, f"from {' and '.join(look.views.products)}"]
    return "; ".join(part for part in [*parts, "simulated" * look.simulated] if part)


def _velocity_words(look: RadarLook) -> str:
    return "radial velocity " + ("as measured, wrapped" if look.velocity_m_s is None else "over ground") + ", m/s"


def power_levels(values: Float[np.ndarray, "_ _"]) -> tuple[float, float]:
    """Where a map's colours begin and end: near its floor and near its strongest echoes."""
    inside = values[np.isfinite(values)]
    least, most = np.percentile(inside, [20.0, 99.8]) if inside.size else (0.0, 1.0)
    return float(least), float(max(most, least + 6.0))


def cube_extent(across: np.ndarray, along: np.ndarray) -> tuple[float, float, float, float]:
    """Edges of a map of the cube's cells, whose middles lie at these places of the horizontal and the vertical axis."""
    return across[0] - _HALF_STEP_M, across[-1] + _HALF_STEP_M, along[0] - _HALF_STEP_M, along[-1] + _HALF_STEP_M


def _show(axes: "Axes", values: np.ndarray, across: np.ndarray, along: np.ndarray) -> Any:
    axes.set_facecolor(RULE)
    low, high = power_levels(values)
    extent = cube_extent(across, along)
    return axes.imshow(values, origin="lower", extent=extent, cmap=_POWER, aspect="auto", vmin=low, vmax=high)


def _dots(axes: "Axes", across: np.ndarray, along: np.ndarray, velocity: np.ndarray, size: Any) -> Any:
    """Echoes coloured by velocity."""
    return axes.scatter(
        across,
        along,
        c=velocity,
        s=size,
        cmap=_VELOCITY,
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
        axes.add_collection(LineCollection(box_lines(look.boxes, look.camera), colors=_BOX, linewidths=1.1))
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


def _outline(axes: "Axes", look: RadarLook, across: int, along: int, *, colour: str = _BOX) -> None:
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
    _show(axes, look.views.front_db, CUBE_Y_M, CUBE_Z_M)
    _outline(axes, look, 1, 2)
    axes.set(xlim=(_ASIDE_M, -_ASIDE_M), ylim=(_LOW_M, _HIGH_M), xlabel="y (m), left is positive", ylabel="z (m)")
    axes.set_title("BFS-2D from the front: strongest power over x")


def _draw_side(axes: "Axes", look: RadarLook) -> None:
    _show(axes, look.views.side_db, CUBE_X_M, CUBE_Z_M)
    _outline(axes, look, 0, 2)
    axes.set(xlim=(0, CUBE_X_M[-1]), ylim=(_LOW_M, _HIGH_M), xlabel="x (m), ahead", ylabel="z (m)")
    axes.set_title("BFS-2D from the side: strongest power over y")


def _draw_bird(axes: "Axes", look: RadarLook) -> Any:
    image = _show(axes, look.views.bird_db.T, CUBE_Y_M, CUBE_X_M)
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
    colours = colormaps[_VELOCITY](views.wrapped_m_s / (2 * _SPAN_M_S) + 0.5)[..., :3]
    ground = np.array(to_rgb(_GROUND))
    azimuth = KRADAR_AXES.azimuth_deg
    axes.imshow(
        colours * share + ground * (1 - share),
        origin="lower",
        extent=(azimuth[0] - 0.5, azimuth[-1] + 0.5, 0.0, float(KRADAR_AXES.range_m[-1])),
        aspect="auto",
    )
    axes.set(xlim=(azimuth[-1], azimuth[0]), ylim=(0, float(KRADAR_AXES.range_m[-1])))
    scale = ScalarMappable(Normalize(-_SPAN_M_S, _SPAN_M_S), _VELOCITY)
    figure.colorbar(scale, ax=axes, location="bottom", label="radial velocity as measured, m/s", shrink=0.9, aspect=30)
