"""What the frames of a sequence share: conditions, times, poses, cameras, film, GPS and IMU."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.datasets.kradar.index import FileIndex
from farfield.datasets.kradar.layout import CAMERAS, EYES, LIDARS, RIGHT_EYE
from farfield.datasets.kradar.texts import (
    TimedTable,
    motion_files,
    read_camera,
    read_gps,
    read_imu,
    read_local,
    read_poses,
    read_times,
)
from farfield.files.description import read_description
from farfield.files.videos import film_frame
from farfield.frame import Camera, Lazy
from farfield.frame.provenance import is_simulated
from farfield.vocabulary.kradar import DESCRIPTIONS, published_conditions

RELEASES = ("v2", "v1")
"""Releases of the camera calibrations: ``calib_seq_v2`` (April 2025), which changes 21 sequences (11 in every camera,
the others in the front one), and ``calib_seq``."""

_FOLDERS = {
    "v2": tuple(Path(root, "calib_seq_v2") for root in ("resources/cam_calib", "cam_calib", "")),
    "v1": tuple(Path(root, "calib_seq") for root in ("resources/cam_calib", "cam_calib", "")),
}
_UNNAMED = (Path("resources/cam_calib"), Path("cam_calib"))
_COMMON = tuple(Path(root, "common") for root in ("resources/cam_calib", "cam_calib"))
_READERS: Mapping[str, Callable[[Path], TimedTable]] = {
    "gps": read_gps,
    "gps_local": read_local,
    "imu": read_imu,
    "imu_2": read_imu,
}


@dataclass(frozen=True, eq=False, kw_only=True)
class SequenceFacts:
    """What is known of a sequence.

    Args:
        conditions: Road, time and weather.
        conditions_from: ``"description.txt"``, ``"published table"``, or nothing.
        times_ns: Times of files by name.
        poses: Poses of its annotated frames, or None.
        cameras: Cameras by eye.
        camera_files: The file of each camera.
        video: The dashboard camera's film, or None.
        motion: ``gps``, ``gps_local``, ``imu``, ``imu_2`` where there are such files, read when they are asked for.
    """

    conditions: dict[str, str]
    conditions_from: str
    times_ns: dict[str, int]
    poses: Float[np.ndarray, "n 4 4"] | None
    cameras: dict[str, Camera]
    camera_files: dict[str, Path]
    video: Path | None
    motion: Lazy


def read_sequence(files: FileIndex, sequence: str, *, calibration: str | None = None) -> SequenceFacts:
    """Read what there is of a sequence.

    Args:
        files: The data set's roots.
        sequence: Its name.
        calibration: Release of the camera calibrations, one of :data:`RELEASES`; None takes the newest.

    Raises:
        FileFormatError: If a file is damaged.
    """
    conditions, conditions_from = read_conditions(files, sequence)
    times: dict[str, int] = {}
    for sensor in (*LIDARS, *CAMERAS):
        path = files.find(Path(sequence, "time_info", f"{sensor}.txt"))
        times |= read_times(path) if path is not None else {}
    camera_files = find_camera_files(files, sequence, calibration=calibration)
    motion = motion_files(files.roots, sequence)
    return SequenceFacts(
        conditions=conditions,
        conditions_from=conditions_from,
        times_ns=times,
        poses=read_poses(files.roots, sequence),
        cameras={name: read_camera(path) for name, path in camera_files.items()},
        camera_files=camera_files,
        video=find_video(files.roots, sequence),
        motion=Lazy({name: partial(_READERS[name], path) for name, path in motion.items()}),
    )


def read_conditions(files: FileIndex, sequence: str) -> tuple[dict[str, str], str]:
    """Conditions of a sequence and what says so; the published table's where it has no description.

    A simulated sequence is not a published one, though it bears its number: the table is not asked where the
    simulator's settings or records of frames stand.

    Raises:
        FileFormatError: If the description is damaged.
    """
    for name in DESCRIPTIONS:
        path = files.find(Path(sequence, name))
        if path is not None:
            return read_description(path), "description.txt"
    simulated = any(is_simulated(root) or (root / sequence / "frame_record").exists() for root in files.roots)
    conditions = {} if simulated else published_conditions(sequence)
    return conditions, "published table" if conditions else ""


def find_camera_files(files: FileIndex, sequence: str, *, calibration: str | None = None) -> dict[str, Path]:
    """The calibration file of each eye: of its sequence, or else the one common to all sequences.

    Args:
        files: The data set's roots.
        sequence: Name of the sequence.
        calibration: As :func:`read_sequence`.
    """
    releases = RELEASES if calibration is None else (calibration,)
    folders = [folder for release in releases for folder in _FOLDERS[release]]
    files_by_eye = {}
    for name, number in EYES.items():
        own = [folder / f"seq_{int(sequence):02d}" / f"cam_{number}.yml" for folder in folders]
        if calibration is None:
            eye = f"{name.removesuffix(RIGHT_EYE).removeprefix('cam-')}{int(name.endswith(RIGHT_EYE))}"
            own += [folder / f"seq_{int(sequence):02d}" / f"cam_{number}.yml" for folder in _UNNAMED]
            own += [folder / f"cam_{eye}.yml" for folder in _COMMON]
        path = next((path for candidate in own if (path := files.find(candidate)) is not None), None)
        if path is not None:
            files_by_eye[name] = path
    return files_by_eye


def annotated_poses(facts: SequenceFacts, members: Sequence[int]) -> dict[int, Float[np.ndarray, "4 4"]]:
    """Poses by frame; nothing where the file does not have one for each annotated frame."""
    if facts.poses is None or len(facts.poses) != len(members):
        return {}
    return dict(zip(members, facts.poses, strict=True))


# The dashboard camera's film of a sequence.

DASH = "cam-dash"
FOLDERS = (DASH, "cam_dash")


def find_video(roots: Sequence[Path], sequence: str) -> Path | None:
    """The film of a sequence, ``<sequence>/cam-dash/*.mp4`` or ``<sequence>/cam-dash.mp4``, or None."""
    for root in roots:
        for name in FOLDERS:
            films = sorted((root / sequence).glob(f"{name}/*.mp4")) + sorted((root / sequence).glob(f"{name}*.mp4"))
            if films:
                return films[0]
    return None


def dash_image(video: Path | None, times_ns: Mapping[str, int], time_ns: int | None) -> dict[str, Callable[[], Any]]:
    """Loader of the dashboard camera's image of a frame; none without a film, stamps or PyAV.

    The film has no stamps of the car's clock: it is taken to begin with the first file of its sequence.

    Args:
        video: The film.
        times_ns: Times of the sequence's files.
        time_ns: Time of the frame.
    """
    if video is None or time_ns is None or not times_ns or find_spec("av") is None:
        return {}
    return {DASH: partial(film_frame, video, (time_ns - min(times_ns.values())) / 1e9)}
