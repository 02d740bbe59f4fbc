"""Captures of Velodyne and Hesai: packets made after the manuals, and what networks and clocks do to them."""

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from support.packets import START_NS, pandar40p_packet, pcap, pcapng, udp4, velodyne_packet, xt32_packet

from farfield.datasets import open_dataset, turns
from farfield.datasets.captures import Captures
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.velodyne import MODELS

NOON_NS = 1_709_294_400_000_000_000  # 1 March 2024
STEP = 20  # hundredths of a degree from firing to firing


def shot(azimuth: int, laser: int, number: int) -> tuple[int, int]:
    """No return of every fifth, a second one behind the first of every third laser."""
    del azimuth
    return (
        0 if laser % 5 == 4 else 5000 + 10 * laser + (300 if number and laser % 3 == 0 else 0)
    ), 10 * number + laser % 8


def velodyne(model: int, mode: int, *, turns: float = 2.6, start_us: int = 0, begin: int = 9_000) -> list[bytes]:
    """Packets of some turns; a direction a firing, or two firings."""
    lasers = len(MODELS[model].elevation_deg)
    returns = 2 if mode == 0x39 else 1
    rows = {16: 12, 32: 12, 128: 4 if returns == 2 else 3}[lasers] // (returns if lasers != 128 or returns == 1 else 4)
    firings = 2 if lasers == 16 else 1
    cycle_us = {0x21: 46.08, 0xA1: 53.3}.get(model, 55.296)
    packets, count = [], int(turns * 36000 / (STEP * firings * rows))
    for number in range(count):
        directions = [(begin + STEP * firings * (rows * number + row)) % 36000 for row in range(rows)]
        stamp_us = round(start_us + number * rows * firings * cycle_us)
        packets.append(velodyne_packet(model, mode, stamp_us, directions, shot, lasers=lasers))
    return packets


def capture(folder: Path, packets: Sequence[bytes], *, step_ns: int = 600_000, first_ns: int = START_NS) -> Captures:
    times_ns = [first_ns + step_ns * number for number in range(len(packets))]
    (folder / "a.pcap").write_bytes(pcap([udp4(packet) for packet in packets], times_ns))
    return Captures(folder)


@pytest.mark.parametrize("model", [0x21, 0x22, 0x24, 0x28, 0xA1])
@pytest.mark.parametrize("mode", [0x37, 0x39])
def test_points_lie_where_the_manual_puts_them(tmp_path: Path, model: int, mode: int) -> None:
    data = capture(tmp_path, velodyne(model, mode, turns=1.4))
    known = MODELS[model]
    assert len(data) == 1
    frame = data[0]
    cloud = frame.clouds["lidar"]
    assert frame.metadata["model"] == known.name
    assert frame.metadata["returns"] == (["strongest"] if mode == 0x37 else ["last", "strongest"])
    elevation = np.deg2rad(known.elevation_deg)
    order = np.argsort(-elevation, kind="stable")
    laser = order[cloud.extra["ring"]]
    assert set(laser.tolist()) == {number for number in range(known.lasers) if number % 5 != 4}
    for row in np.linspace(0, len(cloud) - 1, 40).astype(int):
        number, nth = int(laser[row]), int(cloud.extra["return"][row])
        range_m = shot(0, number, nth)[0] * known.step_m
        focus_m = {"HDL-32E": 0.02883, "VLP-32C": 0.0424, "VLS-128": 0.05863}.get(known.name, 0.04191)
        up_m = range_m * np.sin(elevation[number]) - focus_m * np.tan(elevation[number])
        x_m, y_m, z_m = cloud.points_m[row].astype(float)
        assert z_m == pytest.approx(up_m, abs=1e-4)
        assert np.hypot(x_m, y_m) == pytest.approx(range_m * np.cos(elevation[number]), abs=1e-4)
        begun_us = float(cloud.extra["offset_ns"][row]) / 1000
        turned_deg = 180 + begun_us * STEP / 100 / (known.cycle_ns / 1000)  # sweeps begin behind, and turn clockwise
        azimuth_deg = np.rad2deg(np.arctan2(-y_m, x_m)) - (known.ahead_deg or (0.0,) * known.lasers)[number]
        assert (azimuth_deg - turned_deg + 180) % 360 - 180 == pytest.approx(0, abs=0.25 * STEP / 100 + 0.1)
    second = cloud.extra["return"] == 1
    assert second.any() == (mode == 0x39)


def test_shots_of_a_firing_have_their_own_times_and_directions(tmp_path: Path) -> None:
    cloud = capture(tmp_path, velodyne(0x28, 0x37))[0].clouds["lidar"]
    known = MODELS[0x28]
    laser = np.argsort(-np.array(known.elevation_deg), kind="stable")[cloud.extra["ring"]]
    first = np.flatnonzero(cloud.extra["offset_ns"] < 50_000)
    assert cloud.extra["offset_ns"][first].tolist() == [laser[row] // 2 * 2304 for row in first]
    azimuth = np.rad2deg(np.arctan2(-cloud.points_m[first, 1], cloud.points_m[first, 0])) % 360
    turned = azimuth - np.array(known.ahead_deg)[laser[first]] - 180
    np.testing.assert_allclose(turned, 0.2 * (laser[first] // 2) * 2.304 / 55.296, atol=2e-3)


def test_the_second_firing_of_a_block_of_16_lasers_lies_half_way(tmp_path: Path) -> None:
    cloud = capture(tmp_path, velodyne(0x22, 0x37))[0].clouds["lidar"]
    firing = np.rint(cloud.extra["offset_ns"] / 55_296)  # stamps are whole microseconds
    lowest = cloud.extra["ring"] == 15  # the first laser
    azimuth = np.unwrap(np.arctan2(-cloud.points_m[lowest, 1], cloud.points_m[lowest, 0]))
    np.testing.assert_allclose(np.rad2deg(np.diff(azimuth[:100])), STEP / 100, atol=2e-3)
    assert firing[lowest][:100].tolist() == list(range(100))


def test_a_sector_that_packets_span_is_not_smeared(tmp_path: Path) -> None:
    """A sensor that was told to see but a half waits with its packet until it comes there again."""
    directions = [(9_000 + STEP * number) % 36000 for number in range(1800 * 4)]
    seen = [(number, azimuth) for number, azimuth in enumerate(directions) if not 10_000 <= azimuth < 28_000]
    packets = []
    for start in range(0, len(seen) - 12, 12):
        rows = seen[start : start + 12]
        packets.append(velodyne_packet(0x28, 0x37, round(rows[0][0] * 55.296), [azimuth for _, azimuth in rows], shot))
    data = capture(tmp_path, packets)
    cloud = data[1].clouds["lidar"]
    assert len(cloud) == 900 * 26
    azimuth = np.rad2deg(np.arctan2(-cloud.points_m[:, 1], cloud.points_m[:, 0]))
    assert (np.abs(azimuth) < 100 + 4.3).all()
    offset_ns = cloud.extra["offset_ns"] - cloud.extra["offset_ns"].min()
    lowest = cloud.extra["ring"] == 31  # the first laser
    turned = np.unwrap(np.deg2rad(azimuth[lowest]))
    expected_ns = np.rad2deg(turned - turned[0]) / 0.2 * 55_296
    np.testing.assert_allclose(offset_ns[lowest], expected_ns, atol=30_000)


def test_sweeps_are_cut_where_it_is_said(tmp_path: Path) -> None:
    capture(tmp_path, velodyne(0x22, 0x37))
    for cut_deg in (0.0, 90.0, 180.0, -90.0):
        cloud = Captures(tmp_path, cut_deg=cut_deg)[1].clouds["lidar"]
        start = np.rad2deg(np.arctan2(cloud.points_m[0, 1], cloud.points_m[0, 0]))
        assert (start - cut_deg + 180) % 360 - 180 == pytest.approx(0, abs=0.4)
        assert len(cloud) == 1800 * 13
        assert cloud.missing == 1800 * 3
    with pytest.raises(ConfigError, match="cut_deg"):
        Captures(tmp_path, cut_deg=1000.0)


def test_clocks_of_the_hour_are_told_by_the_captures(tmp_path: Path) -> None:
    """Within a second of the capture's it is UTC, over the full hour too; else times are the capture's."""
    end_of_hour_ns = START_NS // 3_600_000_000_000 * 3_600_000_000_000 + 3_599_900_000_000
    start_us = end_of_hour_ns // 1000 % 3_600_000_000
    packets = velodyne(0x22, 0x37, turns=4, start_us=start_us)
    told = capture(tmp_path, packets, first_ns=end_of_hour_ns + 2_000_000, step_ns=1_327_104)
    assert not any("GPS" in note for note in told.assumptions)
    np.testing.assert_allclose(np.diff(told.drives()[0].times_ns), 1800 * 55_296, atol=60_000)
    assert abs(told[0].time_ns - end_of_hour_ns) < 100_000_000
    free = capture(tmp_path, velodyne(0x22, 0x37, turns=4), step_ns=1_327_104)
    assert any("GPS" in note for note in free.assumptions)
    assert abs(free[0].time_ns - START_NS) < 100_000_000


def test_networks_change_nothing(tmp_path: Path) -> None:
    packets = velodyne(0x28, 0x39)
    plain = capture(tmp_path, packets)[1].clouds["lidar"]
    swapped = [packet for pair in zip(packets[1::2], packets[::2], strict=False) for packet in pair]
    other = capture(tmp_path, [*swapped, *packets[2 * (len(packets) // 2) :], *packets[:9]], step_ns=1000)[1]
    np.testing.assert_array_equal(plain.points_m, other.clouds["lidar"].points_m)
    (tmp_path / "a.pcap").write_bytes(pcapng([udp4(packet) for packet in packets], [START_NS] * len(packets)))
    again = Captures(tmp_path)
    np.testing.assert_array_equal(plain.points_m, again[1].clouds["lidar"].points_m)


def test_lost_packets_and_torn_turns_are_said(tmp_path: Path) -> None:
    packets = velodyne(0x28, 0x37, turns=4.4)
    data = capture(tmp_path, packets[:200] + packets[260:] + [packets[0][:-2] + b"\x38\x28"])
    assert len(data) == 4
    text = " ".join(data.assumptions)
    assert "lack more than a twentieth" in text
    assert "1 packets of another size, layout or mode" in text


def test_several_sensors_are_named_and_chosen(tmp_path: Path) -> None:
    one, two = velodyne(0x22, 0x37), velodyne(0x28, 0x37)
    frames = [udp4(packet) for packet in one] + [udp4(packet, source=b"\x0a\0\0\x05", port=2369) for packet in two]
    (tmp_path / "a.pcap").write_bytes(pcap([*frames, udp4(bytes(512), port=8308)]))
    both = Captures(tmp_path)
    assert set(both.sequences) == {"a-192.168.1.201-2368", "a-10.0.0.5-2369"}
    chosen = Captures(tmp_path, sensor="10.0.0.5-2369")
    assert {frame.metadata["model"] for frame in chosen} == {"VLP-32C"}
    assert any("192.168.1.201-2368 is a VLP-16" in note for note in chosen.assumptions)
    with pytest.raises(DatasetError, match=r"192\.168\.1\.201-2368 is a VLP-16"):
        Captures(tmp_path, sensor="1.2.3.4-5")


HDL64 = b"".join(struct.pack("<HH", 0xEEFF - 0x1100 * (number % 2), 0) + bytes(96) for number in range(12)) + bytes(6)
AT128 = b"\xee\xff\x04\x03\0\0" + bytes([128, 2, 1, 4, 2, 0]) + bytes(1100)


@pytest.mark.parametrize(
    ("packet", "part"),
    [
        (HDL64, "HDL-64E, whose angles"),
        (AT128, "AT128"),
        (velodyne(0x22, 0x37)[0][:-1] + b"\x31", "Velarray"),
        (velodyne(0x22, 0x37)[0][:-1] + b"\x99", "unknown model 0x99"),
        (velodyne(0x22, 0x37)[0][:-2] + b"\x3b\x22", "unknown mode of returns 0x3b"),
        (velodyne(0xA1, 0x37)[0][:-1] + b"\x22", "blocks in another order"),
        (xt32_packet([0, 18, 36, 54], shot, mode=0x39, second=0, time_us=0)[:-2], "packets of 1078 bytes"),
        (xt32_packet([0, 18, 36, 54], shot, mode=0x39, second=0, time_us=0, step_mm=99), "steps of 99 mm"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_other_sensors_are_refused_by_name(tmp_path: Path, packet: bytes, part: str) -> None:
    (tmp_path / "a.pcap").write_bytes(pcap([udp4(packet)] * 4))
    with pytest.raises(DatasetError, match=part):
        open_dataset(tmp_path)


def hesai(count: int = 560, *, mode: int = 0x3B) -> list[bytes]:
    rows = 4 if mode == 0x3B else 8
    packets = []
    for number in range(count):
        directions = [(9_000 + 18 * (rows * number + row)) % 36000 for row in range(rows)]
        time_us = rows * number * 50
        packets.append(xt32_packet(directions, shot, mode=mode, second=time_us // 10**6, time_us=time_us % 10**6))
    return packets


ANGLES = "Channel,Elevation,Azimuth\n" + "".join(
    f"{beam + 1},{15 - beam},{0.5 if beam % 2 else -0.25}\n" for beam in range(32)
)


def test_a_hesais_points_lie_by_its_angles(tmp_path: Path) -> None:
    (tmp_path / "angles.csv").write_text(ANGLES)
    data = capture(tmp_path, hesai(1200))
    frame = data[1]
    cloud = frame.clouds["lidar"]
    assert (frame.metadata["model"], frame.metadata["returns"]) == ("PandarXT-32", ["last", "first"])
    assert abs(frame.time_ns - NOON_NS) < 400_000_000
    assert any("from the capture's" in note for note in data.assumptions)
    beam, nth = cloud.extra["ring"], cloud.extra["return"]
    range_m = np.array([shot(0, int(number), int(second))[0] for number, second in zip(beam, nth, strict=True)]) * 0.004
    np.testing.assert_allclose(np.linalg.norm(cloud.points_m, axis=1), range_m, atol=1e-4)
    np.testing.assert_allclose(np.rad2deg(np.arcsin(cloud.points_m[:, 2] / range_m)), 15 - beam, atol=1e-3)
    row_ns = cloud.extra["offset_ns"] - 1512 * beam.astype(np.int64)
    assert (row_ns % 50_000 == 0).all()
    azimuth = np.rad2deg(np.arctan2(-cloud.points_m[:, 1], cloud.points_m[:, 0])) - np.where(beam % 2, 0.5, -0.25)
    np.testing.assert_allclose((azimuth - row_ns / 50_000 * 0.18) % 360, 180, atol=2e-2)


def test_a_pandar40p_is_told_by_its_marks(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("".join(f"{beam + 1},{7 - beam / 2},0\n" for beam in range(40)))
    packets = [
        pandar40p_packet(
            [(20 * (10 * number + row)) % 36000 for row in range(10)], shot, second=0, time_us=number * 556
        )
        for number in range(500)
    ]
    data = capture(tmp_path, packets)
    cloud = data[0].clouds["lidar"]
    assert data[0].metadata["model"] == "Pandar40P"
    assert abs(data[0].time_ns - NOON_NS) < 400_000_000
    np.testing.assert_allclose(
        np.rad2deg(np.arcsin(cloud.points_m[:, 2] / np.linalg.norm(cloud.points_m, axis=1))),
        7 - cloud.extra["ring"] / 2,
        atol=1e-3,
    )


@pytest.mark.parametrize(
    ("angles", "part"),
    [
        (None, r"PandarXT-32's beams beside it as a\.csv, found no CSV"),
        (ANGLES.replace("\n7,", "\n6,"), "beam 6 again"),
        (ANGLES.replace("\n7,9,", "\n7,nan,"), "line 8"),
        (ANGLES.replace("\n7,9,", "\n7,98,"), "line 8"),
        (ANGLES + "33,0,0\n", "line 34"),
        (ANGLES.replace("\n7,9,", "\nx,8,"), "none of beam 7"),
        ("\udcff", "no text"),
    ],
)
def test_a_hesai_without_its_angles_is_refused(tmp_path: Path, angles: str | None, part: str) -> None:
    if angles is not None:
        (tmp_path / "a.csv").write_bytes(angles.encode(errors="surrogateescape"))
    with pytest.raises((DatasetError, FileFormatError), match=part):
        capture(tmp_path, hesai(60))


def test_two_hesais_of_one_capture_need_angles_of_their_own(tmp_path: Path) -> None:
    frames = [udp4(packet, port=port) for port in (2368, 2369) for packet in hesai()]
    (tmp_path / "a.pcap").write_bytes(pcap(frames))
    (tmp_path / "a.csv").write_text(ANGLES)
    with pytest.raises(DatasetError, match=r"a-192\.168\.1\.201-2368\.csv"):
        Captures(tmp_path)
    for port in (2368, 2369):
        (tmp_path / f"a-192.168.1.201-{port}.csv").write_text(ANGLES)
    assert len(Captures(tmp_path).drives()) == 2


def test_a_rotor_that_stands_is_refused(tmp_path: Path) -> None:
    packets = [velodyne_packet(0x28, 0x37, 664 * number, [0] * 12, shot) for number in range(50)]
    with pytest.raises(FileFormatError, match="a rotor that turns"):
        capture(tmp_path, packets)


def test_a_capture_that_grows_keeps_what_was_indexed(tmp_path: Path) -> None:
    packets = velodyne(0x28, 0x37, turns=5)
    frames = [udp4(packet) for packet in packets]
    whole = pcap(frames)
    (tmp_path / "a.pcap").write_bytes(whole[: len(whole) * 3 // 5 + 100])
    data = open_dataset(tmp_path)
    assert data.name == "captures"
    assert any("still written" in note for note in data.assumptions)
    before = data[0].clouds["lidar"].points_m
    with (tmp_path / "a.pcap").open("ab") as file:
        file.write(whole[len(whole) * 3 // 5 + 100 :])
    np.testing.assert_array_equal(before, data[0].clouds["lidar"].points_m)
    assert len(open_dataset(tmp_path)) > len(data)


def test_damage_is_an_error_of_its_own_or_changes_points_alone(tmp_path: Path) -> None:
    whole = bytearray(pcap([udp4(packet) for packet in velodyne(0x28, 0x37, turns=1.6)]))
    rng = np.random.default_rng(1)
    for _ in range(40):
        content = bytearray(whole)
        for at in rng.integers(0, len(content), 3):
            content[at] = rng.integers(256)
        (tmp_path / "a.pcap").write_bytes(content[: rng.integers(1, len(content) + 1)])
        try:
            clouds = [frame.clouds["lidar"] for frame in Captures(tmp_path)]
        except (FileFormatError, DatasetError):
            continue
        assert all(np.isfinite(cloud.points_m).all() for cloud in clouds)


@pytest.mark.parametrize("clock_ns", [None, 3_600_000_000_000])
@pytest.mark.parametrize("step_s", [-0.7, -1.03, 50.0])
def test_a_clock_that_is_set_meanwhile_does_not_mix_turns(step_s: float, clock_ns: int | None) -> None:
    """Sorted by such stamps, packets of two turns would lie between one another."""
    captured_ns = 1_700_000_000_000_000_000 + np.arange(2000) * 1_300_000
    stamps_ns = captured_ns + np.where(np.arange(2000) >= 1000, int(step_s * 1e9), 0)
    stamps_ns[500:502] = stamps_ns[[501, 500]]  # one packet overtook another
    notes: list[str] = []
    continued_ns = turns._continuous(stamps_ns, captured_ns, clock_ns, notes)
    np.testing.assert_array_equal(np.delete(continued_ns, [500, 501]), np.delete(captured_ns, [500, 501]))
    assert list(np.argsort(continued_ns)[500:502]) == [501, 500]
    assert "The sensor's clock jumped 1 time" in notes[0]
