"""Ouster's captures: real ones against the manufacturer's decoder, written ones with what networks do to packets."""

import json
import struct
import time
import tracemalloc
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.datasets.ouster import Ouster
from farfield.errors import DatasetError, FileFormatError
from farfield.files.captures import datagrams
from farfield.inspection.doctor import examine

BEAMS, COLUMNS, PER_PACKET = 4, 64, 16
ORIGIN_MM = 15.806
# By ouster-sdk 1.0.1: points, mean of |x|, |y|, |z| in metres, sum of the reflectivity (whose upper byte it leaves out
# before firmware 2.1: None).
BY_THE_SDK: dict[tuple[str, str], tuple[int, list[float], int | None]] = {
    ("OS-0-128-U1_v2.3.0_1024x10", "000000"): (97299, [4.8654, 5.3589, 2.4964], 1471827),
    ("OS-1-128_v2.3.0_1024x10_lb_n3", "000000"): (107647, [10.0491, 10.0407, 2.5340], 1515516),
    ("OS-1-128_v2.3.0_1024x10_lb_n3", "000001"): (107357, [10.0469, 10.0561, 2.5348], 1511825),
    ("OS-1-128_v2.3.0_1024x10_lb_n3", "000002"): (107532, [10.0888, 10.1052, 2.5436], 1507611),
    ("OS-1-32-G_v2.1.1_1024x10", "000000"): (27310, [12.4422, 10.2681, 1.1919], 544495),
    ("OS-2-128-U1_v2.3.0_1024x10", "000000"): (119682, [12.7310, 10.2735, 1.6527], 6608460),
    ("OS-2-32-U0_v2.0.0_1024x10", "000000"): (28541, [14.8155, 11.3528, 1.8198], None),
}


def test_real_captures_are_decoded_as_the_manufacturers_tool_decodes_them(shared_open: Path) -> None:
    data = open_dataset(shared_open / "ouster")
    assert data.name == "ouster"
    assert data.assumptions == ()
    assert set(data.keys) == set(BY_THE_SDK)
    for frame in data:
        cloud = frame.clouds["lidar"]
        count, mean_m, reflectivity = BY_THE_SDK[frame.key]
        assert len(cloud) == count
        np.testing.assert_allclose(np.abs(cloud.points_m.astype(np.float64)).mean(axis=0), mean_m, atol=6e-5)
        assert reflectivity in (None, int(cloud.extra["reflectivity"].sum()))
        assert cloud.extra["ring"].max() + 1 in (32, 128)
        offset_ns = cloud.extra["offset_ns"]
        assert offset_ns[0] < 1e6
        turn_ns = 5e7 if "OS-2-32" in frame.sequence else 1e8  # that one turned 20 times a second
        assert 0.99 * turn_ns < offset_ns.max() <= turn_ns
        assert (np.diff(offset_ns) >= 0).all()


def test_sweeps_of_a_real_drive_are_a_tenth_of_a_second_apart(shared_open: Path) -> None:
    data = open_dataset(shared_open / "ouster")
    drive = next(drive for drive in data.drives() if drive.name.startswith("OS-1-128"))
    assert drive.times_ns is not None
    np.testing.assert_allclose(np.diff(drive.times_ns), 1e8, rtol=1e-3)


# A writer of its own: packets after the manual, column by column.


def metadata(profile: str = "RNG19_RFL8_SIG16_NIR16", **changed: Any) -> dict[str, Any]:
    return {
        "build_rev": "v2.3.0",
        "beam_altitude_angles": [10.0, 0.0, -5.0, -10.0],
        "beam_azimuth_angles": [3.0, 1.0, -1.0, -3.0],
        "lidar_origin_to_beam_origin_mm": ORIGIN_MM,
        "lidar_to_sensor_transform": [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1],
        "data_format": {
            "columns_per_frame": COLUMNS,
            "columns_per_packet": PER_PACKET,
            "pixels_per_column": BEAMS,
            "column_window": [0, COLUMNS - 1],
            "udp_profile_lidar": profile,
        },
    } | changed


def pixel(profile: str, range_mm: int, reflectivity: int) -> bytes:
    bloomed = 1 << 19
    if profile == "RNG19_RFL8_SIG16_NIR16_DUAL":
        second = range_mm + 1000 if range_mm % 3 == 0 and range_mm else 0
        return struct.pack("<IIHHHxx", range_mm | reflectivity << 24, second | 7 << 24, 500, 400, 30)
    if profile == "RNG15_RFL8_NIR8":
        return struct.pack("<HBB", range_mm // 8 | 1 << 15, reflectivity, 3)
    return struct.pack("<IBxHHxx", range_mm | bloomed, reflectivity, 500, 30)


def packet(profile: str, turn: int, first: int, range_mm: Callable[[int, int], int]) -> bytes:
    columns = []
    for number in range(first, first + PER_PACKET):
        time_ns = 5_000_000_000 + turn * 100_000_000 + number * 100_000_000 // COLUMNS
        pixels = b"".join(pixel(profile, range_mm(number, beam), 10 * beam) for beam in range(BEAMS))
        columns.append(struct.pack("<QHH", time_ns, number, 1) + pixels)
    return b"\x01\x00" + bytes(30) + b"".join(columns) + bytes(32)


def range_mm(number: int, beam: int) -> int:
    return 0 if (number + beam) % 5 == 0 else 8 * (1000 + 10 * number + beam)


def frames_of(payload: bytes, *, fragment: int = 0, vlan: bool = False, port: int = 7502) -> list[bytes]:
    """Ethernet frames with a datagram, in fragments of some bytes."""
    datagram = struct.pack(">HHHH", 7502, port, len(payload) + 8, 0) + payload
    step = fragment or len(datagram)
    frames = []
    for start in range(0, len(datagram), step):
        piece = datagram[start : start + step]
        flags = (0 if start + step >= len(datagram) else 0x2000) | start // 8
        identity = zlib.crc32(payload) & 0xFFFF
        head = struct.pack(
            ">BBHHHBBH4s4s", 0x45, 0, 20 + len(piece), identity, flags, 64, 17, 0, b"\x0a" * 4, b"\x0b" * 4
        )
        tag = b"\x81\x00\x00\x05" if vlan else b""
        frames.append(bytes(12) + tag + b"\x08\x00" + head + piece)
    return frames


def pcap(frames: Sequence[bytes], *, order: str = "<", nanoseconds: bool = False) -> bytes:
    magic = 0xA1B23C4D if nanoseconds else 0xA1B2C3D4
    records = [struct.pack(order + "IIII", 5, 0, len(frame), len(frame)) + frame for frame in frames]
    return struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 1 << 18, 1) + b"".join(records)


def packets(profile: str = "RNG19_RFL8_SIG16_NIR16", turns: int = 2) -> list[bytes]:
    starts = range(0, COLUMNS, PER_PACKET)
    return [packet(profile, turn, start, range_mm) for turn in range(turns) for start in starts]


def capture(root: Path, frames: Sequence[bytes], described: dict[str, Any] | None = None, **form: Any) -> Ouster:
    (root / "a.pcap").write_bytes(pcap(frames, **form))
    (root / "a.json").write_text(json.dumps(described or metadata()))
    return Ouster(root)


def flat(payloads: Sequence[bytes], **form: Any) -> list[bytes]:
    return [frame for payload in payloads for frame in frames_of(payload, **form)]


def test_points_lie_where_the_manual_puts_them(tmp_path: Path) -> None:
    data = capture(tmp_path, flat(packets()))
    assert data.keys == (("a", "000000"), ("a", "000001"))
    cloud = data[0].clouds["lidar"]
    measured = [(number, beam) for number in range(COLUMNS) for beam in range(BEAMS) if range_mm(number, beam)]
    assert len(cloud) == len(measured)
    assert cloud.missing == COLUMNS * BEAMS - len(measured)
    described = metadata()
    for row, (number, beam) in enumerate(measured):
        encoder = 2 * np.pi * (1 - number / COLUMNS)
        azimuth = encoder - np.deg2rad(described["beam_azimuth_angles"][beam])
        altitude = np.deg2rad(described["beam_altitude_angles"][beam])
        reach = range_mm(number, beam) - ORIGIN_MM
        x = reach * np.cos(azimuth) * np.cos(altitude) + ORIGIN_MM * np.cos(encoder)
        y = reach * np.sin(azimuth) * np.cos(altitude) + ORIGIN_MM * np.sin(encoder)
        z = reach * np.sin(altitude)
        np.testing.assert_allclose(cloud.points_m[row] * 1000, [-x, -y, z + 36.18], atol=0.01)
    assert cloud.extra["ring"].tolist() == [beam for _, beam in measured]
    assert cloud.intensity is not None
    np.testing.assert_allclose(cloud.intensity, [10 * beam / 255 for _, beam in measured])
    assert cloud.extra["offset_ns"].tolist() == [number * 100_000_000 // COLUMNS for number, _ in measured]
    assert data[1].time_ns == 5_100_000_000


@pytest.mark.parametrize(
    ("frames", "form"),
    [
        (flat(packets(), fragment=160), {}),
        (flat(packets(), fragment=160)[::-1], {}),
        (flat(packets(), vlan=True), {}),
        (flat(packets()[::-1]), {}),
        (flat(packets() + packets()), {}),
        (flat(packets()) + frames_of(b"imu" * 16, port=7503) + [bytes(12) + b"\x08\x06" + bytes(28)], {}),
        (flat(packets()), {"order": ">"}),
        (flat(packets()), {"nanoseconds": True}),
    ],
    ids=["fragments", "fragments in disorder", "vlan", "disorder", "twice", "other traffic", "big-endian", "ns"],
)
def test_what_a_network_does_to_packets_changes_nothing(tmp_path: Path, frames: list[bytes], form: Any) -> None:
    (tmp_path / "plain").mkdir()
    (tmp_path / "other").mkdir()
    straight, other = capture(tmp_path / "plain", flat(packets())), capture(tmp_path / "other", frames, **form)
    assert straight.keys == other.keys
    assert other.assumptions == ()
    for one, two in zip(straight, other, strict=True):
        np.testing.assert_array_equal(one.clouds["lidar"].points_m, two.clouds["lidar"].points_m)


def test_second_returns_stand_beside_the_first(tmp_path: Path) -> None:
    profile = "RNG19_RFL8_SIG16_NIR16_DUAL"
    cloud = capture(tmp_path, flat(packets(profile)), metadata(profile))[0].clouds["lidar"]
    second = cloud.extra["return"] == 1
    first = sum(range_mm(number, beam) > 0 for number in range(COLUMNS) for beam in range(BEAMS))
    assert (~second).sum() == first
    assert second.any()
    assert set(cloud.extra["reflectivity"][second].tolist()) == {7.0}
    at = np.flatnonzero(second)[0]
    assert np.linalg.norm(cloud.points_m[at]) - np.linalg.norm(cloud.points_m[at - 1]) == pytest.approx(1.0, abs=1e-3)


def test_lost_packets_and_torn_turns_are_said(tmp_path: Path) -> None:
    payloads = packets(turns=3)
    data = capture(tmp_path, flat(payloads[3:5] + payloads[6:9]))
    assert data.keys == (("a", "000000"),)
    assert "left out" in data.assumptions[0]
    assert "16 of 64 columns" in data.assumptions[1]


def test_two_sensors_are_told_by_the_port(tmp_path: Path) -> None:
    """Equal sensors whose clocks agree: their columns would pass for one sensor's."""
    both = flat(packets(), port=7502) + flat(packets(), port=7503)
    with pytest.raises(FileFormatError, match=r"packets of one sensor.*10\.10\.10\.10 to port 7502.*7503"):
        capture(tmp_path, both)
    named = capture(tmp_path, both, metadata(udp_port_lidar=7503))
    assert len(named[0].clouds["lidar"]) == len(capture(tmp_path, flat(packets()))[0].clouds["lidar"])


def test_fragments_of_which_one_was_lost_are_not_completed_later(tmp_path: Path) -> None:
    whole, other = flat(packets(), fragment=160), flat(packets(), fragment=160)
    records = pcap(whole[1:])  # the first fragment is lost; much later its number comes again
    later = pcap(other)[24:].replace(struct.pack("<II", 5, 0), struct.pack("<II", 65, 0))
    (tmp_path / "a.pcap").write_bytes(records + later)
    (tmp_path / "a.json").write_text(json.dumps(metadata()))
    assert len(Ouster(tmp_path)) == 2


def test_many_fragments_cost_no_more_than_their_number(tmp_path: Path) -> None:
    """One byte each and none the last: what is sorted at each would take minutes."""
    head = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 21, 7, 0x2000, 64, 17, 0, b"\x0a" * 4, b"\x0b" * 4)
    frames = [
        bytes(12) + b"\x08\x00" + head[:6] + struct.pack(">H", 0x2000 | number) + head[8:] + b"a"
        for number in range(8191)
        for _ in range(4)
    ]
    start = time.process_time()
    with pytest.raises(FileFormatError, match="of this very sensor"):
        capture(tmp_path, frames)
    assert time.process_time() - start < 10


def test_fragments_that_wait_cost_no_more_than_their_bytes(tmp_path: Path) -> None:
    head = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 28, 7, 0x2000, 64, 17, 0, b"\x0a" * 4, b"\x0b" * 4)
    frames = [
        bytes(12) + b"\x08\x00" + head[:4] + struct.pack(">HH", datagram, 0x2000 | number) + head[8:] + bytes(8)
        for datagram in range(20)
        for number in range(1, 1000)
    ]
    (tmp_path / "a.pcap").write_bytes(pcap(frames))
    tracemalloc.start()
    assert not list(datagrams(tmp_path / "a.pcap"))
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak_bytes < 5 * (tmp_path / "a.pcap").stat().st_size


def test_metadata_in_groups_are_read_as_flat_ones(tmp_path: Path) -> None:
    described = metadata()
    grouped = {
        "sensor_info": {"build_rev": "v3.1.0"},
        "beam_intrinsics": {name: described[name] for name in ("beam_altitude_angles", "beam_azimuth_angles")}
        | {"beam_to_lidar_transform": [1, 0, 0, ORIGIN_MM, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]},
        "lidar_intrinsics": {"lidar_to_sensor_transform": described["lidar_to_sensor_transform"]},
        "lidar_data_format": described["data_format"],
    }
    (tmp_path / "flat").mkdir()
    (tmp_path / "grouped").mkdir()
    one = capture(tmp_path / "flat", flat(packets()))[0].clouds["lidar"]
    two = capture(tmp_path / "grouped", flat(packets()), grouped)[0].clouds["lidar"]
    np.testing.assert_array_equal(one.points_m, two.points_m)


@pytest.mark.parametrize(
    ("changed", "part"),
    [
        ({"beam_azimuth_angles": [1.0]}, "4 numbers"),
        ({"beam_altitude_angles": [1.0, 2.0]}, "an angle for each beam"),
        ({"lidar_to_sensor_transform": [2] * 16}, "a rotation"),
        ({"lidar_to_sensor_transform": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 36, 0, 0, 0, 1]}, "a mirror"),
        ({"data_format": metadata("RNG15_RFL8_WIN8")["data_format"]}, "RNG19_RFL8_SIG16_NIR16"),
        ({"data_format": metadata()["data_format"] | {"columns_per_frame": 1 << 40}}, "columns_per_frame"),
        ({"data_format": metadata()["data_format"] | {"columns_per_packet": 8}}, "of this very sensor"),
        ({"lidar_origin_to_beam_origin_mm": None}, "a number"),
    ],
)
def test_wrong_metadata_are_refused(tmp_path: Path, changed: dict[str, Any], part: str) -> None:
    with pytest.raises(FileFormatError, match=part):
        capture(tmp_path, flat(packets()), metadata() | changed)


@pytest.mark.parametrize(
    ("content", "part"),
    [
        (b"\x0a\x0d\x0d\x0a" + bytes(60), "1a2b3c4d"),
        (b"", "an empty file"),
        (bytes(100), "a .pcap"),
        (struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65536, 105), "link type 105"),
        (
            struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65536, 1) + struct.pack("<IIII", 0, 0, 1 << 30, 1 << 30),
            "at most",
        ),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "git lfs pull"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, content: bytes, part: str) -> None:
    (tmp_path / "a.pcap").write_bytes(content)
    (tmp_path / "a.json").write_text(json.dumps(metadata()))
    with pytest.raises(FileFormatError, match=part):
        Ouster(tmp_path)


def test_captures_without_metadata_say_what_is_missing(tmp_path: Path) -> None:
    (tmp_path / "a.pcap").write_bytes(pcap(flat(packets())))
    with pytest.raises(DatasetError, match="metadata beside them"):
        open_dataset(tmp_path)
    with pytest.raises(DatasetError, match=r"NAME\.json"):
        Ouster(tmp_path)


def test_the_doctor_looks_at_captures_as_at_any_data(shared_open: Path) -> None:
    data = open_dataset(shared_open / "ouster")
    findings = {finding.topic: finding for finding in examine(data).findings}
    assert "files" not in findings
    assert "10.0 Hz" in findings["times"].what
