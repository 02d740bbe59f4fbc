"""Captures of Velodyne's VLP-16 and Hesai's Pandar64 and XT32: packets in a pcap, of a sensor that stands still.

Every return has a distance of its own, by which it is found again among a reader's points.

Sources: the VLP-16 user manual (63-9243) and the Hesai SDK 2.0 (BSD-3-Clause): packet structs, angles and times.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

START = datetime(2023, 5, 17, 9, 41, 7, 250000, UTC)
START_US = (START - datetime(1970, 1, 1, tzinfo=UTC)).seconds * 1_000_000 + START.microsecond
EPOCH_US = round(START.timestamp() * 1e6)
VLP16_DEG = (-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15)
PANDAR64_DEG = tuple(
    np.round(
        np.concatenate([[14.8, 11.0, 8.0, 5.0, 3.0], np.linspace(2, -6.1, 49), np.arange(-7, -14.5, -1), [-19, -25]]), 3
    )
)
PANDAR64_TURN_DEG = tuple(np.round(np.resize([1.09, 5.52, 3.3, -3.35, -5.55, -1.13], 64), 3))


@dataclass(frozen=True)
class Return:
    """One return: what a reader must give of it."""

    ring: int
    distance_m: float
    elevation_rad: float
    azimuth_rad: float
    strength: int
    time_us: float
    number: int


@dataclass
class CaptureTruth:
    """All returns by distance in the sensor's unit, and how sure they are."""

    unit_m: float
    returns: dict[int, Return] = field(default_factory=dict)
    azimuth_deg: float = 0.02
    distance_m: float = 0.006
    time_us: float = 60.0
    turns: int = 3


class Distances:
    """Distances that nobody else has, in whole units."""

    def __init__(self, seed: int, unit_m: float) -> None:
        random = np.random.default_rng(seed)
        low, high = round(4.0 / unit_m), min(65_535, round(190 / unit_m))
        self.values = iter(random.permutation(np.arange(low, high)).tolist())

    def draw(self) -> int:
        """The next one."""
        return next(self.values)


def returns_here(azimuth_deg: float, ring: int) -> bool:
    """Where anything returns: some rings, ahead on the right and a little behind on the left."""
    turn = azimuth_deg % 360
    return (20 < turn < 80 and ring % 3 == 1) or (190 < turn < 199 and ring % 5 == 2)


def write_vlp16(path: Path, *, dual: bool = False, turns: float = 3.2) -> CaptureTruth:
    """A VLP-16 at 10 Hz; of two returns the last stands in the even blocks, the strongest in the odd ones."""
    truth, distances, packets = CaptureTruth(0.002), Distances(5, 0.002), []
    rate, number, time_us = 360 / 100_000, 0, 0.0  # degrees a microsecond
    while time_us < turns * 100_000:
        blocks = []
        for block in range(12):
            start_us = time_us + 2 * (block // 2 if dual else block) * 55.296
            azimuth = round(start_us * rate * 100) % 36_000
            rows = []
            for channel in range(32):
                sequence, ring = divmod(channel, 16)
                late_us = sequence * 55.296 + ring * 2.304
                exact = azimuth / 100 + late_us * rate
                if not returns_here(exact, ring) or (dual and block % 2 == 0 and ring % 2 == 0):
                    rows.append((0, 0))
                    continue
                value, strength = distances.draw(), (number * 7) % 256
                truth.returns[value] = Return(
                    ring,
                    value * 0.002,
                    np.radians(VLP16_DEG[ring]),
                    np.radians(exact),
                    strength,
                    EPOCH_US + start_us + late_us,
                    number,
                )
                number += 1
                rows.append((value, strength))
            blocks.append(struct.pack("<HH", 0xEEFF, azimuth) + b"".join(struct.pack("<HB", *row) for row in rows))
        stamp = (START_US + round(time_us)) % 3_600_000_000
        packets.append((time_us + 1500, b"".join(blocks) + struct.pack("<IBB", stamp, 0x39 if dual else 0x37, 0x22)))
        time_us += (12 if dual else 24) * 55.296
    truth.turns = int(turns)
    write_pcap(path, packets)
    return truth


def write_hesai(path: Path, *, model: str = "pandar64", turns: float = 3.2) -> CaptureTruth:
    """A Pandar64 or an XT32 at 10 Hz, with the Pandar64's angles beside it."""
    is_xt = model == "xt32"
    rings, blocks_each, block_us = (32, 8, 50.0) if is_xt else (64, 6, 55.56)
    elevations = tuple(range(15, -17, -1)) if is_xt else PANDAR64_DEG
    turned = (0.0,) * 32 if is_xt else PANDAR64_TURN_DEG
    truth = CaptureTruth(0.004, azimuth_deg=0.25, distance_m=0.06 if is_xt else 0.005, time_us=800.0, turns=int(turns))
    distances, packets, number, time_us, sequence = Distances(6, 0.004), [], 0, 0.0, 0
    rate = 360 / 100_000
    while time_us < turns * 100_000:
        body = b""
        for block in range(blocks_each):
            start_us = time_us + block * block_us
            azimuth = round(start_us * rate * 100) % 36_000
            rows = []
            for ring in range(rings):
                exact = azimuth / 100 + turned[ring]
                if not returns_here(exact, ring) or ring % 2:
                    rows.append((0, 0))
                    continue
                value, strength = distances.draw(), (number * 11) % 256
                truth.returns[value] = Return(
                    ring,
                    value * 0.004,
                    np.radians(elevations[ring]),
                    np.radians(exact),
                    strength,
                    EPOCH_US + start_us,
                    number,
                )
                number += 1
                rows.append((value, strength))
            body += struct.pack("<H", azimuth)
            body += b"".join(struct.pack("<HBB", *row, 0) if is_xt else struct.pack("<HB", *row) for row in rows)
        moment_us = EPOCH_US + time_us + blocks_each * block_us
        moment = datetime.fromtimestamp(int(moment_us // 1_000_000), UTC)
        date = bytes([moment.year - 2000, moment.month, moment.day, moment.hour, moment.minute, moment.second])
        if is_xt:
            date = bytes([moment.year - 1900]) + date[1:]
            head = bytes([0xEE, 0xFF, 6, 1, 0, 0, rings, blocks_each, 0, 4, 1, 1])
            tail = bytes(9) + b"\0" + bytes([0x37]) + struct.pack("<H", 600) + date
            tail += struct.pack("<IBI", int(moment_us % 1_000_000), 0x42, sequence)
        else:
            head = bytes([0xEE, 0xFF, rings, blocks_each, 0, 4, 0, 0])
            tail = (
                bytes(8) + struct.pack("<H", 600) + struct.pack("<I", int(moment_us % 1_000_000)) + bytes([0x37, 0x42])
            )
            tail += date + struct.pack("<I", sequence)
        packets.append((time_us + blocks_each * block_us + 300, head + body + tail))
        time_us += blocks_each * block_us
        sequence += 1
    write_pcap(path, packets)
    rows = [f"{ring + 1},{elevations[ring]:.3f},{turned[ring]:.3f}" for ring in range(rings)]
    path.with_suffix(".csv").write_text("\n".join(["Channel,Elevation,Azimuth", *rows]) + "\n")
    return truth


def write_pcap(path: Path, packets: Sequence[tuple[float, bytes]], port: int = 2368) -> None:
    """Packets as UDP over Ethernet."""
    path.parent.mkdir(parents=True, exist_ok=True)
    parts = [struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65_535, 1)]
    for late_us, payload in packets:
        stamp = EPOCH_US + round(late_us)
        udp = struct.pack(">HHHH", port, port, len(payload) + 8, 0) + payload
        address = bytes([192, 168, 1, 201]), bytes([255, 255, 255, 255])
        ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, len(udp) + 20, 0, 0x4000, 128, 17, 0, *address)
        data = b"\xff" * 6 + b"\x60\x76\x88\0\0\0" + b"\x08\0" + ip + udp
        parts.append(struct.pack("<IIII", stamp // 1_000_000, stamp % 1_000_000, len(data), len(data)) + data)
    path.write_bytes(b"".join(parts))
