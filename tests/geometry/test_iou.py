"""Rotated IoU: analytic cases at 250 m, exact rational clipping, invariants."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import aligned_iou, bev_intersection_m2, paired_iou, pairwise_iou
from farfield.geometry.poses import pose_from_yaw

TOLERANCE = 1e-9
AZIMUTHS_RAD = np.linspace(-np.pi, np.pi, 9)
YAWS_RAD = np.array([0.0, 1e-9, 0.3, np.pi / 4, np.pi / 2, 2.0, -np.pi, -np.pi / 2, -2.7])
Point = tuple[Fraction, Fraction]


def boxes_of(centre_m: object, size_m: object, yaw_rad: object) -> Boxes:
    centre, size, yaw = (np.atleast_2d(np.asarray(v, dtype=np.float64)) for v in (centre_m, size_m, yaw_rad))
    n = max(len(centre), yaw.shape[1])
    return Boxes(
        centre_m=np.broadcast_to(centre, (n, 3)).copy(),
        size_m=np.broadcast_to(size, (n, 3)).copy(),
        yaw_rad=np.broadcast_to(yaw[0], (n,)).copy(),
    )


def far_boxes(size_m: tuple[float, float, float]) -> Boxes:
    """Boxes of one size, 250 m away in all directions, with all headings."""
    azimuth_rad, yaw_rad = (grid.ravel() for grid in np.meshgrid(AZIMUTHS_RAD, YAWS_RAD))
    centre_m = np.stack([250 * np.cos(azimuth_rad), 250 * np.sin(azimuth_rad), np.full(azimuth_rad.size, -1.0)], axis=1)
    return boxes_of(centre_m, size_m, yaw_rad)


def shifted(box: Boxes, ahead_m: float = 0.0, left_m: float = 0.0, up_m: float = 0.0, turn_rad: float = 0.0) -> Boxes:
    cos, sin = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    offset = np.stack([ahead_m * cos - left_m * sin, ahead_m * sin + left_m * cos, np.full(len(box), up_m)], axis=1)
    return box.replace(centre_m=box.centre_m + offset, yaw_rad=box.yaw_rad + turn_rad)


def exact_corners(row: np.ndarray) -> list[Point]:
    box = boxes_of([row[0], row[1], 0.0], [row[2], row[3], 1.0], row[4])
    return [(Fraction(float(x)), Fraction(float(y))) for x, y in box.bev_corners_m()[0]]


def exact_clip_area(subject: list[Point], clip: list[Point]) -> Fraction:
    """Area of the intersection of two convex counter-clockwise polygons, by cutting along each edge, in fractions."""
    for (ax, ay), (bx, by) in zip(clip, clip[1:] + clip[:1], strict=True):
        sides = [(bx - ax) * (y - ay) - (by - ay) * (x - ax) for x, y in subject]
        kept: list[Point] = []
        for i, (x, y) in enumerate(subject):
            j = (i + 1) % len(subject)
            if sides[i] >= 0:
                kept.append((x, y))
            if (sides[i] > 0 > sides[j]) or (sides[i] < 0 < sides[j]):
                share = sides[i] / (sides[i] - sides[j])
                kept.append((x + share * (subject[j][0] - x), y + share * (subject[j][1] - y)))
        subject = kept
        if len(subject) < 3:
            return Fraction(0)
    doubled = sum(
        (x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in zip(subject, subject[1:] + subject[:1], strict=True)), Fraction(0)
    )
    return doubled / 2


@pytest.mark.parametrize("kind", ["bev", "3d"])
class TestAnalyticAt250Metres:
    """Every peer is wrong in one of these; here the error stays below 1e-9."""

    size_m = (4.5, 1.9, 1.6)

    def check(self, a: Boxes, b: Boxes, kind: str, expected: float) -> None:
        for first, second in ((a, b), (b, a)):
            found = paired_iou(first, second, kind=kind)
            assert np.abs(found - expected).max() < TOLERANCE
            assert found.max() <= 1.0

    def test_coincident(self, kind: str) -> None:
        boxes = far_boxes(self.size_m)
        self.check(boxes, boxes, kind, 1.0)

    def test_turned_by_pi(self, kind: str) -> None:
        boxes = far_boxes(self.size_m)
        self.check(boxes, shifted(boxes, turn_rad=np.pi), kind, 1.0)

    def test_square_turned_by_a_right_angle(self, kind: str) -> None:
        boxes = far_boxes((2.5, 2.5, 1.0))
        self.check(boxes, shifted(boxes, turn_rad=np.pi / 2), kind, 1.0)
        self.check(boxes, shifted(boxes, turn_rad=-np.pi / 2), kind, 1.0)

    def test_square_turned_by_half_a_right_angle_leaves_an_octagon(self, kind: str) -> None:
        boxes = far_boxes((2.5, 2.5, 1.0))
        self.check(boxes, shifted(boxes, turn_rad=np.pi / 4), kind, np.sqrt(0.5))

    def test_shifted_along_its_heading_with_two_shared_edges(self, kind: str) -> None:
        boxes = far_boxes(self.size_m)
        for shift in (1e-6, 0.5, 2.25, 4.4):
            expected = (4.5 - shift) / (4.5 + shift)
            self.check(boxes, shifted(boxes, ahead_m=shift), kind, expected)
            self.check(boxes, shifted(boxes, ahead_m=-shift, turn_rad=np.pi), kind, expected)

    def test_shifted_sideways_with_two_shared_edges(self, kind: str) -> None:
        boxes = far_boxes(self.size_m)
        self.check(boxes, shifted(boxes, left_m=0.7), kind, (1.9 - 0.7) / (1.9 + 0.7))

    def test_nested(self, kind: str) -> None:
        boxes = far_boxes(self.size_m)
        inner = shifted(boxes, ahead_m=0.3, left_m=-0.1, turn_rad=0.2).replace(
            size_m=np.tile([1.0, 0.8, 1.6], (len(boxes), 1))
        )
        self.check(boxes, inner, kind, 0.8 / (4.5 * 1.9))

    def test_nested_with_a_shared_corner(self, kind: str) -> None:
        boxes = far_boxes(self.size_m)
        inner = shifted(boxes, ahead_m=1.75, left_m=0.45).replace(size_m=np.tile([1.0, 1.0, 1.6], (len(boxes), 1)))
        self.check(boxes, inner, kind, 1.0 / (4.5 * 1.9))

    def test_crossed(self, kind: str) -> None:
        boxes = far_boxes(self.size_m)
        self.check(boxes, shifted(boxes, turn_rad=np.pi / 2), kind, 1.9**2 / (2 * 4.5 * 1.9 - 1.9**2))

    def test_crossed_strips_share_a_parallelogram(self, kind: str) -> None:
        boxes = far_boxes((40.0, 0.5, 1.0))
        shared = 0.5 * 0.5 / np.sin(0.7)
        self.check(boxes, shifted(boxes, turn_rad=0.7), kind, shared / (2 * 40 * 0.5 - shared))

    def test_touching_edges_and_corners(self, kind: str) -> None:
        boxes = far_boxes(self.size_m)
        self.check(boxes, shifted(boxes, ahead_m=4.5), kind, 0.0)
        self.check(boxes, shifted(boxes, left_m=1.9), kind, 0.0)
        self.check(boxes, shifted(boxes, ahead_m=4.5, left_m=1.9), kind, 0.0)
        self.check(boxes, shifted(boxes, ahead_m=(4.5 + 1.9) / 2, turn_rad=np.pi / 2), kind, 0.0)

    def test_apart_is_exactly_zero(self, kind: str) -> None:
        boxes = far_boxes(self.size_m)
        assert not paired_iou(boxes, shifted(boxes, ahead_m=5.0), kind=kind).any()
        assert not paired_iou(boxes, shifted(boxes, ahead_m=-500.0), kind=kind).any()

    def test_above_one_another(self, kind: str) -> None:
        boxes = far_boxes(self.size_m)
        self.check(boxes, shifted(boxes, up_m=0.8), kind, 1.0 if kind == "bev" else 1 / 3)
        self.check(boxes, shifted(boxes, up_m=1.6), kind, 1.0 if kind == "bev" else 0.0)
        self.check(boxes, shifted(boxes, up_m=-9.0), kind, 1.0 if kind == "bev" else 0.0)


def random_rows(rng: np.random.Generator, n: int) -> np.ndarray:
    return np.column_stack([rng.uniform(-3, 3, (n, 2)), rng.uniform(0.3, 6, (n, 2)), rng.uniform(-4, 4, n)])


def test_random_pairs_equal_exact_rational_clipping(rng: np.random.Generator) -> None:
    a, b = random_rows(rng, 150), random_rows(rng, 150)
    exact = [float(exact_clip_area(exact_corners(p), exact_corners(q))) for p, q in zip(a, b, strict=True)]
    assert np.count_nonzero(exact) > 75
    np.testing.assert_allclose(bev_intersection_m2(a, b), exact, atol=1e-12)


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    exponent=st.integers(-17, -3),
    quarter_turns=st.integers(0, 3),
    ends=st.tuples(st.sampled_from([-1, 0, 1]), st.sampled_from([-1, 0, 1])),
)
def test_almost_coincident_edges_at_250_m_equal_exact_clipping(
    seed: int, exponent: int, quarter_turns: int, ends: tuple[int, int]
) -> None:
    """Boxes that share edges up to a perturbation between nothing and a millimetre: where tolerances fail."""
    rng = np.random.default_rng(seed)
    a = np.array([rng.uniform(-250, 250), rng.uniform(-250, 250), rng.uniform(1, 6), rng.uniform(1, 6), 0.0])
    a[4] = rng.choice([0.0, np.pi / 2, rng.uniform(-3, 3)])
    cos, sin = np.cos(a[4]), np.sin(a[4])
    ahead, left = ends[0] * a[2] / 2, ends[1] * a[3] / 2
    b = a.copy()
    b += (ahead * cos - left * sin, ahead * sin + left * cos, 0, 0, quarter_turns * np.pi / 2)
    b += 10.0**exponent * rng.choice([0.0, 1.0, -1.0], 5)
    exact = float(exact_clip_area(exact_corners(a), exact_corners(b)))
    found = bev_intersection_m2(a[None], b[None])[0]
    assert abs(found - exact) / (a[2] * a[3] + b[2] * b[3] - exact) < TOLERANCE


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_symmetric_bounded_and_unmoved_by_rigid_motion_to_250_m(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = (boxes_of(rng.uniform(-2, 2, (8, 3)), rng.uniform(0.3, 5, (8, 3)), rng.uniform(-4, 4, 8)) for _ in range(2))
    motion = pose_from_yaw(rng.uniform(-4, 4), (250.0, rng.uniform(-250, 250), 3.0))
    for kind in ("bev", "3d"):
        iou = paired_iou(a, b, kind=kind)
        assert ((iou >= 0) & (iou <= 1)).all()
        np.testing.assert_allclose(paired_iou(b, a, kind=kind), iou, atol=TOLERANCE)
        np.testing.assert_allclose(paired_iou(a.transform(motion), b.transform(motion), kind=kind), iou, atol=TOLERANCE)
        np.testing.assert_allclose(pairwise_iou(a, b, kind=kind).diagonal(), iou, atol=1e-15)


def test_pairwise_holds_every_pair(rng: np.random.Generator) -> None:
    a = boxes_of(rng.uniform(-20, 20, (30, 3)), rng.uniform(1, 8, (30, 3)), rng.uniform(-4, 4, 30))
    b = a[::2]
    table = pairwise_iou(a, b, kind="bev")
    for row in range(len(a)):
        repeated = a[[row] * len(b)]
        np.testing.assert_allclose(table[row], paired_iou(repeated, b, kind="bev"), atol=1e-15)
    np.testing.assert_allclose(table[::2].diagonal(), 1.0, atol=TOLERANCE)
    assert 0 < np.count_nonzero(table) < table.size


def test_more_pairs_than_one_chunk(rng: np.random.Generator) -> None:
    a, b = random_rows(rng, 10_001), random_rows(rng, 10_001)
    together = bev_intersection_m2(a, b)
    np.testing.assert_array_equal(together[5000:5010], bev_intersection_m2(a[5000:5010], b[5000:5010]))
    assert together[-1] == bev_intersection_m2(a[-1:], b[-1:])[0]


@pytest.mark.parametrize("scale", [1e-200, 1e-9, 1e9])
def test_extreme_sizes_stay_in_bounds(scale: float) -> None:
    box = boxes_of([250.0, 3.0, 0.0], [scale, scale * 2, scale], 0.4)
    iou = paired_iou(box, shifted(box, turn_rad=np.pi))
    assert np.isfinite(iou).all()
    assert (iou >= 0).all()
    assert (iou <= 1).all()


def test_empty_sets_and_wrong_arguments() -> None:
    box, none = boxes_of([0.0, 0.0, 0.0], [1.0, 1.0, 1.0], 0.0), Boxes.empty()
    assert paired_iou(none, none).shape == (0,)
    assert pairwise_iou(none, box).shape == (0, 1)
    assert pairwise_iou(box, none).shape == (1, 0)
    with pytest.raises(ValueError, match="as many boxes"):
        paired_iou(box, none)
    with pytest.raises(ValueError, match="'bev', '3d', got '2d'"):
        paired_iou(box, box, kind="2d")
    with pytest.raises(ValueError, match="'yaw', 'scale', 'bev', got '3d'"):
        aligned_iou(box, box, kind="3d")


def test_aligned_iou_by_hand() -> None:
    a = boxes_of([250.0, 0.0, 0.0], [4.0, 2.0, 1.0], 0.0)
    b = boxes_of([-250.0, 9.0, 5.0], [4.0, 2.0, 2.0], np.pi / 2)
    assert aligned_iou(a, b, kind="scale")[0] == pytest.approx(0.5, abs=1e-12)  # 8 / 16
    assert aligned_iou(a, b, kind="yaw")[0] == pytest.approx(4 / (8 + 16 - 4), abs=1e-12)
    assert aligned_iou(a, b, kind="bev")[0] == pytest.approx(4 / 12, abs=1e-12)
    assert aligned_iou(a, a, kind="yaw")[0] == pytest.approx(1.0, abs=1e-12)
