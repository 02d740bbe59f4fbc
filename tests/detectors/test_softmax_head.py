"""The head of RTN and RTNH: its matching beside brute force, its codes, its loss."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from farfield.detectors.anchors.grid import AnchorConfig, AnchorGrid
from farfield.detectors.anchors.head import AnchorHeadConfig
from farfield.detectors.kradar.softmax_head import BoxTargets, SoftmaxHead, SoftmaxMaps, match_proposals
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import paired_iou

CLASSES = {
    "vehicle": AnchorConfig(size_m=(4.2, 2.1, 2.0), z_m=0.0, positive_iou=0.5, negative_iou=0.2),
    "large_vehicle": AnchorConfig(size_m=(9.5, 3.2, 3.7), z_m=0.8, positive_iou=0.45, negative_iou=0.15),
}


class Config(AnchorHeadConfig):
    name: str = "test"

    @property
    def reach_m(self) -> float:
        return 16.0


def grid() -> AnchorGrid:
    return AnchorGrid(CLASSES, nx=20, ny=16, cell_m=0.8, y_min_m=-6.4)


def head(**settings) -> SoftmaxHead:
    torch.manual_seed(0)
    return SoftmaxHead(Config(anchors=CLASSES, **settings), 4, grid(), proposals="predicted")


def some_boxes() -> Boxes:
    return Boxes(
        centre_m=np.array([[5.0, 1.0, 0.1], [9.0, -3.0, 0.0], [11.0, 2.0, 1.0], [40.0, 0.0, 0.0]]),
        size_m=np.array([[4.4, 1.9, 1.5], [4.0, 2.0, 1.6], [9.0, 3.0, 3.3], [4.0, 2.0, 1.6]]),
        yaw_rad=np.array([0.3, -2.8, 1.4, 0.0]),
        label=np.array(["vehicle", "vehicle", "large_vehicle", "vehicle"]),
    )


def as_boxes(rows):
    return Boxes(centre_m=rows[:, :3], size_m=rows[:, 3:6], yaw_rad=rows[:, 6], label="")


def test_matching_equals_brute_force(rng):
    anchors, built = grid(), head()
    targets = built.assigner(some_boxes(), {})
    assert len(targets.rows) == 3  # the last one stands beside the grid
    proposals = anchors.rows(np.arange(len(anchors))) + rng.normal(0, 0.3, (len(anchors), 7))
    found = match_proposals(proposals, targets, anchors)
    slots = np.arange(len(anchors)) % 4
    iou = np.zeros((3, len(anchors)))
    for number, row in enumerate(targets.rows):
        own = np.flatnonzero(slots // 2 == targets.kind[number])
        iou[number, own] = paired_iou(as_boxes(np.tile(row, (len(own), 1))), as_boxes(proposals[own]), kind="bev")
    limit = np.where(targets.kind == 0, 0.5, 0.45)[:, None]
    answers = (iou > limit) | (iou == iou.max(1, keepdims=True))
    expected = np.flatnonzero(answers.any(0))
    assert found.proposal.tolist() == expected.tolist()
    assert found.box.tolist() == np.where(answers, iou, -1)[:, expected].argmax(0).tolist()
    cells = expected // 4
    best = {cell: max(expected[cells == cell], key=lambda p: iou[:, p].max()) for cell in np.unique(cells)}
    assert found.proposal[found.best].tolist() == list(best.values())
    between = iou >= np.where(targets.kind == 0, 0.2, 0.15)[:, None]
    assert found.ignored.tolist() == sorted(set(np.flatnonzero(between.any(0)) // 4) - set(cells))


def test_a_box_that_nothing_overlaps_goes_to_the_nearest_proposal_of_its_class():
    anchors = grid()
    rows = anchors.rows(np.arange(len(anchors)))
    rows[:, 2:6] = 0.1  # specks
    target = BoxTargets(np.array([[5.05, 1.15, 0, 0.1, 0.1, 0.1, 0.0]]), np.array([1]), np.ones(1))
    found = match_proposals(rows, target, anchors)
    assert anchors.labels(found.proposal).tolist() == ["large_vehicle"]
    np.testing.assert_allclose(rows[found.proposal[0], :2], [5.2, 1.2])


def test_codes_are_differences_from_the_anchor_and_come_back():
    built, boxes = head(), some_boxes()
    targets = built.assigner(boxes, {})
    index = np.array([0, 131, 402])
    code = built._code(targets.rows, index).double().numpy()
    anchors = grid().rows(index)
    np.testing.assert_allclose(code[:, :6], targets.rows[:, :6] - anchors[:, :6], atol=1e-6)
    np.testing.assert_allclose(code[:, 6], np.cos(targets.rows[:, 6]) - np.cos(anchors[:, 6]), atol=1e-6)
    np.testing.assert_allclose(built._decoded(code, index), targets.rows, atol=1e-5)


def test_perfect_maps_lose_nothing_and_give_the_boxes_back():
    built, boxes = head(score_threshold=0.3), some_boxes()
    targets = built.assigner(boxes, {})
    cells, anchors = 20 * 16, grid()
    logits, codes = torch.zeros(1, cells, 5), torch.zeros(1, cells, 4, 8)
    logits[..., 0] = 20.0
    found = match_proposals(built._rows(None), targets, anchors)
    cell, slot = np.divmod(found.proposal, 4)
    codes[0, cell, slot] = built._code(targets.rows[found.box], found.proposal)
    again = match_proposals(built._rows(codes[0]), targets, anchors)  # the predictions are matched, not the anchors
    cell, slot = np.divmod(again.proposal[again.best], 4)
    logits[0, cell, slot + 1] = 40.0
    losses = built.losses(SoftmaxMaps(logits, codes), [targets])
    assert float(losses["classification"]) < 1e-6
    assert float(losses["box"]) < 1e-9
    predicted = built.decode(SoftmaxMaps(logits, codes))[0]
    order = [int(np.hypot(*(predicted.centre_m[:, :2] - b[:2]).T).argmin()) for b in targets.rows]
    np.testing.assert_allclose(predicted.centre_m[order], targets.rows[:, :3], atol=1e-4)
    np.testing.assert_allclose(np.cos(predicted.yaw_rad[order] - targets.rows[:, 6]), 1, atol=1e-6)
    assert predicted.label[order].tolist() == ["vehicle", "vehicle", "large_vehicle"]


def test_classes_weigh_alike_however_many_cells_they_have():
    """Focal loss by hand: background -(1-p)^2 log p over its cells' mean, an anchor likewise, then their mean."""
    built = head()
    built.proposals = "anchors"
    box = some_boxes()[:1]
    logits = torch.zeros(1, 320, 5)
    logits[..., 1] = 1.0
    targets = built.assigner(box, {})
    losses = built.losses(SoftmaxMaps(logits, torch.zeros(1, 320, 4, 8)), [targets])
    p = torch.softmax(logits[0, 0], 0)
    background, along = (-((1 - p[k]) ** 2) * torch.log(p[k]) for k in (0, 1))
    found = match_proposals(built._rows(None), targets, grid())
    assert set((found.proposal[found.best] % 4).tolist()) == {0}
    assert len(found.best) > 1
    assert float(losses["classification"]) == pytest.approx(float((background + along) / 2), rel=1e-5)


def test_background_wins_where_it_is_the_likeliest():
    built = head(score_threshold=0.0)
    logits = torch.zeros(1, 320, 5)
    logits[..., 0] = 0.1
    logits[0, 7, 3] = 0.2
    found = built.decode(SoftmaxMaps(logits, torch.zeros(1, 320, 4, 8)))[0]
    assert found.label.tolist() == ["large_vehicle"]
