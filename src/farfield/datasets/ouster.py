"""Ouster's captures: ``NAME.pcap`` with the sensor's metadata beside it, each a drive of sweeps.

Packets are put into the order in which they were measured; a sweep ends where the turn begins anew.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Int64

from farfield.datasets.base import Dataset, Indices
from farfield.errors import DatasetError, FileFormatError
from farfield.files.captures import Datagram, datagrams
from farfield.files.limits import open_file
from farfield.files.ouster import PROFILES, OusterSensor, is_metadata, read_sensor
from farfield.files.point_times import OFFSET_COLUMN
from farfield.files.remote_paths import as_path
from farfield.files.suffixes import pattern_in_any_case
from farfield.frame import Cloud, Frame, Lazy, Sensor

CLOUD = "lidar"
_LEAST_SHARE = 0.5  # of a turn's columns: captures begin and end within one


def captures_in(root: Path) -> dict[Path, Path]:
    """The captures of a folder, each with its metadata: of the same name, or the folder's only ones."""
    described = [path for path in sorted(root.glob(pattern_in_any_case("*.json"))) if is_metadata(path)]
    captures = sorted(root.glob(pattern_in_any_case("*.pcap")))
    of_stem = {path.stem: path for path in described}
    only = described[0] if len(described) == 1 and len(captures) == 1 else None
    pairs = {capture: of_stem.get(capture.stem, only) for capture in captures}
    return {capture: metadata for capture, metadata in pairs.items() if metadata is not None}


class Ouster(Dataset):
    """Captures of Ouster's sensors: one cloud ``"lidar"`` a frame, in the sensor's axes (x ahead, y left, z up).

    The cloud has ``ring`` (the beam, 0 on top), ``offset_ns``, ``return`` (0 the strongest, 1 the second),
    ``reflectivity``, ``near_ir`` and, where the profile sends it, ``signal``; the intensity is the reflectivity over
    255 (over 65535 before firmware 2.1, which did not calibrate it). A frame's time is that of its first column, by the
    sensor's clock, which counts from its start unless it was synchronised. Opening reads a capture once.

    Args:
        root: Folder of ``NAME.pcap`` and ``NAME.json``; the metadata of a lone capture may have any name.

    Raises:
        DatasetError: If no capture has metadata, or none holds a sweep.
        FileFormatError: If metadata or a capture are damaged, or of a profile that is not read.
    """

    name = "ouster"

    def __init__(self, root: Path | str) -> None:
        self.root = as_path(root)
        pairs = captures_in(self.root)
        if not pairs:
            raise DatasetError(f"{root}: expected NAME.pcap with the sensor's metadata beside it as NAME.json")
        self.captures = {path.stem: Capture.of(path, metadata) for path, metadata in pairs.items()}
        sizes = {name: len(capture.sweeps) for name, capture in self.captures.items()}
        self.sequences = tuple(name for name, size in sizes.items() for _ in range(size))
        self.frame_ids = tuple(f"{number:06d}" for size in sizes.values() for number in range(size))
        if not self.sequences:
            raise DatasetError(f"{root}: {' '.join(self.assumptions) or 'no capture holds a whole turn.'}")

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What is missing of each capture, and which are not read."""
        alone = [path.name for path in self.root.glob(pattern_in_any_case("*.pcap")) if path.stem not in self.captures]
        texts = [f"{name} has no metadata beside it and is not read." for name in sorted(alone)]
        return (*texts, *(f"{name}: {text}" for name, capture in self.captures.items() for text in capture.notes))

    def files(self, index: int) -> Sequence[Path]:
        """The capture and its metadata."""
        capture = self.captures[self.sequences[index]]
        return [capture.path, capture.metadata]

    def _times_of(self, indices: Indices) -> Indices | None:
        capture = self.captures[self.sequences[int(indices[0])]]
        return np.array([capture.sweeps[int(self.frame_ids[index])].time_ns for index in indices], dtype=np.int64)

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        capture = self.captures[self.sequences[index]]
        number = int(self.frame_ids[index])
        return Frame(
            sequence=self.sequences[index],
            frame_id=self.frame_ids[index],
            time_ns=capture.sweeps[number].time_ns,
            clouds=Lazy({CLOUD: partial(capture.cloud, number)}),
            sensors={CLOUD: Sensor(kind="lidar", frame_T_sensor=np.eye(4))},
            reference=CLOUD,
            metadata={"files": [str(path) for path in self.files(index)]},
        )


@dataclass(frozen=True)
class Sweep:
    """One turn: its first column's time, and the packets that hold it or a part of it."""

    time_ns: int
    last_ns: int
    packets: tuple[Datagram, ...]


@dataclass(frozen=True)
class Capture:
    """One capture, indexed.

    Args:
        path: The ``.pcap``.
        metadata: The sensor's metadata.
        sensor: What they say.
        sweeps: Its turns in the order of time.
        notes: What is missing, a sentence each.
    """

    path: Path
    metadata: Path
    sensor: OusterSensor
    sweeps: tuple[Sweep, ...]
    notes: tuple[str, ...]

    @classmethod
    def of(cls, path: Path, metadata: Path) -> "Capture":
        """Index a capture: one pass through it, of which the columns' times and numbers are kept."""
        sensor = read_sensor(metadata)
        layout = sensor.packet
        streams: dict[tuple[bytes, int], list[Datagram]] = {}
        sizes = set[int]()
        for datagram in datagrams(path):
            sizes.add(datagram.size)
            if datagram.size == layout.itemsize:
                streams.setdefault((datagram.source, datagram.port), []).append(datagram)
        packets, times, numbers = [], [], []
        with open_file(path, max_bytes=None) as file:
            for datagram in _of_one_sensor(path, streams, sensor):
                columns = sensor.valid(np.frombuffer(datagram.content(file), dtype=layout)["columns"][0])
                packets += [datagram] * len(columns)
                times.append(columns["time_ns"].astype(np.int64))
                numbers.append(columns["number"].astype(np.int64))
        if not packets:
            raise FileFormatError(
                path,
                where="the capture",
                expected=f"packets of {layout.itemsize} bytes, as {metadata.name} says",
                got=f"none; there are packets of {', '.join(map(str, sorted(sizes)[-4:])) or 'no size'} bytes",
                fix="Put the metadata of this very sensor and recording beside the capture.",
            )
        return cls(path, metadata, sensor, *_sweeps(sensor, packets, np.concatenate(times), np.concatenate(numbers)))

    def cloud(self, number: int) -> Cloud:
        """The cloud of a sweep."""
        sweep, profile = self.sweeps[number], PROFILES[self.sensor.profile]
        with open_file(self.path, max_bytes=None) as file:
            data = b"".join(packet.content(file) for packet in sweep.packets)
        columns = self.sensor.valid(np.frombuffer(data, dtype=self.sensor.packet)["columns"].reshape(-1))
        times = columns["time_ns"].astype(np.int64)
        columns = columns[(times >= sweep.time_ns) & (times <= sweep.last_ns)]
        _, first = np.unique(columns["number"], return_index=True)  # a packet that the network sent twice counts once
        columns = columns[first[np.argsort(columns["time_ns"][first], kind="stable")]]
        pixels = columns["pixels"]
        returns = [_returned(pixels, second, profile.range_mask) for second in ("", "_2")[: profile.returns]]
        column, beam, nth, steps = (np.concatenate(parts) for parts in zip(*returns, strict=True))
        order = np.lexsort((nth, beam, column))
        column, beam, nth, steps = column[order], beam[order], nth[order], steps[order]
        extra = {
            "ring": beam.astype(np.int32),
            "return": nth.astype(np.int8),
            OFFSET_COLUMN: columns["time_ns"][column].astype(np.int64) - sweep.time_ns,
            "near_ir": pixels["near_ir"][column, beam].astype(np.float32) * profile.near_ir_step,
        }
        for name in ("reflectivity", "signal"):
            if name in (profile.pixel.names or ()):
                values = pixels[name][column, beam]
                if profile.returns == 2:
                    values = np.where(nth == 1, pixels[f"{name}_2"][column, beam], values)
                extra[name] = values.astype(np.float32)
        points = self.sensor.points_m(steps * profile.range_step_m, beam, columns["number"][column].astype(np.int64))
        missing = pixels.size - int((pixels["range"] & profile.range_mask > 0).sum())
        return Cloud(points, extra["reflectivity"] / profile.reflectivity_full, extra, missing)


def _of_one_sensor(
    path: Path, streams: Mapping[tuple[bytes, int], list[Datagram]], sensor: OusterSensor
) -> list[Datagram]:
    """The packets of the sensor that the metadata are of: those to its port, where several send packets of that size.

    Raises:
        FileFormatError: If several do still: their columns would be taken for those of one.
    """
    own = {key: packets for key, packets in streams.items() if len(streams) == 1 or key[1] == sensor.port}
    if len(own) > 1 or (streams and not own):
        shown = ", ".join(f"{'.'.join(map(str, source))} to port {port}" for source, port in sorted(streams)[:6])
        raise FileFormatError(
            path,
            where="the capture",
            expected="packets of one sensor",
            got=f"those of {len(streams)}: {shown}",
            fix="Cut it by sensor: tcpdump -r IN -w OUT src host ADDRESS and port PORT.",
        )
    return next(iter(own.values()), [])


def _returned(
    pixels: np.ndarray, second: str, mask: int
) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"], Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """Column, beam, number of the return and range in steps of the pixels in which something returned."""
    steps = (pixels[f"range{second}"] & mask).astype(np.int64)
    column, beam = np.nonzero(steps)
    return column, beam, np.full(len(column), 1 if second else 0), steps[column, beam]


def _sweeps(
    sensor: OusterSensor,
    packets: Sequence[Datagram],
    times_ns: Int64[np.ndarray, " n"],
    numbers: Int64[np.ndarray, " n"],
) -> tuple[tuple[Sweep, ...], tuple[str, ...]]:
    """Cut columns into turns; sentences on what is left out or was lost.

    Args:
        sensor: The sensor.
        packets: The packet of each column.
        times_ns: When each was measured.
        numbers: Which of its turn each is.
    """
    order = np.argsort(times_ns, kind="stable")
    times_ns, numbers = times_ns[order], numbers[order]
    begun = (numbers - sensor.window[0]) % sensor.columns  # counted from the window's first column
    turn = np.concatenate([[0], np.cumsum((np.diff(begun) < 0) | _pauses(sensor, times_ns, begun))])
    sweeps, short, lost = [], 0, 0
    for rows in np.split(np.arange(len(turn)), np.flatnonzero(np.diff(turn)) + 1):
        columns = len(np.unique(numbers[rows]))
        if columns < _LEAST_SHARE * sensor.expected_columns:
            short += 1
            continue
        lost += sensor.expected_columns - columns
        own = {int(packet.spans[0, 0]): packet for packet in (packets[row] for row in order[rows].tolist())}
        sweeps.append(Sweep(int(times_ns[rows[0]]), int(times_ns[rows[-1]]), tuple(own.values())))
    notes = []
    if short:
        notes.append(f"{short} sweep{' is' if short == 1 else 's are'} left out of which less than half was captured.")
    if lost:
        notes.append(f"{lost} of {len(sweeps) * sensor.expected_columns} columns of the sweeps were lost.")
    return tuple(sweeps), tuple(notes)


def _pauses(
    sensor: OusterSensor, times_ns: Int64[np.ndarray, " n"], begun: Int64[np.ndarray, " n"]
) -> Bool[np.ndarray, " m"]:
    """Where more than a turn lies between a column and the next: packets were lost, and the turn is another."""
    steps, passed = np.diff(begun), np.diff(times_ns)
    forward = steps > 0
    column_ns = float(np.median(passed[forward] / steps[forward])) if forward.any() else np.inf
    return passed > sensor.columns * column_ns
