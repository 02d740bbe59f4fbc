import numpy as np
import pytest

torch = pytest.importorskip("torch")

from pydantic import ValidationError
from small import batch_of, cloud_of, losses_of, targets_of

from farfield.detectors import build_detector
from farfield.detectors.config import VoxelGridConfig
from farfield.detectors.runtime import Detector
from farfield.detectors.sparse import FLAT, SparseTensor
from farfield.detectors.sparse.tables import submanifold_book
from farfield.detectors.sparsecentre.head import (
    BoxTensors,
    CentreTargets,
    assign,
    decode,
    encode,
    heat_loss,
    peaks,
    vote_loss,
)
from farfield.detectors.sparsecentre.network import (
    CentreDiffusion,
    SparseCentre,
    SparseCentreConfig,
    SparsePyramid,
    flat_keys,
    means_at,
    merge_heights,
)
from farfield.frame import Boxes, Cloud
from farfield.geometry.boxes import points_in_boxes

SMALL = SparseCentreConfig(
    grid=VoxelGridConfig(range_m=64.0, half_width_m=20.0, z_min_m=-4.0, z_max_m=4.0, cell_m=(0.4, 0.4, 0.5)),
    classes=("vehicle", "pedestrian"),
    widths=(16, 32),
    depths=(0, 1),
    pyramid_widths=(32, 32, 32),
)
MAP = (1, 80, 56)


@pytest.fixture(autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def network():
    return build_detector(SMALL, seed=3)


def random_map(rng, channels=4, cells=200, shape=MAP, frames=2):
    keys = np.sort(rng.choice(frames * int(np.prod(shape)), cells, replace=False))
    features = torch.from_numpy(rng.normal(size=(cells, channels))).float()
    return SparseTensor(features, torch.from_numpy(keys), shape, frames)


def truth_of(rows, kind=None, weight=None):
    rows = np.asarray(rows, dtype=np.float64).reshape(-1, 7)
    kind = np.zeros(len(rows), np.int64) if kind is None else np.asarray(kind)
    weight = np.ones(len(rows)) if weight is None else np.asarray(weight)
    target = CentreTargets(rows[:, :3], rows[:, 3:6], rows[:, 6], kind, weight)
    return BoxTensors.of(target, torch.device("cpu"))


def test_default_covers_the_range_asked_for_and_knows_all_eight_classes():
    network = SparseCentre()
    assert len(network.config.class_names) == 8
    assert network.config.reach_m == 250.0
    nx, ny = network.head.shape
    assert nx * network.head.cell_m >= 250.0
    assert ny * network.head.cell_m >= 100.0
    assert network.head.cell_m == pytest.approx(0.8)


def test_batch_of_many_equals_batches_of_one_whatever_the_order_of_points(network, scene, rng):
    network.eval()
    first = cloud_of(network, scene.cloud())
    second = first[::3] * torch.tensor([1.0, -1.0, 1.0])
    with torch.no_grad():
        together, again = (network(batch_of(first, first[:0], second)) for _ in range(2))
        shuffled = network(batch_of(first[torch.from_numpy(rng.permutation(len(first)))]))
        apart = [network(batch_of(cloud)) for cloud in (first, first[:0], second)]
    assert all(torch.equal(a, b) for a, b in zip(together[:6], again[:6], strict=True))
    cells = int(np.prod(network.head.shape)) * torch.arange(3)
    alone = [
        torch.cat([part.keys + base for part, base in zip(apart, cells, strict=True)]),
        *(torch.cat(parts) for parts in zip(*[part[:3] for part in apart], strict=True)),
    ]
    for joint, single in zip([together.keys, *together[:3]], alone, strict=True):
        torch.testing.assert_close(joint, single, rtol=1e-4, atol=1e-4)
    for one, other in zip(shuffled[:6], apart[0][:6], strict=True):
        torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((7, 3), 500.0), np.array([[30.0, 1.0, -1.0]])])
@pytest.mark.parametrize("with_box", [False, True])
def test_clouds_and_annotations_with_next_to_nothing(network, scene, points, with_box):
    cloud = Cloud(points.astype(np.float32), np.zeros(len(points), np.float32))
    assert len(Detector(network, precision="fp32")(cloud)) >= 0
    boxes = scene.boxes if with_box else Boxes.empty()
    network.train()
    losses = losses_of(network, [cloud_of(network, cloud)], [boxes])
    assert all(torch.isfinite(loss) for loss in losses.values())
    sum(losses.values()).backward()
    gradients = [p.grad for p in network.parameters() if p.grad is not None]
    assert gradients
    assert all(torch.isfinite(gradient).all() for gradient in gradients)


def test_the_work_follows_the_points_not_the_grid(scene):
    cells = []
    for range_m, half_width_m in ((64.0, 20.0), (256.0, 80.0), (2048.0, 640.0)):
        grid = SMALL.grid.model_copy(update={"range_m": range_m, "half_width_m": half_width_m})
        network = build_detector(SMALL.model_copy(update={"grid": grid, "vote_threshold": 1.0}), seed=3).eval()
        with torch.no_grad():
            maps = network(batch_of(cloud_of(network, scene.cloud())))
        cells.append((len(maps.vote_keys), len(maps.keys)))
    assert cells[0][0] == cells[1][0] == cells[2][0]
    assert max(after for _, after in cells) <= cells[0][0] + SMALL.vote_least * 9


def test_diffusion_reaches_the_empty_centre_of_a_long_vehicle(rng):
    """The rear of a truck at cell 10; its centre, six cells ahead, holds no point."""
    diffusion = CentreDiffusion(3, threshold=0.5, least=0, ring=1, reach_cells=12.0)
    with torch.no_grad():  # the first feature is the foreground, the second the step along x
        diffusion.vote.weight.copy_(torch.tensor([[10.0, 0, 0], [0, 1, 0], [0, 0, 0]]))
        diffusion.vote.bias.copy_(torch.tensor([-5.0, 0.0, 0.0]))
    features = torch.tensor([[1.0, 6.2, 0.0], [1.0, 6.4, 1.0], [0.0, 6.0, 2.0], [1.0, -50.0, 0.0]], requires_grad=True)
    cells = torch.tensor([[0, 0, 10, 20], [0, 0, 10, 21], [0, 0, 40, 40], [1, 0, 3, 3]])
    sparse = SparseTensor.from_indices(features, cells, MAP, 2)
    grown = diffusion(sparse, torch.tensor([-1.0, -2.0, 5.0, 7.0]))
    expected = {tuple(cell) for cell in cells.tolist()}
    expected |= {(0, 0, x, y) for x in range(15, 18) for y in range(19, 23)}  # the last vote leaves the map
    assert {tuple(cell) for cell in grown.sparse.indices().tolist()} == expected
    row = {tuple(cell): i for i, cell in enumerate(grown.sparse.indices().tolist())}
    centre = grown.sparse.features[row[0, 0, 16, 20]]
    assert grown.height_m[row[0, 0, 16, 20]] == -1.0
    assert grown.height_m[row[0, 0, 15, 19]] == -1.0  # the only voted neighbour
    assert grown.height_m[row[0, 0, 15, 20]] == pytest.approx(-1.5)
    torch.testing.assert_close(grown.sparse.features[row[0, 0, 40, 40]], features[2])
    centre.sum().backward()
    assert features.grad[0].abs().sum() > 0  # of the cell that voted
    assert features.grad[2].abs().sum() == 0


def test_means_at_places_are_those_by_hand_and_do_not_hang_on_the_order(rng):
    values, place = torch.tensor([[1.0, 2.0], [3.0, 6.0], [5.0, 7.0]], requires_grad=True), torch.tensor([2, 2, 0])
    means, known = means_at(values, place, 4)
    assert means.tolist() == [[5, 7], [0, 0], [2, 4], [0, 0]]
    assert known.tolist() == [True, False, True, False]
    means.sum().backward()
    assert values.grad.tolist() == [[0.5, 0.5], [0.5, 0.5], [1, 1]]
    many, order = torch.from_numpy(rng.normal(size=5000).astype(np.float32)), torch.from_numpy(rng.permutation(5000))
    place = torch.arange(5000) % 7
    assert torch.equal(means_at(many, place, 7)[0], means_at(many[order], place[order], 7)[0])


def test_sparse_peaks_equal_a_dense_maximum(rng):
    sparse = random_map(rng, channels=3, cells=900)
    for reach in (1, 2):
        found = peaks(sparse.features, sparse.keys, MAP[1:], reach)
        frame, _, ix, iy = sparse.indices().unbind(1)
        dense = torch.full((2, 3, *MAP[1:]), -torch.inf)
        dense[frame, :, ix, iy] = sparse.features
        pooled = torch.nn.functional.max_pool2d(dense, 2 * reach + 1, 1, reach)[frame, :, ix, iy]
        assert torch.equal(found, sparse.features == pooled)
        assert 0 < found.sum() < found.numel()


def test_peaks_are_the_same_by_a_table_that_is_at_hand(rng):
    sparse = random_map(rng, channels=3, cells=900)
    table = submanifold_book(sparse.keys, MAP, FLAT).table
    expected = peaks(sparse.features, sparse.keys, MAP[1:], 1)
    assert torch.equal(peaks(sparse.features, sparse.keys, MAP[1:], 1, table), expected)


@pytest.mark.parametrize("frames", [1, 3])
@pytest.mark.parametrize("stride", [1, 4])
def test_columns_are_those_of_the_places(rng, frames, stride):
    sparse = random_map(rng, shape=(6, 8, 12), cells=400, frames=frames)
    frame, _, ix, iy = sparse.indices().unbind(1)
    expected = (frame * (8 // stride) + ix // stride) * (12 // stride) + iy // stride
    assert torch.equal(flat_keys(sparse, stride), expected)


def test_heights_are_summed_as_in_the_dense_grid(rng):
    sparse = random_map(rng, shape=(6, 8, 12), cells=400)
    flat = merge_heights(sparse)
    torch.testing.assert_close(flat.dense()[:, :, 0], sparse.dense().sum(2))
    assert flat.keys.diff().min() > 0


def test_pyramid_keeps_the_cells_and_sees_far(rng):
    pyramid = SparsePyramid((8, 8, 8, 8), depth=1).eval()
    sparse = SparseTensor.from_indices(torch.randn(2, 8), torch.tensor([[0, 0, 8, 8], [0, 0, 23, 8]]), (1, 64, 64), 1)
    with torch.no_grad():
        first = pyramid(sparse).features[1]
        second = pyramid(sparse.replace(sparse.features * torch.tensor([[5.0], [1.0]]))).features[1]
    assert torch.equal(pyramid(sparse).keys, sparse.keys)
    assert (first - second).abs().max() > 1e-6  # a cell 15 cells away matters


def test_codes_round_trip_at_every_heading(rng):
    yaw = np.concatenate([rng.uniform(-np.pi, np.pi, 200), [-np.pi, -np.pi / 2, 0, np.pi / 2]])
    rows = np.column_stack([rng.uniform(0, 250, len(yaw)), rng.uniform(-5, 5, (len(yaw), 2)), yaw, yaw, yaw, yaw])
    rows[:, 3:6] = rng.uniform(0.2, 16, (len(yaw), 3))
    truth, box = truth_of(rows), torch.arange(len(yaw))
    place = truth.centre_m[:, :2] + torch.from_numpy(rng.uniform(-3, 3, (len(yaw), 2))).float()
    height = torch.from_numpy(rng.normal(size=len(yaw))).float()
    found = decode(encode(truth, box, place, height, 0.8), place, height, 0.8).numpy()
    np.testing.assert_allclose(found[:, :6], rows[:, :6], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(np.cos(found[:, 6] - yaw), 1.0, atol=1e-5)


def test_boxes_are_shared_out_by_distance():
    """Three cells; a box beside the first, one far from any, one shared centre with another class, one out of reach."""
    place = torch.tensor([[0.0, 0.0], [1.0, 0.0], [20.0, 0.0]])
    rows = [[x, 0, 0, 4, 2, 2, 0] for x in (0.2, 25.0, 0.9, 60.0)]
    truth = truth_of(rows, kind=[0, 0, 1, 0], weight=[1.0, 3.0, 2.0, 1.0])
    duties = assign(place, truth, 2, gaussian_m=0.7, assign_m=8.0, box_m=1.2)
    assert duties.heat_weight.tolist() == [[1, 0], [0, 2], [3, 0]]
    assert duties.heat[0, 0] == duties.heat[1, 1] == duties.heat[2, 0] == 1
    assert duties.heat[1, 0].item() == pytest.approx(np.exp(-0.5 * (0.8 / 0.7) ** 2), rel=1e-5)
    assert dict(zip(duties.cell.tolist(), duties.box.tolist(), strict=True)) == {0: 0, 1: 2, 2: 1}
    assert duties.weight.tolist() == [1, 2, 3]


def test_every_box_with_a_point_has_a_cell_assigned_to_it(scene):
    """Down to a single point of a car in 60 m, and with far_weight."""
    config = SMALL.model_copy(update={"far_weight": 1.0})
    network = SparseCentre(config).eval()
    cloud = cloud_of(network, scene.cloud())
    inside = points_in_boxes(cloud[:, :3].numpy(), scene.boxes)
    single = cloud[torch.from_numpy(np.array([rows[0] for rows in inside]))]
    targets = targets_of(network, scene.boxes, single)
    assert targets.weight == pytest.approx(1 + np.hypot(*scene.boxes.centre_m[:, :2].T) / 100)
    with torch.no_grad():
        maps = network(batch_of(single))
    _, place = network.head.places_m(maps.keys)
    duties = assign(place, BoxTensors.of(targets, place.device), 2, gaussian_m=0.7, assign_m=8.0, box_m=1.2)
    assert set(duties.box.tolist()) == set(range(5))
    gap = np.linalg.norm(place[duties.cell].numpy() - scene.boxes.centre_m[duties.box.numpy(), :2], axis=1)
    assert gap.max() < 2.5 + 0.8


def test_losses_vanish_where_all_is_right_and_grow_where_not():
    truth = truth_of([[10.0, 0.0, 0.0, 8.0, 2.0, 2.0, np.pi / 2]])
    place = torch.tensor([[10.0, -3.6], [10.0, 0.4], [16.0, 0.0]])  # two in the box, which lies along y
    votes = torch.tensor([[30.0, 0.0, 4.5], [30.0, 0.0, -0.5], [-30.0, 9.0, 9.0]])
    foreground, step = vote_loss(votes, place, truth, 0.8)
    assert foreground.item() < 1e-9
    assert step.item() < 1e-9
    foreground, step = vote_loss(-votes, place, truth, 0.8)
    assert foreground.item() == pytest.approx(30 + 30, rel=1e-3)  # the box's mean over its cells, and one false alarm
    assert step.item() == pytest.approx((9 + 1) / 2 - 1 / 18, rel=1e-3)
    heat, weight = torch.tensor([[1.0], [0.5], [0.0]]), torch.tensor([[2.0], [0.0], [0.0]])
    assert heat_loss(torch.tensor([[30.0], [-30.0], [-30.0]]), heat, weight).item() < 1e-9
    wrong = heat_loss(torch.tensor([[-30.0], [30.0], [30.0]]), heat, weight).item()
    assert wrong == pytest.approx(2 * 30 + 30 * 0.5**4 + 30, rel=1e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"depths": (1,)}, "as many depths"),
        ({"grid": {"cell_m": (0.2, 0.4, 0.25)}}, "as long as wide"),
        ({"grid": {"z_max_m": 6.25}}, "extra_layers"),
    ],
)
def test_settings_that_do_not_fit_are_refused(change, message):
    with pytest.raises(ValidationError, match=message):
        SparseCentreConfig.model_validate(change)
