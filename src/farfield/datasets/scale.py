"""Read LiDAR tasks of Scale: the frames as they were uploaded, and the answer with the cuboids of each.

A folder of frames is a sequence. Its answer (a list of ``{"cuboids"}``, one a frame) lies in it, or in a folder above
it up to the root; so does the task's own JSON (``attachments``), where there is one. Without that the frames are in the
order of their names, numbers in them by their size.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from farfield.datasets.base import Dataset, Indices, Poses
from farfield.datasets.labelled_clouds import folders_with, names_of_folders
from farfield.datasets.labels.json_labels import annotation_of
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.atomic import read_bytes
from farfield.files.images import image_size, read_image
from farfield.files.limits import MAX_BYTES
from farfield.files.map_coordinates import beyond_any_sensor
from farfield.files.point_times import OFFSET_COLUMN
from farfield.files.remote_paths import as_path
from farfield.files.scale import (
    ScaleCamera,
    ScaleFrame,
    ScaleOrder,
    ScalePoints,
    TimeUnit,
    cuboids_of,
    parse_answer,
    parse_frame,
    parse_order,
    parse_points,
)
from farfield.frame import Annotation, Camera, Cloud, Constant, Frame, Lazy, Sensor
from farfield.frame.record import camera_sensor
from farfield.geometry.poses import invert, transform_points
from farfield.vocabulary.counts import count_of

_HEAD_BYTES, _LOOKED_AT, _DEEP = 1 << 16, 8, 2
_IMAGES = (".jpg", ".jpeg", ".png")
_LONGEST_NS = 60 * 10**9
_COUNT, _STILL = "numberOfPoints", "stationary"


def is_scale(root: Path) -> bool:
    """Whether a folder holds frames of Scale, directly or up to two folders down."""
    return bool(_folders(root))


def _folders(root: Path) -> list[Path]:
    return folders_with(root, _has_frames, deep=_DEEP)


def _has_frames(folder: Path) -> bool:
    """Whether one of the first JSON files of a folder is a frame; the device's pose may stand behind the points."""
    for path in islice(_jsons(folder), _LOOKED_AT):
        head = _head(path)
        if _kind(head) == "frame":
            return b'"device_position"' in head or b'"device_position"' in _all_of(path)
    return False


def _jsons(folder: Path) -> Iterator[Path]:
    paths = (path for path in folder.glob("*.json") if not path.name.startswith(".") and path.is_file())
    return iter(sorted(paths, key=_by_numbers))


def _by_numbers(path: Path) -> tuple[tuple[int, int, str], ...]:
    """A key that puts frame-9 before frame-10."""
    parts = re.findall(r"[0-9]+|[^0-9]+", path.stem)
    return (
        *((0, int(part), "") if part.isascii() and part.isdecimal() else (1, 0, part) for part in parts),
        (2, 0, path.name),
    )


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_HEAD_BYTES)


def _all_of(path: Path) -> bytes:
    return b"" if path.stat().st_size > MAX_BYTES else read_bytes(path)


def _kind(head: bytes) -> str:
    """What a JSON file is by its beginning: a frame, an answer, a task's own, or none of them (empty)."""
    first = head.removeprefix(b"\xef\xbb\xbf").lstrip()[:1]
    if first == b"[":
        return "answer" if b'"cuboids"' in head else ""
    if first != b"{":
        return ""
    if b'"attachments"' in head:
        return "task"
    return "frame" if b'"points"' in head or b'"device_position"' in head else ""


@dataclass(frozen=True, kw_only=True)
class _Member:
    """One frame: its file, its sequence, its answer and its place there, and metres of one unit."""

    path: Path
    sequence: str
    answer: Path | None
    number: int
    metres_per_unit: float


class ScaleAi(Dataset):
    """A task of Scale's LiDAR annotation: cloud ``"lidar"``, boxes with tracks, poses, images that lie beside it.

    Frames stand in the device's coordinates, into which its pose brings points, cuboids and cameras from the world.
    Points have ``device``, ``offset_ns`` and ``is_ground`` where the file says them. ``numberOfPoints`` is the boxes'
    ``point_count``, ``stationary`` its contrary in ``moving``; ``camera_used``, ``distance_to_device`` and attributes
    are ``annotation.details``. Cameras are called ``camera_0`` and so on, by ``camera_index`` or their place; one whose
    lens is no pinhole of Brown and Conrady without skew has no place in ``cameras`` and stands in ``metadata["lens"]``.

    Args:
        root: The task's folder, or that of several.
        answer: Name of the answer's file where there are several.
        metres_per_unit: Metres of one unit of all coordinates; None: as the task's own JSON says, else 1.
        intensity_scale: Value of ``i`` that stands for full reflectance; None: 1, as Scale's page says.
        time_unit: Unit of the times of frames and images; those of points are nanoseconds.

    Raises:
        DatasetError: If there are no frames, or frames, task and answer do not match.
        FileFormatError: If an answer or a task's own JSON is damaged.
        ConfigError: If an option is none.
    """

    name = "scale"

    def __init__(
        self,
        root: Path | str,
        *,
        answer: str = "",
        metres_per_unit: float | int | None = None,
        intensity_scale: float | int | None = None,
        time_unit: TimeUnit = "ns",
    ) -> None:
        for name, value in (("metres_per_unit", metres_per_unit), ("intensity_scale", intensity_scale)):
            if value is not None and not 0 < value < 1e6:
                raise ConfigError(f"scale: expected a number above 0 as {name}, got {value!r}")
        if time_unit not in ("ns", "us", "ms", "s"):
            raise ConfigError(f"scale: expected time_unit to be one of ns, us, ms, s, got {time_unit!r}")
        self.root, self.answer = as_path(root), answer
        self.metres_per_unit, self.intensity_scale, self.time_unit = metres_per_unit, intensity_scale, time_unit
        self._ordered = True
        folders = _folders(self.root)
        names = names_of_folders(self.root, folders)
        self.members = tuple(member for folder in folders for member in self._of_folder(folder, folders, names[folder]))
        if not self.members:
            raise DatasetError(f"{self.root}: expected frames of Scale (*.json with device_position), found none")
        self.sequences = tuple(member.sequence for member in self.members)
        self.frame_ids = tuple(member.path.stem for member in self.members)

    def _of_folder(self, folder: Path, folders: Sequence[Path], sequence: str) -> list[_Member]:
        files = {path.name: path for path in _jsons(folder) if _kind(_head(path)) == "frame"}
        order = None
        for task in self._beside(folder, folders, "task"):
            if order is not None and parse_order(read_bytes(task), task) != order:
                raise DatasetError(f"{task}: expected the same frames as in the other task beside it, found others")
            order = order or parse_order(read_bytes(task), task)
            files = _in_order(files, order, task)
        self._ordered &= order is not None
        answers = self._beside(folder, folders, "answer")
        if len(answers) > 1:
            shown = ", ".join(path.name for path in answers[:5])
            expected = f"one answer of Scale for {folder}"
            raise DatasetError(
                f"{answers[0].parent}: expected {expected}, found {shown}; name the one with --reader answer=NAME"
            )
        answer = answers[0] if answers else None
        if answer is not None:
            _check_count(answer, list(files.values()))
        unit_m = 1.0 if order is None else order.metres_per_unit or 1.0
        metres_per_unit = float(self.metres_per_unit or unit_m)
        return [
            _Member(path=path, sequence=sequence, answer=answer, number=number, metres_per_unit=metres_per_unit)
            for number, path in enumerate(files.values())
        ]

    def _beside(self, folder: Path, folders: Sequence[Path], kind: str) -> list[Path]:
        """Answers or tasks of a folder of frames: in it, or above it, named like it where it is one of several."""
        for above in _upwards(folder, self.root):
            paths = [path for path in _jsons(above) if _kind(_head(path)) == kind]
            if kind == "answer" and self.answer:
                paths = [path for path in paths if path.name == self.answer]
            if sum(other.is_relative_to(above) for other in folders) > 1:
                paths = [path for path in paths if path.stem == folder.name]
            if paths:
                return paths
        if kind == "answer" and self.answer:
            raise DatasetError(f"{folder}: expected the answer {self.answer!r} in it or above it, found none")
        return []

    @property
    def assumptions(self) -> tuple[str, ...]:
        """How frames and answers were matched, and in what unit coordinates are, where nothing says it."""
        matched = any(member.answer is not None for member in self.members) and not self._ordered
        order = "scale: frames and answer are matched by the order of the files' names (numbers by their size): "
        return (f"{order}a task's own JSON with its attachments beside them decides otherwise",) if matched else ()

    @property
    def notes(self) -> tuple[str, ...]:
        """Cameras whose lenses cannot be used, as the first frame tells; a damaged one tells when it is read."""
        try:
            cameras = self._frame(0).cameras
        except FileFormatError:
            return ()
        unlike = [f"camera_{camera.number} ({camera.unlike})" for camera in cameras if camera.unlike]
        which = ", ".join(unlike)
        return (f"scale: pictures are shown without calibration of {which}: no pinhole without skew",) if unlike else ()

    def _frame(self, index: int) -> ScaleFrame:
        member = self.members[index]
        status = member.path.stat()
        return _frame_of(member.path, member.metres_per_unit, self.time_unit, status.st_mtime_ns, status.st_size)

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``."""
        member = self.members[index]
        pictures = [path for _, path in self._pictures(index) if path is not None]
        return [member.path, *([] if member.answer is None else [member.answer]), *pictures]

    def _pictures(self, index: int) -> list[tuple[ScaleCamera, Path | None]]:
        """The cameras of a frame, each with its picture where it lies there."""
        path = self.members[index].path
        folders = _upwards(path.parent, self.root)
        paths = [(camera, _picture(camera, folders)) for camera in self._frame(index).cameras]
        there = [picture for _, picture in paths if picture is not None]
        if len(set(there)) < len(there):
            twin = next(picture for picture in there if there.count(picture) > 1)
            raise FileFormatError(path, where="images", expected="a picture for each camera", got=f"{twin} for two")
        return paths

    def has_annotation(self, index: int) -> bool:
        """Whether the task has an answer."""
        return self.members[index].answer is not None

    def annotation(self, index: int) -> Annotation | None:
        """The boxes of frame ``index``."""
        return _annotation(self.members[index], self.time_unit) if self.has_annotation(index) else None

    def _times_of(self, indices: Indices) -> Indices | None:
        times = [self._frame(int(index)).time_ns for index in indices]
        if any(time is None for time in times):
            return None
        times_ns = np.array(times, dtype=np.int64)
        late = np.flatnonzero(np.diff(times_ns) < 0)
        if len(late):
            before, after = (self.members[int(indices[late[0] + step])].path for step in (0, 1))
            raise DatasetError(
                f"{after}: expected a timestamp from that of {before.name} on, which comes before it in the order of "
                "the task (or of the names, without a task's own JSON), found an earlier one: frames and answer may "
                "not match"
            )
        return times_ns

    def _poses_of(self, indices: Indices) -> Poses | None:
        return np.stack([self._frame(int(index)).world_T_device for index in indices])

    def frame(self, index: int) -> Frame:
        """Build frame ``index``.

        Raises:
            FileFormatError: If a file is damaged.
        """
        member, frame = self.members[index], self._frame(index)
        pictures = self._pictures(index)
        cameras = {_name(camera): _camera(camera, path, frame) for camera, path in pictures if not camera.unlike}
        sensors = {_name(camera): camera_sensor(cameras.get(_name(camera)), camera.time_ns) for camera, _ in pictures}
        lenses = {_name(camera): camera.unlike for camera, _ in pictures if camera.unlike}
        metadata: dict[str, Any] = {"files": Constant([str(path) for path in self.files(index)])}
        if lenses:
            metadata["lens"] = Constant(lenses)
        load = partial(_cloud, member, self.intensity_scale, self.time_unit)
        return Frame(
            sequence=member.sequence,
            frame_id=self.frame_ids[index],
            time_ns=frame.time_ns,
            clouds=Lazy({"lidar": load}),
            images=Lazy({_name(camera): partial(read_image, path) for camera, path in pictures if path is not None}),
            cameras=cameras,
            sensors={"lidar": Sensor(kind="lidar", frame_T_sensor=np.eye(4), time_ns=frame.time_ns), **sensors},
            load_annotation=None if member.answer is None else partial(_annotation, member, self.time_unit),
            world_T_frame=frame.world_T_device,
            metadata=Lazy(metadata),
        )


def _upwards(folder: Path, root: Path) -> list[Path]:
    """A folder and those above it up to the root."""
    folders = [folder]
    while folders[-1] != root and len(folders) <= _DEEP:
        folders.append(folders[-1].parent)
    return folders


def _in_order(files: dict[str, Path], order: ScaleOrder, task: Path) -> dict[str, Path]:
    """The frames' files in the order of a task's attachments.

    Raises:
        DatasetError: If an attachment is not there, or a file is no attachment.
    """
    for number, name in enumerate(order.attachments):
        if name not in files:
            raise DatasetError(f"{task}: expected the file of frame {number}, {name!r}, found none: download it")
    rest = [name for name in files if name not in order.attachments]
    if rest:
        raise DatasetError(f"{files[rest[0]]}: expected an attachment of {task}, found it in none of its frames")
    return {name: files[name] for name in order.attachments}


def _check_count(answer: Path, frames: Sequence[Path]) -> None:
    count = len(_answer_of(answer))
    if count != len(frames):
        got = f"those of {count_of(count, 'frame')}"
        more = f"frame {len(frames)} has no file" if count > len(frames) else f"{frames[count].name} has no cuboids"
        raise DatasetError(f"{answer}: expected cuboids of {count_of(len(frames), 'frame')}, found {got}: {more}")


def _answer_of(path: Path) -> tuple[tuple[Any, ...], ...]:
    status = path.stat()
    return _parsed(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=4)
def _parsed(path: Path, changed_ns: int, size: int) -> tuple[tuple[Any, ...], ...]:
    """An answer, parsed once while it stays."""
    del changed_ns, size
    return parse_answer(read_bytes(path), path)


@lru_cache(maxsize=1024)
def _frame_of(path: Path, metres_per_unit: float, time_unit: TimeUnit, changed_ns: int, size: int) -> ScaleFrame:
    """What a frame's file says beside its points, parsed once while it stays."""
    del changed_ns, size
    return parse_frame(read_bytes(path), path, metres_per_unit=metres_per_unit, time_unit=time_unit)


def _frame_at(member: _Member, time_unit: TimeUnit) -> ScaleFrame:
    status = member.path.stat()
    return _frame_of(member.path, member.metres_per_unit, time_unit, status.st_mtime_ns, status.st_size)


def _picture(camera: ScaleCamera, folders: Sequence[Path]) -> Path | None:
    """Where an image lies: by the longest end of its address that is there, or by its name in ``images``."""
    if not camera.address[-1].lower().endswith(_IMAGES):
        return None
    ends = [camera.address[-length:] for length in range(min(3, len(camera.address)), 0, -1)]
    places = [folder.joinpath(*end) for end in (*ends, ("images", camera.address[-1])) for folder in folders]
    return next((path for path in places if path.is_file()), None)


def _name(camera: ScaleCamera) -> str:
    return f"camera_{camera.number}"


def _camera(camera: ScaleCamera, picture: Path | None, frame: ScaleFrame) -> Camera:
    width, height = (0, 0) if picture is None else image_size(picture)
    pose = invert(camera.world_T_camera) @ frame.world_T_device
    return Camera(
        matrix=camera.matrix, distortion=camera.distortion, camera_T_lidar=pose, width_px=width, height_px=height
    )


def _cloud(member: _Member, intensity_scale: float | int | None, time_unit: TimeUnit) -> Cloud:
    """The points in the device's coordinates."""
    frame = _frame_at(member, time_unit)
    points = parse_points(read_bytes(member.path), member.path, metres_per_unit=member.metres_per_unit)
    points_m = transform_points(invert(frame.world_T_device), points.world_m)
    if away_m := beyond_any_sensor(points_m):
        expected = "points round device_position: both stand in one world"
        got = f"points of which the nearest lies {away_m:.4g} m away from it"
        raise FileFormatError(member.path, where="points", expected=expected, got=got)
    extra: dict[str, np.ndarray] = {} if points.device is None else {"device": points.device}
    if points.time_ns is not None:
        extra[OFFSET_COLUMN] = _offsets(points.time_ns, frame.time_ns, member.path)
    if points.ground is not None:
        extra["is_ground"] = points.ground
    return Cloud(points_m, _intensity(points, intensity_scale, member.path), extra)


def _offsets(time_ns: np.ndarray, frame_ns: int | None, path: Path) -> np.ndarray:
    """Times of points since that of the frame, or since the first of them where the frame says none."""
    offsets: np.ndarray = time_ns - (int(time_ns.min()) if frame_ns is None else frame_ns)
    if np.abs(offsets).max() > _LONGEST_NS:
        row = int(np.abs(offsets).argmax())
        expected = "times of points in nanoseconds, within a minute of the frame's"
        raise FileFormatError(path, where=f"point {row}", expected=expected, got=f"{offsets[row] / 1e9:g} s from it")
    return offsets


def _intensity(points: ScalePoints, scale: float | int | None, path: Path) -> Float32[np.ndarray, " n"] | None:
    if points.intensity is None:
        return None
    values = points.intensity / (1 if scale is None else scale)
    if len(values) and not (values.min() >= 0 and values.max() <= 1):
        row = int(np.argmax(~((values >= 0) & (values <= 1))))
        fix = "Say which value stands for full reflectance: --reader intensity_scale=255."
        expected = f"intensities i from 0 to {1 if scale is None else scale:g}"
        raise FileFormatError(path, where=f"point {row}", expected=expected, got=f"{points.intensity[row]:g}", fix=fix)
    return values.astype(np.float32)


def _annotation(member: _Member, time_unit: TimeUnit) -> Annotation:
    """The boxes of a frame, its counts of points and what moves where all of its boxes say it."""
    assert member.answer is not None
    frames = _answer_of(member.answer)
    where = f"frame {member.number} ({member.path.name})"
    if member.number >= len(frames):
        raise FileFormatError(member.answer, where=where, expected="its cuboids", got=f"{len(frames)} frames")
    pose = _frame_at(member, time_unit).world_T_device
    cuboids = cuboids_of(frames[member.number], pose, member.answer, where, metres_per_unit=member.metres_per_unit)
    counts = [cuboid.attributes.get(_COUNT) for cuboid in cuboids]
    still = [cuboid.attributes.get(_STILL) for cuboid in cuboids]
    annotation = annotation_of(cuboids)
    details = dict(annotation.details)
    if cuboids and all(isinstance(flag, bool) for flag in still):
        del details[_STILL]
        annotation = replace(annotation, moving=np.array([not flag for flag in still]), details=details)
    if cuboids and all(
        isinstance(count, int | float) and 0 <= count < 2**31 and count == int(count) for count in counts
    ):
        del details[_COUNT]
        whole = np.array(counts, dtype=np.int64)
        annotation = replace(annotation, boxes=replace(annotation.boxes, point_count=whole), details=details)
    return annotation
