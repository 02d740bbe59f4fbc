"""Which pictures of a folder are to be covered, and which of them follow one another or are two eyes of a pair."""

import itertools
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from farfield.errors import ConfigError, DatasetError
from farfield.files.stamps import name_time_ns
from farfield.files.videos import VIDEOS
from farfield.vocabulary.kradar import STEREO_CAMERAS

PICTURES = (".jpg", ".jpeg", ".png")
_NUMBER = re.compile(r"\d+")
_NS = 1e-9
NOMINAL_HZ = 10.0

PAIRS = (
    ("image_2", "image_3"),
    ("image_02", "image_03"),
    ("zed_left", "zed_right"),
    ("stereo_front_left", "stereo_front_right"),
)
"""Names of folders that hold the two eyes of a pair, where the data sets name them so."""

SIDE_BY_SIDE = STEREO_CAMERAS
"""Names of folders whose pictures hold both eyes, the left one on the left: K-Radar's."""
_TWO_EYES = 3.0  # a picture of two eyes is at least so many times as wide as high


@dataclass(frozen=True)
class Series:
    """Pictures of one camera in order of time.

    Args:
        root: The folder that was named.
        files: Files below it, relative, in order.
        times_s: When each was taken; a tenth of a second apart where names are no stamps.
        stamped: Whether the names said so.
    """

    root: Path
    files: tuple[Path, ...]
    times_s: Float[np.ndarray, " n"]
    stamped: bool

    @property
    def name(self) -> str:
        """The folder of the pictures below the root."""
        return self.files[0].parent.as_posix()


@dataclass(frozen=True)
class Sources:
    """What is to be covered.

    Args:
        root: The folder that was named, or that of the file.
        folders: Series of pictures.
        films: Films below the root.
    """

    root: Path
    folders: tuple[Series, ...]
    films: tuple[Path, ...]


def find_sources(path: Path) -> Sources:
    """The pictures and films below a folder, or a single one.

    Links are not followed, and neither are folders whose names begin with a dot.

    Raises:
        DatasetError: If there is none.
    """
    if path.is_file():
        root, files_by_folder = path.parent, {path.parent: [Path(path.name)]}
    else:
        root, files_by_folder = path, dict(_walk(path))
    pictures = [[file for file in files if file.suffix.lower() in PICTURES] for files in files_by_folder.values()]
    films = tuple(file for files in files_by_folder.values() for file in sorted(files) if file.suffix.lower() in VIDEOS)
    folders = tuple(_series(root, files) for files in pictures if files)
    if not folders and not films:
        raise DatasetError(f"{path}: expected pictures ({', '.join(PICTURES)}) or films there, found none")
    return Sources(root, folders, films)


def _walk(root: Path) -> Iterator[tuple[Path, list[Path]]]:
    """Files of each folder, relative to the root, that are no links and not hidden."""
    for folder, subfolders, names in os.walk(root):
        subfolders[:] = sorted(name for name in subfolders if not name.startswith("."))
        files = [Path(folder, name) for name in names if not name.startswith(".")]
        yield Path(folder), [file.relative_to(root) for file in files if not file.is_symlink()]


def _series(root: Path, files: Sequence[Path]) -> Series:
    ordered = sorted(files, key=_by_numbers)
    names = [file.stem for file in ordered]
    stamps_s = [time_ns * _NS for name in names if (time_ns := name_time_ns(name)) is not None]
    if len(stamps_s) == len(names) and all(a < b for a, b in itertools.pairwise(stamps_s)):
        return Series(root, tuple(ordered), np.array(stamps_s) - stamps_s[0], stamped=True)
    return Series(root, tuple(ordered), np.arange(len(ordered)) / NOMINAL_HZ, stamped=False)


def _by_numbers(file: Path) -> tuple[list[int], str]:
    """Order by the numbers of a name, then by the name: frame_9 before frame_10."""
    return [int(number) for number in _NUMBER.findall(file.stem)], file.name


def find_stereo_pairs(folders: Sequence[Series], eye_names: Sequence[tuple[str, str]] = PAIRS) -> list[tuple[int, int]]:
    """Numbers of the series that are the two eyes of one pair: equal names in folders that are named so.

    Args:
        folders: All series.
        eye_names: Names of the two folders of each kind of pair.

    Raises:
        ConfigError: If a name is that of both eyes.
    """
    if any(left == right for left, right in eye_names):
        raise ConfigError("stereo: expected the names of two different folders, LEFT:RIGHT")
    numbers = {series.name: number for number, series in enumerate(folders)}
    pairs = []
    for left, right in eye_names:
        for name, number in numbers.items():
            parts = name.split("/")
            if left in parts:
                last = len(parts) - 1 - parts[::-1].index(left)
                partner = numbers.get("/".join([*parts[:last], right, *parts[last + 1 :]]))
                if partner is not None:
                    pairs.append((number, partner))
    return pairs


def find_side_by_side(folders: Sequence[Series], folder_names: Sequence[str] = SIDE_BY_SIDE) -> list[int]:
    """Numbers of the series whose pictures hold both eyes beside each other, by the names of their folders."""
    return [number for number, series in enumerate(folders) if set(folder_names) & set(series.name.split("/"))]


def holds_two_eyes(width_px: int, height_px: int) -> bool:
    """Whether a picture is wide enough to hold two; an eye cut out of it is not."""
    return width_px >= _TWO_EYES * height_px
