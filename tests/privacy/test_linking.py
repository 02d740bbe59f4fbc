"""Boxes over time: a face that is missed once stays covered, a ghost that is weak throughout does not."""

import numpy as np
import pytest

from farfield.privacy.image_boxes import ImageBoxes
from farfield.privacy.linking import ORIGINS, LinkSettings, link_boxes

TIMES = np.arange(20) / 10


def walking(place: int, score: float = 0.8, kind: str = "face") -> ImageBoxes:
    """A face that walks 4 pixels to the right a picture."""
    left = 100.0 + 4 * place
    return ImageBoxes.of_kind(kind, np.array([[left, 50.0, left + 20, 75.0]]), np.array([score]))


def test_gaps_are_bridged_on_the_way_and_ends_are_prolonged():
    seen = [4, 5, 6, 7, 11, 12]
    covers = link_boxes([walking(place) if place in seen else ImageBoxes() for place in range(20)], TIMES)
    hows = {place: ORIGINS[int(cover.origin[0])] for place, cover in enumerate(covers) if len(cover.boxes)}
    assert [place for place, how in hows.items() if how == "found"] == seen
    assert [place for place, how in hows.items() if how == "bridged"] == [8, 9, 10]
    assert [place for place, how in hows.items() if how == "extended"] == [1, 2, 3, 13, 14, 15]
    for place in hows:
        box = covers[place].boxes.box_px[0]
        truth = walking(place).box_px[0]
        np.testing.assert_allclose((box[:2] + box[2:]) / 2, (truth[:2] + truth[2:]) / 2, atol=1e-9)
    np.testing.assert_allclose(np.ptp(covers[15].boxes.box_px[0][[0, 2]]), 20 * 1.15)
    assert len({int(track) for cover in covers for track in cover.track}) == 1


def test_a_pause_of_more_than_a_second_ends_a_track():
    covers = link_boxes([walking(place) if place in (2, 14) else ImageBoxes() for place in range(20)], TIMES)
    assert [place for place, cover in enumerate(covers) if len(cover.boxes)] == [0, 1, 2, 3, 4, 5, *range(11, 18)]
    assert len({int(track) for cover in covers for track in cover.track}) == 2


def test_weak_boxes_count_on_a_track_with_a_strong_one_only():
    weak = [walking(place, 0.15) for place in range(20)]
    assert all(not len(cover.boxes) for cover in link_boxes(weak, TIMES))
    strong_once = [walking(place, 0.5 if place == 10 else 0.15) for place in range(20)]
    assert all(len(cover.boxes) == 1 for cover in link_boxes(strong_once, TIMES))


def test_a_plate_in_one_picture_of_many_is_none_but_a_face_is_and_so_is_a_plate_among_few():
    for kind, pictures, covered in (("plate", 20, False), ("face", 20, True), ("plate", 4, True)):
        seen = [walking(place, 0.8, kind) if place == 2 else ImageBoxes() for place in range(pictures)]
        covers = link_boxes(seen, TIMES[:pictures])
        assert bool(len(covers[2].boxes)) == covered
    twice = [walking(place, 0.8, "plate") if place in (2, 5) else ImageBoxes() for place in range(20)]
    assert all(len(cover.boxes) for cover in link_boxes(twice, TIMES)[2:6])


def test_two_that_cross_and_kinds_stay_apart():
    found = []
    for place in range(20):
        other = ImageBoxes.of_kind("plate", walking(place).box_px, np.array([0.9]))
        found.append(ImageBoxes.concatenate([walking(place), other]))
    covers = link_boxes(found, TIMES)
    for cover in covers:
        assert sorted(cover.boxes.kind) == ["face", "plate"]
    tracks = {
        (str(kind), int(track)) for cover in covers for kind, track in zip(cover.boxes.kind, cover.track, strict=True)
    }
    assert len(tracks) == 2


def test_one_picture_alone_has_its_strong_boxes():
    found = ImageBoxes.concatenate([walking(0, 0.31), walking(30, 0.29)])
    (cover,) = link_boxes([found], np.zeros(1))
    assert cover.boxes.score.tolist() == [0.31]
    assert link_boxes([], np.zeros(0)) == []


def test_what_lies_outside_of_the_picture_is_dropped():
    covers = link_boxes(
        [walking(place) for place in range(3)] + [ImageBoxes()] * 3, TIMES[:6], LinkSettings(extend_s=0.3)
    )
    inside = covers[5].within(110, 100)
    assert not len(inside.boxes)
    assert len(covers[0].within(110, 100).boxes) == 1
    assert covers[0].within(110, 100).boxes.box_px[0, 2] == pytest.approx(110)
