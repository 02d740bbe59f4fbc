"""Boxes of the class ``unsure``: where one stands, a training neither rewards nor punishes what a detector says."""

import numpy as np
import pytest
import torch
from small import small_detector

from farfield.detectors import build_detector
from farfield.detectors.config import BoxWeights
from farfield.detectors.sparsecentre.head import in_rectangles
from farfield.frame import Boxes
from farfield.geometry.boxes import inside_box
from farfield.vocabulary.classes import UNSURE

CLUTTER = Boxes(
    centre_m=np.array([[30.0, 6.0, 0.0]]), size_m=np.array([[6.0, 4.0, 10.0]]), yaw_rad=np.array([0.4]), label=[UNSURE]
)
CAR = Boxes(
    centre_m=np.array([[20.0, -4.0, -1.0]]), size_m=np.array([[4.5, 1.9, 1.6]]), yaw_rad=np.zeros(1), label=["vehicle"]
)


def cloud_on(box: Boxes, rng: np.random.Generator, count: int = 200) -> torch.Tensor:
    """Points in a box and nowhere else."""
    points = rng.uniform(-0.45, 0.45, (count, 3)) * np.array([*box.size_m[0, :2], 1.0])
    cos, sin = np.cos(box.yaw_rad[0]), np.sin(box.yaw_rad[0])
    points[:, :2] = points[:, :2] @ np.array([[cos, sin], [-sin, cos]])
    points += np.array([*box.centre_m[0, :2], -1.0])
    return torch.from_numpy(np.column_stack([points, np.zeros(count)])).float()


@pytest.mark.parametrize("name", ["pointpillars", "second", "voxelnet", "pointrcnn"])
def test_what_stands_in_an_unsure_box_has_no_gradient(name, rng):
    """The logits of all that lies in it: anchors, or points; where nobody is unsure they have one."""
    network = small_detector(name).train()
    cloud = cloud_on(CLUTTER, rng)[:, : len(network.inputs["points"].columns)]
    for boxes, ignored in ((CLUTTER, True), (CLUTTER[np.zeros(1, dtype=bool)], False)):
        targets = network.assigner(boxes, {"points": cloud.numpy()})
        outputs = network.head(network.encode({"points": [cloud]}), [targets])
        outputs.logits.retain_grad()
        name_of_loss = "segmentation" if name == "pointrcnn" else "classification"
        network.losses(outputs, [targets])[name_of_loss].backward()
        gradient = outputs.logits.grad.flatten()
        if name == "pointrcnn":
            inside = torch.ones(len(gradient), dtype=torch.bool)
        else:
            grid = network.head.anchors
            index = np.arange(len(grid))
            tall = grid.rows(index)[:, :3] * [1, 1, 0]
            inside = torch.from_numpy(inside_box(tall, CLUTTER, 0))
            assert inside.sum() > 20
            step_m = grid.step_m.max()
            wide = CLUTTER.replace(size_m=CLUTTER.size_m + 2 * step_m)
            assert (gradient[torch.from_numpy(~inside_box(tall, wide, 0))] != 0).all()
        assert bool((gradient[inside] == 0).all()) == ignored


def test_cells_of_the_sparse_detector_in_an_unsure_box_have_no_gradient(rng):
    network = small_detector("sparsecentre").train()
    cloud = torch.cat([cloud_on(CLUTTER, rng), cloud_on(CAR, rng)])[:, : len(network.inputs["points"].columns)]
    targets = network.assigner(Boxes.concatenate([CAR, CLUTTER]), {"points": cloud.numpy()})
    outputs = network.head(network.encode({"points": [cloud]}), [targets])
    losses = network.losses(outputs, [targets])
    rectangles = torch.from_numpy(targets.unsure).float()
    for loss, values, keys in (
        ("heat", outputs.logits, outputs.keys),
        ("foreground", outputs.votes, outputs.vote_keys),
    ):
        (gradient,) = torch.autograd.grad(losses[loss], values, retain_graph=True)
        inside = in_rectangles(network.head.places_m(keys)[1], rectangles)
        assert inside.any()
        assert not gradient[inside].any()
        assert gradient[~inside].any(dim=1).all()


def test_second_stage_proposals_in_an_unsure_box_are_no_false_ones():
    from farfield.detectors.pointrcnn.boxes import centres_in

    rows = np.array([[30.0, 6.0, -1, 4, 2, 1.5, 0], [40.0, 6.0, -1, 4, 2, 1.5, 0]], dtype=np.float32)
    unsure = np.array([[30.0, 6.0, 0, 6, 4, 10, 0.4]], dtype=np.float32)
    assert centres_in(rows, unsure).tolist() == [True, False]


def test_an_object_that_stands_in_an_unsure_box_is_learnt():
    network = small_detector("pointpillars")
    car = CAR.replace(centre_m=CLUTTER.centre_m - [0.0, 0.0, 1.0])
    inputs = {"points": np.zeros((0, 3), dtype=np.float32)}
    alone, both = (network.assigner(boxes, inputs) for boxes in (car, Boxes.concatenate([car, CLUTTER])))
    assert both.positive.tolist() == alone.positive.tolist()
    assert len(both.ignored) > len(alone.ignored)


@pytest.mark.parametrize(("points", "weight"), [(1, 0.2**0.5), (3, 0.6**0.5), (5, 1.0), (100, 1.0)])
def test_boxes_of_few_points_weigh_less(points, weight, rng):
    cloud = cloud_on(CAR, rng, points).numpy()
    assert BoxWeights(full_points=5)(CAR, {"points": cloud}) == pytest.approx([weight])
    assert BoxWeights()(CAR, {"points": cloud}).tolist() == [1.0]


def test_the_key_reaches_every_detector_and_is_not_written_where_it_is_not_set(rng):
    cloud = cloud_on(CAR, rng, 2)
    for name in ("pointpillars", "second", "voxelnet", "pointrcnn", "sparsecentre"):
        network = small_detector(name, full_points=5)
        columns = len(network.inputs["points"].columns)
        targets = network.assigner(CAR, {"points": cloud[:, :columns].numpy()})
        np.testing.assert_allclose(targets.weight, 0.4**0.5)
        assert "full_points" in network.config.model_dump()
        assert not {"full_points", "score_bands"} & set(small_detector(name).config.model_dump())
    assert build_detector(network.config).config == network.config
