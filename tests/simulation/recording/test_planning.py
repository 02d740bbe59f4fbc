"""How frames are spread over sequences, and what is reported of drives of one frame each."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.errors import ConfigError
from farfield.simulation import find_preset
from farfield.simulation.recording.options import Recording, frames_of_sequences, spread
from farfield.simulation.recording.recorder import announced


@given(st.lists(st.integers(0, 30), min_size=1, max_size=8), st.data())
def test_frames_are_spread_evenly_and_fill_no_sequence_beyond_its_length(
    capacity: list[int], data: st.DataObject
) -> None:
    total = data.draw(st.integers(0, sum(capacity)))
    plan = spread(total, capacity)
    assert sum(plan) == total
    assert all(planned <= most for planned, most in zip(plan, capacity, strict=True))
    unfilled = [planned for planned, most in zip(plan, capacity, strict=True) if planned < most]
    if unfilled:  # whoever has room has as many as any other, give or take one in each round
        assert max(plan) - min(unfilled) <= len(capacity)


def test_more_frames_than_room_is_an_error() -> None:
    with pytest.raises(ConfigError, match="have room for 5 frames, got 6"):
        spread(6, [2, 3])


def lines(tmp_path: Path, frames: int, sequences: int | None) -> str:
    preset = find_preset("kradar-sim")
    plan = frames_of_sequences(preset, frames, sequences, frozen=False)
    recording = Recording(
        preset=preset, seed=1, sensors=("os2-64",), plan=plan, out=tmp_path, cache=False, frozen=False
    )
    return "\n".join(announced(recording, sum(plan), 1))


def test_drives_of_one_frame_are_reported_with_the_way_out(tmp_path: Path) -> None:
    text = lines(tmp_path, 24, None)
    assert "24 drives of one frame" in text
    assert "--sequences 1" in text


@pytest.mark.parametrize(("frames", "sequences"), [(24, 1), (1, None), (24, 4)])
def test_longer_drives_and_a_single_frame_are_not(tmp_path: Path, frames: int, sequences: int | None) -> None:
    assert "drives of one frame" not in lines(tmp_path, frames, sequences)
