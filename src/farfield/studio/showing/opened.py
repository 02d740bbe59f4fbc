"""The open data set: frames as they are read, and layers as the bytes that the page gets."""

import gzip
import hashlib
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from farfield.datasets.base import Dataset
from farfield.datasets.maps import Sweeps
from farfield.errors import ConfigError, FarfieldError
from farfield.frame import Drive, Frame
from farfield.studio.messages.rows import DriveRow, Layer
from farfield.studio.showing.layers import layers_of, picture
from farfield.studio.showing.radar import RadarPower, ground_z_m, in_radar
from farfield.studio.showing.wire import encode_cloud, encode_map
from farfield.studio.threads import Cache
from farfield.vocabulary.counts import count_of

_FRAMES = 5
"""Frames whose clouds stay in memory, for fits and counts."""
_POWERS = 2
MOST_NAMED = 20_000
"""Frames up to which a window gets the name and time of each."""
CACHE_BYTES = 512 << 20
STATIC = Path(__file__).resolve().parent.parent / "static"
"""The built page."""
_PATH = re.compile(r"(?<![\w./])/(?:[^\s/'\":,]+/)+")


@dataclass(frozen=True, eq=False)
class Payload:
    """Bytes to send.

    Args:
        body: As they are.
        kind: Media type.
        packed: The same, compressed, by name of the coding (``zstd``, ``gzip``), filled as they are asked for.
    """

    body: bytes
    kind: str
    packed: dict[str, bytes]

    @classmethod
    def of(cls, body: bytes, kind: str) -> "Payload":
        """Bytes not yet compressed."""
        return cls(body, kind, {})

    @cached_property
    def tag(self) -> str:
        """ETag of the bytes."""
        return '"' + hashlib.blake2b(self.body, digest_size=12).hexdigest() + '"'

    def coded(self, accepted: str) -> tuple[bytes, str]:
        """The bytes in the best coding that a client accepts, and its name, empty for none.

        Args:
            accepted: Its Accept-Encoding header.
        """
        names = {coding_name.split(";")[0].strip() for coding_name in accepted.lower().split(",")}
        coding = next((name for name in ("zstd", "gzip") if name in names and self.kind != "image/jpeg"), "")
        if not coding or self.kind.startswith("image/"):
            return self.body, ""
        if coding not in self.packed:
            self.packed[coding] = _zstd(self.body) if coding == "zstd" else gzip.compress(self.body, 1)
        return self.packed[coding], coding


def _zstd(body: bytes) -> bytes:
    import zstandard

    return zstandard.ZstdCompressor(level=1).compress(body)


def _size(payload: Payload) -> int:
    return len(payload.body) + sum(map(len, payload.packed.values()))


class OpenedDataset:
    """A data set whose frames are shown.

    Args:
        data: The data set.
    """

    def __init__(self, data: Dataset) -> None:
        self.data = data
        self._frames: Cache[Frame] = Cache(_FRAMES, lambda _: 1)
        self._powers: Cache[RadarPower] = Cache(_POWERS, lambda _: 1)
        self._payloads: Cache[Payload] = Cache(CACHE_BYTES, _size)
        self._sweeps: dict[int, Dataset] = {}

    def __len__(self) -> int:
        return len(self.data)

    def check(self, index: int) -> None:
        """Refuse a number that no frame has.

        Raises:
            ConfigError: If it has none.
        """
        if not 0 <= index < len(self.data):
            raise ConfigError(f"frame: expected a number from 0 to {len(self.data) - 1}, got {index}")

    @cached_property
    def drives(self) -> tuple[Drive, ...]:
        """The drives of the data set."""
        return self.data.drives()

    @cached_property
    def drive_rows(self) -> tuple[DriveRow, ...]:
        """Which frames belong together, in the order of time; of large data sets without the times."""
        small = len(self.data) <= MOST_NAMED
        return tuple(
            DriveRow(
                name=drive.name,
                frames=tuple(drive.indices.tolist()),
                times_ns=tuple(map(str, drive.times_ns.tolist())) if small and drive.times_ns is not None else None,
            )
            for drive in self.drives
        )

    def frame(self, index: int, sweeps: int = 1) -> Frame:
        """A frame; its clouds stay in memory for a while."""
        self.check(index)
        return self._frames.get((index, sweeps), lambda: self._swept(sweeps)[index])

    def _swept(self, sweeps: int) -> Dataset:
        if sweeps == 1:
            return self.data
        if sweeps not in self._sweeps:
            self._sweeps[sweeps] = self.data.mapped(Sweeps(sweeps))
        return self._sweeps[sweeps]

    def layers(self, index: int, sweeps: int = 1) -> tuple[tuple[Layer, ...], tuple[str, ...]]:
        """The layers of a frame, and what is missing and why, a sentence each."""
        notes: list[str] = []
        if sweeps > 1:
            try:
                self.frame(index, sweeps)
            except FarfieldError as error:
                notes, sweeps = [f"one sweep is shown: {plain_error(error, self.data)}"], 1
        layers = layers_of(self.frame(index), index, root=self.data.root, sweeps=sweeps)
        return layers, (*self.remarks, *notes, *_missing(layers, self.frame(index)))

    @cached_property
    def remarks(self) -> tuple[str, ...]:
        """As of :func:`plain_remarks`."""
        return plain_remarks(self.data)

    def layer(self, index: int, number: int) -> Layer:
        """One layer by its number.

        Raises:
            ConfigError: If the frame has none of this number.
        """
        layers = layers_of(self.frame(index), index, root=self.data.root)
        if not 0 <= number < len(layers):
            raise ConfigError(f"layer: frame {index} has {count_of(len(layers), 'layer')}, got number {number}")
        return layers[number]

    def cloud(self, index: int, number: int, sweeps: int = 1) -> Payload:
        """A cloud as FFP1.

        Raises:
            ConfigError: If the layer is no cloud.
        """
        layer = self.layer(index, number)
        if layer.kind != "points":
            raise ConfigError(f"layer {number} of frame {index}: expected points, it is {layer.kind}")
        return self._payloads.get(("cloud", index, number, sweeps), lambda: self._cloud(index, layer, sweeps))

    def _cloud(self, index: int, layer: Layer, sweeps: int) -> Payload:
        cloud = self.frame(index, sweeps).cloud(layer.name)
        facts = {"frame": index, "layer": layer.name, "time_ns": layer.time_ns, "version": 1}
        return Payload.of(encode_cloud(cloud, facts), "application/octet-stream")

    def picture(self, index: int, number: int, *, exact: bool = False) -> Payload:
        """A picture, made once as :func:`~farfield.studio.showing.layers.picture` says.

        Args:
            index: The frame.
            number: The layer.
            exact: Every pixel as the file has it.

        Raises:
            ConfigError: If the layer is no picture.
        """
        layer = self.layer(index, number)
        if layer.kind != "image":
            raise ConfigError(f"layer {number} of frame {index}: expected a picture, it is {layer.kind}")
        return self._payloads.get(
            ("image", index, number, exact), lambda: Payload.of(*picture(self.data[index], layer.name, exact=exact))
        )

    def radar_map(self, index: int, kind: str, low_m: float = 0.0, high_m: float = float("inf")) -> Payload:
        """A radar's power from above (``bev``) or from the front (``bfs``, between two ranges) as FFP1.

        Raises:
            ConfigError: If the frame has no radar product.
        """
        self.check(index)
        key = ("radar", index, kind, round(low_m, 1), round(high_m, 1) if high_m < 1e6 else None)
        return self._payloads.get(key, lambda: self._map(index, kind, low_m, high_m))

    def _map(self, index: int, kind: str, low_m: float, high_m: float) -> Payload:
        power = self.radar_power(index)
        level = power.from_above() if kind == "bev" else power.from_front(low_m, high_m)
        return Payload.of(encode_map(level, {"frame": index, "layer": kind, "version": 1}), "application/octet-stream")

    def radar_near(self, index: int, at_xy: tuple[float, float], reach_m: float) -> Payload:
        """A radar's cells about a place of the frame as FFP1, at all heights, and the height of the ground there.

        Raises:
            ConfigError: If the frame has no radar product.
        """
        self.check(index)
        key = ("radar", index, "near", *(round(value, 1) for value in (*at_xy, reach_m)))
        return self._payloads.get(key, lambda: self._near(index, at_xy, reach_m))

    def _near(self, index: int, at_xy: tuple[float, float], reach_m: float) -> Payload:
        block = self.radar_power(index).near(in_radar(self.frame(index), at_xy), reach_m)
        facts = {"frame": index, "layer": "near", "version": 1, "axes": block.axes}
        facts["ground_z_m"] = ground_z_m(self.frame(index), at_xy)
        return Payload.of(encode_map(block.level_db, facts, block.doppler_m_s), "application/octet-stream")

    def radar_power(self, index: int) -> RadarPower:
        """A radar's power on all its cells.

        Raises:
            ConfigError: If the frame has no radar product.
        """
        return self._powers.get(index, lambda: self._power(index))

    def _power(self, index: int) -> RadarPower:
        try:
            return RadarPower.read(self.data[index].radar)
        except KeyError as error:
            raise ConfigError(f"frame {index}: {error.args[0]}") from error


def _missing(layers: tuple[Layer, ...], frame: Frame) -> tuple[str, ...]:
    """What a person may look for in vain, and what would bring it."""
    notes = []
    for layer in layers:
        if layer.kind == "image" and layer.camera is None:
            notes.append(f"{layer.name}: no calibration found, so boxes and points are not drawn into it")
        if layer.kind == "points" and not layer.placed:
            notes.append(f"{layer.name}: where its sensor stands is not known; it is shown in its own axes")
    if not frame.has_annotation:
        notes.append("this frame was not annotated")
    return tuple(notes)


def plain_error(error: BaseException | str, data: Any = None) -> str:
    """A message without absolute paths: what the page may show."""
    text = error if isinstance(error, str) else str(error) or type(error).__name__
    root = str(getattr(data, "root", "")) if data is not None else ""
    if root and root != ".":
        text = text.replace(root + "/", "").replace(root, "the data set")
    return _PATH.sub("…/", text)


def plain_remarks(data: Dataset) -> tuple[str, ...]:
    """What the reader left out or assumed, as the page may show it."""
    return tuple(plain_error(sentence, data) for _, sentence in data.remarks)
