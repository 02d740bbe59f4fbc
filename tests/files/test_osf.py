"""OSF: files made byte by byte after the schemas, damage, and real captures that were written as OSF."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from osf_files import (
    BEAMS,
    COLUMNS,
    METADATA,
    NEAR_IR,
    ORIGIN_MM,
    RANGE_MM,
    REFLECTIVITY,
    START_NS,
    Fields,
    array,
    buffer,
    checked,
    opened,
    png,
    recording,
    sweep,
    zpng,
    zstandard,
)

from farfield.datasets import open_dataset
from farfield.errors import DatasetError, FileFormatError
from farfield.files.flat_tables import FlatBuffer
from farfield.files.osf import OsfFile


@pytest.mark.parametrize("pack", [zpng, png])
def test_points_are_those_of_the_pictures(tmp_path: Path, pack: Any) -> None:
    (tmp_path / "a.osf").write_bytes(recording([sweep(0, pack), sweep(1, pack)]))
    data = open_dataset(tmp_path)
    assert data.name == "osf"
    assert data.keys == (("a", "000000"), ("a", "000001"))
    assert data[1].time_ns == START_NS + 100_000_000
    cloud = data[0].clouds["lidar"]
    first = cloud.extra["return"] == 0
    measured = [(column, beam) for column in range(COLUMNS) for beam in range(BEAMS) if RANGE_MM[beam, column]]
    assert first.sum() == len(measured)
    assert cloud.missing == BEAMS * COLUMNS - len(measured)
    assert (~first).sum() == (RANGE_MM % 3 == 0).sum()
    rows = np.flatnonzero(first)
    for row, (column, beam) in zip(rows, measured, strict=True):
        encoder = 2 * np.pi * (1 - column / COLUMNS)
        azimuth = encoder - np.deg2rad(METADATA["beam_azimuth_angles"][beam])  # type: ignore[index]
        altitude = np.deg2rad(METADATA["beam_altitude_angles"][beam])  # type: ignore[index]
        reach = RANGE_MM[beam, column] - ORIGIN_MM
        x = reach * np.cos(azimuth) * np.cos(altitude) + ORIGIN_MM * np.cos(encoder)
        y = reach * np.sin(azimuth) * np.cos(altitude) + ORIGIN_MM * np.sin(encoder)
        expected = [-x, -y, reach * np.sin(altitude) + 36.18]
        np.testing.assert_allclose(cloud.points_m[row] * 1000.0, expected, atol=0.01)
    assert cloud.extra["ring"][rows].tolist() == [beam for _, beam in measured]
    assert cloud.extra["offset_ns"][rows].tolist() == [column * 1_000_000 for column, _ in measured]
    assert cloud.extra["reflectivity"][rows].tolist() == [REFLECTIVITY[beam, column] for column, beam in measured]
    assert cloud.extra["near_ir"][rows].tolist() == [NEAR_IR[beam, column] for column, beam in measured]


def test_poses_are_the_frames(tmp_path: Path) -> None:
    poses = np.tile(np.eye(4), (COLUMNS, 1, 1))
    poses[:, 0, 3] = 5.0
    data = opened(tmp_path, recording([sweep(0, _6=array(poses, "<f8"))]))
    pose = data[0].world_T_frame
    assert pose is not None
    assert pose[:3, 3].tolist() == [5, 0, 0]
    assert data.drives()[0].world_T_frame is not None


def test_lost_columns_are_said_and_short_sweeps_left_out(tmp_path: Path) -> None:
    states = np.ones(COLUMNS)
    states[50:] = 0
    few = np.zeros(COLUMNS)
    few[:10] = 1
    data = opened(tmp_path, recording([sweep(0, _4=array(states, "<u4")), sweep(1, _4=array(few, "<u4"))]))
    assert len(data) == 1
    assert any("14 of 64 columns" in note for note in data.assumptions)
    assert any("1 sweep is left out" in note for note in data.assumptions)
    assert data[0].clouds["lidar"].extra["offset_ns"].max() == 49_000_000


@pytest.mark.parametrize(
    ("content", "part"),
    [
        (recording([sweep(0)], version=14), "OSF version 2"),
        (recording([sweep(0)], version=3 << 48), "OSF version 2"),
        (recording([sweep(0)], status=1), "a finished file"),
        (recording([sweep(0, _2=array([1, 2], "<u8"))]), "those of 64 columns"),
        (recording([sweep(0, _6=array([np.nan], "<f8"))]), "finite poses"),
        (recording([sweep(0)], metadata=METADATA | {"beam_azimuth_angles": [1.0]}), "4 numbers"),
        (recording([sweep(0)])[:-3], "the file's end"),
        (checked(buffer({0: ("Q", 2 << 48), 1: ("B", 2), 2: ("Q", 1 << 63)}, b"OSF$")), "a place within the file"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_other_files_are_refused(tmp_path: Path, content: bytes, part: str) -> None:
    with pytest.raises((FileFormatError, DatasetError), match=part):
        opened(tmp_path, content)


@pytest.mark.parametrize(
    ("pictures", "part"),
    [
        ([{0: b"GIF89a.."}] * 4, "zpng or PNG"),
        ([{0: zpng(RANGE_MM[:, :10].copy())}] * 4, "64 x 4 pixels"),
        ([{0: zpng(RANGE_MM)[:-9]}] * 4, "bytes packed by zstd"),
        ([{0: zpng(RANGE_MM)[:8] + zstandard.compress(bytes(1 << 22))}] * 4, "1024 bytes packed by zstd"),
        ([{0: zpng(RANGE_MM)}], "4 pictures"),
        ([{0: png(REFLECTIVITY)}] * 4, "pixels of 4 bytes"),
        ([{0: png(RANGE_MM)[:60]}] * 4, "a PNG"),
    ],
)
def test_damaged_pictures_are_refused(tmp_path: Path, pictures: list[Fields], part: str) -> None:
    data = opened(tmp_path, recording([sweep(0, _0=pictures)]))
    with pytest.raises(FileFormatError, match=part):
        _ = data[0].clouds["lidar"]


def test_changed_bytes_are_seen_by_their_check_sums(tmp_path: Path) -> None:
    whole = recording([sweep(0)])
    path = tmp_path / "a.osf"
    rng = np.random.default_rng(3)
    for at in rng.integers(0, len(whole), 60).tolist():
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x10]) + whole[at + 1 :])
        with pytest.raises(FileFormatError):
            OsfFile.of(path)


def test_no_offset_leads_out_of_a_buffer(tmp_path: Path) -> None:
    whole = buffer({0: ("Q", 7), 1: [{0: "text"}, {0: b"bytes"}], 2: array([1, 2, 3], "<u8")})[4:]
    rng = np.random.default_rng(4)
    outcomes = set()
    for _ in range(2000):
        content = bytearray(whole)
        for at in rng.integers(0, len(content), 2):
            content[at] = rng.integers(256)
        try:
            root = FlatBuffer(tmp_path, "made", bytes(content[: rng.integers(len(content) + 1)])).root()
            outcomes.add(
                len(root.array(2, "<u8")) + len([child.text(0) for child in root.tables(1)]) + root.whole(0, "Q") * 0
            )
        except FileFormatError:
            outcomes.add(-1)
    assert {-1, 5} <= outcomes
