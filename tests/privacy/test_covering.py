"""Covered boxes hold nothing of what stood in them, and nothing outside of them changes."""

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.privacy.covering import box_mask, cover_boxes
from farfield.privacy.image_boxes import ImageBoxes, covered_share, pairwise_iou, suppress_overlapping

BOX = np.array([[20.0, 10.0, 50.0, 40.0]])
FACE, PLATE = (ImageBoxes.of_kind(kind, BOX, np.ones(1)) for kind in ("face", "plate"))


@pytest.fixture
def image(rng) -> np.ndarray:
    return rng.integers(0, 256, (60, 80, 3), dtype=np.uint8)


def test_filled_boxes_do_not_depend_on_what_stood_in_them(image, rng):
    other = image.copy()
    other[10:40, 20:50] = rng.integers(0, 256, (30, 30, 3), dtype=np.uint8)
    one, two = (cover_boxes(each, FACE, "fill", rng) for each in (image, other))
    np.testing.assert_array_equal(one, two)
    assert len(np.unique(one[10:40, 20:50].reshape(-1, 3), axis=0)) == 1
    outside = ~box_mask(FACE, 80, 60)
    np.testing.assert_array_equal(one[outside], image[outside])


def test_the_colour_is_that_of_the_ring_without_other_boxes(rng):
    image = np.full((60, 80, 3), 40, dtype=np.uint8)
    image[:, 50:] = 200  # all of it covered by the second box
    both = ImageBoxes.concatenate([FACE, ImageBoxes.of_kind("plate", np.array([[50.0, 0.0, 80.0, 60.0]]), np.ones(1))])
    assert (cover_boxes(image, both, "fill", rng)[10:40, 20:50] == 40).all()
    whole = ImageBoxes.of_kind("face", np.array([[0.0, 0.0, 80.0, 60.0]]), np.ones(1))
    assert (cover_boxes(image, whole, "fill", rng) == 127).all()


@pytest.mark.parametrize(("hits", "rows", "columns"), [(FACE, 6, 6), (PLATE, 1, 2)])
def test_pixels_are_few_and_coarse(image, rng, hits, rows, columns):
    part = cover_boxes(image, hits, "pixelate", rng)[10:40, 20:50]
    assert len(np.unique(part.reshape(-1, 3), axis=0)) <= rows * columns
    assert (np.diff(part[:, 0].astype(int), axis=0).any(axis=1)).sum() <= rows - 1
    assert (np.diff(part[0].astype(int), axis=0).any(axis=1)).sum() <= columns - 1


def test_cells_keep_sixteen_levels_under_noise_of_eight(rng):
    """Two pictures that differ within a level give the same cells but for the noise."""
    flat = np.full((60, 80, 3), 130, dtype=np.uint8)
    drawn = [cover_boxes(each, PLATE, "pixelate", np.random.default_rng(3))[10, 20] for each in (flat, flat + 10)]
    np.testing.assert_array_equal(*drawn)
    many = [cover_boxes(flat, PLATE, "pixelate", rng)[10, 20].astype(float) for _ in range(400)]
    assert np.std(many) == pytest.approx(8, rel=0.15)
    assert np.mean(many) == pytest.approx(136, abs=1)


def test_blur_is_smooth_and_says_no_more_than_the_cells(image):
    """Blurred and pixelated alike hold a picture's box with few numbers: they are equal for equal cell means."""
    mirrored = image.copy()
    mirrored[10:40, 20:50] = image[10:40, 20:50].reshape(6, 5, 6, 5, 3)[:, ::-1, :, ::-1].reshape(30, 30, 3)
    one, two = (cover_boxes(each, FACE, "blur", np.random.default_rng(0)) for each in (image, mirrored))
    np.testing.assert_array_equal(one, two)
    steps = np.abs(np.diff(one[10:40, 20:50].astype(int), axis=0)).max()
    edges = np.abs(
        np.diff(cover_boxes(image, FACE, "pixelate", np.random.default_rng(0))[10:40, 20:50].astype(int), axis=0)
    )
    assert steps < edges.max() / 2


def test_boxes_touch_every_pixel_and_stay_inside():
    hits = ImageBoxes.of_kind("face", np.array([[-5.0, 3.2, 4.1, 9.9], [90.0, 0.0, 99.0, 9.0]]), np.ones(2)).within(
        80, 60
    )
    assert len(hits) == 1
    mask = box_mask(hits, 80, 60)
    assert mask[3:10, :5].all()
    assert mask.sum() == 35
    assert covered_share(mask, np.array([0.0, 3.0, 10.0, 10.0])) == pytest.approx(0.5)


def test_an_unknown_way_and_boxes_outside_are_refused(image, rng):
    with pytest.raises(ConfigError, match="fill, pixelate, blur; got 'smear'"):
        cover_boxes(image, FACE, "smear", rng)
    with pytest.raises(ConfigError, match="within"):
        cover_boxes(image, ImageBoxes.of_kind("face", np.array([[90.0, 0.0, 99.0, 9.0]]), np.ones(1)), "fill", rng)


def test_the_best_of_overlapping_boxes_of_a_kind_stays():
    boxes = np.array([[0.0, 0, 10, 10], [1.0, 0, 11, 10], [0.0, 0, 10, 10], [50.0, 0, 60, 10]])
    hits = ImageBoxes(boxes, np.array([0.5, 0.9, 0.4, 0.2]), np.array(["face", "face", "plate", "face"]))
    kept = suppress_overlapping(hits, 0.3)
    assert kept.score.tolist() == [0.9, 0.4, 0.2]
    assert pairwise_iou(boxes[:1], boxes[1:2])[0, 0] == pytest.approx(90 / 110)
