"""What an Ouster sends: its metadata, and its packets as columns of ranges.

Written from Ouster's firmware manual (ouster.com/sensor-docs/fw-user-manual, "Lidar Data", "Lidar Data Legacy",
"Coordinate Frames and XYZ Calculation"). A packet holds some columns, measured at one moment each; a column holds a
pixel for each beam. How a pixel is laid out is the profile, which the metadata name.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64, Integer, Shaped

from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes
from farfield.files.json_text import finite, parse_json
from farfield.files.limits import open_file

LEGACY, EARLY = "LEGACY", "LEGACY before firmware 2.1"
_MAX_BYTES = 1 << 20
_MOST_BEAMS, _MOST_COLUMNS = 512, 8192
_HEADER_BYTES, _FOOTER_BYTES = 32, 32  # of a packet, unless it is a legacy one
_EARLY_FIRMWARE = re.compile(r"v?(1\.|2\.0\.)")
_GROUPS = ("sensor_info", "beam_intrinsics", "lidar_intrinsics", "lidar_data_format", "data_format", "config_params")


@dataclass(frozen=True)
class Profile:
    """How a pixel is laid out.

    Args:
        pixel: Its fields; a second return's end in ``_2``.
        range_mask: Bits of the range that are the range.
        range_step_m: What a step of the range stands for.
        returns: Returns of a pixel.
        reflectivity_full: The largest reflectivity.
        near_ir_step: Photons that a step of ``near_ir`` stands for.
    """

    pixel: np.dtype[Any]
    range_mask: int
    range_step_m: float
    returns: int = 1
    reflectivity_full: float = 255.0
    near_ir_step: int = 1


def _pixel(size: int, **fields: tuple[str, int]) -> np.dtype[Any]:
    formats, offsets = zip(*fields.values(), strict=True)
    return np.dtype({"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": size})


_FULL = _pixel(12, range=("<u4", 0), reflectivity=("u1", 4), signal=("<u2", 6), near_ir=("<u2", 8))
_EARLY = _pixel(12, range=("<u4", 0), reflectivity=("<u2", 4), signal=("<u2", 6), near_ir=("<u2", 8))
_DUAL = _pixel(
    16,
    range=("<u4", 0),
    reflectivity=("u1", 3),
    range_2=("<u4", 4),
    reflectivity_2=("u1", 7),
    signal=("<u2", 8),
    signal_2=("<u2", 10),
    near_ir=("<u2", 12),
)
_LOW_RATE = _pixel(4, range=("<u2", 0), reflectivity=("u1", 2), near_ir=("u1", 3))
_LOW_RATE_DUAL = _pixel(
    8, range=("<u2", 0), reflectivity=("u1", 2), near_ir=("u1", 3), range_2=("<u2", 4), reflectivity_2=("u1", 6)
)
PROFILES: Mapping[str, Profile] = {
    LEGACY: Profile(_FULL, 0xFFFFF, 0.001),
    EARLY: Profile(_EARLY, 0xFFFFF, 0.001, reflectivity_full=65535.0),  # not calibrated, of 16 bits
    "RNG19_RFL8_SIG16_NIR16": Profile(_FULL, 0x7FFFF, 0.001),
    "RNG19_RFL8_SIG16_NIR16_DUAL": Profile(_DUAL, 0x7FFFF, 0.001, returns=2),
    "RNG15_RFL8_NIR8": Profile(_LOW_RATE, 0x7FFF, 0.008, near_ir_step=16),
    "RNG15_RFL8_NIR8_DUAL": Profile(_LOW_RATE_DUAL, 0x7FFF, 0.008, returns=2, near_ir_step=16),
}
"""Profiles by name, those of which the layout is certain. A bit above the range says that the pixel bloomed."""


@dataclass(frozen=True, eq=False)
class OusterSensor:
    """One sensor, by its metadata.

    Args:
        profile: Name of the layout of its pixels.
        columns: Columns of a turn.
        columns_per_packet: Columns in a packet.
        window: First and last column that it fires in; the first lies behind the last where the window crosses zero.
        altitude_rad: Elevation of each beam, shape (beams,).
        azimuth_rad: Azimuth of each beam from its column's, shape (beams,).
        lidar_T_beam_m: From the beams' origin to the lidar's axes at column zero: x and z in metres, shape (2,).
        sensor_T_lidar: Pose of the lidar's axes (x to the connector) in the sensor's (x ahead), shape (4, 4).
        port: Port that it sends to; None where the metadata do not say.
        shift_columns: How far each beam's row is shifted where pictures show one direction a column, shape (beams,);
            None where the metadata do not say.
    """

    profile: str
    columns: int
    columns_per_packet: int
    window: tuple[int, int]
    altitude_rad: Float64[np.ndarray, " beams"]
    azimuth_rad: Float64[np.ndarray, " beams"]
    lidar_T_beam_m: Float64[np.ndarray, " 2"]
    sensor_T_lidar: Float64[np.ndarray, "4 4"]
    port: int | None = None
    shift_columns: Int64[np.ndarray, " beams"] | None = None

    @property
    def beams(self) -> int:
        """Beams, which are the pixels of a column."""
        return len(self.altitude_rad)

    @property
    def legacy(self) -> bool:
        """Whether packets have no header, and columns their status at the end."""
        return self.profile in (LEGACY, EARLY)

    @property
    def expected_columns(self) -> int:
        """Columns that a whole turn has within the window."""
        first, last = self.window
        return (last - first) % self.columns + 1

    @property
    def packet(self) -> np.dtype[Any]:
        """A packet's layout: ``columns`` with ``time_ns``, ``number``, ``status`` and ``pixels``."""
        legacy, pixels = self.legacy, (PROFILES[self.profile].pixel, (self.beams,))
        pixel_bytes = self.beams * PROFILES[self.profile].pixel.itemsize
        head = 16 if legacy else 12
        column = np.dtype(
            {
                "names": ["time_ns", "number", "status", "pixels"],
                "formats": ["<u8", "<u2", "<u4" if legacy else "<u2", pixels],
                "offsets": [0, 8, head + pixel_bytes if legacy else 10, head],
                "itemsize": head + pixel_bytes + (4 if legacy else 0),
            }
        )
        header, footer = (0, 0) if legacy else (_HEADER_BYTES, _FOOTER_BYTES)
        size = header + self.columns_per_packet * column.itemsize + footer
        columns = (column, (self.columns_per_packet,))
        return np.dtype({"names": ["columns"], "formats": [columns], "offsets": [header], "itemsize": size})

    def valid(self, columns: Shaped[np.ndarray, " n"]) -> Shaped[np.ndarray, " m"]:
        """The columns that were measured: the status of a legacy one is all ones, of others its lowest bit."""
        measured = columns["status"] == 0xFFFFFFFF if self.legacy else columns["status"] & 1 == 1
        return columns[measured & (columns["number"] < self.columns)]

    def points_m(
        self, range_m: Float64[np.ndarray, " n"], beam: Integer[np.ndarray, " n"], number: Integer[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n 3"]:
        """Where pixels lie in the sensor's axes: x ahead (away from the connector), y left, z up.

        Args:
            range_m: Ranges, shape (n,).
            beam: Row of each pixel in its column, from 0, shape (n,).
            number: Column of each pixel in the turn, shape (n,).
        """
        out_m, up_m = self.lidar_T_beam_m
        encoder = 2 * np.pi * (1 - number / self.columns)
        azimuth, altitude = encoder - self.azimuth_rad[beam], self.altitude_rad[beam]
        beam_m = range_m - np.hypot(out_m, up_m)  # ranges count from the lidar's axis
        level_m = beam_m * np.cos(altitude)
        lidar_m = np.stack(
            [
                level_m * np.cos(azimuth) + out_m * np.cos(encoder),
                level_m * np.sin(azimuth) + out_m * np.sin(encoder),
                beam_m * np.sin(altitude) + up_m,
            ],
            axis=1,
        )
        return lidar_m @ self.sensor_T_lidar[:3, :3].T + self.sensor_T_lidar[:3, 3]


def is_metadata(path: Path) -> bool:
    """Whether a JSON file is an Ouster's metadata: small, with the beams' angles in it."""
    if not path.is_file():
        return False
    with open_file(path, max_bytes=None) as file:
        head = file.read(_MAX_BYTES)
    return b'"beam_altitude_angles"' in head


def read_sensor(path: Path) -> OusterSensor:
    """Read an Ouster's metadata, flat as the first firmwares give them or in groups as later ones.

    Raises:
        FileFormatError: If something is missing or impossible, or the profile is none of :data:`PROFILES`.
    """
    return sensor_of(parse_json(read_bytes(path, max_bytes=_MAX_BYTES), path), path)


def sensor_of(content: Any, path: Path, *, unpacked: bool = False) -> OusterSensor:
    """A sensor by its metadata.

    Args:
        content: The JSON's.
        path: The file that they stand in.
        unpacked: Whether its pixels stand apart already, so that any profile will do.

    Raises:
        FileFormatError: As :func:`read_sensor`.
    """
    entries = _Entries(path, _flat(content))
    profile = entries.values.get("udp_profile_lidar", LEGACY)  # firmware before 2.2 had no other, and does not say it
    if profile == LEGACY and _EARLY_FIRMWARE.match(str(entries.values.get("build_rev"))):
        profile = EARLY
    if not isinstance(profile, str) or (profile not in PROFILES and not unpacked):
        fix = "Record with the profile RNG19_RFL8_SIG16_NIR16, or let the driver write a ROS 2 bag."
        expected = f"one of {', '.join(name for name in PROFILES if name != EARLY)}"
        raise FileFormatError(path, where="udp_profile_lidar", expected=expected, got=repr(profile)[:60], fix=fix)
    altitude = entries.numbers("beam_altitude_angles", None)
    beams = len(altitude)
    columns = entries.whole("columns_per_frame", _MOST_COLUMNS)
    if not 1 <= beams <= _MOST_BEAMS or entries.values.get("pixels_per_column", beams) != beams:
        got = f"{beams} angles, pixels_per_column {entries.values.get('pixels_per_column')!r}"
        raise FileFormatError(path, where="beam_altitude_angles", expected="an angle for each beam", got=got)
    port = entries.values.get("udp_port_lidar")
    window = entries.values.get("column_window", [0, columns - 1])
    if not (isinstance(window, list) and len(window) == 2 and all(finite(edge) is not None for edge in window)):
        raise FileFormatError(path, where="column_window", expected="two columns", got=repr(window)[:60])
    beam_mm = entries.values.get("beam_to_lidar_transform")
    out_mm, up_mm = (
        (entries.number("lidar_origin_to_beam_origin_mm"), 0.0)
        if beam_mm is None
        else (entries.numbers("beam_to_lidar_transform", 16)[[3, 11]].tolist())
    )
    sensor_T_lidar = entries.numbers("lidar_to_sensor_transform", 16).reshape(4, 4)
    sensor_T_lidar[:3, 3] /= 1000
    check_motion(path, "lidar_to_sensor_transform", sensor_T_lidar)
    return OusterSensor(
        profile=profile,
        columns=columns,
        columns_per_packet=entries.whole("columns_per_packet", columns, usual=16),
        window=(int(window[0]) % columns, int(window[1]) % columns),
        altitude_rad=np.deg2rad(altitude),
        azimuth_rad=np.deg2rad(entries.numbers("beam_azimuth_angles", beams)),
        lidar_T_beam_m=np.array([out_mm, up_mm]) / 1000,
        sensor_T_lidar=sensor_T_lidar,
        port=port if type(port) is int else None,
        shift_columns=entries.shifts("pixel_shift_by_row", beams),
    )


def body_T_sensor_of(content: Any, path: Path) -> Float64[np.ndarray, "4 4"]:
    """Where a sensor stands on its carrier, in metres, by the extrinsic that ouster-sdk writes into its metadata.

    Before version 0.13 it wrote it beside the beams' angles, where those were not in groups.

    Args:
        content: The JSON's.
        path: The file that they stand in.

    Returns:
        The pose, shape (4, 4); the identity where the metadata do not say it.

    Raises:
        FileFormatError: If it is no rigid motion.
    """
    if not isinstance(content, dict):
        return np.eye(4)
    groups = [
        group for group in (content, content.get("ouster-sdk")) if isinstance(group, dict) and "extrinsic" in group
    ]
    poses = [_Entries(path, group).numbers("extrinsic", 16).reshape(4, 4) for group in groups] or [np.eye(4)]
    check_motion(path, "extrinsic", poses[0])
    if not np.array_equal(poses[0], poses[-1]):
        raise FileFormatError(path, where="extrinsic", expected="one", got="two that differ")
    return poses[0]


def check_motion(path: Path, where: str, matrix: Float64[np.ndarray, "4 4"]) -> None:
    """Refuse a matrix that does more than turn and shift.

    Raises:
        FileFormatError: If it mirrors, stretches or is another one.
    """
    turn = matrix[:3, :3]
    is_turn = np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) and np.linalg.det(turn) > 0
    if not is_turn or matrix[3].tolist() != [0, 0, 0, 1]:
        raise FileFormatError(path, where=where, expected="a rotation", got="a mirror or another matrix")


def _flat(content: Any) -> dict[str, Any]:
    """The entries of metadata, those of its groups among them."""
    if not isinstance(content, dict):
        return {}
    entries = dict(content)
    for group in _GROUPS:
        if isinstance(content.get(group), dict):
            entries |= content[group]
    return entries


@dataclass(frozen=True)
class _Entries:
    """Entries of metadata, read with their kind checked."""

    path: Path
    values: Mapping[str, Any]

    def number(self, name: str) -> float:
        value = finite(self.values.get(name))
        if value is None:
            raise FileFormatError(self.path, where=name, expected="a number", got=repr(self.values.get(name))[:60])
        return value

    def whole(self, name: str, most: int, usual: int | None = None) -> int:
        value = self.values.get(name, usual)
        if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= most:
            expected = f"a whole number from 1 to {most}"
            raise FileFormatError(self.path, where=name, expected=expected, got=repr(value)[:60])
        return value

    def numbers(self, name: str, count: int | None) -> Float64[np.ndarray, " count"]:
        values = self.values.get(name)
        numbers = [finite(value) for value in values] if isinstance(values, list) else [None]
        if None in numbers or (count is not None and len(numbers) != count):
            expected = f"{'a list of' if count is None else count} numbers"
            raise FileFormatError(self.path, where=name, expected=expected, got=repr(values)[:60])
        return np.array(numbers, dtype=np.float64)

    def shifts(self, name: str, count: int) -> Int64[np.ndarray, " count"] | None:
        values = self.values.get(name)
        whole = isinstance(values, list) and all(type(value) is int and abs(value) < _MOST_COLUMNS for value in values)
        return np.array(values, dtype=np.int64) if whole and len(self.values[name]) == count else None
