"""Which frames a K-Radar tree holds, whatever part of it was downloaded."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from farfield.datasets.kradar.layout import (
    LABEL_TREES,
    LIDARS,
    RADAR_PRODUCTS,
    frame_difference,
    is_sequence,
    is_stem,
    label_stem,
    product_path,
)
from farfield.datasets.kradar.texts import read_radar_calibration


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One frame: its sequence, radar and LiDAR index, and its annotation with its version where there is one."""

    sequence: str
    radar: int
    lidar: int
    label: Path | None = None
    version: str | None = None

    @property
    def stem(self) -> str:
        """Its name, ``<radar>_<os2-64>``."""
        return label_stem(self.radar, self.lidar)


def find_file(roots: Sequence[Path], relative: Path) -> Path | None:
    """The first root's file of this name, or None."""
    return next((root / relative for root in roots if (root / relative).is_file()), None)


def find_sequences(roots: Sequence[Path]) -> list[str]:
    """Sequences of which some product, LiDAR sweep or annotation stands below one of the roots, in order."""
    patterns = [product_path(product, "*", 0).parent for product in (*RADAR_PRODUCTS, *LIDARS)]
    patterns += [Path(tree.format(seq="*")) for trees in LABEL_TREES.values() for tree in trees]
    found: set[str] = set()
    for pattern in patterns:
        place = next(number for number, part in enumerate(pattern.parts) if "*" in part)
        for root in roots:
            for folder in root.glob(pattern.as_posix()):
                name = folder.relative_to(root).parts[place].removesuffix("_info_label_revised")
                if folder.is_dir() and is_sequence(name):
                    found.add(name)
    return sorted(found, key=int)


def find_labels(roots: Sequence[Path], sequence: str, versions: Iterable[str]) -> tuple[str, list[Path]] | None:
    """The annotations of the first version that a sequence has, in the order of its frames; or None."""
    for version in versions:
        for tree in LABEL_TREES[version]:
            for root in roots:
                folder = root / tree.format(seq=sequence)
                paths = sorted(path for path in folder.glob("*.txt") if is_stem(path.stem))
                if paths:
                    return version, paths
    return None


def radar_geometry(roots: Sequence[Path], sequence: str) -> tuple[int, float | None, float | None]:
    """Radar index minus LiDAR index, and x and y of the radar; the published figures where there is no file.

    Raises:
        FileFormatError: If the calibration is damaged.
    """
    path = find_file(roots, Path(sequence, "info_calib", "calib_radar_lidar.txt"))
    return (frame_difference(sequence), None, None) if path is None else read_radar_calibration(path)


def index_sequence(roots: Sequence[Path], sequence: str, versions: Iterable[str], difference: int) -> list[Entry]:
    """The frames of a sequence: those that are annotated, or, without annotations, those with a LiDAR or radar file."""
    labels = find_labels(roots, sequence, versions)
    if labels is not None:
        stems = [path.stem.split("_") for path in labels[1]]
        return [
            Entry(sequence=sequence, radar=int(radar), lidar=int(lidar), label=path, version=labels[0])
            for (radar, lidar), path in zip(stems, labels[1], strict=True)
        ]
    lidars = _numbers(roots, sequence, LIDARS, lambda index: index)
    lidars |= _numbers(roots, sequence, RADAR_PRODUCTS, lambda index: index - difference)
    return [Entry(sequence=sequence, radar=number + difference, lidar=number) for number in sorted(lidars)]


def _numbers(
    roots: Sequence[Path], sequence: str, products: Iterable[str], lidar_index: Callable[[int], int]
) -> set[int]:
    found: set[int] = set()
    for product in products:
        example = product_path(product, sequence, 0)
        prefix = example.stem.removesuffix("00000")
        for root in roots:
            for path in (root / example.parent).glob(f"{prefix}*{example.suffix}"):
                digits = path.stem.removeprefix(prefix)
                if digits.isascii() and digits.isdigit() and len(digits) <= 9:
                    found.add(lidar_index(int(digits)))
    return found
