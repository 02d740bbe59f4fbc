"""Gradient reversal, discriminators and their loss, cells, objects and the memory, against cases worked out by hand."""

import math

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from farfield.adaptation.adversarial import (
    PatchDiscriminator,
    RowDiscriminator,
    balanced_accuracy,
    domain_loss,
    logits_of,
    reverse,
    schedule,
)
from farfield.adaptation.base import effective_rank, mean_variance
from farfield.adaptation.cells import (
    background_weight,
    density_bins,
    inside,
    match_density,
    occupied,
    values_at,
)
from farfield.adaptation.objects import Memory, bilinear, descriptors, effective_number, objects_of, sampled, similarity
from farfield.detectors.features import FeatureMap, PointFeatures
from farfield.detectors.inputs import Inputs
from farfield.detectors.sparse.cells import SparseTensor
from farfield.frame import Boxes

ALL_HEIGHTS = (-math.inf, math.inf)


def test_the_reversed_gradient_is_minus_lambda_times_the_plain_one() -> None:
    weight = torch.randn(5, 5, dtype=torch.float64)
    gradients = []
    for strength in (None, 0.3):
        values = torch.arange(10.0, dtype=torch.float64).view(2, 5).requires_grad_()
        passed = values if strength is None else reverse(values, strength)
        assert torch.equal(passed, values)
        (passed @ weight).sigmoid().sum().backward()
        gradients.append(values.grad)
    torch.testing.assert_close(gradients[1], -0.3 * gradients[0], rtol=1e-7, atol=1e-15)
    assert not reverse(torch.ones(2, requires_grad=True), 0.0).requires_grad  # 0 cuts


def test_the_schedule_is_danns() -> None:
    assert schedule(0.0) == 0.0
    assert schedule(0.3) == pytest.approx(math.tanh(1.5))  # the same function, another form
    assert schedule(1.0) == pytest.approx(0.99990920)


def test_the_domain_loss_by_hand() -> None:
    domain = torch.tensor([0.0, 0.0, 0.0, 1.0])
    nothing = torch.zeros(4)
    assert domain_loss(nothing, domain).item() == pytest.approx(math.log(2), abs=1e-7)
    assert domain_loss(nothing, domain, smoothing=0.1).item() == pytest.approx(math.log(2), abs=1e-7)
    assert domain_loss(nothing, domain, form="least_squares").item() == pytest.approx(0.25)
    logits = torch.tensor([-1.0, 0.0, 2.0, 1.0])
    near = [math.log1p(math.exp(x)) for x in (-1.0, 0.0, 2.0)]
    far = math.log1p(math.exp(-1.0))
    assert domain_loss(logits, domain).item() == pytest.approx((sum(near) / 3 + far) / 2, rel=1e-6)
    weight = torch.tensor([1.0, 2.0, 1.0, 5.0])
    expected = ((near[0] + 2 * near[1] + near[2]) / 4 + far) / 2
    assert domain_loss(logits, domain, weight=weight).item() == pytest.approx(expected, rel=1e-6)
    squares = [(x + 0.5) ** 2 for x in (-1.0, 0.0, 2.0)]
    assert domain_loss(logits, domain, form="least_squares").item() == pytest.approx((sum(squares) / 3 + 0.25) / 2)
    smooth = domain_loss(logits, domain, smoothing=0.2).item()
    soft = [0.9 * math.log1p(math.exp(x)) + 0.1 * math.log1p(math.exp(-x)) for x in (-1.0, 0.0, 2.0, -1.0)]
    assert smooth == pytest.approx((sum(soft[:3]) / 3 + soft[3]) / 2, rel=1e-6)
    assert domain_loss(torch.zeros(0), torch.zeros(0)).item() == 0.0


def test_accuracy_counts_both_domains_alike() -> None:
    logits, domain = torch.tensor([-1.0, -1.0, -1.0, -1.0, 3.0]), torch.tensor([0.0, 0.0, 0.0, 1.0, 1.0])
    assert balanced_accuracy(logits, domain).item() == pytest.approx((1 + 0.5) / 2)
    assert math.isnan(balanced_accuracy(logits[:3], domain[:3]).item())


def test_a_patch_discriminator_sees_five_cells() -> None:
    judge = PatchDiscriminator(3).double()
    image = torch.randn(1, 3, 15, 15, dtype=torch.float64, requires_grad=True)
    judge(image)[0, 0, 7, 7].backward()
    assert image.grad is not None
    reached = image.grad.abs().sum((0, 1)).nonzero()
    assert reached.min(0).values.tolist() == [5, 5]
    assert reached.max(0).values.tolist() == [9, 9]
    assert not any(isinstance(module, torch.nn.modules.batchnorm._BatchNorm) for module in judge.modules())


def dense_map(frames: int = 2, channels: int = 3, nx: int = 4, ny: int = 6) -> FeatureMap:
    values = torch.arange(float(frames * channels * nx * ny)).view(frames, channels, nx, ny)
    return FeatureMap(values=values, cell_m=2.0, origin_m=(10.0, -6.0))


def two_clouds() -> Inputs:
    one = torch.tensor([[10.1, -5.9, 0.0], [10.2, -5.8, 0.0], [17.9, 5.9, 0.0], [18.1, 0.0, 0.0], [12.5, 0.5, 9.0]])
    return Inputs({"points": [one, torch.tensor([[12.5, 0.5, 0.0]])]})


def test_occupied_cells_are_those_that_a_point_fell_into() -> None:
    features = dense_map()
    cells = occupied(features, two_clouds(), (-3.0, 3.0))  # the point at 9 m is not read, one lies beside the map
    assert cells.frame.tolist() == [0, 0, 1]
    assert cells.cell.tolist() == [0, 3 * 6 + 5, 1 * 6 + 3]
    assert cells.points.tolist() == [2, 1, 1]
    assert cells.place_m.tolist() == [[11.0, -5.0], [17.0, 5.0], [13.0, 1.0]]
    assert cells.share == pytest.approx(3 / 48)
    expected = torch.stack([features.dense[0, :, 0, 0], features.dense[0, :, 3, 5], features.dense[1, :, 1, 3]])
    assert torch.equal(values_at(features, cells), expected)
    nowhere = occupied(features, Inputs({"points": [torch.zeros(0, 3)] * 2}), ALL_HEIGHTS)
    assert len(nowhere) == 0


def test_sparse_rows_without_a_point_are_left_out() -> None:
    """The diffusion of a sparse detector makes cells where no point fell."""
    keys = torch.tensor([0, 7, 23, 24 + 9])
    sparse = SparseTensor(torch.arange(8.0).view(4, 2), keys, (1, 4, 6), 2)
    features = FeatureMap(values=sparse, cell_m=2.0, origin_m=(10.0, -6.0))
    cells = occupied(features, two_clouds(), (-3.0, 3.0))
    assert cells.row.tolist() == [0, 2, 3]
    assert cells.cell.tolist() == [0, 23, 9]
    assert torch.equal(values_at(features, cells), sparse.features[[0, 2, 3]])
    points = PointFeatures(values=torch.randn(3, 2), xyz=torch.randn(3, 3), lengths=(1, 2))
    assert occupied(points, two_clouds(), ALL_HEIGHTS).frame.tolist() == [0, 1, 1]


def test_logits_of_maps_and_rows_are_those_of_their_cells() -> None:
    features = dense_map()
    cells = occupied(features, two_clouds(), (-3.0, 3.0))
    patch, rows = PatchDiscriminator(3), RowDiscriminator(3)
    image = patch(features.dense)
    expected = torch.stack([image[0, 0, 0, 0], image[0, 0, 3, 5], image[1, 0, 1, 3]])
    torch.testing.assert_close(logits_of(patch, features, cells, 0.1), expected)
    torch.testing.assert_close(logits_of(rows, features, cells, 0.1), rows(values_at(features, cells)).squeeze(1))


def test_drawn_cells_have_the_density_of_the_reference() -> None:
    assert density_bins(torch.tensor([1, 2, 3, 4, 7, 8, 31, 32, 900])).tolist() == [0, 1, 1, 2, 2, 3, 4, 5, 5]
    near = torch.cat([torch.full((100,), 1), torch.full((300,), 5), torch.full((600,), 40)])
    far = torch.tensor([1] * 30 + [6] * 10)
    chosen = match_density(near, far, np.random.default_rng(0))
    assert chosen.diff().min() > 0  # each once
    assert torch.bincount(density_bins(near[chosen])).tolist() == [100, 0, 33]  # 3 to 1, all of the rarer
    assert len(match_density(near, far[:0], np.random.default_rng(0))) == 0


def test_balanced_background_gives_objects_their_near_share() -> None:
    weight = background_weight(10.0, 100.0, 2.0, 8.0)
    assert 2 / (2 + 6 * weight) == pytest.approx(0.1)
    assert background_weight(1.0, 1000.0, 2.0, 8.0) == 10.0
    assert background_weight(999.0, 1000.0, 2.0, 800.0) == 0.1
    for nothing in ((0, 100, 2, 8), (100, 100, 2, 8), (10, 100, 0, 8), (10, 100, 8, 8), (0, 0, 0, 0)):
        assert background_weight(*map(float, nothing)) == 1.0


def car(x: float, y: float, yaw: float = 0.0, label: str = "vehicle") -> Boxes:
    return Boxes(
        centre_m=np.array([[x, y, 0.0]]),
        size_m=np.array([[4.0, 2.0, 1.5]]),
        yaw_rad=np.array([yaw]),
        label=label,
        point_count=np.array([7]),
    )


def test_cells_inside_boxes() -> None:
    cells = occupied(dense_map(), two_clouds(), (-3.0, 3.0))  # at (11, -5) and (17, 5) of frame 0, (13, 1) of frame 1
    assert inside(cells, [car(12.0, -5.0), Boxes.empty()], 0.0).tolist() == [True, False, False]
    assert inside(cells, [car(15.0, 5.0, np.pi / 2), car(13.0, 1.0)], 0.5).tolist() == [False, False, True]
    assert inside(cells, [car(15.0, 5.0, np.pi / 2), car(13.0, 1.0)], 1.0).tolist() == [False, True, True]


def test_descriptors_hold_the_angle_of_sight_and_sizes_of_whole_objects() -> None:
    boxes = Boxes.concatenate([car(10.0, 10.0, np.pi / 4), car(10.0, -10.0, np.pi / 4)])
    full, visible = descriptors(boxes, "full"), descriptors(boxes, "visible")
    np.testing.assert_allclose(full[:, :3], np.log([[4.0, 2.0, 1.5]] * 2))
    np.testing.assert_allclose(full[:, 3:], [[0.0, 1.0], [1.0, 0.0]], atol=1e-12)  # seen from behind, and from the side
    np.testing.assert_allclose(visible, full[:, 2:])


def test_samples_of_a_plane_are_its_value_at_the_centre() -> None:
    ix, iy = torch.meshgrid(torch.arange(8.0), torch.arange(8.0), indexing="ij")
    image = torch.stack([3 * ix + 5 * iy, ix * 0 + 2])[None]
    at = torch.tensor([[2.25, 3.5], [-4.0, 99.0]])
    expected = torch.tensor([[3 * 2.25 + 5 * 3.5, 2.0], [35.0, 2.0]])
    torch.testing.assert_close(bilinear(image, torch.tensor([0, 0]), at), expected)
    features = FeatureMap(values=image, cell_m=2.0, origin_m=(0.0, -8.0))
    found = sampled(features, car(8.0, 0.0, 0.7), torch.tensor([0]))  # the mean of samples on a plane is its centre's
    torch.testing.assert_close(found, torch.tensor([[3 * 3.5 + 5 * 3.5, 2.0]]), rtol=1e-5, atol=1e-5)


def test_an_object_on_a_sparse_map_is_the_mean_of_its_cells_or_the_nearest() -> None:
    sparse = SparseTensor(torch.tensor([[1.0], [3.0], [50.0]]), torch.tensor([0, 6, 23]), (1, 4, 6), 1)
    features = FeatureMap(values=sparse, cell_m=2.0, origin_m=(10.0, -6.0))
    boxes = Boxes.concatenate([car(12.0, -5.0), car(17.0, 0.0), car(12.0, 0.0, label="tram"), car(90.0, 0.0)])
    found = objects_of(features, [boxes], ("pedestrian", "vehicle"), "full")
    assert found.feature.tolist() == [[2.0], [50.0]]  # other classes, and beside the map, are left out
    assert found.kind.tolist() == [1, 1]
    assert found.points.tolist() == [7, 7]
    assert found.range_m.tolist() == [13.0, 17.0]


def test_the_memory_is_a_ring_that_forgets() -> None:
    memory = Memory(2, 2, 1, size=4, max_age=10)
    assert not list(memory.parameters())
    for step in range(3):
        feature = torch.full((2, 2), float(step), requires_grad=True)
        memory.add(torch.tensor([1, 1]), feature, torch.full((2, 1), float(step)), step)
    assert len(memory.entries(0, 2).feature) == 0
    held = memory.entries(1, 2)
    assert sorted(held.descriptor[:, 0].tolist()) == [1.0, 1.0, 2.0, 2.0]
    assert not held.feature.requires_grad
    assert memory.entries(1, 12).descriptor[:, 0].tolist() == [2.0, 2.0]  # those of step 1 are 11 steps old
    assert set(memory.state_dict()) == {"feature", "descriptor", "entered", "following"}


def test_similar_entries_weigh_more() -> None:
    entries = torch.tensor([[0.0], [2.0], [4.0]])
    weights = similarity(torch.tensor([[0.0]]), entries, 1.0)[0]
    spread = math.sqrt(8 / 3)
    expected = np.exp(-np.array([0.0, 2.0, 4.0]) / spread)
    np.testing.assert_allclose(weights.numpy(), expected / expected.sum(), rtol=1e-6)
    assert effective_number(torch.tensor([[1.0, 0.0], [0.5, 0.5]])).tolist() == [1.0, 2.0]
    assert effective_number(similarity(torch.zeros(1, 1), entries, 1e6)).item() == pytest.approx(3.0)


def test_rank_and_variance_show_collapse() -> None:
    wide = torch.randn(4000, 8, generator=torch.Generator().manual_seed(0))
    assert effective_rank(wide) == pytest.approx(8, abs=0.1)
    assert mean_variance(wide) == pytest.approx(1, abs=0.05)
    assert effective_rank(wide[:, :1] * torch.ones(1, 8)) == pytest.approx(1, abs=1e-3)
    assert effective_rank(torch.ones(5, 3)) == effective_rank(wide[:1]) == mean_variance(wide[:1]) == 0


def two_gaussians(count: int, draw: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Rows of eight numbers and their domain; the domains lie 2 sigma apart along each of the first four."""
    domain = (torch.arange(count) % 2).float()
    rows = torch.randn(count, 8, generator=draw)
    rows[:, :4] += 2 * domain[:, None]
    return rows, domain


def test_reversal_mixes_two_clouds_that_a_probe_told_apart() -> None:
    """The trunk, whose features carry noise, may forget the first four numbers and is to keep the others."""
    steps, rate, strength, noise = 250, 5e-3, 0.3, 0.2
    draw = torch.Generator().manual_seed(0)
    held, truth = two_gaussians(1024, draw)
    assert probe(held, truth) >= 0.95
    with torch.random.fork_rng():
        torch.manual_seed(1)
        trunk, judge, task = torch.nn.Linear(8, 8), RowDiscriminator(8), torch.nn.Linear(8, 4)
    trained = [*trunk.parameters(), *judge.parameters(), *task.parameters()]
    solver = torch.optim.AdamW(trained, lr=rate, betas=(0.5, 0.99), weight_decay=0.0)
    for step in range(steps):
        solver.param_groups[0]["lr"] = rate * (1 - step / steps)
        rows, domain = two_gaussians(256, draw)
        features = trunk(rows) + noise * torch.randn(256, 8, generator=draw)
        logits = judge(reverse(features, strength * schedule(step / steps))).squeeze(1)
        solver.zero_grad()
        (domain_loss(logits, domain) + (task(features) - rows[:, 4:]).square().mean()).backward()
        solver.step()
    with torch.no_grad():
        features = trunk(held) + noise * torch.randn(1024, 8, generator=draw)
        assert probe(features, truth) <= 0.6
        assert (task(features) - held[:, 4:]).square().mean() < 0.1


def probe(rows: "torch.Tensor", domain: "torch.Tensor") -> float:
    """Accuracy, on held-out rows, of a fresh linear probe."""
    rows = (rows - rows.mean(0)) / rows.std(0)
    with torch.enable_grad():
        weight = torch.zeros(rows.shape[1] + 1, requires_grad=True)
        whole = torch.cat([rows, torch.ones(len(rows), 1)], 1)
        half = len(rows) // 2
        solver = torch.optim.Adam([weight], lr=0.05)
        for _ in range(200):
            solver.zero_grad()
            domain_loss(whole[:half] @ weight, domain[:half]).backward()
            solver.step()
    return balanced_accuracy(whole[half:] @ weight.detach(), domain[half:]).item()
