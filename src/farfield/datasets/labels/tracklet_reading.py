"""The tracklets of a drive read onto its sweeps: what the file's numbers stand for, and which sweep a frame number is.

KITTI's own files and those of CVAT and Datumaro have the same elements with other meanings. Which a file has is decided
by ``frame_list.txt`` beside it and by the writer's marks; else by the points in the boxes, whose volume is the same
under each; else by the shapes of road users. A frame number is the sweep that ``frame_list.txt`` names; else the sweep
whose name is that number; else, where names are no numbers, the place in the order of the names.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePosixPath

import numpy as np

from farfield.errors import ConfigError, DatasetError
from farfield.files.atomic import read_bytes
from farfield.files.cuboids import Cuboid
from farfield.files.tracklets import (
    CONVENTIONS,
    Convention,
    ConventionName,
    parse_frame_list,
    parse_tracklets,
    tracklet_writer,
)
from farfield.frame import Boxes
from farfield.frame.cloud import CLOUD_SUFFIXES, CloudSettings, read_cloud
from farfield.geometry.boxes import count_points_in_boxes
from farfield.vocabulary.classes import CIRRUS_FROM_TOOLS, normalised_class
from farfield.vocabulary.counts import count_of

FRAME_LIST = "frame_list.txt"
_MARKS = "the writer's marks"
_SWEEPS_LOOKED_AT = 6
_LEAST_POINTS, _CLEARLY = 10, 1.15
_LONG = ("vehicle", "large_vehicle", "trailer", "bicycle", "motorcycle")
_TALL = ("pedestrian",)


@dataclass(frozen=True, kw_only=True)
class TrackletReading:
    """A drive's tracklets.

    Args:
        path: The file.
        convention: What the file's numbers stand for.
        reason: By what that was decided.
        numbers: The frame number of each sweep, by its name; -1 where the list does not name it.
        cuboids: The boxes of each frame number.
    """

    path: Path
    convention: Convention
    reason: str
    numbers: Mapping[str, int]
    cuboids: Mapping[int, tuple[Cuboid, ...]]

    @property
    def published(self) -> bool:
        """Whether it is KITTI's own file by its marks, of which nothing needs to be said."""
        return self.convention.name == "kitti" and self.reason == _MARKS

    @property
    def sentence(self) -> str:
        """What the numbers are taken for, by what that was decided, and how to overrule it."""
        name, *others = dict.fromkeys([self.convention.name, *CONVENTIONS])
        words = "centre of the bottom, h is the height" if self.convention.bottom else "centre, l is the height"
        return (
            f"{self.path.name} of {self.path.parent.resolve().name} is read as {name}'s (tz is the {words}): "
            f"{self.reason}. --tracklets {' or '.join(others)} overrules it"
        )

    def boxes(self, stem: str) -> tuple[Cuboid, ...]:
        """The boxes of a sweep, by its name."""
        return self.cuboids.get(self.numbers[stem], ())


def read_tracklets(
    path: Path, clouds: Sequence[Path], *, convention: str | None = None, bin_columns: int | None = None
) -> TrackletReading:
    """Read a drive's tracklets; the file is parsed once while it stays.

    Args:
        path: ``tracklet_labels.xml``.
        clouds: The drive's sweeps, in the order of their names.
        convention: One of :data:`~farfield.files.tracklets.CONVENTIONS`; None decides.
        bin_columns: Columns of ``.bin`` sweeps, whose points may decide.

    Raises:
        ConfigError: If there is no such convention.
        FileFormatError: If the file or the list beside it is damaged.
        DatasetError: If boxes belong to frames of which it is not known which sweeps they are.
    """
    checked_convention(convention)
    if not path.is_file():
        numbers = _numbers_by_name([cloud.stem for cloud in clouds], set(), path, own=True)
        reason = "there is no file yet"
        return TrackletReading(path=path, convention=CONVENTIONS["kitti"], reason=reason, numbers=numbers, cuboids={})
    beside = path.with_name(FRAME_LIST)
    states = tuple((file.stat().st_mtime_ns, file.stat().st_size) for file in (path, beside) if file.is_file())
    return _reading(path, tuple(clouds), convention, bin_columns, states)


def checked_convention(convention: str | None) -> None:
    """Refuse a convention that there is not.

    Raises:
        ConfigError: If it is neither None nor one of them.
    """
    if convention is not None and convention not in CONVENTIONS:
        raise ConfigError(f"tracklets: expected one of {', '.join(CONVENTIONS)}, got {convention!r}")


@lru_cache(maxsize=64)
def _reading(
    path: Path,
    clouds: tuple[Path, ...],
    convention: ConventionName | None,
    bin_columns: int | None,
    states: tuple[tuple[int, int], ...],
) -> TrackletReading:
    del states
    data, beside = read_bytes(path), path.with_name(FRAME_LIST)
    listed = parse_frame_list(read_bytes(beside), beside) if beside.is_file() else None
    writer = tracklet_writer(data, path)
    by_frame = {name: _by_frame(parse_tracklets(data, path, CONVENTIONS[name])) for name in CONVENTIONS}
    frames = set(by_frame["kitti"])
    if listed is not None:
        numbers = _numbers_by_list(listed, frames, clouds, beside)
    else:
        numbers = _numbers_by_name([cloud.stem for cloud in clouds], frames, path, own=writer == "kitti")
    if convention is not None:
        name, reason = convention, "as the flag says"
    else:
        mark = f"{FRAME_LIST} beside it" if listed is not None else _MARKS if writer else ""
        tool = listed is not None or writer == "tool"
        names: list[ConventionName] = ["cvat", "datumaro"] if tool else ["kitti"] if writer else [*CONVENTIONS]
        sweeps = {numbers[cloud.stem]: cloud for cloud in clouds}
        name, reason = _decided(by_frame, names, sweeps, bin_columns)
        reason = ", ".join(filter(None, (mark, reason)))
    return TrackletReading(
        path=path, convention=CONVENTIONS[name], reason=reason, numbers=numbers, cuboids=by_frame[name]
    )


def _by_frame(cuboids: Sequence[Cuboid]) -> dict[int, tuple[Cuboid, ...]]:
    rows: dict[int, list[Cuboid]] = {}
    for cuboid in cuboids:
        rows.setdefault(int(cuboid.frame), []).append(cuboid)
    return {frame: tuple(boxes) for frame, boxes in rows.items()}


# Which sweep a frame number is.


def _numbers_by_list(
    listed: Mapping[int, str], frames: set[int], clouds: Sequence[Path], beside: Path
) -> dict[str, int]:
    """Frame numbers as the list names their sweeps."""
    stems = {cloud.stem for cloud in clouds}
    named = {number: _stem_of(name, stems) for number, name in listed.items()}
    unlisted = sorted(frames - set(named))
    if unlisted:
        raise DatasetError(
            f"{beside}: expected a line for each frame that has boxes, found none for {unlisted[:5]}. "
            "Export the list anew with the boxes."
        )
    missing = [listed[number] for number in sorted(frames) if named[number] not in stems]
    if missing:
        raise DatasetError(
            f"{beside}: expected the sweeps that it names for frames with boxes, found no {', '.join(missing[:3])} "
            f"among {clouds[0].name} ... {clouds[-1].name}. Put those sweeps there, or export boxes and list anew."
        )
    number_of: dict[str, int] = {}
    for number, stem in named.items():
        other = number_of.setdefault(stem, number)
        if stem in stems and other != number:
            raise DatasetError(
                f"{beside}: expected each sweep once, got {listed[other]!r} and {listed[number]!r}, which both are "
                f"{stem}: boxes of two sweeps would stand on one. Give the sweeps names of their own and export anew."
            )
    return {cloud.stem: number_of.get(cloud.stem, -1) for cloud in clouds}


def _stem_of(name: str, stems: set[str]) -> str:
    """The sweep that a name in the list stands for: itself, without its folders, or without its suffix."""
    last = PurePosixPath(name.replace("\\", "/")).name
    plain = last[: -len(PurePosixPath(last).suffix)] if PurePosixPath(last).suffix.lower() in CLOUD_SUFFIXES else last
    return next((candidate for candidate in (name, last, plain) if candidate in stems), plain)


def _numbers_by_name(stems: Sequence[str], frames: set[int], path: Path, *, own: bool) -> dict[str, int]:
    """Frame numbers as the sweeps are called, or their places in the order of their names.

    Args:
        stems: The sweeps' names in order.
        frames: Frame numbers with boxes.
        path: The file of the boxes, for messages.
        own: Whether the file is KITTI's own, which may hold boxes of sweeps that are not there.
    """
    fix = f"Put {FRAME_LIST} beside it, with a line NUMBER NAME for each sweep, as CVAT and Datumaro write it."
    shown = f"sweeps {stems[0]} ... {stems[-1]}, boxes of frames {min(frames, default=0)} to {max(frames, default=0)}"
    numeric = all(stem.isascii() and stem.isdigit() for stem in stems)
    values = [int(stem) for stem in stems] if numeric else list(range(len(stems)))
    strangers = frames - set(values)
    if numeric and len(set(values)) < len(values):
        raise DatasetError(f"{path}: expected sweeps of different numbers, found two of one: {shown}. {fix}")
    if frames and strangers == frames:
        raise DatasetError(f"{path}: expected boxes of frames that are called like sweeps, found none: {shown}. {fix}")
    if strangers and not own and (max(frames) < len(stems) or not numeric):
        raise DatasetError(
            f"{path}: expected frame numbers that are the sweeps' names, found {len(strangers)} frames without a sweep "
            f"({shown}): they may count the sweeps instead. {fix}"
        )
    if frames and not numeric and _counts_from_elsewhere(stems):
        raise DatasetError(
            f"{path}: the sweeps' names are numbered, and not from 0 on by one, so it is not known whether a frame "
            f"number is a name's or a place in their order: {shown}. {fix}"
        )
    return dict(zip(stems, values, strict=True))


def _counts_from_elsewhere(stems: Sequence[str]) -> bool:
    """Whether names such as ``frame_000005`` end in numbers other than their places."""
    tails = [stem[len(stem.rstrip("0123456789")) :] for stem in stems]
    return all(tails) and [int(tail) for tail in tails] != list(range(len(stems)))


# What the numbers stand for.

_PLACES_ALONE = CloudSettings(intensity_scale=np.inf, point_times="none")  # neither a scale nor a unit is in doubt


def _decided(
    by_frame: Mapping[ConventionName, Mapping[int, tuple[Cuboid, ...]]],
    names: Sequence[ConventionName],
    sweeps: Mapping[int, Path],
    bin_columns: int | None,
) -> tuple[ConventionName, str]:
    """Of some conventions the one under which boxes hold the most points, else that which shapes fit best."""
    if len(names) == 1:
        return names[0], ""
    frames = [frame for frame in sorted(by_frame[names[0]]) if frame in sweeps]
    counts = dict.fromkeys(names, 0)
    spread = np.linspace(0, len(frames) - 1, min(len(frames), _SWEEPS_LOOKED_AT)).round().astype(int)
    for frame in (frames[row] for row in spread):
        points_m = read_cloud(sweeps[frame], _PLACES_ALONE, bin_columns=bin_columns).points_m.astype(np.float64)
        for name in names:
            counts[name] += int(count_points_in_boxes(points_m, _boxes(by_frame[name][frame])).sum())
    best, second = sorted(names, key=lambda name: -counts[name])[:2]
    if counts[best] >= _LEAST_POINTS and counts[best] > _CLEARLY * counts[second]:
        others = ", ".join(f"{counts[name]} as {name}" for name in names if name != best)
        return best, f"the points in the boxes ({counts[best]}, {others})"
    cuboids = [cuboid for frame in by_frame[names[0]].values() for cuboid in frame]
    fits = {name: sum(_fits(cuboid) for rows in by_frame[name].values() for cuboid in rows) for name in names}
    best = max(names, key=lambda name: fits[name])
    if fits[best] > sum(sorted(fits.values())[:-1][-1:]):
        return best, f"the shapes of {fits[best]} of {count_of(len(cuboids), 'box', 'boxes')}"
    return best, "assumed: neither points nor shapes decide"


def _boxes(cuboids: Sequence[Cuboid]) -> Boxes:
    rows = np.array([cuboid.box for cuboid in cuboids], dtype=np.float64).reshape(-1, 7)
    return Boxes(centre_m=rows[:, :3], size_m=rows[:, 3:6], yaw_rad=rows[:, 6])


def _fits(cuboid: Cuboid) -> bool:
    """Whether a box has its class's shape: vehicles are longest along their heading, people are tallest."""
    label = normalised_class(cuboid.label, CIRRUS_FROM_TOOLS)
    length, width, height = cuboid.box[3:6]
    if label in _LONG:
        return length > max(width, height) and (label not in ("bicycle", "motorcycle") or height > width)
    return label in _TALL and height > max(length, width)
