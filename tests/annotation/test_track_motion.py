"""Interpolation and propagation of boxes, in the world and without it."""

import math

import numpy as np
import pytest
from edited_drives import pose

from farfield.annotation.motion import (
    RefitBox,
    TrackFrame,
    carry_box,
    from_world,
    interpolate,
    propagate,
    to_world,
    transform_box,
    turn_angle,
    wrap_yaw,
)
from farfield.datasets.labels import Numbers
from farfield.frame import Boxes, Key
from farfield.geometry.poses import invert

SIZE = (4.5, 1.9, 1.6)


def _moment(row: int, *, posed: bool = True) -> TrackFrame:
    return TrackFrame(("a", f"{row:04d}"), row / 10, pose(row) if posed else None)


def _world(row: int) -> Numbers:
    """A car that drives 8 m/s along a bend, in the world."""
    yaw = 3.0 + 0.03 * row
    return 20.0 - 0.8 * row, 5.0 + 0.1 * row, 0.5, *SIZE, wrap_yaw(yaw)


def _seen(row: int) -> Numbers:
    return from_world(_world(row), _moment(row))


def _boxes(box: Numbers) -> Boxes:
    return Boxes(centre_m=np.array([box[:3]]), size_m=np.array([box[3:6]]), yaw_rad=np.array([box[6]]), label="car")


def test_moved_as_boxes_are() -> None:
    tilted = pose(7)
    tilted[:3, :3] = tilted[:3, :3] @ np.array([[1, 0, 0], [0, 0.96, -0.28], [0, 0.28, 0.96]])
    box = (3.0, -2.0, 1.0, *SIZE, 2.5)
    there = _boxes(box).transform(tilted)
    assert np.allclose(transform_box(box, tilted)[:3], there.centre_m[0])
    assert transform_box(box, tilted)[6] == pytest.approx(there.yaw_rad[0])
    assert transform_box(transform_box(box, pose(7)), invert(pose(7))) == pytest.approx(box)


def test_yaw_goes_the_shorter_way() -> None:
    keyframes = [
        (_moment(0, posed=False), (0.0, 0.0, 0.0, *SIZE, 3.0)),
        (_moment(10, posed=False), (9.0, 0.0, 0.0, *SIZE, -3.0)),
    ]
    found = interpolate(keyframes, [_moment(row, posed=False) for row in range(11)])
    assert len(found) == 9
    middle = found["a", "0005"]
    assert abs(abs(middle[6]) - math.pi) < 1e-9
    assert middle[0] == pytest.approx(4.5)
    assert turn_angle(3.1, -3.1) == pytest.approx(2 * math.pi - 6.2)


def test_straight_in_the_world_not_in_the_sensor() -> None:
    rows = (0, 10, 20)
    wanted = [_moment(row) for row in range(21)]
    found = interpolate([(_moment(row), _seen(row)) for row in rows], wanted)
    errors = [math.dist(box[:2], _seen(int(key[1]))[:2]) for key, box in found.items()]
    assert max(errors) < 1e-9
    flat = interpolate([(_moment(row)._replace(world_T_frame=None), _seen(row)) for row in rows], wanted)
    assert max(math.dist(box[:2], _seen(int(key[1]))[:2]) for key, box in flat.items()) > 0.1
    assert all(abs(turn_angle(found[key][6], _seen(int(key[1]))[6])) < 1e-9 for key in found)


def test_sizes_go_over_or_are_the_tracks() -> None:
    first, second = (0.0, 0.0, 0.0, 4.0, 2.0, 1.0, 0.0), (1.0, 0.0, 0.0, 5.0, 2.0, 2.0, 0.0)
    keyframes = [(_moment(0, posed=False), first), (_moment(2, posed=False), second)]
    assert interpolate(keyframes, [_moment(1, posed=False)])["a", "0001"][3:6] == (4.5, 2.0, 1.5)
    assert interpolate(keyframes, [_moment(1, posed=False)], SIZE)["a", "0001"][3:6] == SIZE


def test_carried_stands_still_in_the_world() -> None:
    box = _seen(0)
    there = carry_box(box, _moment(0), _moment(5))
    assert to_world(there, _moment(5)) == pytest.approx(_world(0))
    assert carry_box(box, _moment(0), _moment(5, posed=False)) == box


def test_propagated_by_its_motion() -> None:
    keyframes = [(_moment(row), _seen(row)) for row in (0, 1, 2)]
    found = propagate(keyframes, [_moment(row) for row in range(3, 8)])
    assert found.message == ""
    assert list(found.boxes) == [("a", f"{row:04d}") for row in range(3, 8)]
    for key, box in found.boxes.items():
        assert math.dist(box[:2], _seen(int(key[1]))[:2]) < 1e-9
    back = propagate([(_moment(row), _seen(row)) for row in (9, 8, 7)], [_moment(row) for row in (6, 5)])
    assert math.dist(back.boxes["a", "0005"][:2], _seen(5)[:2]) < 1e-9


class _Object:
    """Fits the object where it is, with as many points as are said; remembers how far it looked."""

    def __init__(self, points: dict[int, int], shift_m: dict[int, float]) -> None:
        self.points, self.shift_m, self.windows = points, shift_m, list[float]()

    def __call__(self, key: Key, guess: Numbers, window_m: float) -> RefitBox:
        row = int(key[1])
        self.windows.append(window_m)
        seen = _seen(row)
        return RefitBox((seen[0] + self.shift_m.get(row, 0.0), *seen[1:]), self.points.get(row, 40))


def test_a_fit_leads_it_on() -> None:
    look = _Object({}, {})
    keyframes = [(_moment(0), _seen(0))]
    found = propagate(keyframes, [_moment(row) for row in range(1, 9)], look)
    assert found.message == ""
    assert found.boxes["a", "0008"] == pytest.approx(_seen(8))
    assert look.windows[0] == pytest.approx(1.0 + 20.0 * 0.1)  # its speed is not known yet
    assert look.windows[-1] == pytest.approx(1.0 + 0.5 * math.hypot(0.8, 0.1))


def test_it_stops_where_the_points_end() -> None:
    rows = range(3, 20)
    look = _Object(dict.fromkeys(range(8, 20), 2), {})
    found = propagate([(_moment(row), _seen(row)) for row in (0, 1, 2)], [_moment(row) for row in rows], look)
    assert list(found.boxes) == [("a", f"{row:04d}") for row in range(3, 8)]
    assert "lost from frame 0008" in found.message
    assert len(look.windows) == 10  # five frames without points, no more


def test_it_passes_a_short_gap() -> None:
    look = _Object(dict.fromkeys(range(6, 10), 0), {})
    found = propagate([(_moment(r), _seen(r)) for r in (0, 1, 2)], [_moment(row) for row in range(3, 14)], look)
    assert found.message == ""
    assert len(found.boxes) == 11
    assert math.dist(found.boxes["a", "0008"][:2], _seen(8)[:2]) < 0.2


def test_it_stops_where_the_points_lie_elsewhere() -> None:
    look = _Object({}, {6: 2.5})
    found = propagate([(_moment(r), _seen(r)) for r in (0, 1, 2)], [_moment(row) for row in range(3, 14)], look)
    assert list(found.boxes) == [("a", f"{row:04d}") for row in range(3, 6)]
    assert "frame 0006" in found.message
    assert "2.5 m" in found.message


def test_keyframes_ahead_are_kept() -> None:
    ahead = {("a", "0005"): _seen(5)}
    look = _Object({}, {})
    found = propagate([(_moment(0), _seen(0))], [_moment(row) for row in range(1, 8)], look, later_keyframes=ahead)
    assert ("a", "0005") not in found.boxes
    assert len(found.boxes) == 6
