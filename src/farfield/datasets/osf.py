"""Ouster's own recordings, ``NAME.osf``: each sensor in one is a drive of sweeps."""

import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Int64, Shaped

from farfield.datasets.base import Dataset, Indices, Poses, all_poses
from farfield.errors import DatasetError, FileFormatError
from farfield.files.osf import OsfFile, OsfMessage, OsfSweep, is_osf
from farfield.files.ouster import EARLY, LEGACY, PROFILES
from farfield.files.point_times import OFFSET_COLUMN
from farfield.files.remote_paths import as_path
from farfield.files.suffixes import pattern_in_any_case
from farfield.frame import Cloud, Frame, Lazy, Sensor

CLOUD = "lidar"
_LEAST_SHARE = 0.5  # of a turn's columns: recordings begin and end within one
_EIGHT_BITS = re.compile(r"(.*_)?RFL8(_.*)?|FIVE_WORD_PIXEL")  # profiles whose reflectivity is calibrated, to 255


def recordings_in(root: Path) -> list[Path]:
    """The OSF of a folder."""
    return [path for path in sorted(root.glob(pattern_in_any_case("*.osf"))) if is_osf(path)]


class Osf(Dataset):
    """OSF recordings of Ouster's sensors: one cloud ``"lidar"`` a frame, in the sensor's axes (x ahead, y left, z up).

    The cloud's columns are those of :class:`~farfield.datasets.ouster.Ouster`: ``ring``, ``offset_ns``, ``return``,
    ``reflectivity``, ``near_ir`` and ``signal``, as far as the recording has them. The reflectivity's full scale is
    that of the sensor's profile, whatever the width in which it is stored. A frame's time is that of its first column,
    by the sensor's clock; its pose, where the recording has poses, is the sensor's at that column: the carrier's pose
    times where the sensor stands on it. A drive is called after its file, and after the sensor's serial number too
    where the file has several.

    Args:
        root: Folder of ``NAME.osf``.

    Raises:
        DatasetError: If there is none, or none holds a sweep.
        FileFormatError: If one is damaged, unfinished or of another generation.
    """

    name = "osf"

    def __init__(self, root: Path | str) -> None:
        self.root = as_path(root)
        paths = recordings_in(self.root)
        if not paths:
            raise DatasetError(f"{root}: expected NAME.osf, as Ouster's tools record")
        self.recordings: dict[str, tuple[OsfFile, tuple[OsfMessage, ...]]] = {}
        self._assumptions: list[str] = []
        for path in paths:
            self._add(path, OsfFile.of(path))
        sizes = {name: len(messages) for name, (_, messages) in self.recordings.items()}
        self.sequences = tuple(name for name, size in sizes.items() for _ in range(size))
        self.frame_ids = tuple(f"{number:06d}" for size in sizes.values() for number in range(size))
        if not self.sequences:
            raise DatasetError(f"{root}: no recording holds a whole turn. {' '.join(self._assumptions)}")

    def _add(self, path: Path, recording: OsfFile) -> None:
        """The sensors of a file, each a drive."""
        for number, sensor in sorted(recording.sensors.items()):
            name = path.stem if len(recording.sensors) == 1 else f"{path.stem}-{recording.names[number]}"
            if name in self.recordings:
                raise DatasetError(f"{self.root}: two drives are called {name}; rename one of the files.")
            own = [message for message in recording.messages if message.sensor == number]
            whole = [message for message in own if message.measured >= _LEAST_SHARE * sensor.expected_columns]
            whole.sort(key=lambda message: message.time_ns)
            self.recordings[name] = recording, tuple(whole)
            if len(whole) < len(own):
                count = len(own) - len(whole)
                verb = " is" if count == 1 else "s are"
                self._assumptions.append(f"{name}: {count} sweep{verb} left out of which less than half was recorded.")
            lost = sum(sensor.expected_columns - message.measured for message in whole)
            if lost > 0:
                expected = len(whole) * sensor.expected_columns
                self._assumptions.append(f"{name}: {lost} of {expected} columns of the sweeps were lost.")
            self._assumptions += [f"{name}: {sentence}" for sentence in _remarks(recording, number, whole)]

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What is missing of each recording, and where its sensors stand on their carrier."""
        return tuple(self._assumptions)

    def _message(self, index: int) -> OsfMessage:
        return self.recordings[self.sequences[index]][1][int(self.frame_ids[index])]

    def files(self, index: int) -> Sequence[Path]:
        """The recording."""
        return [self.recordings[self.sequences[index]][0].path]

    def _times_of(self, indices: Indices) -> Indices | None:
        return np.array([self._message(int(index)).time_ns for index in indices], dtype=np.int64)

    def _poses_of(self, indices: Indices) -> Poses | None:
        return all_poses(self._message(int(index)).world_T_sensor for index in indices)

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        recording, message = self.recordings[self.sequences[index]][0], self._message(index)
        return Frame(
            sequence=self.sequences[index],
            frame_id=self.frame_ids[index],
            time_ns=message.time_ns,
            clouds=Lazy({CLOUD: partial(_cloud_of, recording, message)}),
            sensors={CLOUD: Sensor(kind="lidar", frame_T_sensor=np.eye(4))},
            world_T_frame=message.world_T_sensor,
            reference=CLOUD,
            metadata={"files": [str(path) for path in self.files(index)]},
        )


def _cloud_of(recording: OsfFile, message: OsfMessage) -> Cloud:
    """The cloud of a sweep."""
    sweep, sensor = recording.sweep(message), recording.sensors[message.sensor]
    seconds = ["", "_2"] if "range_2" in sweep.fields else [""]
    rows = [_returned(sweep, second) for second in seconds]
    column, beam, nth = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    order = np.lexsort((nth, beam, sweep.times_ns[column]))
    column, beam, nth = column[order], beam[order], nth[order]
    range_m = _values(sweep, "range", column, beam, nth).astype(np.int64) * 0.001
    extra = {
        "ring": beam.astype(np.int32),
        "return": nth.astype(np.int8),
        OFFSET_COLUMN: sweep.times_ns[column] - message.time_ns,
    }
    for name in ("near_ir", "reflectivity", "signal"):
        if name in sweep.fields:
            extra[name] = _values(sweep, name, column, beam, nth).astype(np.float32)
    intensity = None
    if "reflectivity" in sweep.fields:
        width = sweep.fields["reflectivity"].dtype.itemsize
        full = _full_reflectivity(recording.path, sensor.profile, width)
        if full is None:
            del extra["reflectivity"]
        elif extra["reflectivity"].max(initial=0.0) > full:
            got = f"{extra['reflectivity'].max():.0f}"
            raise _unlike(recording.path, f"reflectivities to {full:.0f}, as {sensor.profile} measures them", got)
        else:
            intensity = extra["reflectivity"] / np.float32(full)
    points_m = sensor.points_m(range_m, beam, column)
    missing = int((sweep.fields["range"][:, sweep.measured] == 0).sum())
    return Cloud(points_m, intensity, extra, missing)


def _full_reflectivity(path: Path, profile: str, width: int) -> float | None:
    """The largest reflectivity of a profile; None where the width in which it is stored cut it.

    Args:
        path: The recording.
        profile: The sensor's, which says what it measures.
        width: Bytes in which it is stored: ouster-sdk before 0.13 takes two or four for what is one byte.

    Raises:
        FileFormatError: If neither tells it.
    """
    if profile == EARLY:
        return None if width == 1 else PROFILES[EARLY].reflectivity_full
    if width == 1 or profile == LEGACY or _EIGHT_BITS.fullmatch(profile):
        return 255.0
    raise _unlike(path, "a profile whose largest reflectivity is known, such as with RFL8", profile[:60])


def _unlike(path: Path, expected: str, got: str) -> FileFormatError:
    fix = "Record with the profile RNG19_RFL8_SIG16_NIR16, or convert it with ouster-cli of ouster-sdk 0.13 or later."
    return FileFormatError(path, where="reflectivity", expected=expected, got=got, fix=fix)


def _remarks(recording: OsfFile, number: int, messages: Sequence[OsfMessage]) -> list[str]:
    """Notes on a sensor: its place on the carrier, and reflectivities that give no intensity."""
    sentences = []
    x_m, y_m, z_m = recording.body_T_sensor[number][:3, 3].tolist()
    if not np.array_equal(recording.body_T_sensor[number], np.eye(4)):
        posed = any(message.world_T_sensor is not None for message in messages)
        use = "is counted into the frames' poses" if posed else "is in no frame, since there are no poses"
        sentences.append(
            f"the sensor stands at ({x_m:.3f}, {y_m:.3f}, {z_m:.3f}) m on its carrier; this extrinsic {use}."
        )
    if recording.sensors[number].profile == EARLY:
        sentences.append(
            "firmware before 2.1 measures reflectivities to 65535; where the file stores one byte of them, clouds have "
            "neither reflectivity nor intensity."
        )
    return sentences


def _returned(
    sweep: OsfSweep, second: str
) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """Column, beam and number of the return of the pixels of measured columns in which something returned."""
    beam, column = np.nonzero((sweep.fields[f"range{second}"] > 0) & sweep.measured)
    return column, beam, np.full(len(column), 1 if second else 0)


def _values(
    sweep: OsfSweep,
    name: str,
    column: Int64[np.ndarray, " n"],
    beam: Int64[np.ndarray, " n"],
    nth: Int64[np.ndarray, " n"],
) -> Shaped[np.ndarray, " n"]:
    """A field of some pixels, of the second return where the field has one."""
    values = sweep.fields[name][beam, column]
    second = sweep.fields.get(f"{name}_2")
    return values if second is None else np.where(nth == 1, second[beam, column], values)
