import math

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from small import batch_of, losses_of, targets_of

from farfield.detectors.inputs import POSITION, cloud_tensor
from farfield.detectors.layers import fold_batch_norm
from farfield.detectors.pointrcnn.boxes import (
    BinCoder,
    BinConfig,
    MatchConfig,
    ProposalConfig,
    draw_proposals,
    first_candidates,
    keep_proposals,
    match_proposals,
)
from farfield.detectors.pointrcnn.network import PointRCNN, PointRCNNConfig, RefinementConfig
from farfield.detectors.pointrcnn.pointnet import (
    BackboneConfig,
    FeaturePropagation,
    SetAbstraction,
    SetAbstractionConfig,
)
from farfield.detectors.pointrcnn.points import BandConfig, WindowConfig, three_nearest
from farfield.detectors.runtime import Detector
from farfield.frame import Boxes, Cloud
from farfield.metrics import score
from farfield.vocabulary.classes import CIRRUS_SIZES_M


def level(centres, radii_m, *widths):
    return SetAbstractionConfig(centres=centres, radii_m=radii_m, limits=(16, 32), widths=widths)


SMALL = PointRCNNConfig(
    grid=WindowConfig(range_m=64.0, half_width_m=20.0),
    sizes_m={"vehicle": (4.6, 1.95, 1.7), "pedestrian": (0.75, 0.7, 1.75)},
    points=2048,
    bands=BandConfig(edges_m=(0.0, 30.0, 64.0), shares=(0.5, 0.5)),
    backbone=BackboneConfig(
        levels=(level(512, (0.5, 1.5), (16, 32), (16, 32)), level(128, (1.5, 4.0), (32, 48), (32, 48))),
        propagation=((64,), (64,)),
    ),
    head_width=64,
    proposals=ProposalConfig(
        threshold=0.0,
        candidates=256,
        training_count=64,
        count=48,
        bands=BandConfig(edges_m=(0.0, 30.0, 64.0), shares=(0.5, 0.5)),
    ),
    refinement=RefinementConfig(points=64, match=MatchConfig(drawn=48)),
)


@pytest.fixture
def network():
    torch.manual_seed(3)
    return PointRCNN(SMALL)


@pytest.fixture
def cloud(scene):
    return cloud_tensor(scene.cloud(), POSITION)


def test_default_reaches_as_far_as_asked_and_knows_all_eight_classes():
    config = PointRCNNConfig()
    assert config.class_names == tuple(CIRRUS_SIZES_M)
    assert config.reach_m == 250.0


def test_forward_has_no_nan_and_every_parameter_gets_a_gradient(network, scene, cloud):
    clouds = [cloud, cloud[::2]]
    outputs = network(batch_of(*clouds), [targets_of(network, scene.boxes, each) for each in clouds])
    assert all(torch.isfinite(part).all() for part in outputs)
    sum(losses_of(network, [cloud], [scene.boxes]).values()).backward()
    without = [name for name, p in network.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
    assert without == []


def test_overfits_one_frame(scene, trained):
    predicted = Detector(trained("pointrcnn"), precision="fp32")(scene)
    result = score({scene.key: predicted}, {scene.key: scene.boxes}, protocol="dds")
    assert result.to_json()["dds"]["0"]["dds"] > 0.9
    best = predicted[:5]
    near = np.argmin(np.hypot(*(best.centre_m[:, None, :2] - scene.boxes.centre_m[None, :, :2]).transpose(2, 0, 1)), 1)
    assert sorted(near) == [0, 1, 2, 3, 4]
    assert np.cos(best.yaw_rad - scene.boxes.yaw_rad[near]).min() > 0.95  # the whole heading, not only its axis


def per_frame(outputs):
    points, proposals = outputs.lengths.tolist(), outputs.proposal_lengths.tolist()
    first = zip(*[part.split(points) for part in outputs[1:5]], strict=True)
    second = zip(*[part.split(proposals) for part in outputs[6:]], strict=True)
    return list(zip(first, second, strict=True))


def test_batch_of_two_equals_two_of_one(network, cloud):
    network.eval()
    second = cloud[::3] * torch.tensor([1.0, -1.0, 1.0])
    with torch.no_grad():
        together = per_frame(network(batch_of(cloud, second)))
        apart = [per_frame(network(batch_of(each)))[0] for each in (cloud, second)]
    for joint, single in zip(together, apart, strict=True):
        for a, b in zip((*joint[0], *joint[1]), (*single[0], *single[1]), strict=True):
            torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4)


def test_same_input_same_output_whatever_the_order_of_points(network, scene, cloud, rng):
    shuffled = cloud[torch.from_numpy(rng.permutation(len(cloud)))]
    first, again = (list(losses_of(network, [cloud], [scene.boxes]).values()) for _ in range(2))
    assert torch.equal(torch.stack(first), torch.stack(again))  # while training, with drawn proposals
    network.eval()
    with torch.no_grad():
        one, again, other = (network(batch_of(each)) for each in (cloud, cloud, shuffled))
    assert all(torch.equal(a, b) for a, b in zip(one, again, strict=True))
    torch.testing.assert_close(one.logits, other.logits, rtol=1e-3, atol=1e-4)
    torch.testing.assert_close(one.proposals, other.proposals, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize(
    "points",
    [np.zeros((0, 3)), np.full((7, 3), 500.0), np.full((3, 3), np.nan), [[10.0, 2, -1]], np.full((9, 3), 5.0)],
)
def test_clouds_without_usable_points_give_no_error(network, points):
    points = np.asarray(points, dtype=np.float32)
    cloud = Cloud(points, np.zeros(len(points), np.float32))
    assert len(Detector(network, precision="fp32")(cloud)) >= 0
    network.train()
    box = Boxes(centre_m=np.array([[10.0, 2, -1]]), size_m=np.ones((1, 3)), yaw_rad=np.zeros(1), label="pedestrian")
    for boxes in (Boxes.empty(), box):
        losses = losses_of(network, [cloud_tensor(cloud, POSITION)], [boxes])
        assert all(torch.isfinite(loss) for loss in losses.values())
        sum(losses.values()).backward()
        assert all(torch.isfinite(p.grad).all() for p in network.parameters())


def test_folding_changes_nothing_but_speed(network, scene, cloud):
    for _ in range(3):
        losses_of(network, [cloud], [scene.boxes])
    network.eval()
    folded = fold_batch_norm(network)
    assert not any(isinstance(m, torch.nn.BatchNorm1d) for m in folded.modules())
    with torch.no_grad():
        plain, fast = network(batch_of(cloud)), folded(batch_of(cloud))
    torch.testing.assert_close(plain.logits, fast.logits, rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(plain.codes, fast.codes, rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(plain.confidences, fast.confidences, rtol=1e-2, atol=1e-2)


def test_half_precision_finds_the_same_boxes(network, scene, cloud):
    boxes = [Detector(network, precision=precision)(scene) for precision in ("fp32", "bf16")]
    assert len(boxes[0]) > 5
    assert abs(len(boxes[0]) - len(boxes[1])) <= 0.2 * len(boxes[0]) + 1


def test_targets_name_the_box_of_each_point(network, scene, cloud):
    targets = targets_of(network, scene.boxes, cloud)
    assert [int((targets.owner == index).sum()) for index in range(5)] == [120] * 5
    assert (targets.owner[: -5 * 120] < 0).all()
    middle = np.array([[2.0, 1.8, 1.4]])
    small = Boxes(centre_m=scene.boxes.centre_m[:1], size_m=middle, yaw_rad=scene.boxes.yaw_rad[:1], label="vehicle")
    inner = targets_of(network, Boxes.concatenate([small, scene.boxes]), cloud).owner
    assert 0 < (inner == 0).sum() < 120  # the smaller box has what both hold
    assert (inner == 0).sum() + (inner == 1).sum() == 120


# --- bins ---


@pytest.mark.parametrize("log_size", [True, False])
@pytest.mark.parametrize(("headings", "span"), [(12, 2 * math.pi), (9, math.pi / 2), (1, 2 * math.pi)])
def test_boxes_survive_encoding(rng, headings, span, log_size):
    config = BinConfig(scope_m=3.0, bin_m=0.5, headings=headings, heading_span_rad=span, log_size=log_size)
    coder, count = BinCoder(config), 200
    reference = torch.from_numpy(rng.uniform(0.5, 3.0, (count, 7)))
    reference[:, 6] = torch.from_numpy(rng.uniform(-9, 9, count))
    boxes = torch.from_numpy(rng.uniform(0.5, 3.0, (count, 7)))
    angle, gap = rng.uniform(-math.pi, math.pi, count), rng.uniform(0, 2.9, count)
    boxes[:, :2] = reference[:, :2] + torch.from_numpy(np.column_stack([gap * np.cos(angle), gap * np.sin(angle)]))
    boxes[:, 6] = reference[:, 6] + torch.from_numpy(rng.uniform(-span / 2, span / 2, count))
    targets = coder.encode(boxes, reference)
    assert targets.bins.min() >= 0
    assert targets.residuals.abs().max() <= 1 + 1e-6
    codes = torch.zeros(count, config.numbers)
    parts = coder.split(codes)
    for axis in range(3):
        parts.logits[axis].scatter_(1, targets.bins[:, axis, None], 1.0)
        parts.residuals[axis].scatter_(1, targets.bins[:, axis, None], targets.residuals[:, axis, None].float())
    parts.z.copy_(targets.z)
    parts.size.copy_(targets.size)
    decoded = coder.decode(codes, reference.float())
    torch.testing.assert_close(decoded[:, :6].double(), boxes[:, :6], rtol=1e-4, atol=1e-4)
    assert torch.cos(decoded[:, 6] - boxes[:, 6]).min() > 1 - 1e-6
    for logits in coder.split(codes).logits:
        logits *= 100  # sure of the right bins: what is left is the residuals' error, which is none
    assert coder.loss(codes, targets).max() < 1e-4


def test_bins_are_those_of_the_paper():
    coder = BinCoder(BinConfig(scope_m=3.0, bin_m=0.5, headings=12, log_size=False, beta=1.0))
    reference = torch.tensor([[10.0, 5, -1, 3.9, 1.6, 1.5, 0]])
    targets = coder.encode(torch.tensor([[10.1, 4.3, -0.5, 3.9, 1.6, 3.0, math.pi / 2]]), reference)
    assert targets.bins.tolist() == [[6, 4, 3]]
    torch.testing.assert_close(targets.residuals, torch.tensor([[-0.6, 0.2, 0.0]]), rtol=0, atol=1e-5)
    torch.testing.assert_close(targets.z, torch.tensor([[0.5]]))
    torch.testing.assert_close(targets.size, torch.tensor([[0.0, 0.0, 1.0]]))
    # uniform logits and zero residuals: 2 ln 12 + ln 12 for the bins, smooth L1 for the rest
    expected = 3 * math.log(12) + 0.5 * (0.6**2 + 0.2**2 + 0.5**2) + 0.5
    assert coder.loss(torch.zeros(1, coder.config.numbers), targets).item() == pytest.approx(expected, rel=1e-5)


def test_second_stage_takes_a_reversed_box_as_its_own_reverse():
    coder = BinCoder(BinConfig(scope_m=1.5, bin_m=0.5, headings=9, heading_span_rad=math.pi / 2))
    reference, box = torch.tensor([[0.0, 0, 0, 4, 2, 1.5, 0.3]]), torch.tensor([[0.2, 0, 0, 4, 2, 1.5, 0.4]])
    backwards = box + torch.tensor([[0.0, 0, 0, 0, 0, 0, math.pi]])
    for one, other in zip(coder.encode(box, reference), coder.encode(backwards, reference), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5)


# --- PointNet++ ---


def test_set_abstraction_equals_a_loop_over_centres(rng):
    config = SetAbstractionConfig(centres=9, radii_m=(1.0, 3.0), limits=(3, 8), widths=((8, 6), (5,)))
    torch.manual_seed(0)
    layer = SetAbstraction(4, config).eval()
    for norm in (m for m in layer.modules() if isinstance(m, torch.nn.BatchNorm1d)):
        norm.running_mean.normal_()
    xyz, features = torch.from_numpy(rng.uniform(0, 5, (60, 3))).float(), torch.randn(60, 4)
    with torch.no_grad():
        out = layer(xyz, features, [60], xyz[:9], [9])
        for index in range(9):
            pooled = []
            for mlp, radius, limit in zip(layer.mlps, config.radii_m, config.limits, strict=True):
                near = torch.nonzero((xyz - xyz[index]).norm(dim=1) <= radius)[:limit, 0]
                rows = torch.cat([(xyz[near] - xyz[index]) / radius, features[near]], 1)
                pooled.append(mlp(rows).amax(0))
            torch.testing.assert_close(out[index], torch.cat(pooled), rtol=1e-4, atol=1e-5)


def test_feature_propagation_equals_interpolating_first(rng):
    torch.manual_seed(0)
    layer = FeaturePropagation(6, 3, (8, 5)).eval()
    fine, coarse = (torch.from_numpy(rng.uniform(0, 5, (n, 3))).float() for n in (40, 10))
    coarse_features, fine_features = torch.randn(10, 6), torch.randn(40, 3)
    row, weight = three_nearest(fine, [40], coarse, [10])
    with torch.no_grad():
        out = layer(coarse_features, row, weight, fine_features)
        between = (coarse_features[row] * weight[..., None]).sum(1)
        expected = layer.mlp(torch.cat([between, fine_features], 1))
    torch.testing.assert_close(out, expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    "wrong",
    [{"propagation": ((8,),)}, {"levels": (level(9, (1.0, 2.0), (4,), (4,)), level(99, (1.0, 2.0), (4,), (4,)))}],
)
def test_backbones_that_do_not_fit_together_are_refused(wrong):
    right = {"levels": (level(99, (1.0, 2.0), (4,), (4,)),) * 2, "propagation": ((8,), (8,))}
    BackboneConfig(**right)
    with pytest.raises(ValueError, match="expected"):
        BackboneConfig(**right | wrong)


# --- proposals ---


def test_proposals_beyond_80_m_are_kept_beside_many_near_ones(rng):
    config = ProposalConfig(candidates=200, count=40, threshold=0.0)
    near, far = rng.uniform(3, 39, 1000), rng.uniform(160, 240, 15)
    place = torch.from_numpy(np.column_stack([np.r_[near, far], rng.uniform(-2, 2, 1015), np.zeros(1015)])).float()
    score = torch.from_numpy(np.r_[rng.uniform(0.5, 1, 1000), rng.uniform(0.01, 0.4, 15)]).float()
    row = first_candidates(place, score, config)
    assert len(row) == 200
    assert (place[row, 0] > 80).sum() == 15
    assert (score[row].diff() <= 0).all()
    boxes = torch.cat([place[row], torch.full((200, 3), 0.2), torch.zeros(200, 1)], 1)
    kept = keep_proposals(boxes, config, training=False)
    assert len(kept) == 40
    assert (boxes[kept, 0] > 80).sum() >= 6  # at least the share of the last band


def test_a_thin_box_missed_by_a_little_is_still_matched():
    rear = np.array([[60.0, 3.0, -1.0, 0.3, 1.9, 1.4, 0.0]], dtype=np.float32)
    off = rear + np.array([[0.4, 0, 0, 0, 0, 0, 0]], dtype=np.float32)
    far_off = rear + np.array([[3.0, 0, 0, 0, 0, 0, 0]], dtype=np.float32)
    match = match_proposals(np.concatenate([rear, off, far_off]), rear)
    assert match.iou.tolist() == pytest.approx([1.0, 0.0, 0.0], abs=1e-6)
    config = MatchConfig()
    assert match.right(config).tolist() == [True, True, False]
    assert match.wrong(config).tolist() == [False, False, True]
    published = MatchConfig(right_m=0.0, wrong_m=0.0, refined_m=0.0)
    assert match.right(published).tolist() == [True, False, False]


@pytest.mark.parametrize(
    ("near", "wrong", "expected"), [(100, 100, 20), (3, 100, 3), (100, 3, 37), (0, 100, 0), (8, 9, 8), (0, 0, 0)]
)
def test_drawn_proposals_fill_the_budget_from_both_kinds(rng, near, wrong, expected):
    boxes = np.array([[20.0, 0, 0, 4, 2, 1.5, 0]], dtype=np.float32)
    rows = np.repeat(boxes, near + wrong, axis=0)
    rows[near:, 0] += np.linspace(3, 90, wrong)
    match, config = match_proposals(rows, boxes), MatchConfig(drawn=40)
    drawn = draw_proposals(match, config, rng)
    assert len(drawn) == len(set(drawn)) == min(40, near + wrong)
    assert (drawn < near).sum() == expected
