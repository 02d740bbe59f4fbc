"""Random changes to frames, objects that are pasted, and draws."""

import numpy as np
import pytest

pytest.importorskip("torch")

from farfield.frame import Boxes
from farfield.geometry.boxes import count_points_in_boxes
from farfield.training.augmentation import ObjectBank, augment, cut_out, draw
from farfield.training.config import AugmentationConfig
from farfield.training.samples import systematic


def test_bands_are_drawn_from_evenly(rng):
    range_m = np.concatenate([np.full(900, 30.0), np.full(90, 100.0), np.full(10, 200.0), np.full(50, 300.0)])
    bands = (0.0, 70.0, 150.0, 250.0)
    counts = sum(
        np.histogram(range_m[draw(range_m, 3, rng, bands_m=bands)], bins=(*bands, 400.0))[0] for _ in range(1000)
    )
    np.testing.assert_allclose(counts[:3], 1000, rtol=0.1)  # five standard deviations are 0.13
    assert counts[3] == 0
    everything = draw(range_m, 2000, rng, bands_m=bands)
    assert len(everything) == len(set(everything.tolist())) == 1000
    plain = range_m[draw(range_m, 1000, rng)]
    assert (plain < 70).mean() > 0.8


def test_thinning_drops_points_and_the_boxes_they_leave(rng):
    """Whatever share goes, no point moves, no box keeps none of the points it had, and one that had none stays."""
    points = rng.uniform(0, 40, (4000, 5)).astype(np.float32)
    centre = np.array([[10.0, 10.0, 10.0], [20.0, 20.0, 20.0], [90.0, 0.0, 0.0]])
    boxes = Boxes(centre_m=centre, size_m=np.array([[2.5] * 3] * 3), yaw_rad=np.zeros(3), label=["vehicle"] * 3)
    plain = AugmentationConfig(flip_probability=0, rotation_rad=0, scale=0, thinning=0.99)
    shares, left = [], []
    for _ in range(60):
        kept, seen = augment(points, boxes, plain, rng)
        shares.append(len(kept) / len(points))
        left.append(len(seen))
        assert {tuple(row) for row in kept[:50]} <= {tuple(row) for row in points}
        counts = count_points_in_boxes(kept[:, :3], seen, margin_m=0.05)
        assert (counts[seen.centre_m[:, 0] < 80] > 0).all()
        assert (seen.centre_m[:, 0] > 80).sum() == 1
    assert min(shares) < 0.1
    assert max(shares) > 0.9
    assert min(left) < 3


def scanned(range_m, rng):
    """Boxes at ranges, along a spiral, with as many points in each as a scanner puts on it: 4e5 / r^2."""
    angle = np.linspace(-1.0, 1.0, len(range_m))
    centre = np.column_stack([range_m * np.cos(angle), range_m * np.sin(angle), np.zeros(len(range_m))])
    size = np.full((len(range_m), 3), 0.5)
    counts = np.round(4e5 / range_m**2).astype(int)
    points = np.repeat(centre, counts, axis=0) + rng.uniform(-0.2, 0.2, (counts.sum(), 3))
    boxes = Boxes(centre_m=centre, size_m=size, yaw_rad=np.zeros(len(centre)), label=["vehicle"] * len(centre))
    return np.column_stack([points, np.zeros(len(points))]).astype(np.float32), boxes


def test_near_points_get_as_sparse_as_those_of_far_objects(rng):
    """Points of near boxes: as many as in far ones, by quartiles over many frames; far points stay."""
    config = AugmentationConfig(
        flip_probability=0,
        rotation_rad=0,
        scale=0,
        sparse_near={"near_m": 100, "far_m": (100, 250), "probability": 1},
    )
    near, far, before = [], [], []
    for _ in range(60):
        range_m = np.concatenate([rng.uniform(15, 99, 12), rng.uniform(101, 249, 6)])
        points, boxes = scanned(range_m, rng)
        kept, _ = augment(points, boxes, config, rng)
        counts = count_points_in_boxes(kept[:, :3], boxes, margin_m=0.01)
        whole = count_points_in_boxes(points[:, :3], boxes, margin_m=0.01)
        np.testing.assert_array_equal(counts[12:], whole[12:])
        near.append(counts[:12])
        before.append(whole[:12])
        far.append(whole[12:])
    quartiles = [np.percentile(np.concatenate(part), [25, 50, 75]) for part in (near, far, before)]
    np.testing.assert_allclose(quartiles[0], quartiles[1], rtol=0.35)
    assert (quartiles[2] > 3 * quartiles[1]).all()


def test_a_frame_without_far_objects_stays_and_so_does_half_of_the_others(rng):
    settings = {"near_m": 100, "far_m": (100, 250)}
    config = AugmentationConfig(flip_probability=0, rotation_rad=0, scale=0, sparse_near=settings)
    points, boxes = scanned(np.array([30.0, 60.0]), rng)
    kept, seen = augment(points, boxes, config, rng)
    np.testing.assert_array_equal(kept, points)
    assert len(seen) == 2
    points, boxes = scanned(np.array([30.0, 60.0, 200.0]), rng)
    changed = sum(len(augment(points, boxes, config, rng)[0]) < len(points) for _ in range(400))
    assert 140 < changed < 260  # half, six standard deviations
    with pytest.raises(ValueError, match="near_m up to far_m"):
        AugmentationConfig(sparse_near={"near_m": 120, "far_m": (100, 250)})


def test_raising_the_scene_raises_points_and_boxes_alike(rng):
    points = rng.uniform(0, 40, (100, 5)).astype(np.float32)
    box = Boxes(centre_m=np.full((1, 3), 5.0), size_m=np.ones((1, 3)), yaw_rad=np.zeros(1), label=["vehicle"])
    raised = AugmentationConfig(flip_probability=0, rotation_rad=0, scale=0, height_m=0.5)
    moved, above = augment(points, box, raised, rng)
    rise = above.centre_m[0, 2] - 5.0
    assert 0 < abs(rise) <= 0.5
    np.testing.assert_allclose(moved[:, 2] - points[:, 2], rise, atol=1e-5)
    np.testing.assert_array_equal(moved[:, [0, 1, 3, 4]], points[:, [0, 1, 3, 4]])


def test_mirrored_boxes_by_hand(rng):
    box = Boxes(
        centre_m=np.array([[10.0, 4.0, -1.0]]),
        size_m=np.array([[4.0, 2.0, 1.5]]),
        yaw_rad=np.array([0.4]),
        label="vehicle",
    )
    points = np.array([[10.0, 4.0, -1.0, 0.5, 0.1]], dtype=np.float32)
    settings = AugmentationConfig(flip_probability=1.0, rotation_rad=0.0, scale=0.0)
    moved, mirrored = augment(points, box, settings, rng)
    np.testing.assert_allclose(moved[0], [10, -4, -1, 0.5, 0.1])
    np.testing.assert_allclose(mirrored.centre_m[0], [10, -4, -1])
    np.testing.assert_allclose(mirrored.yaw_rad, [-0.4])


def test_pasted_objects_touch_nothing_and_clear_their_place(rng):
    bank = ObjectBank()
    place = np.array([[20.0, 0.0, 0.0]])
    car = Boxes(centre_m=place, size_m=np.array([[4.0, 2.0, 2.0]]), yaw_rad=np.zeros(1), label="vehicle")
    bank.add(cut_out(np.array([[20, 0, 0, 0, 0]] * 6, dtype=np.float32), car, min_points=5))
    farther = car.replace(centre_m=place * 2)
    bank.add(cut_out(np.array([[40, 0, 0, 0, 0]] * 4, dtype=np.float32), farther, min_points=5))
    assert len(bank.objects["vehicle"]) == 1  # the second has too few points
    ground = np.array([[20.5, 0, -0.5, 0, 0], [60, 0, 0, 0, 0]], dtype=np.float32)
    points, boxes = bank.paste(ground, Boxes.empty(), {"vehicle": 3}, rng)
    assert len(boxes) == 1
    assert len(points) == 7  # one of the ground's two points stood where the car is now
    points, boxes = bank.paste(ground, car, {"vehicle": 3}, rng)
    assert (len(boxes), len(points)) == (1, 2)


def test_equal_weights_draw_every_sample_once_and_others_by_their_share(rng):
    np.testing.assert_array_equal(systematic(np.full(50, 0.3), rng), np.arange(50))
    weight = np.array([1.0, 3.0, 0.5, 5.5])
    counts = np.array([np.bincount(systematic(weight, rng), minlength=4) for _ in range(4000)])
    assert (counts.sum(1) == 4).all()
    assert (np.abs(counts - weight / 2.5) < 1).all()  # each time rounded up or down
    np.testing.assert_allclose(counts.mean(0), weight / 2.5, atol=0.03)
