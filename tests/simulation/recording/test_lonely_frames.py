"""Frames that are spread over so many drives that each has one are no sequences: it is said, and how to have some."""

from pathlib import Path

import pytest

from farfield.simulation import find_preset
from farfield.simulation.recording.planning import frames_of_sequences
from farfield.simulation.recording.settings import RecordingOptions
from farfield.simulation.recording.words import announced


def lines(tmp_path: Path, frames: int, sequences: int | None) -> str:
    preset = find_preset("kradar-sim")
    plan = frames_of_sequences(preset, frames, sequences, frozen=False)
    recording = RecordingOptions(
        preset=preset, seed=1, sensors=("os2-64",), plan=plan, out=tmp_path, cache=False, frozen=False
    )
    return "\n".join(announced(recording, sum(plan), 1))


def test_drives_of_one_frame_are_said_and_mended(tmp_path: Path) -> None:
    said = lines(tmp_path, 24, None)
    assert "24 drives of one frame" in said
    assert "--sequences 1" in said


@pytest.mark.parametrize(("frames", "sequences"), [(24, 1), (1, None), (24, 4)])
def test_longer_drives_and_a_single_frame_are_not(tmp_path: Path, frames: int, sequences: int | None) -> None:
    assert "drives of one frame" not in lines(tmp_path, frames, sequences)
