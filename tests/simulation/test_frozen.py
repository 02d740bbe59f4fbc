"""The frozen validation split: its record, and frames against it."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from whole import whole_or

from farfield.errors import ConfigError
from farfield.frame import Cloud, Frame
from farfield.simulation import find_preset, simulate_frame
from farfield.simulation.frozen import FROZEN, compare, frame_record, frozen_records, split_digest
from farfield.simulation.presets import PRESETS

ROOT = Path(__file__).resolve().parents[2]
NAME = "cirrus-sim-val-v2"
SHA256 = "0e2da4fda727f4d782a1ec724069c05e265ddca1ce70cb62d054cb8aa0fd8b45"


def test_the_record_has_not_changed() -> None:
    records = frozen_records(NAME)
    assert len(records) == 400
    assert split_digest(records) == SHA256
    assert sum(record.boxes for record in records.values()) > 4000


def test_both_roads_are_in_the_split() -> None:
    roads = [simulate_frame(NAME, sequence=sequence, index=0).conditions["road"] for sequence in (0, 1)]
    assert roads == ["highway", "urban"]


@pytest.mark.parametrize(("sequence", "index"), [(0, 0), (1, 0), (2, 7), (19, 19)])
def test_frames_match_the_record(sequence: int, index: int) -> None:
    got = frame_record(simulate_frame(NAME, sequence=sequence, index=index))
    assert compare(got, frozen_records(NAME)[sequence, index]) in ("identical", "equivalent")


@pytest.mark.slow
@pytest.mark.parametrize("sequence", whole_or(range(20), range(0, 20, 7)))
def test_all_frames_match_the_record(sequence: int) -> None:
    preset = find_preset(NAME)
    expected = {index: record for (mine, index), record in frozen_records(NAME).items() if mine == sequence}
    assert list(expected) == list(range(20))  # twenty sequences of these are the four hundred frames of the split
    for index, record in expected.items():
        assert compare(frame_record(simulate_frame(preset, sequence=sequence, index=index)), record) != "different"


def _moved(frame: Frame, by_m: float) -> Frame:
    clouds = {
        name: Cloud(cloud.points_m + np.float32(by_m), cloud.intensity, cloud.extra)
        for name, cloud in frame.clouds.items()
    }
    return Frame(
        sequence=frame.sequence,
        frame_id=frame.frame_id,
        clouds=clouds,
        load_annotation=frame.load_annotation,
    )


def test_a_changed_frame_is_noticed() -> None:
    frame = simulate_frame("cirrus-sim-mini", sequence=0, index=0)
    record = frame_record(frame)
    assert compare(frame_record(_moved(frame, 0.0)), record) == "identical"
    assert compare(frame_record(_moved(frame, 0.01)), record) == "equivalent"
    fewer = {name: cloud[: len(cloud) // 2] for name, cloud in frame.clouds.items()}
    cut = Frame(sequence="", frame_id=frame.frame_id, clouds=fewer, load_annotation=frame.load_annotation)
    assert compare(frame_record(cut), record) == "different"


def test_unknown_split_is_refused() -> None:
    with pytest.raises(ConfigError, match="expected one of cirrus-sim-val-v2"):
        frozen_records("cirrus-sim-val-v9")


def test_a_split_is_frozen_where_its_record_lies() -> None:
    assert NAME in FROZEN
    assert set(FROZEN) <= set(PRESETS)


@pytest.mark.slow
def test_one_command_records_a_split(tmp_path: Path) -> None:
    record = tmp_path / "mini.json"
    command = [sys.executable, "tools/freeze_split.py", "cirrus-sim-mini", "--output", str(record)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    tree = json.loads(record.read_text(encoding="utf-8"))
    rows = {(row[0], row[1]): row[2:] for row in tree["frames"]}
    assert list(rows) == [(sequence, index) for sequence in range(2) for index in range(3)]
    own = frame_record(simulate_frame("cirrus-sim-mini", sequence=1, index=2))
    assert rows[1, 2][1:] == [*own.points, own.boxes]
    assert tree["sha256"] in done.stdout
