"""How frames are spread over sequences."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.errors import ConfigError
from farfield.simulation.recording.planning import spread


@given(st.lists(st.integers(0, 30), min_size=1, max_size=8), st.data())
def test_frames_are_spread_evenly_and_fill_no_sequence_beyond_its_length(
    longest: list[int], data: st.DataObject
) -> None:
    total = data.draw(st.integers(0, sum(longest)))
    plan = spread(total, longest)
    assert sum(plan) == total
    assert all(planned <= most for planned, most in zip(plan, longest, strict=True))
    open_ones = [planned for planned, most in zip(plan, longest, strict=True) if planned < most]
    if open_ones:  # whoever has room has as many as any other, give or take one in each round
        assert max(plan) - min(open_ones) <= len(longest)


def test_more_frames_than_room_is_an_error() -> None:
    with pytest.raises(ConfigError, match="have room for 5 frames, got 6"):
        spread(6, [2, 3])
