"""Read OpenLABEL beside clouds: ``*.json`` of ASAM's schema, one file a sequence, and the clouds that its frames name.

A file's clouds lie in a folder called like it, ``drive.json`` and ``drive/``, or anywhere in its own folder. A frame's
cloud is the file of one of its streams' ``uri``, of the frame's name as Farfield writes it (``frame_id``), or of the
frame's number, where clouds are numbered.
"""

from collections.abc import Iterator, Mapping, Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path, PurePosixPath
from typing import Any

from farfield.datasets.labelled_clouds import LabelledCloud, LabelledClouds, clouds_in
from farfield.datasets.labels.json_labels import OpenLabels
from farfield.errors import DatasetError
from farfield.files.atomic import read_bytes
from farfield.files.json_text import parse_json
from farfield.files.openlabel import frame_name, parse_openlabel, parsed_frames
from farfield.files.stand_ins import stand_in
from farfield.frame.cloud import CLOUD_SUFFIXES

_HEAD_BYTES, _DEEP = 4096, 3
_LATEST_S = 1 << 33  # of a timestamp


def is_openlabel(root: Path) -> bool:
    """Whether a folder holds OpenLABEL's files, with clouds in it."""
    files = label_files(root)
    if clouds_in(root) and not any(b'"openlabel"' in _head(path) for path in files):
        return False  # own folders, whose label files may be stand-ins
    return bool(files) and next(_clouds_below(root), None) is not None


def label_files(root: Path) -> list[Path]:
    """The label files in a folder, or in those in it; a stand-in counts, and is named when read."""
    for pattern in ("*.json", "*/*.json"):
        paths = sorted(path for path in root.glob(pattern) if path.is_file() and not path.name.startswith("."))
        files = [path for path in paths if _is_of_it(path)]
        if files:
            return files
    return []


def _is_of_it(path: Path) -> bool:
    head = _head(path)
    return b'"openlabel"' in head or stand_in(head) is not None


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_HEAD_BYTES)


def _clouds_below(folder: Path, deep: int = _DEEP) -> Iterator[Path]:
    yield from clouds_in(folder)
    for inner in sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")):
        if deep:
            yield from _clouds_below(inner, deep - 1)


class OpenLabel(LabelledClouds):
    """Clouds labelled in OpenLABEL: point cloud ``"lidar"``, boxes whose tracks are the objects' uids, times.

    Boxes stand in the coordinates of their cloud: other coordinate systems of a file are not turned.

    Args:
        root: The folder of label files and clouds.
        bin_columns: Columns of ``.bin`` files; None takes what the largest of the first ones shows.
        intensity_scale: Value that stands for full reflectance in all clouds; None decides by some of them.
        point_times: Unit of the points' times, where the files have any.

    Raises:
        DatasetError: If there is none, or boxes belong to no cloud.
        FileFormatError: If a label file is damaged.
    """

    name = "openlabel"
    looked_at = "*.json of OpenLABEL, with clouds beside them"
    parser = parse_openlabel

    def find(self) -> Sequence[LabelledCloud]:
        """The clouds that each file's frames name, and all others of a file that stands alone."""
        files = label_files(self.root)
        members: list[LabelledCloud] = []
        self._times: dict[Path, int | None] = {}
        for path in files:
            own = path.with_suffix("")
            clouds = list(_clouds_below(own if own.is_dir() else path.parent))
            alone = own.is_dir() or len(files) == 1
            frames = parsed_frames(parse_json(read_bytes(path), path), path)
            frame_of = _frames_of(path, clouds, frames)
            for cloud in clouds:
                number = frame_of.get(cloud)
                if number is None and not alone:
                    continue
                within = cloud.stem if number is None else frame_name(number, frames[number], path)
                self._times[cloud] = None if number is None else _time_ns(frames[number])
                members.append(
                    LabelledCloud(
                        cloud=cloud, sequence=path.stem, labels=path, within=within, annotated=number is not None
                    )
                )
        return members

    def time_ns(self, index: int) -> int | None:
        """The frame's timestamp, where the file has one."""
        return self._times[self.members[index].cloud]


def _frames_of(path: Path, clouds: Sequence[Path], frames: Mapping[str, Mapping[str, Any]]) -> dict[Path, str]:
    """The frame's number of each cloud.

    Raises:
        DatasetError: If a frame with objects has no cloud, or two clouds.
    """
    by_stem: dict[str, list[Path]] = {}
    for cloud in clouds:
        by_stem.setdefault(cloud.stem, []).append(cloud)
    by_number = {int(stem): stem for stem in by_stem if stem.isascii() and stem.isdigit() and len(stem) < 18}
    frame_of: dict[Path, str] = {}
    for number, frame in frames.items():
        names = [*_uris(frame), frame_name(number, frame, path)]
        names += [by_number.get(int(number), "")] if number.isascii() and number.isdigit() and len(number) < 18 else []
        matches = next((by_stem[name] for name in names if name in by_stem), [])
        objects = frame.get("objects")
        if len(matches) == 1 and matches[0] not in frame_of:
            frame_of[matches[0]] = number
        elif objects or len(matches) > 1:
            raise DatasetError(
                f"{path}: expected each frame with objects to have one cloud, found "
                f"{len(matches) or 'none'} for frame {number} ({', '.join(dict.fromkeys(filter(None, names)))}). Name "
                "clouds by the streams' uri, the frame's frame_id or its number"
            )
    return frame_of


def _uris(frame: Mapping[str, Any]) -> list[str]:
    """Stems of the clouds that a frame's streams name."""
    properties = frame.get("frame_properties")
    streams = properties.get("streams") if isinstance(properties, dict) else None
    held = [stream for stream in streams.values() if isinstance(stream, dict)] if isinstance(streams, dict) else []
    named = [stream.get("uri") or _inner(stream) for stream in held]
    paths = [PurePosixPath(uri.replace("\\", "/")) for uri in named if isinstance(uri, str)]
    return [path.stem for path in paths if path.suffix.lower() in CLOUD_SUFFIXES]


def _inner(stream: Mapping[str, Any]) -> Any:
    properties = stream.get("stream_properties")
    return properties.get("uri") if isinstance(properties, dict) else None


def _time_ns(frame: Mapping[str, Any]) -> int | None:
    """A frame's timestamp, seconds as text or number; None where it is neither."""
    properties = frame.get("frame_properties")
    value = properties.get("timestamp") if isinstance(properties, dict) else None
    if isinstance(value, bool) or not isinstance(value, str | int | float) or len(str(value)) > 40:
        return None
    try:
        seconds = Decimal(str(value))
    except InvalidOperation:
        return None
    return int(seconds * 10**9) if seconds.is_finite() and 0 <= seconds < _LATEST_S else None


def label_format(data: OpenLabel) -> OpenLabels:
    """The label files of a data set, to edit them."""
    members = list(zip(data.keys, data.members, strict=True))
    return OpenLabels(
        data.root,
        paths={key: member.labels for key, member in members},
        frames={key: member.within for key, member in members},
    )
