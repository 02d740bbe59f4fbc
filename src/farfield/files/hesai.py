"""What a Hesai sends: packets of a header, some blocks of one direction with a shot a beam, and a tail.

Written from the packet structures of the makers' manuals as github.com/tier4/nebula (Apache-2.0) states them
(``nebula_hesai_decoders/decoders/pandar_*.hpp``); read are those models of which its test packets could be compared
with the clouds that it made of them. The beams' angles stand in the unit's correction file, a CSV.
"""

import calendar
import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes
from farfield.files.firings import Firings, Heads, TurningLidar
from farfield.vocabulary import hesai as tables

SINGLE_MODES: Mapping[int, tuple[str, ...]] = {
    0x33: ("first",),
    0x34: ("second",),
    0x37: ("strongest",),
    0x38: ("last",),
}
DUAL_MODES: Mapping[int, tuple[str, ...]] = {
    0x39: ("last", "strongest"),
    0x3A: ("first", "second"),
    0x3B: ("first", "last"),
    0x3C: ("first", "strongest"),
    0x3E: ("strongest", "second strongest"),
}
MODES: Mapping[int, tuple[str, ...]] = {**SINGLE_MODES, **DUAL_MODES}
_MARK, _BLOCK_MARK = b"\xee\xff", b"\xff\xee"
_BEAMS, _MOST_BLOCKS, _LEAST_BYTES = (16, 20, 32, 40, 64, 80, 90, 120, 128), 15, 300  # of any model
_HEADER_BYTES = 10  # of those before the blocks that are always the same
_FIRST_YEAR = 70  # a date's year counts from 1900 or, in older firmware, from 2000
_TURN = 36_000  # hundredths of a degree
_MOST_ANGLES_BYTES = 1 << 20
_CYBER_BYTES = 32  # a signature, which newer firmware appends


@dataclass(frozen=True, eq=False, kw_only=True)
class HesaiModel:
    """What the manual says of a model.

    Args:
        name: Its name.
        head_bytes: Before the blocks.
        beams: Of each block.
        blocks: Of a packet.
        shot_bytes: Range, reflectivity and, where it is 4, a byte of confidence.
        block_mark: Whether a mark stands before each block's direction.
        gap_bytes: Between the blocks and the tail.
        tail: Where the tail's fields begin: ``mode``, ``date``, ``time_us``.
        tail_bytes: How long the tail is, without what may be appended.
        appended_bytes: How much may be appended: a packet's number, a signature.
        block_ns: From one direction to the next.
        first_ns: When the last direction's firing begins (``counts_back``) or the first's, from the packet's stamp.
        counts_back: Whether blocks are timed back from the last one.
        beam_ns: When each beam is fired, from its block's begin, shape (loops, beams); loops take turns.
        step_m: Metres of a step of the range; None: the header says it in millimetres.
        reversed_modes: Modes in which the two returns stand the other way round.
        dual_only: Whether it is certain but with two returns when its blocks are fired.
    """

    name: str
    head_bytes: int
    beams: int
    blocks: int
    shot_bytes: int
    block_mark: bool = False
    gap_bytes: int = 0
    tail: Mapping[str, int]
    tail_bytes: int
    appended_bytes: tuple[int, ...] = (0, 4)
    block_ns: float
    first_ns: float
    counts_back: bool = True
    beam_ns: Int64[np.ndarray, "loops beams"]
    step_m: float | None = None
    reversed_modes: tuple[int, ...] = ()
    dual_only: bool = False

    @cached_property
    def packet(self) -> np.dtype[Any]:
        """A packet's layout: ``blocks`` with ``azimuth`` and ``shots``, and the tail's fields."""
        shot = np.dtype(
            {
                "names": ["range", "reflectivity"],
                "formats": ["<u2", "u1"],
                "offsets": [0, 2],
                "itemsize": self.shot_bytes,
            }
        )
        mark = 2 if self.block_mark else 0
        block = np.dtype(
            {
                "names": ["mark", "azimuth", "shots"],
                "formats": ["V2" if mark else "V0", "<u2", (shot, (self.beams,))],
                "offsets": [0, mark, mark + 2],
                "itemsize": mark + 2 + self.beams * self.shot_bytes,
            }
        )
        tail = self.head_bytes + self.blocks * block.itemsize + self.gap_bytes
        names = ["blocks", *self.tail]
        kinds: dict[str, Any] = {"mode": "u1", "date": ("u1", (6,)), "time_us": "<u4", "loop": "u1"}
        formats: list[Any] = [(block, (self.blocks,)), *(kinds[name] for name in self.tail)]
        offsets = [self.head_bytes, *(tail + offset for offset in self.tail.values())]
        size = tail + self.tail_bytes
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})


_TAIL_40P = {"time_us": 10, "mode": 14, "date": 16}
_TAIL_QT64 = {"time_us": 12, "mode": 16, "date": 18}
_TAIL_XT = {"mode": 10, "date": 13, "time_us": 19}
_TAIL_QT128 = {"loop": 5, "mode": 12, "date": 15, "time_us": 21}

PANDAR_40P = HesaiModel(
    name="Pandar40P",
    head_bytes=0,
    beams=40,
    blocks=10,
    shot_bytes=3,
    block_mark=True,
    tail=_TAIL_40P,
    tail_bytes=22,
    block_ns=55_560.0,
    first_ns=-28_580.0,
    beam_ns=np.array([tables.PANDAR_40P_NS]),
    step_m=0.004,
)
MODELS: Mapping[tuple[int, ...], HesaiModel] = {
    (64, 6): HesaiModel(
        name="Pandar64",
        head_bytes=8,
        beams=64,
        blocks=6,
        shot_bytes=3,
        tail=_TAIL_40P,
        tail_bytes=22,
        block_ns=55_560.0,
        first_ns=-42_580.0,
        beam_ns=np.array([tables.PANDAR_64_NS]),
        step_m=0.004,
    ),
    (3, 1, 64, 4): HesaiModel(
        name="PandarQT64",
        head_bytes=12,
        beams=64,
        blocks=4,
        shot_bytes=4,
        tail=_TAIL_QT64,
        tail_bytes=24,
        block_ns=500_000 / 3,
        first_ns=25_710.0,
        counts_back=False,
        beam_ns=np.array([tables.PANDAR_QT64_NS]),
    ),
    (3, 2, 128, 2): HesaiModel(
        name="QT128",
        head_bytes=12,
        beams=128,
        blocks=2,
        shot_bytes=4,
        gap_bytes=4 + 17,
        tail=_TAIL_QT128,
        tail_bytes=34,
        appended_bytes=(0, _CYBER_BYTES),
        block_ns=0.0,
        dual_only=True,
        first_ns=9_000.0,
        beam_ns=np.array([tables.QT128_SECOND_LOOP_NS, tables.QT128_FIRST_LOOP_NS]),
    ),
    (6, 1, 16, 8): HesaiModel(
        name="PandarXT-16",
        head_bytes=12,
        beams=16,
        blocks=8,
        shot_bytes=4,
        tail=_TAIL_XT,
        tail_bytes=24,
        block_ns=50_000.0,
        first_ns=5_632.0,
        beam_ns=np.array([[368 + 3_024 * beam for beam in range(16)]]),
        reversed_modes=(0x3B,),
    ),
    (6, 1, 32, 8): HesaiModel(
        name="PandarXT-32",
        head_bytes=12,
        beams=32,
        blocks=8,
        shot_bytes=4,
        tail=_TAIL_XT,
        tail_bytes=24,
        block_ns=50_000.0,
        first_ns=5_632.0,
        beam_ns=np.array([[368 + 1_512 * beam for beam in range(32)]]),
        reversed_modes=(0x3B,),
    ),
    (6, 1, 32, 6): HesaiModel(
        name="PandarXT-32M",
        head_bytes=12,
        beams=32,
        blocks=6,
        shot_bytes=4,
        tail=_TAIL_XT,
        tail_bytes=24,
        block_ns=50_000.0,
        first_ns=5_632.0,
        beam_ns=np.array([[368 + 2_888 * (beam % 16) for beam in range(32)]]),
    ),
}
"""Models by what their header says: version (where it has one), beams and blocks; those whose layout is certain."""

_NOT_READ: Mapping[tuple[int, int], str] = {
    (1, 128): "Pandar128 or OT128",
    (4, 128): "AT128, whose angles stand in a correction file of another kind",
}


def looks_like_hesai(packet: bytes) -> bool:
    """Whether a datagram may be a Hesai's: with a header that fits its length, or the Pandar40P's marks."""
    if packet[:2] != _MARK or len(packet) < _LEAST_BYTES:
        return _is_40p(packet)
    return any(
        beams in _BEAMS and 1 <= blocks <= _MOST_BLOCKS and _LEAST_BYTES <= 3 * beams * blocks < len(packet)
        for beams, blocks in (packet[2:4], packet[6:8])
    )


def _is_40p(packet: bytes) -> bool:
    sizes = [PANDAR_40P.packet.itemsize + more for more in PANDAR_40P.appended_bytes]
    return len(packet) in sizes and all(packet[start : start + 2] == _BLOCK_MARK for start in range(0, 1240, 124))


def hesai_of(packet: bytes) -> "tuple[Hesai | None, str]":
    """The model and mode of a packet, still without angles; None where it is not read, with the reason.

    Args:
        packet: One that :func:`looks_like_hesai`.
    """
    version = (packet[2], packet[3])
    lasers = (packet[6], packet[7])
    model = PANDAR_40P if _is_40p(packet) else MODELS.get(version) or MODELS.get((*version, *lasers))
    if model is None:
        unknown = f"of an unknown kind (version {version[0]}.{version[1]}, {lasers[0]} beams, {lasers[1]} blocks)"
        return None, f"a Hesai {_NOT_READ.get((version[0], lasers[0]), unknown)}"
    if len(packet) not in [model.packet.itemsize + more for more in model.appended_bytes]:
        return None, f"a Hesai {model.name} with packets of {len(packet)} bytes"
    mode = int(np.frombuffer(packet[: model.packet.itemsize], dtype=model.packet)["mode"][0])
    if mode not in (DUAL_MODES if model.dual_only else MODES):
        return None, f"a Hesai {model.name} in the mode of returns 0x{mode:02x}"
    step_m = model.step_m or packet[9] / 1000
    if not 0.001 <= step_m <= 0.02:
        return None, f"a Hesai {model.name} with ranges in steps of {step_m * 1000:g} mm"
    return Hesai(packet[: min(model.head_bytes, _HEADER_BYTES)], model, mode, step_m), ""


class Hesai(TurningLidar):
    """A model in a mode of returns; its beams' angles are those of its unit.

    Args:
        header: How its packets begin.
        model: One of :data:`MODELS`.
        mode: The byte of the packet that says which returns it holds.
        step_m: Metres of a step of the range.
        angles_deg: Elevation of each beam and its direction from the block's, shape (beams, 2); 0 until it is known.
    """

    def __init__(
        self,
        header: bytes,
        model: HesaiModel,
        mode: int,
        step_m: float,
        angles_deg: Float64[np.ndarray, "beams 2"] | None = None,
    ) -> None:
        self.header, self.model, self.mode, self.name, self.step_m = header, model, mode, model.name, step_m
        names = MODES[mode]
        self.returns = names[::-1] if mode in model.reversed_modes else names
        angles_deg = np.zeros((model.beams, 2)) if angles_deg is None else angles_deg
        self.elevation_deg, self._ahead_deg = angles_deg[:, 0], angles_deg[:, 1]
        self.up_m = np.zeros(model.beams)

    def with_angles(self, path: Path) -> "Hesai":
        """The same sensor with the angles of its unit's correction file.

        Raises:
            FileFormatError: As :func:`read_angles`.
        """
        return Hesai(self.header, self.model, self.mode, self.step_m, read_angles(path, self.model))

    @property
    def rows(self) -> int:
        """Directions that a packet holds."""
        return self.model.blocks // len(self.returns)

    def valid(self, packets: UInt8[np.ndarray, "packets bytes"]) -> Bool[np.ndarray, " packets"]:
        """Which packets are of this model and mode, their directions within a turn."""
        content = self._content(packets)
        azimuth = content["blocks"]["azimuth"]
        header = np.frombuffer(self.header, dtype=np.uint8)
        as_said = (content["mode"] == self.mode) & (packets[:, : len(header)] == header).all(axis=1)
        return as_said & (azimuth < _TURN).all(axis=1)

    def heads(self, packets: UInt8[np.ndarray, "packets bytes"]) -> Heads:
        """When and where the firings of packets began."""
        content = self._content(packets)
        azimuth = content["blocks"]["azimuth"][:, :: len(self.returns)]
        since = np.broadcast_to(np.rint(self._row_ns).astype(np.int64), azimuth.shape)
        date = content["date"].astype(np.int64)
        days, inverse = np.unique(date[:, :3], axis=0, return_inverse=True)
        day_s = np.array([self._day_s(*day) for day in days.tolist()], dtype=np.int64)
        seconds = day_s[inverse.reshape(-1)] + date[:, 3] * 3600 + date[:, 4] * 60 + date[:, 5]
        stamp_ns = seconds * 1_000_000_000 + content["time_us"].astype(np.int64) * 1000
        return Heads(stamp_ns, since, azimuth % _TURN / 100.0, content["mode"])

    def firings(self, packets: UInt8[np.ndarray, "packets bytes"]) -> Firings:
        """What packets measured; a beam points to its block's direction and its own correction, as nebula takes it."""
        content = self._content(packets)
        heads = self.heads(packets)
        beams, returns = self.model.beams, len(self.returns)
        shots = content["blocks"]["shots"].reshape(len(content) * self.rows, returns, beams)
        beam_ns = self._beam_ns(content)
        return Firings(
            azimuth_deg=(heads.azimuth_deg.reshape(-1, 1) + self._ahead_deg) % 360,
            since_stamp_ns=heads.since_stamp_ns.reshape(-1, 1) + beam_ns,
            range_steps=shots["range"].transpose(0, 2, 1),
            reflectivity=shots["reflectivity"].transpose(0, 2, 1),
            step_m=self.step_m,
        )

    def _beam_ns(self, content: np.ndarray) -> Int64[np.ndarray, "_ beams"]:
        """When the beams of each firing are fired, from the firing's begin."""
        loops = self.model.beam_ns
        if len(loops) == 1:
            return loops
        if self.rows > 1:
            return np.tile(loops[::-1], (len(content) * self.rows // 2, 1))
        return loops[content["loop"] & 1]

    @property
    def _row_ns(self) -> Float64[np.ndarray, " rows"]:
        """When each direction of a packet is fired, from its stamp."""
        rows = np.arange(self.rows)
        return self.model.first_ns + self.model.block_ns * (rows - (self.rows - 1 if self.model.counts_back else 0))

    def _day_s(self, year: int, month: int, day: int) -> int:
        """Seconds since 1970 of a day; of one that the sensor does not know, of 1970's first."""
        is_day = 1 <= month <= 12 and 1 <= day <= 31
        since = 1900 if year >= _FIRST_YEAR else 2000
        return calendar.timegm((since + year, month, day, 0, 0, 0)) if is_day else 0

    def _content(self, packets: UInt8[np.ndarray, "packets bytes"]) -> np.ndarray:
        size = self.model.packet.itemsize
        return np.ascontiguousarray(packets[:, :size]).view(self.model.packet)[:, 0]


def read_angles(path: Path, model: HesaiModel) -> Float64[np.ndarray, "beams 2"]:
    """Elevation and azimuth of each beam, degrees, from a unit's correction file.

    Lines of the beam's number from 1, its elevation and its azimuth, below a line of names; newer units write a first
    line ``EEFF,...`` and a last one of a check sum, which are passed over.

    Args:
        path: The CSV.
        model: Whose beams it must hold.

    Raises:
        FileFormatError: If a beam lacks or is there twice, or an angle is none.
    """
    try:
        text = read_bytes(path, max_bytes=_MOST_ANGLES_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileFormatError(path, where="the file", expected="a CSV of angles", got="no text") from error
    angles = np.full((model.beams, 2), np.nan)
    for line, cells in enumerate(csv.reader(io.StringIO(text)), start=1):
        if len(cells) < 3 or not cells[0].strip().isdecimal():
            continue
        beam = int(cells[0]) - 1 if len(cells[0].strip()) < 6 else -1
        try:
            elevation_deg, azimuth_deg = float(cells[1]), float(cells[2])
        except ValueError:
            elevation_deg = azimuth_deg = np.nan
        if not (0 <= beam < model.beams and abs(elevation_deg) <= 90 and abs(azimuth_deg) <= 180):
            expected = f"a beam from 1 to {model.beams} of a {model.name}, its elevation and azimuth in degrees"
            raise FileFormatError(path, where=f"line {line}", expected=expected, got=",".join(cells)[:60])
        if np.isfinite(angles[beam, 0]):
            raise FileFormatError(path, where=f"line {line}", expected="each beam once", got=f"beam {beam + 1} again")
        angles[beam] = elevation_deg, azimuth_deg
    missing = np.flatnonzero(np.isnan(angles[:, 0]))
    if len(missing):
        expected = f"angles of {model.beams} beams, as a {model.name} has"
        fix = "Take the correction file of this very unit: its web page or the maker's viewer gives it."
        raise FileFormatError(path, where="the file", expected=expected, got=f"none of beam {missing[0] + 1}", fix=fix)
    return angles
