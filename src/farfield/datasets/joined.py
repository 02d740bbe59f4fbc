"""Several data sets as one: a user's drives that lie in folders of their own.

What is seen alike in all of them (a turn, poses, classes) lies over the whole, as over a single data set: labels that
are laid over the frames go beneath it, the fingerprint tells it, and a detector's own view takes its place.
"""

from collections.abc import Mapping, Sequence
from itertools import accumulate
from os.path import commonpath
from pathlib import Path
from textwrap import shorten
from typing import Any

from farfield.datasets.base import Dataset, Indices
from farfield.datasets.class_mapping import class_mapping_of
from farfield.datasets.frame_maps import FrameMap, described
from farfield.errors import DatasetError
from farfield.frame import Annotation, Drive, Frame


class Joined(Dataset):
    """The frames of several data sets, one after the other; each is built by its own reader when it is indexed.

    Args:
        parts: The readers; their sequences have different names. :func:`joined` takes data sets with maps, too.

    Raises:
        DatasetError: If there is none, or two have a sequence of one name.
    """

    name = "joined"

    def __init__(self, parts: Sequence[Dataset]) -> None:
        if not parts:
            raise DatasetError("expected at least one data set to join, got none.")
        self.parts = tuple(parts)
        self.starts = tuple(accumulate((len(part) for part in parts), initial=0))
        self.root = Path(commonpath([part.root.resolve() for part in parts]))
        self.sequences = tuple(name for part in parts for name in part.sequences)
        self.frame_ids = tuple(name for part in parts for name in part.frame_ids)
        self.stored = all(part.stored for part in parts)
        self.protocol = parts[0].protocol
        shared = [set(part.references) for part in parts]
        self.references = tuple(name for name in parts[0].references if all(name in names for names in shared))
        self.view_options = tuple(
            name for name in parts[0].view_options if all(name in part.view_options for part in parts)
        )
        self.options = {"parts": [{"format": part.name, "options": dict(part.options)} for part in parts]}
        self._check_names()

    def _check_names(self) -> None:
        root_of: dict[str, Path] = {}
        for part in self.parts:
            for name in dict.fromkeys(part.sequences):
                if name in root_of:
                    raise DatasetError(
                        f"{part.root}: expected drives of different names, found {name!r} in {root_of[name]} too. "
                        "Name one folder otherwise, or name each once. Where a name is the part's, such as training of "
                        "KITTI's object set, such sets cannot be joined as they are: take one of them."
                    )
                root_of[name] = part.root

    @property
    def maps(self) -> tuple[FrameMap, ...]:
        """The maps that the readers themselves have, all the same."""
        return self.parts[0].maps

    @property
    def class_mapping(self) -> Mapping[str, str]:
        """Classes by the names in the files, of all parts."""
        return {name: ours for part in self.parts for name, ours in class_mapping_of(part).items()}

    def _part(self, index: int) -> tuple[Dataset, int]:
        """The data set of a frame, and its index there."""
        number = sum(index >= start for start in self.starts[1:])
        return self.parts[number], index - self.starts[number]

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        part, own = self._part(index)
        return part.frame(own)

    def files(self, index: int) -> Sequence[Path]:
        """List the files that frame ``index`` is read from."""
        part, own = self._part(index)
        return part.files(own)

    def measurement(self, index: int) -> int:
        """Number of what was measured in frame ``index`` among that of its files."""
        part, own = self._part(index)
        return part.measurement(own)

    def annotation(self, index: int) -> Annotation | None:
        """What was annotated in frame ``index``."""
        part, own = self._part(index)
        return part.annotation(own)

    def has_annotation(self, index: int) -> bool:
        """Whether frame ``index`` was annotated."""
        part, own = self._part(index)
        return part.has_annotation(own)

    def before(self, index: int, k: int) -> Frame | None:
        """The k-th frame before frame ``index`` in its drive."""
        part, own = self._part(index)
        return part.before(own, k)

    def files_before(self, index: int, k: int) -> Sequence[Path]:
        """Files of the k-th frame before frame ``index`` in its drive."""
        part, own = self._part(index)
        return part.files_before(own, k)

    def drives(self) -> tuple[Drive, ...]:
        """The drives of all parts."""
        return tuple(
            Drive(
                name=drive.name,
                indices=drive.indices + start,
                keys=drive.keys,
                times_ns=drive.times_ns,
                world_T_frame=drive.world_T_frame,
            )
            for part, start in zip(self.parts, self.starts, strict=False)
            for drive in part.drives()
        )

    def drive_indices(self) -> Mapping[str, Indices]:
        """Indices of each drive's frames in the order of time."""
        pairs = zip(self.parts, self.starts, strict=False)
        return {name: rows + start for part, start in pairs for name, rows in part.drive_indices().items()}

    @property
    def notes(self) -> tuple[str, ...]:
        """What was left out, of all parts."""
        return tuple(note for part in self.parts for note in part.unwrapped.notes)

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What was taken for granted, of all parts."""
        return tuple(dict.fromkeys(sentence for part in self.parts for sentence in part.unwrapped.assumptions))


def joined(parts: Sequence[Dataset]) -> Dataset:
    """Several data sets as one; a single one stays what it is.

    Args:
        parts: The data sets, whole ones or selections; what all are seen through lies over the whole.

    Raises:
        DatasetError: As of :class:`Joined`, or if the frames of one are seen through other maps.
    """
    if len(parts) == 1:
        return parts[0]
    for part in parts[1:]:
        _check_views(parts[0], part)
    readers = Joined([part.unwrapped for part in parts])
    data: Dataset = readers
    for function in parts[0].maps[len(readers.maps) :]:
        data = data.mapped(function)
    pairs = zip(parts, readers.starts, strict=False)
    origins = tuple(start + origin for part, start in pairs for origin in part.origins)
    return data if origins == data.origins else data.select(origins)


def roots_of(data: Dataset) -> tuple[Path, ...]:
    """The folders of a data set: its own, or those of the parts of a joined one."""
    reader = data.unwrapped
    return tuple(part.root for part in reader.parts) if isinstance(reader, Joined) else (data.root,)


def _check_views(first: Dataset, part: Dataset) -> None:
    views, others = ([described(function) for function in data.maps] for data in (part, first))
    if views != others:
        raise DatasetError(
            f"{part.root}: expected frames seen as those of {first.root}, through {_text(others)}; got {_text(views)}. "
            "Open all with the same options, such as one mapping of classes (--mapping) for all."
        )


def _text(views: Sequence[Mapping[str, Any]]) -> str:
    """Maps with their settings, cut where they are long."""
    return ", ".join(shorten(f"{view['name']} {view['settings']}", 100) for view in views) or "no map"
