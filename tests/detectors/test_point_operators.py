import numpy as np
import pytest

torch = pytest.importorskip("torch")

from farfield.detectors.onnx.points import farthest_of_one
from farfield.detectors.pointrcnn import points as ops
from farfield.detectors.pointrcnn.points import _farthest_side_by_side
from farfield.geometry.boxes import Boxes, points_in_boxes


def road(rng: np.random.Generator, count: int) -> torch.Tensor:
    """A cloud that is dense near the sensor and thin far away, as real ones are."""
    range_m = 250 * rng.random(count) ** 3
    side = rng.uniform(-1, 1, count) * np.minimum(range_m, 50)
    return torch.from_numpy(np.column_stack([range_m, side, rng.normal(-2, 0.5, count)]).astype(np.float32))


def greedy(points: np.ndarray, count: int) -> list[int]:
    """The definition: again and again the point farthest from those already chosen."""
    chosen = [0]
    while len(chosen) < count:
        gap2 = ((points[:, None] - points[None, chosen]) ** 2).sum(2, dtype=np.float32).min(1)
        chosen.append(int(gap2.argmax()))
    return chosen


@pytest.mark.parametrize("method", ["of_one", "side_by_side"])
def test_farthest_points_are_the_greedy_sequence(rng, method):
    cloud = road(rng, 700)
    if method == "of_one":
        chosen = farthest_of_one(cloud.numpy(), 90).tolist()
    else:
        chosen = _farthest_side_by_side(cloud, [700], 90).tolist()
    assert chosen == greedy(cloud.numpy(), 90)


def test_farthest_points_of_many_frames_are_those_of_each(rng):
    clouds = [road(rng, n) for n in (5000, 0, 3, 40)]
    lengths = [len(c) for c in clouds]
    chosen, taken = ops.farthest_points(torch.cat(clouds), lengths, 32)
    assert taken == [32, 0, 3, 32]
    first = np.cumsum([0, *lengths])
    parts = chosen.split(taken)
    for index, cloud in enumerate(clouds):
        alone = ops.farthest_points(cloud, [len(cloud)], 32)[0]
        assert torch.equal(parts[index] - first[index], alone)


def test_a_prefix_of_farthest_points_is_the_farthest_points_of_the_choice(rng):
    cloud = road(rng, 3000)
    chosen = ops.farthest_points(cloud, [3000], 400)[0]
    again = ops.farthest_points(cloud[chosen], [400], 100)[0]
    assert torch.equal(again, torch.arange(100))


def test_equal_points_are_chosen_once_each():
    cloud = torch.zeros(6, 3)
    cloud[3] = 1
    assert sorted(ops.farthest_points(cloud, [6], 2)[0].tolist()) == [0, 3]
    assert len(ops.farthest_points(cloud, [6], 6)[0]) == 6


@pytest.mark.parametrize("count", [64, 300])
def test_spread_points_cover_nearly_as_well_as_farthest_points(rng, count):
    cloud = road(rng, 4000)

    def radius(chosen: torch.Tensor) -> float:
        return float(torch.cdist(cloud, cloud[chosen]).amin(1).max())

    chosen, taken = ops.spread_points(cloud, [4000], count)
    assert taken == [count]
    assert len(torch.unique(chosen)) == count
    assert radius(chosen) < 3 * radius(ops.farthest_points(cloud, [4000], count)[0])
    assert radius(chosen) < 0.75 * radius(torch.arange(count))  # of a random choice


def test_spread_points_take_every_point_if_asked_to(rng):
    cloud = torch.cat([road(rng, 50), torch.zeros(5, 3)])
    assert sorted(ops.spread_points(cloud, [55], 100)[0].tolist()) == list(range(55))


@pytest.mark.parametrize(("radii", "limits"), [((0.5, 3.0), (4, 16)), ((20.0,), (1000,)), ((0.01, 8.0), (2, 3))])
def test_ball_query_equals_all_distances(rng, radii, limits, monkeypatch):
    monkeypatch.setattr(ops, "_CANDIDATES", 500)  # many pieces
    clouds, queries = [road(rng, n) for n in (300, 0, 150)], [road(rng, m) for m in (40, 7, 25)]
    points, centres = torch.cat(clouds), torch.cat(queries)
    groups = ops.ball_query(points, [300, 0, 150], centres, [40, 7, 25], radii_m=radii, limits=limits)
    frame, centre_frame = np.repeat([0, 1, 2], [300, 0, 150]), np.repeat([0, 1, 2], [40, 7, 25])
    gap2 = ((centres[:, None] - points[None]) ** 2).sum(2).numpy()
    for radius, limit, group in zip(radii, limits, groups, strict=True):
        expected = [
            (i, j)
            for i in range(len(centres))
            for j in np.flatnonzero((gap2[i] <= radius**2) & (frame == centre_frame[i]))[:limit]
        ]
        assert list(zip(group.centre.tolist(), group.point.tolist(), strict=True)) == expected
        assert group.centres == 72


def test_the_distances_of_all_pairs_give_the_same_groups(rng):
    points, centres, reach = road(rng, 300), road(rng, 40), {"radii_m": (0.01, 0.5, 8.0), "limits": (2, 4, 1000)}
    expected = ops.ball_query(points, [300], centres, [40], **reach)
    for got, group in zip(ops.all_within(points, centres, *reach.values()), expected, strict=True):
        assert torch.equal(got.centre, group.centre)
        assert torch.equal(got.point, group.point)
        assert got.centres == group.centres == 40


def test_ball_query_finds_points_on_the_sphere():
    points = torch.tensor([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0.9, 0.9, 0]])
    group = ops.ball_query(points, [6], torch.zeros(1, 3), [1], radii_m=[1.0], limits=[10])[0]
    assert group.point.tolist() == [0, 1, 2, 3, 4]


def test_group_max_equals_a_loop_and_shares_gradients():
    centre = torch.tensor([0, 0, 2, 2, 2])
    groups = ops.Groups(centre, torch.arange(5), 4)
    values = torch.tensor([[1.0, -3], [2, -4], [5, 1], [5, 0], [4, 1]], requires_grad=True)
    pooled = ops.group_max(values, groups)
    assert pooled.tolist() == [[2, -3], [0, 0], [5, 1], [0, 0]]
    (pooled * torch.tensor([[1.0, 2], [7, 7], [4, 6], [9, 9]])).sum().backward()
    assert values.grad.tolist() == [[0, 2], [1, 0], [2, 3], [2, 0], [0, 3]]


def test_group_max_passes_gradcheck(rng):
    centre = torch.sort(torch.from_numpy(rng.integers(0, 5, 20))).values
    groups = ops.Groups(centre, torch.arange(20), 6)
    values = torch.from_numpy(rng.normal(size=(20, 3))).requires_grad_()
    assert torch.autograd.gradcheck(lambda v: ops.group_max(v, groups), (values,))


@pytest.mark.parametrize("method", ["_nearest_by_tree", "_nearest_by_distance"])
def test_three_nearest_equal_all_distances(rng, method, monkeypatch):
    monkeypatch.setattr(ops, "_DISTANCES", 1000)
    query, source = road(rng, 200), road(rng, 60)
    row, gap = getattr(ops, method)(query, source)
    gaps = torch.cdist(query.double(), source.double())
    torch.testing.assert_close(gap.double(), gaps.sort(1).values[:, :3], rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(gaps.gather(1, row), gap.double(), rtol=1e-5, atol=1e-5)


def test_interpolation_stays_in_its_frame_and_reproduces_the_sources(rng):
    clouds = [road(rng, n) for n in (30, 2, 0)]
    queries = [torch.cat([clouds[0], road(rng, 9)]), road(rng, 5), road(rng, 4)]
    row, weight = ops.three_nearest(torch.cat(queries), [39, 5, 4], torch.cat(clouds), [30, 2, 0])
    values = torch.from_numpy(rng.normal(size=(32, 6))).float().requires_grad_()
    out = ops.interpolate(values, row, weight)
    torch.testing.assert_close(out[:30], values[:30], rtol=1e-3, atol=1e-3)
    assert (row[:39] < 30).all()
    assert ((row[39:44] >= 30) | (weight[39:44] == 0)).all()
    torch.testing.assert_close(weight[:44].sum(1), torch.ones(44))
    assert not out[44:].any()
    out.sum().backward()
    torch.testing.assert_close(values.grad.sum(), torch.tensor(44.0 * 6), rtol=1e-4, atol=1e-3)


def test_points_in_rois_equal_points_in_boxes(rng):
    clouds, lengths, rois = [road(rng, 2000), road(rng, 500)], [2000, 0, 500], []
    for centre in (clouds[0][:30], clouds[1][:3], clouds[1][:20]):
        n = len(centre)
        rois.append(torch.cat([centre, torch.from_numpy(rng.uniform(0.3, 12, (n, 3))).float()], 1))
        rois[-1] = torch.cat([rois[-1], torch.from_numpy(rng.uniform(-9, 9, (n, 1))).float()], 1)
    groups = ops.points_in_rois(torch.cat(clouds), lengths, torch.cat(rois), [30, 3, 20], context_m=1.0, limit=40)
    pairs = []
    for frame, first_roi, first_point in ((0, 0, 0), (2, 33, 2000)):
        r = rois[frame].double().numpy()
        boxes = Boxes(centre_m=r[:, :3], size_m=r[:, 3:6], yaw_rad=r[:, 6])
        for index, inside in enumerate(points_in_boxes(clouds[frame // 2].numpy(), boxes, margin_m=1.0)):
            pairs += [(index + first_roi, j + first_point) for j in inside[:40]]
    assert list(zip(groups.centre.tolist(), groups.point.tolist(), strict=True)) == pairs
    assert groups.centres == 53


def test_no_points_no_pairs():
    none = torch.zeros(0, 3)
    assert ops.farthest_points(none, [0, 0], 4)[1] == [0, 0]
    assert ops.ball_query(none, [0], none, [0], radii_m=[1.0], limits=[3])[0].centres == 0
    assert len(ops.points_in_rois(none, [0], torch.zeros(2, 7), [2], context_m=1.0, limit=4).point) == 0
    assert ops.three_nearest(none, [0], none, [0])[0].shape == (0, 3)
    assert ops.interpolate(torch.zeros(0, 4), torch.zeros(3, 3).long(), torch.zeros(3, 3)).shape == (3, 4)


@pytest.mark.parametrize(
    ("available", "budget", "expected"),
    [
        ([100, 100, 100], 60, [30, 18, 12]),
        ([5, 100, 100], 60, [5, 33, 22]),  # what the first leaves goes to the others by their shares
        ([5, 6, 7], 60, [5, 6, 7]),
        ([0, 0, 100], 60, [0, 0, 60]),
        ([100, 100, 100], 1, [1, 0, 0]),
        ([0, 0, 0], 10, [0, 0, 0]),
    ],
)
def test_budget_is_shared_and_nothing_of_it_lost(available, budget, expected):
    assert ops.share_budget(np.array(available), (0.5, 0.3, 0.2), budget).tolist() == expected


def test_band_sampling_keeps_far_points_and_does_not_depend_on_order(rng):
    cloud = road(rng, 6000)
    range_m = np.hypot(*cloud[:, :2].T.numpy())
    bands = ops.BandConfig(edges_m=(0.0, 40.0, 80.0, 150.0, 250.0), shares=(0.25, 0.25, 0.25, 0.25))
    chosen = ops.sample_bands(cloud, bands, 3000)
    assert len(torch.unique(chosen)) == 3000
    counts = np.histogram(range_m[chosen.numpy()], [0, 40, 80, 150, 400])[0]
    available = np.histogram(range_m, [0, 40, 80, 150, 400])[0]
    assert counts.tolist() == ops.share_budget(available, bands.shares, 3000).tolist()
    shuffled = torch.from_numpy(rng.permutation(6000))
    assert torch.equal(cloud[shuffled][ops.sample_bands(cloud[shuffled], bands, 3000)], cloud[chosen])


def test_content_rank_is_even_and_spread(rng):
    rank = ops.content_rank(road(rng, 20000)).numpy() / 2**31
    assert np.histogram(rank, 10, (0, 1))[0].min() > 1800
    grid = torch.cartesian_prod(torch.arange(40.0), torch.arange(40.0), torch.arange(10.0))
    assert np.histogram(ops.content_rank(grid).numpy() / 2**31, 10, (0, 1))[0].min() > 1400


@pytest.mark.parametrize(
    "wrong",
    [{"shares": (1.0,)}, {"edges_m": (0.0, 5.0, 5.0, 9.0, 12.0)}, {"shares": (1.0, 0.0, 1.0, 1.0)}],
)
def test_bands_that_do_not_fit_together_are_refused(wrong):
    with pytest.raises(ValueError, match="expected"):
        ops.BandConfig(**wrong)


@pytest.mark.gpu
def test_gpu_gives_what_the_cpu_gives(rng):
    clouds = [road(rng, n) for n in (9000, 0, 300)]
    points, lengths = torch.cat(clouds), [9000, 0, 300]
    rois = torch.cat([points[::90], points.new_tensor([[4.0, 2.0, 1.5, 0.7]]).expand(104, 4)], 1)[:103]

    def everything(device: str) -> list[torch.Tensor]:
        cloud = points.to(device)
        chosen, taken = ops.farthest_points(cloud, lengths, 512)
        groups = ops.ball_query(cloud, lengths, cloud[chosen], taken, radii_m=(0.5, 2.0), limits=(16, 32))
        gap_weights = ops.three_nearest(cloud, lengths, cloud[chosen], taken)[1]
        inside = ops.points_in_rois(cloud, lengths, rois.to(device), [100, 0, 3], context_m=1.0, limit=64)
        pairs = [part for group in (*groups, inside) for part in group[:2]]
        return [part.cpu() for part in (chosen, *pairs, gap_weights)]

    for on_cpu, on_gpu in zip(everything("cpu"), everything("cuda"), strict=True):
        torch.testing.assert_close(on_gpu, on_cpu)
