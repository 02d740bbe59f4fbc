"""What a Velodyne sends: packets of 1,206 bytes with twelve blocks of 32 shots, told apart by their last two bytes.

Written from the packet structures of the manuals (63-9243 VLP-16, 97-0038 HDL-32E, 63-9325 VLP-32C, 63-9483 Alpha
Prime), as github.com/tier4/nebula (Apache-2.0), github.com/ros-drivers/velodyne and
github.com/valgur/velodyne_decoder (both BSD-3-Clause) state them too. A block holds the rotor's direction and 32
shots of two bytes of range and one of reflectivity; with dual returns blocks come in pairs, the last return's first.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from farfield.files.firings import HOUR_NS, Firings, Heads, TurningLidar
from farfield.vocabulary import velodyne as tables

PACKET_BYTES = 1206
SINGLE_MODES: Mapping[int, tuple[str, ...]] = {0x37: ("strongest",), 0x38: ("last",)}
DUAL_MODE, DUAL_RETURNS = 0x39, ("last", "strongest")
_BLOCKS, _SHOTS, _BANK = 12, 32, 0xEEFF
_SHOT = np.dtype([("range", "<u2"), ("reflectivity", "u1")])
_BLOCK = np.dtype([("bank", "<u2"), ("azimuth", "<u2"), ("shots", _SHOT, (_SHOTS,))])
_PACKET = np.dtype([("blocks", _BLOCK, (_BLOCKS,)), ("stamp_us", "<u4"), ("mode", "u1"), ("model", "u1")])
_TURN, _BACK = 36_000, 4_500  # hundredths of a degree; a rotor may seem to turn back a little, where it trembles
_WIDE = 2.5  # steps so many times the usual are gaps


@dataclass(frozen=True, eq=False, kw_only=True)
class VelodyneModel:
    """What the manual says of a model.

    Args:
        name: Its name.
        step_m: Metres of a step of the range.
        elevation_deg: Of each laser, in the order of the packet.
        ahead_deg: Of each laser, clockwise from the rotor's direction.
        shot_ns: From one shot, or group of shots at once, to the next.
        together: Shots at once.
        cycle_ns: From one firing of all lasers to the next.
        idle_after: A group after which the lasers rest for one group's time.
        before_stamp_ns: How much earlier than the packet's stamp its first shot is.
    """

    name: str
    step_m: float
    elevation_deg: tuple[float, ...]
    ahead_deg: tuple[float, ...] = ()
    shot_ns: float
    together: int = 1
    cycle_ns: float
    idle_after: int | None = None
    before_stamp_ns: int = 0

    @property
    def lasers(self) -> int:
        """How many it has."""
        return len(self.elevation_deg)

    @property
    def laser_ns(self) -> Float64[np.ndarray, " lasers"]:
        """When each laser is shot, from the firing's begin."""
        group = np.arange(self.lasers) // self.together
        rests = 0 if self.idle_after is None else (group > self.idle_after).astype(np.int64)
        return (group + rests) * self.shot_ns


MODELS: Mapping[int, VelodyneModel] = {
    0x21: VelodyneModel(
        name="HDL-32E", step_m=0.002, elevation_deg=tables.HDL32E_DEG, shot_ns=1_152.0, cycle_ns=46_080.0
    ),
    0x22: VelodyneModel(
        name="VLP-16",
        step_m=0.002,
        elevation_deg=tables.VLP16_DEG,
        shot_ns=2_304.0,
        cycle_ns=55_296.0,
    ),
    0x24: VelodyneModel(
        name="Puck Hi-Res",
        step_m=0.002,
        elevation_deg=tables.HI_RES_DEG,
        shot_ns=2_304.0,
        cycle_ns=55_296.0,
    ),
    0x28: VelodyneModel(
        name="VLP-32C",
        step_m=0.004,
        elevation_deg=tables.VLP32C_DEG,
        ahead_deg=tables.VLP32C_AHEAD_DEG,
        shot_ns=2_304.0,
        together=2,
        cycle_ns=55_296.0,
    ),
    0xA1: VelodyneModel(
        name="VLS-128",
        step_m=0.004,
        elevation_deg=tables.VLS128_DEG,
        ahead_deg=tables.VLS128_AHEAD_DEG,
        shot_ns=2_665.0,
        together=8,
        cycle_ns=53_300.0,
        idle_after=7,
        before_stamp_ns=8_700,
    ),
}
"""Models by the last byte of a packet, those of which the layout is certain."""

_NOT_READ: Mapping[int, str] = {0x23: "VLP-32A or VLP-32B (which of them is not told)", 0x31: "Velarray"}
_NEWER_SHOT_NS, _CYCLES_NS = 2_890.0, (50_000.0, 60_000.0)  # of the Alpha Prime since firmware 5.2.3


def looks_like_velodyne(packet: bytes) -> bool:
    """Whether a datagram may be a Velodyne's: of its size, its first block with a bank's mark."""
    banks = np.frombuffer(packet, dtype=_PACKET)["blocks"]["bank"][0] if len(packet) == PACKET_BYTES else None
    return banks is not None and int(banks[0]) == _BANK


def velodyne_of(packet: bytes) -> "tuple[Velodyne | None, str]":
    """The model and mode of a packet; None where it is not read, with the reason.

    Args:
        packet: One that :func:`looks_like_velodyne`.
    """
    row = np.frombuffer(packet, dtype=_PACKET)[0]
    code, mode = int(row["model"]), int(row["mode"])
    banks = row["blocks"]["bank"].tolist()
    model = MODELS.get(code)
    alternating = banks == [0xEEFF, 0xDDFF] * 6
    if alternating:
        return None, (
            "a Velodyne HDL-64E, whose angles stand in the calibration file of its unit (db.xml) and whose packets do "
            "not say which of three kinds it is"
        )
    if model is None:
        return None, f"a Velodyne {_NOT_READ.get(code, f'of the unknown model 0x{code:02x}')}"
    if mode not in (*SINGLE_MODES, DUAL_MODE):
        return None, f"a Velodyne {model.name} in the unknown mode of returns 0x{mode:02x}"
    lidar = Velodyne(code, mode)
    if banks[: lidar.blocks_read] != lidar.banks:
        return None, f"a Velodyne {model.name} with blocks in another order than its manual's"
    return lidar, ""


class Velodyne(TurningLidar):
    """A model in a mode of returns.

    Args:
        code: The byte of the packet that says which model of :data:`MODELS` it is.
        mode: The byte of the packet that says which returns it holds.
    """

    clock_ns = HOUR_NS

    def __init__(self, code: int, mode: int) -> None:
        model = MODELS[code]
        self.code, self.model, self.mode, self.name = code, model, mode, model.name
        self.returns = DUAL_RETURNS if mode == DUAL_MODE else SINGLE_MODES[mode]
        self.elevation_deg = np.array(model.elevation_deg)
        self.up_m = -tables.FOCUS_MM[model.name] / 1000 * np.tan(np.deg2rad(self.elevation_deg))
        self._ahead_deg = np.array(model.ahead_deg or (0.0,) * model.lasers)
        self.firings_per_block = max(_SHOTS // model.lasers, 1)
        self.blocks_per_firing = max(model.lasers // _SHOTS, 1)

    @property
    def blocks_read(self) -> int:
        """Blocks of a packet that hold something: of a dual VLS-128 eight, which are one firing."""
        return 8 if self.blocks_per_firing == 4 and len(self.returns) == 2 else _BLOCKS

    @property
    def banks(self) -> list[int]:
        """The marks that these blocks begin with."""
        marks = [_BANK - 0x1100 * bank for bank in range(self.blocks_per_firing) for _ in self.returns]
        return marks * (self.blocks_read // len(marks))

    @property
    def rows(self) -> int:
        """Blocks, or groups of them, of one direction that a packet holds."""
        return self.blocks_read // (self.blocks_per_firing * len(self.returns))

    def valid(self, packets: UInt8[np.ndarray, "packets bytes"]) -> Bool[np.ndarray, " packets"]:
        """Which packets are of this model and mode, their blocks in order and their directions within a turn."""
        content = _content(packets)
        blocks = content["blocks"][:, : self.blocks_read]
        as_said = (content["model"] == self.code) & (content["mode"] == self.mode)
        return as_said & (blocks["bank"] == self.banks).all(axis=1) & (blocks["azimuth"] < _TURN).all(axis=1)

    def heads(self, packets: UInt8[np.ndarray, "packets bytes"]) -> Heads:
        """When and where the firings of packets began; a VLP-16's second firing of a block lies between blocks."""
        content = _content(packets)
        azimuth = content["blocks"]["azimuth"][:, : self.blocks_read].reshape(len(content), self.rows, -1)[:, :, 0]
        begin = azimuth.astype(np.float64)
        stamp_ns = content["stamp_us"].astype(np.int64) * 1000
        cycle_ns, _ = self._clocking(stamp_ns)
        row_ns = cycle_ns * self.firings_per_block
        following, gaps = self._following(begin, stamp_ns, row_ns)
        share = np.arange(self.firings_per_block) / self.firings_per_block
        directions = (begin[:, :, None] + following[:, :, None] * share).reshape(len(content), -1)
        late_ns = np.repeat(np.cumsum(gaps, axis=1) * row_ns, self.firings_per_block, axis=1)
        since = np.arange(directions.shape[1]) * cycle_ns + late_ns - self.model.before_stamp_ns
        return Heads(
            stamp_ns=stamp_ns,
            since_stamp_ns=np.rint(since).astype(np.int64),
            azimuth_deg=directions % _TURN / 100,
            mode=content["mode"],
        )

    def firings(self, packets: UInt8[np.ndarray, "packets bytes"]) -> Firings:
        """What packets measured; between the shots of a firing the rotor turns on, as fast as to the next firing."""
        content = _content(packets)
        heads = self.heads(packets)
        cycle_ns, shot_share = self._clocking(heads.stamp_ns)
        laser_ns = self.model.laser_ns * shot_share
        ahead = heads.azimuth_deg
        steps = self._following(ahead * 100, heads.stamp_ns, cycle_ns)[0] / 100
        azimuth_deg = ahead[:, :, None] + steps[:, :, None] * (laser_ns / cycle_ns) + self._ahead_deg
        since = heads.since_stamp_ns[:, :, None] + np.rint(laser_ns).astype(np.int64)
        lasers, returns = self.model.lasers, len(self.returns)
        shots = content["blocks"]["shots"][:, : self.blocks_read]
        shape = (
            len(content) * self.rows,
            self.blocks_per_firing,
            returns,
            self.firings_per_block,
            lasers // self.blocks_per_firing,
        )
        order = (0, 3, 1, 4, 2)
        return Firings(
            azimuth_deg=azimuth_deg.reshape(-1, lasers) % 360,
            since_stamp_ns=since.reshape(-1, lasers),
            range_steps=shots["range"].reshape(shape).transpose(order).reshape(-1, lasers, returns),
            reflectivity=shots["reflectivity"].reshape(shape).transpose(order).reshape(-1, lasers, returns),
            step_m=self.model.step_m,
        )

    def _clocking(self, stamp_ns: Int64[np.ndarray, " packets"]) -> tuple[float, float]:
        """Nanoseconds of a cycle, and the shots' in shares of the manual's: a VLS-128's firmware changed both."""
        if self.blocks_per_firing != 4 or len(stamp_ns) < 3:
            return self.model.cycle_ns, 1.0
        cycle_ns = float(np.median(np.diff(stamp_ns) % HOUR_NS)) / (self.rows * self.firings_per_block)
        if not _CYCLES_NS[0] < cycle_ns < _CYCLES_NS[1]:
            return self.model.cycle_ns, 1.0
        newer = cycle_ns > (20 * _NEWER_SHOT_NS + self.model.cycle_ns) / 2 + 1000
        return cycle_ns, _NEWER_SHOT_NS / self.model.shot_ns if newer else 1.0

    def _following(
        self, begin: Float64[np.ndarray, "packets rows"], stamp_ns: Int64[np.ndarray, " packets"], row_ns: float
    ) -> tuple[Float64[np.ndarray, "packets rows"], Float64[np.ndarray, "packets rows"]]:
        """How far the rotor turns from each direction until the next is due, and how many were not sent before each.

        A sensor that was told to see but a sector sends a packet when it is full: it spans the rest of the turn.

        Args:
            begin: Directions, hundredths of a degree.
            stamp_ns: Of each packet.
            row_ns: From one direction to the next.
        """
        steps = (np.diff(begin, axis=1) + _BACK) % _TURN - _BACK
        gaps = np.zeros_like(begin)
        if begin.shape[1] == 1:
            passed_ns, turned = np.diff(stamp_ns) % HOUR_NS, np.diff(begin[:, 0]) % _TURN
            near = passed_ns < 2.5 * row_ns
            rate = float(np.median(turned[near] / np.maximum(passed_ns[near], 1))) if near.any() else 0.0
            return np.full_like(begin, rate * row_ns), gaps
        usual = float(np.median(steps)) if steps.size else 0.0
        if usual > 0:
            wide = steps > _WIDE * usual
            gaps[:, 1:][wide] = np.rint(steps[wide] / usual) - 1
            steps = np.where(wide, usual, steps)
        return np.concatenate([steps, steps[:, -1:]], axis=1), gaps


def _content(packets: UInt8[np.ndarray, "packets bytes"]) -> np.ndarray:
    return np.ascontiguousarray(packets).view(_PACKET)[:, 0]
