"""Turns of a sensor in a capture: its packets found, put in order by its clock, and cut at a direction."""

from array import array
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from farfield.errors import FileFormatError
from farfield.files.captures import Datagram, Losses, address_of, datagrams
from farfield.files.firings import Firings, TurningLidar
from farfield.files.hesai import hesai_of, looks_like_hesai
from farfield.files.limits import open_file
from farfield.files.point_times import OFFSET_COLUMN
from farfield.files.velodyne import looks_like_velodyne, velodyne_of
from farfield.frame import Cloud
from farfield.vocabulary.counts import count_of

MOST_PACKETS = 32_768
"""Of a turn: a VLS-128 with dual returns sends 4,000 at five turns a second."""
_CHUNK, _MOST_STREAMS = 1024, 256
_SLOWEST_DEG_S, _FASTEST_DEG_S = 90.0, 18_000.0
LEAST_SHARE = 0.5
"""Of the packets that most turns have: a capture begins and ends within one."""
_WHOLE_SHARE = 0.95  # of the same
_BACK_DEG = 45.0  # a rotor that trembles seems to turn back, by less
_NEAR_NS, _JUMP_NS, _LATE_NS = 1_000_000_000, 1_000_000_000, 20_000_000

Key = tuple[bytes, int]
"""A stream: the address that it came from, and the port that it went to."""


@dataclass
class SensorPackets:
    """Packets of one sensor: where they stand in the file, as far as they were indexed.

    Args:
        lidar: Model and mode by its first packet.
        size: Bytes of a packet.
    """

    lidar: TurningLidar
    size: int
    times_ns: "array[int]" = field(default_factory=lambda: array("q"))
    starts: "array[int]" = field(default_factory=lambda: array("q"))
    pieces: dict[int, Int64[np.ndarray, "k 2"]] = field(default_factory=dict)
    others: int = 0

    def add(self, datagram: Datagram) -> None:
        """One packet more; of one in fragments its pieces are kept beside."""
        if len(datagram.spans) > 1:
            self.pieces[len(self.starts)] = datagram.spans
        self.times_ns.append(datagram.time_ns)
        self.starts.append(int(datagram.spans[0, 0]))

    def read(self, file: BinaryIO, rows: Iterable[int]) -> UInt8[np.ndarray, "n bytes"]:
        """The content of some packets, from the open capture."""
        contents = []
        for row in rows:
            spans = self.pieces.get(row)
            for start, length in [(self.starts[row], self.size)] if spans is None else spans.tolist():
                file.seek(start)
                contents.append(file.read(length))
        content = b"".join(contents)
        return np.frombuffer(content[: len(content) // self.size * self.size], dtype=np.uint8).reshape(-1, self.size)


@dataclass(frozen=True, eq=False)
class Traffic:
    """What a capture holds.

    Args:
        streams: Those of sensors that are read.
        refused: Of others why not, by stream.
        losses: What is missing.
        passed_over: Datagrams of neither.
    """

    streams: Mapping[Key, SensorPackets]
    refused: Mapping[Key, str]
    losses: Losses
    passed_over: int


def probe(packet: bytes) -> tuple[TurningLidar | None, str]:
    """The sensor that sent a packet; else None with the reason why it is not read, empty where it is no sensor's."""
    if looks_like_velodyne(packet):
        return velodyne_of(packet)
    return hesai_of(packet) if looks_like_hesai(packet) else (None, "")


def find_streams(path: Path, most_datagrams: int | None = None, most_records: int | None = None) -> Traffic:
    """The sensors of a capture, by address and port, with the places of their packets.

    Args:
        path: The capture.
        most_datagrams: How many are looked at; None: all.
        most_records: How many records are looked at, other traffic's too; None: all.

    Raises:
        FileFormatError: If the capture is damaged.
    """
    streams, refused, losses, passed_over = dict[Key, SensorPackets](), dict[Key, str](), Losses(), 0
    with open_file(path, max_bytes=None) as file:
        for number, datagram in enumerate(datagrams(path, losses, most_records)):
            if number == most_datagrams:
                break
            key, size = (datagram.source, datagram.port), datagram.size
            stream = streams.get(key)
            if stream is None and key not in refused and len(streams) + len(refused) < _MOST_STREAMS:
                lidar, reason = probe(datagram.content(file))
                if lidar is not None:
                    stream = streams[key] = SensorPackets(lidar, size)
                elif reason:
                    refused[key] = reason
            if stream is None:
                passed_over += key not in refused
            elif size == stream.size:
                stream.add(datagram)
            else:
                stream.others += 1
    return Traffic(streams, refused, losses, passed_over)


def stream_name(key: Key) -> str:
    """How a stream is called: ``192.168.1.201-2368``."""
    return f"{address_of(key[0]).replace(':', '_')}-{key[1]}"


@dataclass(frozen=True)
class Turn:
    """One turn of the rotor.

    Args:
        time_ns: When its first firing was.
        number: Of the turns since the rotor first passed the cut.
        first: Row of its first packet in the order of time.
        last: Row of its last.
    """

    time_ns: int
    number: int
    first: int
    last: int


@dataclass(frozen=True, eq=False)
class SensorTurns:
    """A sensor's turns.

    Args:
        path: The capture.
        stream: The sensor's packets.
        lidar: Model, mode and angles.
        order: Rows of the stream's packets in the order of the sensor's clock, shape (n,).
        stamp_ns: Of each of them, shape (n,).
        angle_deg: How far the rotor had turned at each, from the cut, shape (n,).
        turns: Those of which enough was captured.
        notes: What is missing or assumed, a sentence each.
    """

    path: Path
    stream: SensorPackets
    lidar: TurningLidar
    order: Int64[np.ndarray, " n"]
    stamp_ns: Int64[np.ndarray, " n"]
    angle_deg: Float64[np.ndarray, " n"]
    turns: tuple[Turn, ...]
    notes: tuple[str, ...]

    @classmethod
    def of(
        cls, path: Path, stream: SensorPackets, lidar: TurningLidar, cut_deg: float, least_share: float = LEAST_SHARE
    ) -> "SensorTurns":
        """Put a stream's packets in order and cut them.

        Args:
            path: The capture.
            stream: Its packets.
            lidar: The sensor, with its angles.
            cut_deg: The direction at which a turn begins, clockwise from ahead.
            least_share: Turns of a smaller share of the usual number of packets are left out.

        Raises:
            FileFormatError: If the rotor does not turn, or a turn has too many packets.
        """
        notes = []
        valid, stamps, azimuths = _indexed(path, stream, lidar)
        if stream.others or not valid.all():
            count = stream.others + int((~valid).sum())
            notes.append(f"{count} packets of another size, layout or mode of returns are not read.")
        rows = np.flatnonzero(valid)
        captured_ns = np.frombuffer(stream.times_ns, dtype=np.int64)[rows]
        stamp_ns = _continuous(stamps[rows], captured_ns, lidar.clock_ns, notes)
        order = np.argsort(stamp_ns, kind="stable")
        fresh = np.ones(len(order), dtype=bool)  # a packet that the network sent twice counts once
        fresh[1:] = (np.diff(stamp_ns[order]) > 0) | (np.diff(azimuths[rows][order]) != 0)
        order = order[fresh]
        stamp_ns, rows = stamp_ns[order], rows[order]
        angle_deg = _unwrapped(path, azimuths[rows], stamp_ns, cut_deg)
        turning = cls(path, stream, lidar, rows, stamp_ns, angle_deg, (), ())
        turns, more = turning.cut(least_share)
        return cls(path, stream, lidar, rows, stamp_ns, angle_deg, turns, (*notes, *more))

    def cut(self, least_share: float) -> tuple[tuple[Turn, ...], tuple[str, ...]]:
        """The turns of which enough was captured; sentences on others.

        Args:
            least_share: Of the usual number of packets.
        """
        numbers = _numbers(self.angle_deg)
        values, first = np.unique(numbers, return_index=True)
        last = np.append(first[1:], len(numbers))
        counts = last - first
        if counts.max(initial=0) > MOST_PACKETS:
            expected = f"at most {MOST_PACKETS} packets a turn"
            raise FileFormatError(self.path, where="the capture", expected=expected, got=f"{counts.max()}")
        usual = float(np.median(counts[counts >= LEAST_SHARE * counts.max()])) if len(counts) else 0.0
        turns, short, thin = [], 0, 0
        with open_file(self.path, max_bytes=None) as file:
            for number, begin, end in zip(values.tolist(), first.tolist(), last.tolist(), strict=True):
                if end - begin < least_share * usual:
                    short += 1
                    continue
                thin += end - begin < _WHOLE_SHARE * usual
                begin = max(begin - 1, 0)  # the packet in which the turn begins
                packets = self.stream.read(file, self.order[begin : min(begin + 2, end)].tolist())
                chosen, since_ns = self._chosen(packets, begin, number), self.lidar.firings(packets).since_stamp_ns
                stamps = np.repeat(self.stamp_ns[begin : begin + len(packets)], chosen.shape[1])
                times = (stamps + since_ns.min(axis=1))[chosen.reshape(-1)]
                if len(times):
                    turns.append(Turn(int(times[0]), number, begin, end - 1))
        notes = []
        if short:
            notes.append(f"{short} sweep{' is' if short == 1 else 's are'} left out of which too little was captured.")
        if thin:
            notes.append(f"{thin} of {len(turns)} sweeps lack more than a twentieth of their packets.")
        return tuple(turns), tuple(notes)

    def _chosen(
        self, packets: UInt8[np.ndarray, "packets bytes"], first: int, number: int
    ) -> Bool[np.ndarray, "packets firings"]:
        """Which firings of some packets belong to a turn.

        Args:
            packets: Their content.
            first: Where the first of them stands in the order of time.
            number: The turn's.
        """
        azimuth_deg = self.lidar.heads(packets).azimuth_deg
        sign = 1.0 if self.angle_deg[-1] >= self.angle_deg[0] else -1.0
        steps = (sign * np.diff(azimuth_deg, axis=1, prepend=azimuth_deg[:, :1]) + _BACK_DEG) % 360 - _BACK_DEG
        since = np.cumsum(steps, axis=1)
        return _numbers(self.angle_deg[first : first + len(since), None] + since) == number

    def cloud(self, index: int) -> Cloud:
        """The cloud of a turn: x ahead, y left, z up."""
        turn = self.turns[index]
        with open_file(self.path, max_bytes=None) as file:
            packets = self.stream.read(file, self.order[turn.first : turn.last + 1].tolist())
        chosen = self._chosen(packets, turn.first, turn.number)
        stamps = np.repeat(self.stamp_ns[turn.first : turn.first + len(packets)], chosen.shape[1])
        return _cloud(self.lidar, self.lidar.firings(packets), stamps - turn.time_ns, chosen.reshape(-1))


def _numbers(angle_deg: Float64[np.ndarray, "*shape"]) -> Int64[np.ndarray, "*shape"]:
    """Which turn an angle belongs to; sums of hundredths of a degree are off by less than a hundredth of one."""
    return np.floor((angle_deg + 1e-4) / 360).astype(np.int64)


def _indexed(
    path: Path, stream: SensorPackets, lidar: TurningLidar
) -> tuple[Bool[np.ndarray, " n"], Int64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Of each packet whether it is the sensor's, its stamp, and the direction in which it begins."""
    valid, stamps, azimuths = [], [], []
    with open_file(path, max_bytes=None) as file:
        for start in range(0, len(stream.starts), _CHUNK):
            packets = stream.read(file, range(start, min(start + _CHUNK, len(stream.starts))))
            heads = lidar.heads(packets)
            valid.append(lidar.valid(packets))
            stamps.append(heads.stamp_ns)
            azimuths.append(heads.azimuth_deg[:, 0])
    return np.concatenate(valid), np.concatenate(stamps), np.concatenate(azimuths)


def _continuous(
    stamps_ns: Int64[np.ndarray, " n"], captured_ns: Int64[np.ndarray, " n"], clock_ns: int | None, notes: list[str]
) -> Int64[np.ndarray, " n"]:
    """Stamps that count on, as nanoseconds since 1970: a clock of the hour by the capture's.

    Where the clock steps back by more than packets overtake one another, or is set by a second or more, the time that
    passed is the capture's.
    """
    if not len(stamps_ns):
        return stamps_ns
    away_ns = int(stamps_ns[0] - captured_ns[0])
    steps, passed = np.diff(stamps_ns), np.diff(captured_ns)
    if clock_ns is not None:
        steps = steps + clock_ns * np.rint((passed - steps) / clock_ns).astype(np.int64)
    jumps = (np.abs(steps - passed) > _JUMP_NS) | (steps < -_LATE_NS)
    if jumps.any():
        notes.append(f"The sensor's clock jumped {count_of(int(jumps.sum()), 'time')}; there times are the capture's.")
    since_ns = np.concatenate([[0], np.cumsum(np.where(jumps, passed, steps))])
    if clock_ns is None:
        if abs(away_ns) > _NEAR_NS:
            notes.append(
                f"The sensor's clock stands {away_ns / 1e9:+.3f} s from the capture's; times are the sensor's."
            )
        return np.asarray(stamps_ns[0] + since_ns)
    away_ns = (away_ns + clock_ns // 2) % clock_ns - clock_ns // 2
    if abs(away_ns) <= _NEAR_NS:
        return captured_ns[0] + away_ns + since_ns
    notes.append("The sensor's clock was not set by GPS: times count from the capture's first packet.")
    return captured_ns[0] + since_ns


def _unwrapped(
    path: Path, azimuth_deg: Float64[np.ndarray, " n"], stamp_ns: Int64[np.ndarray, " n"], cut_deg: float
) -> Float64[np.ndarray, " n"]:
    """How far the rotor had turned at each packet, from the cut before the first one, in degrees."""
    passed_s = np.diff(stamp_ns) * 1e-9
    steps = (np.diff(azimuth_deg) + 180) % 360 - 180
    rate = float(np.median(steps / np.maximum(passed_s, 1e-6))) if len(steps) else 0.0
    if not _SLOWEST_DEG_S <= abs(rate) <= _FASTEST_DEG_S:
        expected = f"a rotor that turns {_SLOWEST_DEG_S / 360:g} to {_FASTEST_DEG_S / 360:g} times a second"
        raise FileFormatError(path, where="the capture", expected=expected, got=f"{rate / 360:.3g} times a second")
    steps = steps + 360 * np.rint((rate * passed_s - steps) / 360)
    sign = 1.0 if rate > 0 else -1.0
    begin = (sign * (azimuth_deg[0] - cut_deg)) % 360
    return begin + np.concatenate([[0.0], np.cumsum(sign * steps)])


def _cloud(
    lidar: TurningLidar,
    firings: Firings,
    since_ns: Int64[np.ndarray, " firings"],
    chosen: Bool[np.ndarray, " firings"],
) -> Cloud:
    """Points of some firings; a return that repeats the one before it is left out."""
    steps = firings.range_steps[chosen].astype(np.int64)
    returned = steps > 0
    if steps.shape[2] > 1:
        returned[:, :, 1] &= steps[:, :, 1] != steps[:, :, 0]
    row, beam, nth = np.nonzero(returned)
    azimuth = np.deg2rad(firings.azimuth_deg[chosen][row, beam])
    elevation = np.deg2rad(lidar.elevation_deg)[beam]
    range_m = steps[row, beam, nth] * firings.step_m
    level_m = range_m * np.cos(elevation)
    points_m = np.stack(
        [level_m * np.cos(azimuth), -level_m * np.sin(azimuth), range_m * np.sin(elevation) + lidar.up_m[beam]], axis=1
    )
    reflectivity = firings.reflectivity[chosen][row, beam, nth].astype(np.float32)
    extra = {
        "ring": lidar.rings[beam].astype(np.int32),
        "return": nth.astype(np.int8),
        OFFSET_COLUMN: since_ns[chosen][row] + firings.since_stamp_ns[chosen][row, beam],
        "reflectivity": reflectivity,
    }
    return Cloud(points_m, reflectivity / 255, extra, int((~(steps > 0).any(axis=2)).sum()))
