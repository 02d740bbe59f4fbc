import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

torch = pytest.importorskip("torch")

from farfield.detectors.anchors.grid import AnchorConfig, AnchorGrid, decode, encode
from farfield.detectors.losses import box_loss, direction_loss, focal_loss
from farfield.detectors.nms import rotated_nms
from farfield.geometry.boxes import Boxes, wrap_angle_rad
from farfield.geometry.iou import pairwise_iou


def boxes(rows, **rest):
    rows = np.atleast_2d(np.asarray(rows, dtype=np.float64))
    return Boxes(centre_m=rows[:, :3], size_m=rows[:, 3:6], yaw_rad=rows[:, 6], **rest)


@example([(0.0, 0.0, 0.0, 1.0, 1.0, 1.0, -2.220446049250313e-16)])  # a residual of pi/2, up to rounding
@example([(0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0)])
@given(
    st.lists(
        st.tuples(*[st.floats(-200, 200)] * 2, st.floats(-3, 3), *[st.floats(0.2, 20)] * 3, st.floats(-3.1, 3.1)),
        min_size=1,
        max_size=8,
    )
)
def test_codes_round_trip(rows):
    truth = boxes(rows, label="vehicle")
    anchors = np.tile([10.0, 5.0, -1.0, 4.6, 1.95, 1.7, np.pi / 2], (len(rows), 1))
    back = decode(*encode(truth, anchors), anchors)
    np.testing.assert_allclose(back[:, :6], np.column_stack([truth.centre_m, truth.size_m]), atol=1e-9)
    np.testing.assert_allclose(np.cos(back[:, 6] - truth.yaw_rad), 1.0, atol=1e-12)


@pytest.fixture
def grid():
    kinds = {
        "vehicle": AnchorConfig(size_m=(4.6, 1.9, 1.7), z_m=-1.0),
        "pedestrian": AnchorConfig(size_m=(0.8, 0.7, 1.7), z_m=-1.1),
    }
    return AnchorGrid(kinds, nx=40, ny=20, cell_m=1.0, y_min_m=-10.0)


def test_assignment_by_hand(grid):
    truth = boxes(
        [[10.5, 0.5, -1, 4, 2, 1.5, 0.1], [20.4, -3.5, -1, 0.5, 2, 1.5, np.pi / 2]], label=["vehicle", "pedestrian"]
    )
    targets = grid.assign(truth, positive_m=0.6, ignore_m=1.2)
    rows = grid.rows(targets.positive)
    np.testing.assert_allclose(rows[:, :2], [[10.5, 0.5], [20.5, -3.5]])
    np.testing.assert_allclose(rows[:, 6], [0.0, np.pi / 2])
    assert list(grid.labels(targets.positive)) == ["vehicle", "pedestrian"]
    np.testing.assert_allclose(targets.code[0, :2], [0, 0], atol=1e-12)
    # five cells within 1.2 m, two headings each, less the one that answers; for both boxes
    assert len(targets.ignored) == 2 * (5 * 2 - 1)
    assert not set(targets.positive) & set(targets.ignored)


def test_every_box_on_the_grid_is_answered_and_none_off_it(grid, rng):
    inside = np.column_stack(
        [rng.uniform(0, 40, 30), rng.uniform(-10, 10, 30), np.zeros(30), np.ones((30, 3)), rng.uniform(-3, 3, 30)]
    )
    for row in inside:
        targets = grid.assign(boxes(row, label="vehicle"), positive_m=0.1, ignore_m=0.5)
        assert len(targets.positive) == 1
        assert abs(wrap_angle_rad(2 * targets.code[:, 6])).max() <= np.pi / 2 + 1e-9
    for x, y in ((-0.1, 0), (40.1, 0), (5, 10.1), (5, -10.1)):
        assert (
            len(grid.assign(boxes([x, y, 0, 1, 1, 1, 0], label="vehicle"), positive_m=1.0, ignore_m=2.0).positive) == 0
        )
    assert len(grid.assign(boxes([5, 5, 0, 1, 1, 1, 0], label="tram"), positive_m=1.0, ignore_m=2.0).positive) == 0
    assert len(grid.assign(Boxes.empty(), positive_m=1.0, ignore_m=2.0).positive) == 0


def test_a_cell_claimed_twice_goes_to_the_nearer_box(grid):
    truth = boxes([[10.1, 0.5, 0, 4, 2, 1, 0], [10.6, 0.5, 0, 3, 2, 1, 0]], label="vehicle")
    targets = grid.assign(truth, positive_m=0.9, ignore_m=1.0)
    centre = np.flatnonzero((grid.rows(targets.positive)[:, :2] == [10.5, 0.5]).all(1))
    assert len(centre) == 1
    np.testing.assert_allclose(targets.code[centre, 3], np.log(3 / 4.6))


def test_focal_loss_equals_its_formula(rng):
    logits = torch.from_numpy(rng.normal(size=50)).float()
    p = torch.sigmoid(logits).double()
    positive, ignored = torch.tensor([3, 7]), torch.tensor([8, 9, 10])
    expected = 0.0
    for i in range(50):
        if i in (3, 7):
            expected += float(-0.25 * (1 - p[i]) ** 2 * torch.log(p[i]))
        elif i not in (8, 9, 10):
            expected += float(-0.75 * p[i] ** 2 * torch.log(1 - p[i]))
    assert float(focal_loss(logits, positive, ignored)) == pytest.approx(expected, rel=1e-5)


def test_box_and_direction_losses_vanish_at_the_truth_and_ignore_half_turns():
    code = torch.tensor([[0.1, 0.2, 0.3, 0.0, 0.1, -0.1, 0.5]])
    assert float(box_loss(code, code)) == 0
    turned = code + torch.tensor([0, 0, 0, 0, 0, 0, np.pi])
    assert float(box_loss(turned, code)) == pytest.approx(0, abs=1e-6)
    assert float(box_loss(code + 1.0, code)) > 5
    assert float(direction_loss(torch.tensor([[9.0, -9.0]]), torch.tensor([0]))) == pytest.approx(0, abs=1e-6)


def test_nms_equals_the_plain_greedy_algorithm(rng):
    n = 120
    rows = np.column_stack(
        [rng.uniform(0, 30, (n, 2)), np.zeros(n), rng.uniform(1, 6, (n, 2)), np.ones(n), rng.uniform(-3, 3, n)]
    )
    scored = boxes(rows, label="vehicle", score=rng.random(n).round(2))
    overlap = pairwise_iou(scored, scored, kind="bev")
    kept = []
    for index in np.argsort(-scored.score, kind="stable"):
        if all(overlap[index, other] <= 0.2 for other in kept):
            kept.append(index)
    assert rotated_nms(scored, iou_threshold=0.2).tolist() == kept
    assert rotated_nms(scored, iou_threshold=0.2, limit=3).tolist() == kept[:3]
    assert len(rotated_nms(Boxes.empty(scored=True), iou_threshold=0.2)) == 0
