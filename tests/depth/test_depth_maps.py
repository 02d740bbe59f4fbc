"""Depth maps of surfaces that are known exactly: planes, a board before a wall, gaps, orders of rows."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fans import BARREL, camera, directions, onto_plane, true_plane
from scipy import ndimage

from farfield.depth import METHODS, completion, depth_map
from farfield.depth.completion import draw_mesh, ip_basic, nearest_depth
from farfield.depth.raster import remove_hidden, sparse_depth
from farfield.depth.rings import ring_numbers
from farfield.errors import ConfigError
from farfield.geometry.cameras import CAMERA_T_LIDAR_AXES

NUMBA = importlib.util.find_spec("numba") is not None
HOW = [False, pytest.param(True, marks=pytest.mark.skipif(not NUMBA, reason="numba is not installed"))]


def inner(known: np.ndarray, pixels: int = 6) -> np.ndarray:
    """Pixels that lie well inside of what is known."""
    return ndimage.binary_erosion(known, iterations=pixels)


@pytest.mark.parametrize("compiled", HOW)
@pytest.mark.parametrize("distortion", [None, BARREL])
def test_a_tilted_plane_at_250_m_is_right_within_a_pixel(compiled: bool, distortion: np.ndarray | None) -> None:
    lens = camera(distortion=distortion)
    rays, ring = directions(64)
    normal = np.array([1.0, 0.2, 0.15]) / np.linalg.norm([1.0, 0.2, 0.15])
    ranges = onto_plane(rays, normal, 250.0)
    hit = np.isfinite(ranges) & (rays[:, 0] > 0.3)
    made = depth_map(rays[hit] * ranges[hit, None], lens, ring=ring[hit], compiled=compiled)
    truth = true_plane(lens, normal, 250.0)
    inside = inner(np.isfinite(made.depth_m)) & ~made.measured  # measured depths stay as they are, beside the centre
    assert inside.mean() > 0.35
    error = np.abs(made.depth_m - truth)[inside]
    assert np.nanmedian(np.abs(np.diff(truth, axis=1))) > 0.2  # metres a pixel
    assert np.median(error) < 0.05
    assert error.max() < 0.2


def test_a_mesh_on_inverse_depth_has_no_error_on_a_plane_but_that_of_rounded_pixels() -> None:
    lens = camera()
    rays, _ = directions(32)
    normal, offset = np.array([1.0, 0.0, 0.0]), 30.0
    ranges = onto_plane(rays, normal, offset)
    hit = np.isfinite(ranges) & (rays[:, 0] > 0.3)
    made = depth_map(rays[hit] * ranges[hit, None], lens, method="delaunay")
    inside = inner(np.isfinite(made.depth_m))
    assert inside.mean() > 0.6
    assert np.abs(made.depth_m - true_plane(lens, normal, offset))[inside].max() < 1e-3


def board(lines: int = 32) -> tuple[np.ndarray, np.ndarray]:
    """A board 2 m wide at 6 m before a wall at 30 m, both all the way up; and the rings."""
    rays, ring = directions(lines)
    ranges = onto_plane(rays, np.array([1.0, 0, 0]), 30.0)
    near = onto_plane(rays, np.array([1.0, 0, 0]), 6.0)
    ranges = np.where(np.abs(rays[:, 1] * near) < 1.0, near, ranges)
    hit = np.isfinite(ranges) & (rays[:, 0] > 0.3)
    return rays[hit] * ranges[hit, None], ring[hit]


@pytest.mark.parametrize("compiled", HOW)
@pytest.mark.parametrize("method", ["rings", "delaunay"])
def test_the_wall_does_not_show_through_the_board(method: str, compiled: bool) -> None:
    points, ring = board()
    aside = CAMERA_T_LIDAR_AXES.copy()
    aside[:3, 3] = [1.1, -0.2, -0.3]
    lens = replace(camera(), camera_T_lidar=aside)
    made = depth_map(points, lens, method=method, ring=ring, compiled=compiled)
    _, _, inside = lens.project(points)
    pixels, depth, _ = lens.project(points[inside])
    uv = np.rint(pixels).astype(int)
    near = depth < 10
    front = made.depth_m[uv[near, 1], uv[near, 0]]
    assert np.mean(np.abs(front - 5.7) < 0.2) > 0.97
    u = uv[near, 0]
    middle = made.depth_m[:, u.min() + 6 : u.max() - 6]
    assert np.nanmax(middle) < 8  # the wall's points behind it fell among these pixels
    behind = (uv[:, 0] > u.min() + 6) & (uv[:, 0] < u.max() - 6) & ~near
    assert behind.sum() > 20


def test_steps_are_where_it_is_unsure() -> None:
    points, ring = board()
    made = depth_map(points, camera(), ring=ring)
    step = np.abs(np.diff(made.depth_m, axis=1)) > 2
    assert np.nanmedian(made.uncertainty_m[:, 1:][step]) > 3
    assert np.nanmedian(made.uncertainty_m) < 0.5
    sure = made.surer_than(0.5)
    assert 0.3 < np.isfinite(sure.depth_m).mean() < np.isfinite(made.depth_m).mean()
    assert np.nanmax(sure.uncertainty_m) <= 0.5


def test_what_was_measured_stays_as_it_was_measured() -> None:
    points, ring = board()
    made = depth_map(points, camera(), ring=ring)
    sparse = sparse_depth(points, camera())
    assert made.measured.sum() > 1000
    assert np.array_equal(made.depth_m[made.measured], sparse[made.measured].astype(np.float32))


@pytest.mark.parametrize("method", ["rings", "delaunay"])
def test_sky_stays_empty(method: str) -> None:
    """Ground only: nothing above the horizon, and nothing across a gap wider than asked for."""
    rays, ring = directions(48)
    ranges = onto_plane(rays, np.array([0, 0, -1.0]), 1.7)
    azimuth = np.degrees(np.arctan2(rays[:, 1], rays[:, 0]))
    hit = (ranges < 80) & (rays[:, 0] > 0.3) & ~((azimuth > 2) & (azimuth < 16))
    made = depth_map(rays[hit] * ranges[hit, None], camera(), method=method, ring=ring[hit], max_gap_deg=5.0)
    pixels, _, _ = camera().project(rays[hit] * ranges[hit, None])
    top = int(np.nanmin(pixels[:, 1]))
    assert np.isnan(made.depth_m[: top - 4]).all()
    gap = camera().project(np.array([[np.cos(np.radians(9)), np.sin(np.radians(9)), -0.12]]) * 30)[0][0].astype(int)
    assert np.isnan(made.depth_m[gap[1], gap[0] - 2 : gap[0] + 3]).all()
    assert np.isfinite(made.depth_m).mean() > 0.2


@pytest.mark.skipif(not NUMBA, reason="numba is not installed")
@pytest.mark.parametrize("distortion", [None, BARREL])
def test_numba_and_numpy_agree(distortion: np.ndarray | None) -> None:
    points, ring = board(24)
    one, two = (depth_map(points, camera(distortion=distortion), ring=ring, compiled=how) for how in (True, False))
    assert np.array_equal(np.isnan(one.depth_m), np.isnan(two.depth_m))
    np.testing.assert_allclose(one.depth_m, two.depth_m, rtol=1e-4)
    assert np.nanmean(np.abs(one.uncertainty_m - two.uncertainty_m)) < 0.005  # of equally near points either may win


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("start", [0.0, np.pi])
def test_rings_are_told_from_the_order_of_the_rows(way: int, start: float, rng: np.random.Generator) -> None:
    rays, ring = directions(32, columns=900)
    turn = np.array([[np.cos(start), -np.sin(start), 0], [np.sin(start), np.cos(start), 0], [0, 0, 1]])
    rays = rays @ turn.T * [1, way, 1]
    kept = rng.random(len(rays)) < 0.8
    found = ring_numbers(rays[kept] * rng.uniform(5, 50, kept.sum())[:, None])
    assert found is not None
    assert np.array_equal(found, ring[kept])
    mixed = rng.permutation(kept.sum())
    assert ring_numbers((rays[kept] * 9)[mixed]) is None


def test_rings_are_asked_for_where_there_are_none(rng: np.random.Generator) -> None:
    points = rng.uniform([5, -5, -1], [30, 5, 3], (2000, 3))
    with pytest.raises(ConfigError, match="ring"):
        depth_map(points, camera(), method="rings")
    assert depth_map(points, camera()).method == "delaunay"


def test_rings_seen_from_elsewhere_are_not_trusted() -> None:
    """About the car's middle on the ground a ring has no elevation of its own."""
    rays, ring = directions(32)
    ranges = np.minimum(onto_plane(rays, np.array([0, 0, -1.0]), 1.7), onto_plane(rays, np.array([1.0, 0, 0]), 40.0))
    hit = np.isfinite(ranges)
    points, ring = rays[hit] * ranges[hit, None], ring[hit]
    assert depth_map(points, camera(), ring=ring).method == "rings"
    shift = np.eye(4)
    shift[:3, 3] = [-1.3, 0, -1.7]
    lens = replace(camera(), camera_T_lidar=camera().camera_T_lidar @ shift)
    assert depth_map(points - shift[:3, 3], lens, ring=ring).method == "delaunay"
    assert depth_map(points - shift[:3, 3], lens, ring=ring, method="rings").method == "rings"


def test_whatever_rings_are_called(rng: np.random.Generator) -> None:
    """Names of rings come from files: large and negative ones cost nothing, and too many are none."""
    points, ring = board(16)
    named = rng.permutation(16)[ring] * 10**15 - 10**15
    np.testing.assert_array_equal(
        depth_map(points, camera(), ring=named).depth_m, depth_map(points, camera(), ring=ring).depth_m
    )
    assert depth_map(points, camera(), ring=np.arange(len(points))).method in ("delaunay", "rings")
    with pytest.raises(ConfigError, match="more than 512"):
        depth_map(points[::-1][rng.permutation(len(points))], camera(), method="rings", ring=np.arange(len(points)))


def test_the_nearest_point_of_a_pixel_counts() -> None:
    points = np.array([[20.0, 0, 0], [5.0, 0, 0], [9.0, 0, 0], [0.1, 0, 0], [np.nan, 0, 0], [-5.0, 0, 0]])
    lens = replace(camera(), camera_T_lidar=CAMERA_T_LIDAR_AXES)
    depth = sparse_depth(points, lens)
    assert depth[np.isfinite(depth)].tolist() == [5.0]


@pytest.mark.parametrize("method", METHODS)
def test_empty_and_tiny_sweeps(method: str) -> None:
    for points in (np.zeros((0, 3)), np.array([[10.0, 0, 0]]), np.array([[10.0, 0, 0], [11.0, 0.5, 0], [12.0, 1, 0]])):
        made = depth_map(points, camera(), method=method, ring=np.zeros(len(points), dtype=np.int64))
        assert made.depth_m.shape == (160, 300)
        assert np.isfinite(made.depth_m).sum() >= made.measured.sum()


def test_a_camera_without_size_is_refused() -> None:
    with pytest.raises(ConfigError, match="pixels"):
        depth_map(np.ones((10, 3)), replace(camera(), width_px=0))


def test_hidden_points_go_and_grazing_ground_stays() -> None:
    depth = np.full((9, 9), np.inf)
    depth[4, 4], depth[4, 5], depth[4, 6] = 5.0, 30.0, 5.3
    shown = remove_hidden(depth, (3, 3))
    assert np.isfinite(shown).sum() == 2
    assert np.isinf(shown[4, 5])


def test_nearest_and_ip_basic_by_hand() -> None:
    depth = np.full((40, 40), np.inf)
    depth[10, 10], depth[30, 30] = 10.0, 20.0
    near = nearest_depth(depth)
    assert near[9, 9] == 10
    assert near[31, 35] == 20
    filled = ip_basic(depth, extrapolate=False)
    assert filled[10, 10] == pytest.approx(10)
    assert np.isinf(filled[0, 39])
    whole = ip_basic(depth)
    assert np.isfinite(whole[:11, 10]).all()  # each column's top is carried up
    assert np.isfinite(whole).mean() > 2 * np.isfinite(filled).mean()
    both = np.full((40, 40), np.inf)
    both[20, 20], both[20, 22] = 30.0, 10.0
    assert ip_basic(both)[20, 21] == pytest.approx(10, abs=0.5)  # its dilation prefers what is near
    assert np.isinf(ip_basic(np.where(np.isfinite(depth), 200.0, np.inf))).all()  # beyond its 100 m all is empty
    assert np.isfinite(ip_basic(np.where(np.isfinite(depth), 200.0, np.inf), far_m=250.0)).any()


REAL = Path(__file__).resolve().parents[2].parent / "shared" / "real" / "kitti"


@pytest.mark.skipif(not REAL.is_dir(), reason="no real sweeps here")
def test_a_thinned_real_sweep_is_filled_better_than_by_the_baselines() -> None:
    from farfield.datasets import open_dataset
    from farfield.depth.maps import cloud_and_camera
    from farfield.metrics.depth import depth_errors

    cloud, lens = cloud_and_camera(open_dataset(REAL)[1])
    points, ring = cloud.points_m, ring_numbers(cloud.points_m)
    assert ring is not None
    assert ring.max() == 63
    kept = ring % 4 == 0
    given = sparse_depth(points[kept], lens)
    truth = np.where(np.isinf(given), remove_hidden(sparse_depth(points, lens), (5, 7)), np.nan)
    made = depth_map(points[kept], lens, ring=ring[kept])
    ours = depth_errors(nearest_depth(np.where(np.isnan(made.depth_m), np.inf, made.depth_m)), truth)
    theirs = depth_errors(ip_basic(given, stretch=4), truth)
    assert theirs.mae_mm > 1.3 * ours.mae_mm
    assert theirs.rmse_mm > ours.rmse_mm
    both = np.isfinite(truth) & np.isfinite(made.depth_m)
    error, doubt = np.abs(made.depth_m - truth)[both], made.uncertainty_m[both]
    sure = doubt <= np.quantile(doubt, 0.95)
    assert error[sure].mean() < 0.85 * error.mean()


@pytest.mark.skipif(not NUMBA, reason="numba is not installed")
@pytest.mark.parametrize("longest", [4.0, 30.0])
def test_compiled_code_fills_the_same_triangles_as_numpy(longest: float) -> None:
    random = np.random.default_rng(5)
    sparse = np.where(random.random((60, 90)) < 0.02, random.uniform(2, 200, (60, 90)), np.inf)
    one, other = (draw_mesh(sparse, max_edge_px=longest, compiled=compiled) for compiled in (False, True))
    np.testing.assert_allclose(one.depth_m, other.depth_m, rtol=1e-9)
    filled = np.isfinite(one.depth_m).mean()
    assert (filled > 0.6) == (longest == 30.0)
    assert filled > np.isfinite(sparse).mean()


@pytest.mark.parametrize("compiled", HOW)
def test_a_mesh_is_linear_in_inverse_depth_up_to_its_hull(compiled: bool) -> None:
    sparse = np.full((40, 50), np.inf)
    truth = 1 / (0.02 + 0.003 * np.arange(50)[None, :] + 0.001 * np.arange(40)[:, None])
    for row, column in ((0, 0), (0, 49), (39, 0), (39, 49), (17, 23), (30, 8)):
        sparse[row, column] = truth[row, column]
    drawn = draw_mesh(sparse, max_edge_px=100.0, compiled=compiled)
    np.testing.assert_allclose(drawn.depth_m, truth, rtol=1e-9)
    assert drawn.doubt_m[17, 23] == pytest.approx(0)
    assert drawn.doubt_m.max() > 1


@pytest.mark.parametrize("library", [None, "cv2"])
def test_meshes_of_both_libraries_are_alike(monkeypatch: pytest.MonkeyPatch, library: str | None) -> None:
    """On points of which no four lie on a circle the mesh is one; without OpenCV Qhull makes it."""
    sparse = np.full((60, 80), np.inf)
    rows, columns = np.array([3, 5, 20, 31, 50, 57, 44, 12]), np.array([4, 70, 33, 8, 12, 75, 49, 52])
    sparse[rows, columns] = np.linspace(5, 90, 8)
    expected = draw_mesh(sparse, max_edge_px=1e3).depth_m
    if library is None:
        monkeypatch.setattr(completion, "find_spec", lambda name: None)
    made = draw_mesh(sparse, max_edge_px=1e3, compiled=False).depth_m
    np.testing.assert_allclose(made, expected, rtol=1e-6)
    assert 0.3 < np.isfinite(made).mean() < 1
