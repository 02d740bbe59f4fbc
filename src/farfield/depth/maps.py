"""One depth map from one sweep."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from farfield.depth.baselines import ip_basic, nearest_depth
from farfield.depth.blending import blend_raster
from farfield.depth.mesh import draw_mesh
from farfield.depth.rings import image_span, ring_numbers, rings_keep_elevation, sample_rings
from farfield.depth.sparse import NEAREST_M, is_visible, remove_hidden, sparse_depth
from farfield.depth.surface import DepthRaster, draw_surface
from farfield.errors import ConfigError
from farfield.geometry.cameras import Camera

Method = Literal["auto", "rings", "delaunay", "ip-basic", "nearest", "sparse"]
METHODS: tuple[str, ...] = get_args(Method)
"""``auto`` takes rings where they are known (and keep their elevation: the LiDAR stands where it should) or can be told
from the order of the rows, else delaunay."""

MOST_PIXELS, MOST_RINGS = 40_000_000, 512
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
        compiled: Whether numba draws; where it is installed unless given.

    Raises:
        ConfigError: If the camera has no size, the method is unknown, or it is rings and there are none.
    """
    if not 0 < camera.width_px * camera.height_px <= MOST_PIXELS:
        found = f"{camera.width_px} x {camera.height_px}"
        raise ConfigError(f"depth_map: expected a camera of 1 to {MOST_PIXELS} pixels, got {found}")
    if method not in METHODS:
        raise ConfigError(f"method: expected one of {', '.join(METHODS)}, got {method!r}")
    ring = None if ring is None else _counted(ring)
    if method == "auto" and ring is not None and not rings_keep_elevation(points_m, ring):
        method = "delaunay"
    if method in ("auto", "rings"):
        ring = ring_numbers(points_m) if ring is None else ring
        if ring is None and method == "rings":
            raise ConfigError(
                "method: expected a cloud with the column 'ring', or one whose rows go ring by ring, for rings; got "
                f"{len(points_m)} points without (or of more than {MOST_RINGS} rings). Take delaunay, or auto."
            )
    ahead = rows_ahead(points_m, camera)
    points_m, ring = points_m[ahead], None if ring is None else ring[ahead]
    if ring is not None and method in ("auto", "rings"):
        return _from_rings(points_m, ring, camera, max_gap_deg, compiled)
    return _from_pixels(points_m, ring, camera, "delaunay" if method == "auto" else method, max_gap_deg, compiled)


def _counted(ring: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"] | None:
    """Rings counted from 0, whatever their names; None where there are too many to be rings."""
    if not len(ring) or (ring.min() >= 0 and ring.max() < MOST_RINGS):
        return ring
    names, counted = np.unique(ring, return_inverse=True)
    return counted if len(names) <= MOST_RINGS else None


def rows_ahead(points_m: Float[np.ndarray, "n 3"], camera: Camera) -> Int[np.ndarray, " k"]:
    """Rows of the points before the camera and about as far to the sides as it sees."""
    low, high = image_span(camera)
    margin = _MARGIN * (high[0] - low[0])
    pose = camera.camera_T_lidar.astype(points_m.dtype)
    with np.errstate(invalid="ignore"):
        x, z = points_m @ pose[0, :3] + pose[0, 3], points_m @ pose[2, :3] + pose[2, 3]
        chosen = (z > NEAREST_M) & (x > (low[0] - margin) * z) & (x < (high[0] + margin) * z)
    rows = np.flatnonzero(chosen)
    return rows[np.isfinite(points_m[rows]).all(axis=1)]


def _from_rings(
    points_m: Float[np.ndarray, "n 3"],
    ring: Int[np.ndarray, " n"],
    camera: Camera,
    max_gap_deg: float,
    compiled: bool | None,
) -> DepthMap:
    low, high = image_span(camera)
    aside = np.cos(np.arctan(np.abs([low[0], high[0]]).max()))  # an angle upwards spans more pixels there
    step = float(np.clip(_STEP_PX / camera.matrix[1, 1] * aside, *_STEPS_RAD))
    gap = float(np.radians(max_gap_deg))
    rings = sample_rings(points_m, ring, camera, step_px=_STEP_PX, max_gap_rad=gap, compiled=compiled)
    drawn = draw_surface(rings, camera, step_rad=step, max_gap_rad=gap, compiled=compiled)
    filled = blend_raster(drawn, compiled=compiled)
    points = sparse_depth(points_m, camera)
    shown = np.isfinite(points) & is_visible(points, filled.depth_m)
    return _whole(filled, np.where(shown, points, np.inf), "rings")


def _from_pixels(
    points_m: Float[np.ndarray, "n 3"],
    ring: Int[np.ndarray, " n"] | None,
    camera: Camera,
    method: str,
    max_gap_deg: float,
    compiled: bool | None,
) -> DepthMap:
    window = occlusion_window(points_m, ring, camera)
    points = sparse_depth(points_m, camera)
    if method == "ip-basic":  # its first step prefers near points
        return _whole(_unsure(ip_basic(points, far_m=max(100.0, _farthest(points) + 1))), points, method, exact=False)
    points = remove_hidden(points, window)
    if method == "nearest":
        return _whole(_unsure(nearest_depth(points)), points, method)
    if method == "sparse":
        return _whole(DepthRaster(points, np.zeros(points.shape)), points, method)
    edge_px = float(np.tan(np.radians(max_gap_deg)) * camera.matrix[0, 0])
    return _whole(
        blend_raster(draw_mesh(points, max_edge_px=edge_px, compiled=compiled), compiled=compiled), points, method
    )


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


def _farthest(depth_m: Float[np.ndarray, "h w"]) -> float:
    return float(depth_m[np.isfinite(depth_m)].max(initial=0.0))


def _unsure(depth_m: Float[np.ndarray, "h w"]) -> DepthRaster:
    return DepthRaster(depth_m, np.full(depth_m.shape, np.nan))


def _whole(filled: DepthRaster, points_m: Float[np.ndarray, "h w"], method: str, *, exact: bool = True) -> DepthMap:
    """Put the measured depths where they were measured; inf becomes NaN."""
    measured = np.isfinite(points_m)
    depth = np.where(measured, points_m, filled.depth_m) if exact else filled.depth_m
    doubt = np.where(measured & ~np.isnan(filled.doubt_m), _SENSOR_M, filled.doubt_m)
    known = np.isfinite(depth)
    depth, doubt = (np.where(known, part, np.nan).astype(np.float32) for part in (depth, doubt))
    return DepthMap(depth, doubt, measured, method)
