"""Downloads as they come: zip archives of data sets, named by what lies in them without unpacking any."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from farfield.files.archives import ZipListing, list_zip
from farfield.files.sizes import sized
from farfield.vocabulary.counts import count_of

_DEPTH = 3  # folders below the one that is named, in which archives are looked for
_SPLIT = re.compile(r"\.(z\d\d|zip\.\d{3}|7z\.\d{3})$", re.IGNORECASE)

SIGNS: tuple[tuple[str, str, str], ...] = (
    ("Cirrus", "Gaussian sweeps", r"dataset\d*_gaussian/[^/]+\.xyz$"),
    ("Cirrus", "uniform sweeps", r"dataset\d*_uniform/[^/]+\.xyz$"),
    ("Cirrus", "annotations", r"dataset\d*_annotation/[^/]+\.json$"),
    ("Cirrus", "camera", r"dataset\d*_camera/[^/]+\.jpe?g$"),
    ("K-Radar", "tesseracts", r"(^|/)tesseract_\d{5}\.mat$"),
    ("K-Radar", "cubes", r"(^|/)cube_\d{5}\.mat$"),
    ("K-Radar", "polar maps", r"(^|/)polar3d_\d{5}\.npy$"),
    ("K-Radar", "sparse clouds", r"(^|/)(sprdr|spcube|rpc)_\d{5}\.npy$"),
    ("K-Radar", "os2-64", r"(^|/)os2-64_\d{5}\.pcd$"),
    ("K-Radar", "os1-128", r"(^|/)os1-128_\d{5}\.pcd$"),
    ("K-Radar", "cameras", r"(^|/)cam[-_](front|left|right|rear)_\d{5}\.png$"),
    ("K-Radar", "labels", r"(^|/)\d{5}_\d{5}\.txt$"),
    ("K-Radar", "calibration", r"(^|/)info_calib/[^/]+\.txt$"),
    ("K-Radar", "weather", r"(^|/)description\.txt$"),
    ("View-of-Delft", "radar", r"radar(_\d+_?(frames|scans))?/(training|testing)/velodyne/\d+\.bin$"),
    ("View-of-Delft", "LiDAR", r"lidar/(training|testing)/velodyne/\d+\.bin$"),
    ("View-of-Delft", "labels", r"lidar/training/label_2/\d+\.txt$"),
    ("KITTI raw", "sweeps", r"_drive_\d+_\w+/velodyne_points/data/\d+\.(bin|txt)$"),
    ("KITTI", "sweeps", r"(training|testing)/velodyne/\d{6}\.bin$"),
    ("KITTI", "labels", r"training/label_2/\d{6}\.txt$"),
    ("KITTI", "calibration", r"(training|testing)/calib/\d{6}\.txt$"),
    ("KITTI", "images", r"(training|testing)/image_[23]/\d{6}\.png$"),
    ("KITTI tracking", "sweeps", r"(training|testing)/velodyne/\d{4}/\d{6}\.bin$"),
    ("KITTI tracking", "labels", r"training/label_02/\d{4}\.txt$"),
    ("RADIATE", "radar", r"Navtech_(Polar|Cartesian)/\d+\.png$"),
    ("RADIATE", "LiDAR", r"velo_lidar/\d+\.csv$"),
    ("RADIATE", "annotations", r"annotations/annotations\.json$"),
    ("Astyx", "radar", r"radar_6455/\d+\.txt$"),
    ("Astyx", "LiDAR", r"lidar_vlp16/\d+\.txt$"),
    ("Astyx", "labels", r"groundtruth_obj3d/\d+\.json$"),
)
"""Data set, what it is, and how the names of its files end: a name is of the first that it ends like."""


@dataclass(frozen=True)
class ArchiveContent:
    """What an archive holds.

    Args:
        listing: Its directory.
        parts: Files and bytes by data set and kind; what is recognised of no data set under ``"other"``.
    """

    listing: ZipListing
    parts: dict[tuple[str, str], tuple[int, int]]

    @property
    def datasets(self) -> tuple[str, ...]:
        """The data sets of which it holds something."""
        return tuple(dict.fromkeys(name for name, _ in self.parts if name))

    def __str__(self) -> str:
        name = self.listing.path.name
        if self.listing.fault:
            return f"{name}: {self.listing.fault}"
        parts = [
            f"{f'{dataset} ' if dataset else ''}{kind} ({count_of(count, 'file')}, {sized(size)})"
            for (dataset, kind), (count, size) in self.parts.items()
        ]
        refused = f"; {count_of(len(self.listing.refused), 'member')} refused" if self.listing.refused else ""
        return f"{name}: {', '.join(parts)}{refused}"


def archives_in(roots: Iterable[Path], *, depth: int = _DEPTH) -> list[Path]:
    """Zip archives in some folders and those below, in order.

    Args:
        roots: The folders.
        depth: How far below they are looked for.
    """
    paths: dict[Path, None] = {}
    for root in roots:
        for level in range(depth + 1):
            pattern = "*/" * level + "*.[zZ][iI][pP]"
            paths |= dict.fromkeys(path for path in sorted(root.glob(pattern)) if path.is_file())
    return list(paths)


def split_parts(root: Path) -> list[Path]:
    """Parts of archives that were split, which have to be joined before they are read."""
    return sorted(path for path in root.iterdir() if _SPLIT.search(path.name))


def content_of(path: Path) -> ArchiveContent:
    """What an archive holds, by the names in its directory."""
    listing = list_zip(path)
    counts: Counter[tuple[str, str]] = Counter()
    sizes: Counter[tuple[str, str]] = Counter()
    for member in listing.members:
        part = kind_of(f"{path.stem}/{member.name}")
        counts[part] += 1
        sizes[part] += member.bytes
    ordered = sorted(counts, key=lambda part: (part[0] == "", -sizes[part]))
    return ArchiveContent(listing, {part: (counts[part], sizes[part]) for part in ordered})


def kind_of(name: str) -> tuple[str, str]:
    """Data set and kind of a file by its name; ``("", "other")`` where no data set has such."""
    return next(((data, kind) for data, kind, pattern in _COMPILED if pattern.search(name)), ("", "other"))


_COMPILED = [(data, kind, re.compile(pattern)) for data, kind, pattern in SIGNS]
_SAID = 12


def archive_sentences(root: Path, *, depth: int = _DEPTH) -> Sequence[str]:
    """What lies in the archives of a folder, a sentence each, at most twelve; none where there is no archive.

    Args:
        root: The folder.
        depth: How far below it they are looked for.
    """
    return list(_sentences(archives_in([root], depth=depth) if root.is_dir() else [], root))


def _sentences(paths: Sequence[Path], root: Path) -> Iterator[str]:
    for path in paths[:_SAID]:
        yield str(content_of(path))
    if len(paths) > _SAID:
        yield f"and {count_of(len(paths) - _SAID, 'more archive')}"
    if root.is_dir() and (parts := split_parts(root)):
        yield f"{parts[0].name}: a part of a split archive: join them, such as by zip -s 0 FIRST.zip --out WHOLE.zip"
