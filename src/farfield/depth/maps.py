"""One dense depth map from one sweep, without learning: :func:`depth_map` is the algorithm.

With rings (``rings``) the sensor's own raster is interpolated and drawn; without (``delaunay`` and the baselines) the
measured pixels are; then the raster is blended, and what was measured is put back.
"""

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from farfield.depth.completion import draw_mesh, ip_basic, nearest_depth
from farfield.depth.raster import (
    NEAREST_M,
    DepthRaster,
    blend_raster,
    is_visible,
    remove_hidden,
    sparse_depth,
)
from farfield.depth.rings import draw_surface, image_span, ring_numbers, rings_keep_elevation, sample_rings
from farfield.errors import ConfigError, DatasetError
from farfield.files.clouds import MOST_RINGS
from farfield.frame import Cloud, Frame
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert
from farfield.vocabulary.counts import count_of

Method = Literal["auto", "rings", "delaunay", "ip-basic", "nearest", "sparse"]
METHODS: tuple[str, ...] = get_args(Method)
"""``auto`` takes rings where they are known (and keep their elevation: the LiDAR stands where it should) or follow
from the order of the rows, else delaunay."""

MOST_PIXELS = 40_000_000
MAX_GAP_DEG = 5.0
_MARGIN = 0.1  # of the image's width, beyond which no point matters
_STEP_PX = 1.2  # between drawn points
_STEPS_RAD = np.radians((0.02, 0.5))
_SPACING = 0.7  # of the spacing of lines: the window in which a sparse point is hidden
_LINES_DEG = 0.4  # spacing where rings are not known: 64 lines
_SENSOR_M = 0.02  # the doubt of what was measured


@dataclass(frozen=True, eq=False)
class DepthMap:
    """Depth along the optical axis by pixel.

    Args:
        depth_m: Metres, NaN where there is none, shape (height, width).
        uncertainty_m: How far the depth may be off: how much what it came from disagrees, NaN where there is none, and
            everywhere for methods that do not know, shape (height, width).
        measured: Where a point was measured rather than interpolated, shape (height, width).
        method: What filled it.
    """

    depth_m: Float32[np.ndarray, "h w"]
    uncertainty_m: Float32[np.ndarray, "h w"]
    measured: Bool[np.ndarray, "h w"]
    method: str

    def surer_than(self, uncertainty_m: float) -> "DepthMap":
        """Without the pixels whose uncertainty is larger; a method that knows none keeps all."""
        keep = ~(self.uncertainty_m > uncertainty_m)
        depth, doubt = (np.where(keep, part, np.float32(np.nan)) for part in (self.depth_m, self.uncertainty_m))
        return DepthMap(depth, doubt, self.measured & keep, self.method)


def depth_map(
    points_m: Float[np.ndarray, "n 3"],
    camera: Camera,
    *,
    method: Method = "auto",
    ring: Int[np.ndarray, " n"] | None = None,
    max_gap_deg: float = MAX_GAP_DEG,
    compiled: bool | None = None,
) -> DepthMap:
    """Make a dense depth map from a sweep.

    ``rings`` interpolates 1 / r in the sensor's own raster, along the rings and across them, and draws the surface;
    ``delaunay`` meshes the measured pixels and interpolates 1 / z. Both leave sky, and gaps wider than ``max_gap_deg``,
    empty. ``nearest`` and ``ip-basic`` fill the whole picture and know no uncertainty; ``sparse`` fills nothing.

    Args:
        points_m: Points in the axes of the LiDAR, at whose origin it stands, in the order of the file.
        camera: The camera, with its size; its pose refers to the LiDAR's axes.
        method: How the gaps are filled.
        ring: The ring of each point, if known.
        max_gap_deg: Neighbours that lie further apart are not joined.
        compiled: Whether numba draws (default: where it is installed).

    Raises:
        ConfigError: If the camera has no size, the method is unknown, or it is rings and there are none.
    """
    if not 0 < camera.width_px * camera.height_px <= MOST_PIXELS:
        size = f"{camera.width_px} x {camera.height_px}"
        raise ConfigError(f"depth_map: expected a camera of 1 to {MOST_PIXELS} pixels, got {size}")
    if method not in METHODS:
        raise ConfigError(f"method: expected one of {', '.join(METHODS)}, got {method!r}")

    # 1. Rings: as given, or told from the order of the rows; none where they do not keep their elevation.
    ring = None if ring is None else _count_rings(ring)
    if method == "auto" and ring is not None and not rings_keep_elevation(points_m, ring):
        method = "delaunay"
    if method in ("auto", "rings"):
        ring = ring_numbers(points_m) if ring is None else ring
        if ring is None and method == "rings":
            raise ConfigError(
                "method: expected a cloud with the column 'ring', or one whose rows go ring by ring, for rings; got "
                f"{count_of(len(points_m), 'point')} without (or of more than "
                f"{MOST_RINGS} rings). Take delaunay, or auto."
            )

    # 2. Points before the camera.
    ahead = rows_ahead(points_m, camera)
    points_m, ring = points_m[ahead], None if ring is None else ring[ahead]

    # 3. Interpolate between rings, or between pixels.
    if ring is not None and method in ("auto", "rings"):
        return _from_rings(points_m, ring, camera, max_gap_deg, compiled)
    return _from_pixels(points_m, ring, camera, "delaunay" if method == "auto" else method, max_gap_deg, compiled)


def _count_rings(ring: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"] | None:
    """Rings counted from 0, whatever their names; None where there are too many to be rings."""
    if not len(ring) or (ring.min() >= 0 and ring.max() < MOST_RINGS):
        return ring
    names, numbers = np.unique(ring, return_inverse=True)
    return numbers if len(names) <= MOST_RINGS else None


def rows_ahead(points_m: Float[np.ndarray, "n 3"], camera: Camera) -> Int[np.ndarray, " k"]:
    """Rows of the points before the camera and about as far to the sides as it sees."""
    low, high = image_span(camera)
    margin = _MARGIN * (high[0] - low[0])
    pose = camera.camera_T_lidar.astype(points_m.dtype)
    with np.errstate(invalid="ignore"):
        x, z = points_m @ pose[0, :3] + pose[0, 3], points_m @ pose[2, :3] + pose[2, 3]
        ahead = (z > NEAREST_M) & (x > (low[0] - margin) * z) & (x < (high[0] + margin) * z)
    rows = np.flatnonzero(ahead)
    return rows[np.isfinite(points_m[rows]).all(axis=1)]


def _from_rings(
    points_m: Float[np.ndarray, "n 3"],
    ring: Int[np.ndarray, " n"],
    camera: Camera,
    max_gap_deg: float,
    compiled: bool | None,
) -> DepthMap:
    # 1. Sample the rings at common azimuths.
    gap_rad = float(np.radians(max_gap_deg))
    grid = sample_rings(points_m, ring, camera, step_px=_STEP_PX, max_gap_rad=gap_rad, compiled=compiled)

    # 2. Draw the surface between them.
    low, high = image_span(camera)
    aside = np.cos(np.arctan(np.abs([low[0], high[0]]).max()))  # an angle upwards spans more pixels there
    step_rad = float(np.clip(_STEP_PX / camera.matrix[1, 1] * aside, *_STEPS_RAD))
    drawn = draw_surface(grid, camera, step_rad=step_rad, max_gap_rad=gap_rad, compiled=compiled)

    # 3. Blend.
    filled = blend_raster(drawn, compiled=compiled)

    # 4. Measured depths that are not hidden.
    measured_m = sparse_depth(points_m, camera)
    shown = np.isfinite(measured_m) & is_visible(measured_m, filled.depth_m)
    return _with_measured(filled, np.where(shown, measured_m, np.inf), "rings")


def _from_pixels(
    points_m: Float[np.ndarray, "n 3"],
    ring: Int[np.ndarray, " n"] | None,
    camera: Camera,
    method: str,
    max_gap_deg: float,
    compiled: bool | None,
) -> DepthMap:
    # 1. Measured depths that are not hidden.
    measured_m = sparse_depth(points_m, camera)
    if method == "ip-basic":  # its first step prefers near points
        far_m = max(100.0, float(measured_m[np.isfinite(measured_m)].max(initial=0.0)) + 1)
        return _with_measured(_of_no_doubt(ip_basic(measured_m, far_m=far_m)), measured_m, method, exact=False)
    measured_m = remove_hidden(measured_m, occlusion_window(points_m, ring, camera))

    # 2. Fill.
    if method == "nearest":
        return _with_measured(_of_no_doubt(nearest_depth(measured_m)), measured_m, method)
    if method == "sparse":
        return _with_measured(DepthRaster(measured_m, np.zeros(measured_m.shape)), measured_m, method)
    edge_px = float(np.tan(np.radians(max_gap_deg)) * camera.matrix[0, 0])
    drawn = draw_mesh(measured_m, max_edge_px=edge_px, compiled=compiled)
    return _with_measured(blend_raster(drawn, compiled=compiled), measured_m, method)


def occlusion_window(
    points_m: Float[np.ndarray, "n 3"], ring: Int[np.ndarray, " n"] | None, camera: Camera
) -> tuple[int, int]:
    """Rows and columns in which a sparse point may be hidden: 0.7 of the lines' spacing, and 7; both odd."""
    spacing = np.radians(_LINES_DEG)
    if ring is not None and len(ring):
        counts = np.bincount(ring)
        sine = points_m[:, 2] / np.maximum(np.linalg.norm(points_m, axis=1), 1e-3)
        heights = np.sort(np.bincount(ring, sine)[counts > 0] / counts[counts > 0])
        spacing = float(np.median(np.diff(heights))) if len(heights) > 1 else spacing
    rows = round(_SPACING * spacing * camera.matrix[1, 1])
    return int(np.clip(rows, 5, 41)) // 2 * 2 + 1, 7


def _of_no_doubt(depth_m: Float[np.ndarray, "h w"]) -> DepthRaster:
    """Depths of a method that knows no uncertainty."""
    return DepthRaster(depth_m, np.full(depth_m.shape, np.nan))


def _with_measured(
    filled: DepthRaster, measured_m: Float[np.ndarray, "h w"], method: str, *, exact: bool = True
) -> DepthMap:
    """Put the measured depths where they were measured; inf becomes NaN."""
    measured = np.isfinite(measured_m)
    depth = np.where(measured, measured_m, filled.depth_m) if exact else filled.depth_m
    doubt = np.where(measured & ~np.isnan(filled.doubt_m), _SENSOR_M, filled.doubt_m)
    finite = np.isfinite(depth)
    depth, doubt = (np.where(finite, part, np.nan).astype(np.float32) for part in (depth, doubt))
    return DepthMap(depth, doubt, measured, method)


# The depth map of a frame: which cloud, which camera, and the way from one to the other


def frame_depth(
    frame: Frame,
    *,
    cloud: str | None = None,
    camera: str | None = None,
    method: Method = "auto",
    max_gap_deg: float = MAX_GAP_DEG,
) -> DepthMap:
    """Make the depth map of one of a frame's cameras from one of its clouds.

    Args:
        frame: The frame.
        cloud: Name of the cloud (default: the first of a LiDAR).
        camera: Name of the camera (default: the first calibrated one).
        method: As of :func:`depth_map`.
        max_gap_deg: As there.

    Raises:
        DatasetError: If there is no such cloud or camera, or nothing says how the cloud stands to the camera.
        ConfigError: As :func:`depth_map`.
    """
    points, lens = cloud_and_camera(frame, cloud, camera)
    ring = points.extra.get("ring")
    return depth_map(
        points.points_m,
        lens,
        method=method,
        ring=None if ring is None else ring.astype(np.int64),
        max_gap_deg=max_gap_deg,
    )


def cloud_and_camera(frame: Frame, cloud: str | None = None, camera: str | None = None) -> tuple[Cloud, Camera]:
    """A cloud in its sensor's own axes, and a camera whose pose refers to them; see :func:`frame_depth`."""
    name = _cloud_name(frame, cloud)
    lens = _camera(frame, camera)
    points, sensor = frame.cloud(name), frame.sensors.get(name)
    pose = None if sensor is None else sensor.frame_T_sensor
    if sensor is not None and not sensor.in_frame:
        if pose is None:
            raise DatasetError(
                f"frame {frame.key}: cloud {name} keeps its sensor's own axes, and nothing says where that stands; "
                "take another with cloud=, or give the data set the sensor's pose"
            )
        return points, replace(lens, camera_T_lidar=lens.camera_T_lidar @ pose)
    if pose is None:
        return points, lens
    return points.transform(invert(pose)), replace(lens, camera_T_lidar=lens.camera_T_lidar @ pose)


def _cloud_name(frame: Frame, cloud: str | None) -> str:
    """The cloud that was named, or the first of a LiDAR."""
    available = ", ".join(frame.clouds) or "none"
    if cloud is not None:
        if cloud not in frame.clouds:
            raise DatasetError(f"frame {frame.key}: expected cloud {cloud!r}, found {available}")
        return cloud
    lidars = [name for name in frame.clouds if name not in frame.sensors or frame.sensors[name].kind == "lidar"]
    if not lidars:
        raise DatasetError(f"frame {frame.key}: expected a LiDAR's cloud, found {available}")
    return lidars[0]


def _camera(frame: Frame, camera: str | None) -> Camera:
    """The camera that was named, or the first calibrated one, with its size."""
    available = ", ".join(frame.cameras) or "none (Cirrus: name your calibration in the mapping)"
    if camera is not None and camera not in frame.cameras:
        raise DatasetError(f"frame {frame.key}: expected calibrated camera {camera!r}, found {available}")
    name = camera or next(iter(frame.cameras), None)
    if name is None:
        raise DatasetError(f"frame {frame.key}: expected a calibrated camera, found {available}")
    lens = frame.cameras[name]
    if lens.width_px and lens.height_px:
        return lens
    if name not in frame.images:
        raise DatasetError(f"frame {frame.key}: expected the size of camera {name!r} or its image, found neither")
    height, width = frame.images[name].shape[:2]
    return replace(lens, width_px=width, height_px=height)
