"""The radar's strongest cells as a point cloud, from whichever product is there, and frames in its coordinates.

From the store (``cells``), the published sparse files (``sparse``), the cube or the tesseract comes the same cloud; the
published files hold what their rate and region left. The polar map gives its own strongest cells, with their Doppler.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from jaxtyping import Float, Float32

from farfield.datasets.kradar.layout import SPARSE_COLUMNS
from farfield.datasets.kradar.tesseract import read_moments
from farfield.errors import ConfigError
from farfield.frame import Cloud, Frame, Given, Lazy, moved
from farfield.geometry.poses import invert
from farfield.radar.cells import OVERS, RATES, Over, RadarCells, cells_of_cube, find_region
from farfield.radar.products import Moments, doppler_cube, moments, polar_cloud, zyx_cube

RADAR_CLOUD = "radar"
_SOURCES = ("cells", "sparse", "corridor", "sparse_1p", "cube", "tesseract", "polar_cloud", "polar_cloud_1p", "polar3d")
_SPARSE_RATE = 0.01
_NEARLY_ALL = 0.999


@dataclass(frozen=True, kw_only=True)
class RadarView:
    """Which cells of a radar frame become points.

    Args:
        rate: Share of the cube's cells, 1 or one of ``farfield.radar.cells.RATES``.
        region: Name of a region.
        over: ``"all"`` or ``"valid"`` cells of the cube are counted, or those of the ``"region"``. Published files hold
            what was counted when they were made.

    Raises:
        ConfigError: If one is none of those possible.
    """

    rate: float | int = 0.1
    region: str = "wide"
    over: str = "all"

    def __post_init__(self) -> None:
        if self.rate != 1 and self.rate not in RATES:
            raise ConfigError(f"radar_rate: expected 1 or one of {', '.join(map(str, RATES))}; got {self.rate}")
        if self.over not in OVERS:
            raise ConfigError(f"radar_over: expected one of {', '.join(OVERS)}; got {self.over!r}")
        find_region(self.region)


def with_radar_cloud(
    frame: Frame, view: RadarView, frame_T_radar: Float[np.ndarray, "4 4"], tesseract: Path | None = None
) -> Frame:
    """The frame with its cloud ``radar``, if it has a product that gives one; it is read when it is asked for.

    Args:
        frame: The frame, with its radar products.
        view: Which cells.
        frame_T_radar: Pose of the radar in the frame's coordinates.
        tesseract: The tesseract's file, which is reduced while it is read if there is nothing smaller.
    """
    source = _source(frame, view)
    if source is None:
        return frame
    clouds = {name: _loader(frame, name) for name in frame.clouds}
    clouds[RADAR_CLOUD] = partial(_placed_cloud, frame.radar, source, view, frame_T_radar, tesseract)
    return replace(frame, clouds=Lazy(clouds))


def _loader(frame: Frame, name: str) -> Callable[[], Any]:
    return frame.clouds.loader(name) if isinstance(frame.clouds, Lazy) else Given(frame.clouds[name])


def _placed_cloud(
    radar: Mapping[str, Any],
    source: str,
    view: RadarView,
    frame_T_radar: Float[np.ndarray, "4 4"],
    tesseract: Path | None,
) -> Cloud:
    """The cloud of a product in the frame's coordinates."""
    reduced = read_moments(tesseract) if source == "tesseract" and tesseract is not None else None
    cloud = radar_cloud(source, radar[source] if reduced is None else reduced, view)
    return cloud if np.array_equal(frame_T_radar, np.eye(4)) else cloud.transform(frame_T_radar)


def _source(frame: Frame, view: RadarView) -> str | None:
    """The product to take: one without loss or the cheapest to read; of published clouds that of the view."""
    fitting = [name for name in _SOURCES if name.endswith("_1p")] if view.rate <= _SPARSE_RATE else []
    fitting += ["corridor"] if view.over == "region" else []
    return next((name for name in ("cells", *fitting, *_SOURCES) if name in frame.radar), None)


def radar_cloud(product: str, values: Any, view: RadarView) -> Cloud:
    """A cloud in the radar's frame: column ``power`` is power over 1e13, ``doppler_m_s`` stands where it is known.

    Args:
        product: Name of a radar product.
        values: The product; of a tesseract also its moments.
        view: Which cells.
    """
    if product in SPARSE_COLUMNS:
        return _of_columns(np.asarray(values, dtype=np.float32), view)
    if product == "polar3d":
        polar = np.ascontiguousarray(values, dtype=np.float32)
        if view.over != "region" or view.rate == 1:
            return _of_columns(polar_cloud(polar, min(view.rate, _NEARLY_ALL)), view)
        inside = _of_columns(polar_cloud(polar, _NEARLY_ALL), view)
        power = inside.extra["power"]
        return inside[power > np.quantile(power, 1 - view.rate)] if len(inside) else inside
    doppler = None
    if product == "tesseract":
        reduced = values if isinstance(values, Moments) else moments(np.asarray(values, dtype=np.float32))
        values, doppler = zyx_cube(reduced.mean_power), doppler_cube(reduced.mean_power_63, reduced.velocity_moment)
    cells = values
    if not isinstance(values, RadarCells):
        cells = cells_of_cube(np.asarray(values, np.float32), view.region, doppler_m_s=doppler)
    chosen = cells.select(view.region, view.rate, over=cast(Over, view.over))
    extra = {} if chosen.doppler_m_s is None else {"doppler_m_s": chosen.doppler_m_s}
    return Cloud(chosen.points_m(), None, {"power": chosen.power, **extra})


def _of_columns(columns: Float32[np.ndarray, "n c"], view: RadarView) -> Cloud:
    region = find_region(view.region)
    bounds = np.array([region.x_m, region.y_m, region.z_m], dtype=np.float64)
    kept = columns[((columns[:, :3] >= bounds[:, 0]) & (columns[:, :3] < bounds[:, 1])).all(axis=1)]
    extra = {"doppler_m_s": kept[:, 4]} if columns.shape[1] > 4 else {}
    return Cloud(kept[:, :3], None, {"power": kept[:, 3], **extra})


def in_radar_frame(frame: Frame, os2_T_radar: Float[np.ndarray, "4 4"]) -> Frame:
    """A frame of the os2-64's coordinates in the radar's; the os1-128's cloud stays in its own."""
    return moved(frame, invert(os2_T_radar), reference=RADAR_CLOUD)
