"""Decoding and suppression on the network's own device: the boxes of the CPU's path, bit for bit or nearly so."""

import inspect
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

torch = pytest.importorskip("torch")

from _gpu_cases import drawn
from small import batch_of, small_detector

from farfield.detectors import nms
from farfield.detectors.anchors import grid as on_host
from farfield.detectors.anchors import head as on_device
from farfield.detectors.anchors.head import AnchorHead, best_anchors
from farfield.geometry import iou
from farfield.geometry.boxes import Boxes, wrap_angle_rad


def as_boxes(rows, score, label="vehicle"):
    return Boxes(centre_m=rows[:, :3], size_m=rows[:, 3:6], yaw_rad=rows[:, 6], label=label, score=score)


def assert_same(got: Boxes, expected: Boxes):
    """The same boxes in the same order."""
    assert len(got) == len(expected)
    assert got.label.tolist() == expected.label.tolist()
    np.testing.assert_array_equal(got.score, expected.score)
    np.testing.assert_allclose(got.centre_m, expected.centre_m, rtol=0, atol=1e-10)
    np.testing.assert_allclose(got.size_m, expected.size_m, rtol=1e-12)
    np.testing.assert_allclose(wrap_angle_rad(got.yaw_rad - expected.yaw_rad), 0, atol=1e-12)


def test_areas_are_those_of_the_exact_method(rng):
    a, b = drawn(rng, 4000, 8.0), drawn(rng, 4000, 8.0)
    b[:50] = a[:50]  # coincident, and turned by half and quarter turns
    b[50:100] = a[50:100]
    b[50:100, 6] += np.pi
    b[100:150, 3:5], b[100:150, 6] = a[100:150, 4:2:-1], a[100:150, 6] + np.pi / 2
    b[100:150, :2] = a[100:150, :2]
    flat = [rows[:, [0, 1, 3, 4, 6]] for rows in (a, b)]
    expected = iou.bev_intersection_m2(*flat)
    got = nms.bev_intersection_m2(*map(torch.from_numpy, flat)).numpy()
    assert (expected > 0).mean() > 0.2
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-11)
    np.testing.assert_allclose(got[:150], a[:150, 3] * a[:150, 4], rtol=1e-12)  # known without either method


@pytest.mark.parametrize("threshold", [0.01, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("n", [0, 1, 2, 7, 700])
def test_suppression_keeps_what_the_cpu_keeps(rng, n, threshold):
    rows, score = drawn(rng, n, 30), rng.uniform(0, 1, n).round(2)  # with ties
    expected = nms.rotated_nms(as_boxes(rows, score), iou_threshold=threshold, limit=100)
    got = nms.nms_on_device(*map(torch.from_numpy, (rows, score)), iou_threshold=threshold, limit=100)
    np.testing.assert_array_equal(got.numpy(), expected)


def test_boxes_side_by_side_do_not_suppress_one_another_at_threshold_zero(rng):
    place, yaw_rad, turn = rng.uniform(-9, 9, (400, 2)), rng.uniform(-3, 3, 400), rng.uniform(-3, 3, 400)
    one = np.column_stack([place, np.zeros(400), np.full((400, 3), [4, 2, 1.5]), yaw_rad])
    other = one + 0.0
    other[:, 0] -= 2.4 * np.sin(yaw_rad)  # beside it; the gap is less than the sum of half the diagonals
    other[:, 1] += 2.4 * np.cos(yaw_rad)
    other[:, 3:5], other[:, 6] = [1.5, 1.0], yaw_rad + turn
    for rows in zip(one, other, strict=True):
        pair, score = np.stack(rows), np.array([0.9, 0.8])
        assert len(nms.rotated_nms(as_boxes(pair, score), iou_threshold=0.0)) == 2
        assert len(nms.nms_on_device(*map(torch.from_numpy, (pair, score)), iou_threshold=0.0)) == 2


@pytest.mark.parametrize("limit", [5, 40, 400])
def test_the_best_anchors_are_the_first_of_equal_ones(rng, limit):
    strength = torch.from_numpy(rng.normal(0, 1, 2000).round(1).astype(np.float32))
    index, score = best_anchors(strength, limit=limit, score_threshold=0.6)
    order = np.argsort(-strength.numpy(), kind="stable")
    expected = order[1 / (1 + np.exp(-strength.numpy()[order].astype(np.float64))) >= 0.6][:limit]
    assert index.tolist() == expected.tolist()
    np.testing.assert_allclose(score.numpy(), 1 / (1 + np.exp(-strength.numpy()[expected].astype(np.float64))))
    assert len(best_anchors(strength, limit=limit, score_threshold=0.0)[0]) == limit
    assert len(best_anchors(strength, limit=limit, score_threshold=1.0)[0]) == 0


def test_a_long_chain_of_overlaps_is_settled_to_its_end():
    n = 101  # each box overlaps its neighbours alone: every other one stays
    rows = np.tile([0.0, 0, 0, 4, 2, 1.5, 0], (n, 1))
    rows[:, 0] = 3.0 * np.arange(n)
    score = np.linspace(1, 0, n)
    kept = nms.nms_on_device(torch.from_numpy(rows), torch.from_numpy(score), iou_threshold=0.1)
    assert kept.tolist() == list(range(0, n, 2))


def test_many_boxes_are_compared_in_parts(rng, monkeypatch):
    rows, score = drawn(rng, 300, 30), rng.uniform(0, 1, 300)
    whole = nms.nms_on_device(*map(torch.from_numpy, (rows, score)), iou_threshold=0.2)
    monkeypatch.setattr(nms, "_GAPS", 1000)
    monkeypatch.setattr(nms, "_PAIRS", 16)
    parts = nms.nms_on_device(*map(torch.from_numpy, (rows, score)), iou_threshold=0.2)
    assert 0 < len(whole) < 300
    assert torch.equal(whole, parts)


@given(st.lists(st.floats(-1e6, 1e6) | st.sampled_from([np.pi, -np.pi, 3 * np.pi, -3 * np.pi, 0.0]), max_size=20))
def test_angles_are_wrapped_as_on_the_host(angles):
    given_rad = np.array(angles, dtype=np.float64)
    np.testing.assert_array_equal(nms.wrap_angle(torch.from_numpy(given_rad)).numpy(), wrap_angle_rad(given_rad))


@pytest.mark.parametrize("style", ["farfield", "openpcdet"])
def test_codes_give_the_boxes_of_the_host(rng, style):
    anchors = {
        "vehicle": on_host.AnchorConfig(size_m=(4.6, 1.9, 1.7), z_m=-1.1),
        "pedestrian": on_host.AnchorConfig(size_m=(0.7, 0.6, 1.8), z_m=-0.9),
    }
    grid = on_host.AnchorGrid(anchors, nx=50, ny=33, cell_m=0.4, y_min_m=-6.7, style=style)
    index = rng.permutation(len(grid))[:3000]
    code = rng.normal(0, 2, (3000, 7))
    code[:40, 6], code[40:80, 3] = np.pi / 2, 9.0  # residuals at the edge, sizes beyond the limits
    direction = rng.integers(0, 2, 3000)
    rows, expected = grid.rows(index), grid.decode(code, direction, index)
    there = torch.from_numpy(index)
    np.testing.assert_array_equal(on_device.anchor_rows(grid, there).numpy(), rows)
    codes, directions = torch.zeros(len(grid), 7, dtype=torch.float64), torch.zeros(len(grid), 2)
    codes[there] = torch.from_numpy(code)
    directions[there, torch.from_numpy(direction)] = 1.0
    got = on_device.decoded(grid, codes, directions, there).numpy()
    np.testing.assert_allclose(got[:, :6], expected[:, :6], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(wrap_angle_rad(got[:, 6] - expected[:, 6]), 0, atol=1e-12)


def stirred(network, seed=0):
    """The network with heads that find something everywhere."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in network.head.parameters():
            parameter.copy_(torch.randn(parameter.shape, generator=generator) * 0.3)
    return network.eval()


def road(rng, network):
    """Outputs for three frames of points everywhere, one of them empty."""
    clouds = []
    for n in (3000, 0, 500):
        further = rng.uniform(0, 1, (n, len(network.inputs["points"].columns) - 3))
        points = np.column_stack([rng.uniform([0, -20, -2.5], [64, 20, 0.5], (n, 3)), further])
        clouds.append(torch.from_numpy(points.astype(np.float32)))
    with torch.no_grad():
        return network(batch_of(*clouds))


@pytest.mark.parametrize("name", ["pointpillars", "second", "voxelnet"])
@pytest.mark.parametrize("style", ["farfield", "openpcdet"])
def test_detectors_with_anchors_give_the_same_boxes(rng, name, style):
    network = stirred(small_detector(name, head=style, score_threshold=0.3, nms_iou=0.2))
    maps = road(rng, network)
    expected = network.decode(maps)
    assert sum(map(len, expected)) > 20
    for got, boxes in zip(on_device.boxes_on_device(maps, network.head.anchors, network.config), expected, strict=True):
        assert_same(got, boxes)


def test_the_sparse_detector_gives_the_same_boxes(rng):
    network = stirred(small_detector("sparsecentre", score_threshold=0.3, candidates=100))
    maps = road(rng, network)
    expected = network.decode(maps)
    assert sum(map(len, expected)) > 20
    for got, boxes in zip(network.head.boxes_on_device(*network.head.peak_boxes(maps), 3), expected, strict=True):
        assert_same(got, boxes)


def test_pointrcnn_gives_the_boxes_of_suppression_on_the_host(rng):
    network = small_detector("pointrcnn", score_threshold=0.3).eval()
    outputs = road(rng, network)
    reference = network._proposal_reference(outputs.proposals, outputs.kinds)
    boxes = network.refiner.decode(outputs.refinements, reference).double()
    score, kind = torch.sigmoid(outputs.confidences).max(1)
    first = 0
    for got, count in zip(network.decode(outputs), outputs.proposal_lengths.tolist(), strict=True):
        row = np.arange(first, first + count)[score[first : first + count].numpy() >= 0.3]
        labels = np.array(network.config.class_names)[kind[row].numpy()]
        expected = as_boxes(boxes[row].numpy(), score[row].double().numpy(), labels)
        assert_same(got, expected[nms.rotated_nms(expected, iou_threshold=network.config.nms_iou)])
        first += count
    assert first > 20


def test_no_box_is_no_box():
    none = torch.zeros(0, 7, dtype=torch.float64)
    boxes = nms.boxes_after_nms(none, none[:, 0], none[:, 0].long(), ["vehicle"], iou_threshold=0.1, limit=5)
    assert len(boxes) == 0
    assert boxes.score is not None


def test_maps_of_a_gpu_take_the_other_path(monkeypatch):
    network = small_detector("pointpillars")
    monkeypatch.setattr("farfield.detectors.anchors.head.boxes_on_device", lambda maps, grid, config: (grid, config))
    seen = SimpleNamespace(logits=SimpleNamespace(is_cuda=True))
    assert inspect.unwrap(AnchorHead.decode)(network.head, seen) == (network.head.anchors, network.config)
