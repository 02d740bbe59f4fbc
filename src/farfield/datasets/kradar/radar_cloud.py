"""The radar's strongest cells as a point cloud, from whichever product is there.

From the store (``cells``), the published sparse files (``sparse``), the cube or the tesseract comes the same cloud; the
published files hold what their rate and region left. The polar map gives its own strongest cells, with their Doppler.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, cast

import numpy as np
from jaxtyping import Float, Float32
from pydantic import BaseModel, ConfigDict

from farfield.datasets.kradar.layout import POLAR_RATES, SPARSE_COLUMNS
from farfield.datasets.maps import Earlier, TransformedCloud
from farfield.datasets.maps.sweeps import StackedCloud
from farfield.errors import ConfigError
from farfield.frame import Cloud, Constant, Frame, Lazy, Pose
from farfield.radar.cells import OVERS, RATES, Over, RadarCells, cells_of_cube, find_region
from farfield.radar.products import doppler_cube, moments, polar_cloud, zyx_cube

RADAR_CLOUD = "radar"
_SOURCES = ("cells", "sparse", "corridor", "sparse_1p", "cube", "moments", "tesseract")
_SPARSE_RATE = 0.01
_NEARLY_ALL = 0.999


class RadarViewSettings(BaseModel):
    """Settings of :class:`RadarView`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rate: float = 0.1
    region: str = "wide"
    over: str = "all"


@dataclass(frozen=True, kw_only=True)
class RadarView:
    """The cloud ``radar`` of every frame made anew from its radar products; it is read when it is asked for.

    Frames without such products stay as they are. Stack sweeps afterwards, since a new cloud has one.

    Args:
        rate: Share of the cube's cells that become points, 1 or one of ``farfield.radar.cells.RATES``.
        region: Name of a region.
        over: ``"all"`` or ``"valid"`` cells of the cube are counted, or those of the ``"region"``. Published files hold
            what was counted when they were made.

    Raises:
        ConfigError: If one is none of those possible, or a frame has several sweeps already.
    """

    name: ClassVar[str] = "radar_view"
    Settings: ClassVar[type[BaseModel]] = RadarViewSettings
    overrules: ClassVar[bool] = True
    keeps_annotation: ClassVar[bool] = True
    rate: float | int = 0.1
    region: str = "wide"
    over: str = "all"

    def __post_init__(self) -> None:
        if self.rate != 1 and self.rate not in RATES:
            raise ConfigError(f"radar_rate: expected 1 or one of {', '.join(map(str, RATES))}; got {self.rate}")
        if self.over not in OVERS:
            raise ConfigError(f"radar_over: expected one of {', '.join(OVERS)}; got {self.over!r}")
        find_region(self.region)

    def settings(self) -> Mapping[str, Any]:
        """Rate, region and what is counted."""
        return {"rate": float(self.rate), "region": self.region, "over": self.over}

    def fits(self, dataset: Any) -> bool:
        """Whether the data set offers views of its radar."""
        return "radar_rate" in dataset.view_options

    def moved_poses(self, world_T_frame: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
        """The poses as they are."""
        return world_T_frame

    def __call__(self, frame: Frame, earlier: Earlier) -> Frame:
        """The frame with its cloud ``radar`` in this view, if it has a product that gives one."""
        del earlier
        source = _source(frame, self)
        if source is None:
            return frame
        loaders = {
            name: frame.clouds.loader(name) if isinstance(frame.clouds, Lazy) else Constant(frame.clouds[name])
            for name in frame.clouds
        }
        if isinstance(loaders.get(RADAR_CLOUD), StackedCloud):
            raise ConfigError(f"radar_view: frame {frame.key} has several sweeps already; stack them after the view.")
        loader = TransformedCloud(partial(_read, frame.radar, source, self), _frame_T_radar(frame, source))
        return replace(frame, clouds=Lazy(loaders | {RADAR_CLOUD: loader}))


def _source(frame: Frame, view: RadarView) -> str | None:
    """The product to take: one without loss or the cheapest to read; of published clouds that of the view."""
    fitting = ["sparse_1p", "polar_cloud_1p"] if view.rate <= _SPARSE_RATE else []
    fitting += ["corridor"] if view.over == "region" else []
    polar = sorted(
        POLAR_RATES, key=lambda name: abs(POLAR_RATES[name] - view.rate)
    )  # the density asked for, or nearest
    return next((name for name in ("cells", *fitting, *_SOURCES, *polar, "polar3d") if name in frame.radar), None)


def _read(products: Mapping[str, Any], source: str, view: RadarView) -> Cloud:
    return radar_cloud(source, products[source], view)


def _frame_T_radar(frame: Frame, source: str) -> Pose:
    """Pose of the radar that a product is from, or else of the frame's radar."""
    poses = (frame.sensors[name].frame_T_sensor for name in (source, RADAR_CLOUD) if name in frame.sensors)
    pose = next((candidate for candidate in poses if candidate is not None), None)
    if pose is None:
        raise ConfigError(f"radar_view: expected frame {frame.key} to know where the radar of {source!r} stands.")
    return pose


def radar_cloud(product: str, values: Any, view: RadarView) -> Cloud:
    """A cloud in the radar's frame: column ``power`` is power over 1e13, ``doppler_m_s`` stands where it is known.

    Args:
        product: Name of a radar product.
        values: The product.
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
    if product in ("moments", "tesseract"):
        reduced = values if product == "moments" else moments(np.asarray(values, dtype=np.float32))
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
    inside = columns[((columns[:, :3] >= bounds[:, 0]) & (columns[:, :3] < bounds[:, 1])).all(axis=1)]
    extra = {"doppler_m_s": inside[:, 4]} if columns.shape[1] > 4 else {}
    return Cloud(inside[:, :3], None, {"power": inside[:, 3], **extra})
