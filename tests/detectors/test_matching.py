import numpy as np
import pytest
from pydantic import ValidationError

torch = pytest.importorskip("torch")

from farfield.detectors.anchors.grid import AnchorConfig, AnchorGrid, match_by_overlap
from farfield.detectors.anchors.head import AnchorHead, AnchorHeadConfig, AnchorMaps
from farfield.detectors.features import FeatureMap
from farfield.geometry.boxes import Boxes, wrap_angle_rad
from farfield.geometry.iou import pairwise_iou

KINDS = {
    "vehicle": AnchorConfig(size_m=(3.9, 1.6, 1.56), z_m=-1.0),
    "pedestrian": AnchorConfig(size_m=(0.8, 0.6, 1.73), z_m=-0.6, positive_iou=0.5, negative_iou=0.35),
}


class Config(AnchorHeadConfig):
    name: str = "test"

    @property
    def reach_m(self) -> float:
        return 40.0


def grid_of(style="farfield", nx=30, ny=24, cell_m=0.5):
    return AnchorGrid(KINDS, nx=nx, ny=ny, cell_m=cell_m, y_min_m=-ny * cell_m / 2, style=style)


def random_boxes(rng, n=12):
    label = rng.choice(["vehicle", "pedestrian", "tram"], n)
    size = np.where((label == "pedestrian")[:, None], [0.8, 0.65, 1.7], [4.0, 1.7, 1.5]) * rng.uniform(0.8, 1.2, (n, 3))
    centre = np.column_stack([rng.uniform(-1, 16, n), rng.uniform(-7, 7, n), np.full(n, -1.0)])
    return Boxes(centre_m=centre, size_m=size, yaw_rad=rng.uniform(-np.pi, np.pi, n), label=label)


def snapped(rows, labels):
    """Boxes turned to the nearer of 0 and 90 degrees."""
    yaw = np.round(rows[:, 6] / (np.pi / 2)) * np.pi / 2
    return Boxes(centre_m=rows[:, :3], size_m=rows[:, 3:6], yaw_rad=wrap_angle_rad(yaw), label=labels)


@pytest.mark.parametrize("style", ["farfield", "openpcdet"])
@pytest.mark.parametrize("seed", range(4))
def test_matching_by_overlap_equals_a_loop_over_all_anchors(seed, style):
    boxes, grid = random_boxes(np.random.default_rng(seed)), grid_of(style)
    every = np.arange(len(grid))
    anchors = snapped(grid.rows(every), grid.labels(every))
    truth = snapped(np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad]), boxes.label)
    overlap = pairwise_iou(anchors, truth, kind="bev") * (anchors.label[:, None] == boxes.label[None, :])
    positive, ignored, winners = [], [], []
    for index in range(len(grid)):
        best = overlap[index].max()
        limits = KINDS[str(anchors.label[index])]
        forced = any(
            overlap[index, j] > 0 and overlap[index, j] >= overlap[:, j].max() - 1e-12 for j in range(len(boxes))
        )
        if best >= limits.positive_iou or forced:
            positive.append(index)
            winners.append(overlap[index].argmax())
        elif best >= limits.negative_iou:
            ignored.append(index)
    weights = np.arange(1.0, len(boxes) + 1)
    found = match_by_overlap(grid, boxes, weights=weights)
    assert len(positive) > 5
    assert found.positive.tolist() == positive
    assert found.ignored.tolist() == ignored
    np.testing.assert_array_equal(found.weight, weights[winners])
    rows = grid.decode(found.code, found.backwards, found.positive)
    np.testing.assert_allclose(rows[:, :3], boxes.centre_m[winners], atol=1e-9)
    np.testing.assert_allclose(np.cos(rows[:, 6] - boxes.yaw_rad[winners]), 1.0, atol=1e-9)


def test_frames_without_boxes_have_no_targets():
    found = match_by_overlap(grid_of(), Boxes.empty())
    assert [len(part) for part in (found.positive, found.code, found.ignored, found.weight)] == [0, 0, 0, 0]


def test_thresholds_out_of_order_are_refused():
    with pytest.raises(ValidationError, match="negative_iou up to positive_iou"):
        AnchorConfig(size_m=(1.0, 1.0, 1.0), z_m=0.0, positive_iou=0.4)


@pytest.mark.parametrize("style", ["farfield", "openpcdet"])
@pytest.mark.parametrize("matching", ["distance", "iou"])
def test_perfect_maps_give_the_boxes_back(style, matching, rng):
    config = Config(anchors=KINDS, head=style, matching=matching, nms_iou=0.3, positive_m=0.4)
    head = AnchorHead(config, 4, grid_of())
    places = [(3.0, -4.0, 0.1), (4.0, 3.0, 2.9), (9.0, -1.0, 1.3), (12.5, 4.0, -1.5), (13.0, -4.0, -2.4)]
    boxes = Boxes(
        centre_m=np.array([[x, y, -1.0] for x, y, _ in places]),
        size_m=np.array([[3.9, 1.6, 1.5]] * 3 + [[0.8, 0.6, 1.7]] * 2),
        yaw_rad=np.array([yaw for *_, yaw in places]),
        label=["vehicle"] * 3 + ["pedestrian"] * 2,
    )
    targets = head.assigner(boxes, {})
    maps = AnchorMaps(
        *(
            torch.zeros_like(part)
            for part in head(FeatureMap(values=torch.zeros(1, 4, 30, 24), cell_m=0.5, origin_m=(0.0, -6.0)))
        )
    )
    positive = torch.from_numpy(targets.positive)
    maps.logits.fill_(-9.0)
    kind = positive % 4 // 2
    maps.logits[(0, positive) if style == "farfield" else (0, positive, kind)] = 5.0
    maps.codes[0, positive] = torch.from_numpy(targets.code).float()
    maps.directions[0, positive, torch.from_numpy(targets.backwards)] = 4.0
    found = head.decode(maps)[0]
    assert len(found) == len(boxes)
    gap = np.linalg.norm(found.centre_m[:, None] - boxes.centre_m, axis=-1)
    nearest = gap.argmin(1)
    assert sorted(nearest) == list(range(5))
    assert gap.min(1).max() < 1e-4
    np.testing.assert_allclose(np.cos(found.yaw_rad - boxes.yaw_rad[nearest]), 1.0, atol=1e-6)
    assert found.label.tolist() == boxes.label[nearest].tolist()
    assert sum(head.losses(maps, [targets]).values()) < 0.2


def test_a_logit_for_each_class_is_negative_for_the_other_classes(rng):
    config = Config(anchors=KINDS, head="openpcdet", matching="iou")
    head = AnchorHead(config, 4, grid_of())
    assert head.out_channels == 4 * (2 + 9)
    targets = head.assigner(random_boxes(rng), {})
    logits = torch.from_numpy(rng.normal(size=(1, len(head.anchors), 2))).float()
    maps = AnchorMaps(logits, torch.zeros(1, len(head.anchors), 7), torch.zeros(1, len(head.anchors), 2))
    target, counts = np.zeros((len(head.anchors), 2)), np.ones((len(head.anchors), 2))
    target[targets.positive, targets.positive % 4 // 2] = 1
    counts[targets.ignored] = 0
    p = torch.sigmoid(logits[0].double()).numpy()
    each = np.where(target == 1, -0.25 * (1 - p) ** 2 * np.log(p), -0.75 * p**2 * np.log(1 - p))
    expected = (each * counts).sum() / len(targets.positive)
    assert float(head.losses(maps, [targets])["classification"]) == pytest.approx(expected, rel=1e-4)


def test_anchors_in_the_style_of_openpcdet_reach_from_edge_to_edge():
    grid = grid_of("openpcdet")
    rows = grid.rows(np.arange(len(grid)))
    assert (rows[:, 0].min(), rows[:, 1].min()) == (0.0, -6.0)
    np.testing.assert_allclose([rows[:, 0].max(), rows[:, 1].max()], [15.0, 6.0])
    assert set(rows[:, 6]) == {0.0, 1.57}
