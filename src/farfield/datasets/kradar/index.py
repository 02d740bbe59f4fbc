"""Which frames a K-Radar tree holds, whatever part of it was downloaded."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

from farfield.datasets.kradar.labels import MAX_BYTES, parse_text
from farfield.datasets.kradar.layout import (
    CAMERAS,
    LABEL_TREES,
    LIDARS,
    RADAR_PRODUCTS,
    is_sequence,
    is_stem,
    label_stem,
    product_path,
)
from farfield.datasets.kradar.texts import read_radar_calibration
from farfield.files.atomic import read_bytes
from farfield.files.suffixes import any_case, existing
from farfield.vocabulary.kradar import frame_difference


@dataclass(frozen=True, kw_only=True)
class KRadarFiles:
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


class FileIndex:
    """Finds files below several roots; which folders there are is looked up once.

    Args:
        roots: Folders that may each hold any part of the data set; the first that has a file gives it.
    """

    def __init__(self, roots: Sequence[Path]) -> None:
        self.roots = tuple(roots)
        self._folders: dict[Path, tuple[Path, ...]] = {}

    def find(self, relative: Path) -> Path | None:
        """The first root's file of this name, or None."""
        folders = self._folders.get(relative.parent)
        if folders is None:
            candidates = (root / relative.parent for root in self.roots)
            folders = self._folders[relative.parent] = tuple(folder for folder in candidates if folder.is_dir())
        return next((path for folder in folders if (path := existing(folder / relative.name))), None)

    def product(self, product: str, sequence: str, index: int) -> Path | None:
        """A radar product's, LiDAR's or camera's file, also under the other names that documents give its folder."""
        paths = (self.find(path) for path in spellings(product, sequence, index))
        return next((path for path in paths if path is not None), None)


def spellings(product: str, sequence: str, index: int) -> tuple[Path, ...]:
    """Where a product's file may stand, relative to a root; the first is where the real files stand.

    >>> [path.as_posix() for path in spellings("cam-front", "1", 2)]
    ['1/cam-front/cam-front_00002.png', '1/cam_front/cam-front_00002.png', '1/cam_front/cam_front_00002.png']
    """
    path = product_path(product, sequence, index)
    if product == "cube":
        return path, path.parents[1] / "radar_xyz_cube" / path.name
    if product == "corridor":  # as the development kit's settings call its folder
        return path, Path("sp_rdr_cube_corridor", *path.parts[1:])
    if product in CAMERAS:
        other = product.replace("-", "_")
        return path, *(path.parents[1] / other / name for name in (path.name, path.name.replace(product, other)))
    return (path,)


DISKS = "dir_*to*"
"""Folders of the authors' disks, as their docs/dataset.md calls them: ``dir_2to5``, ``dir_1to20``, ``dir_21to37``..."""
CONTAINERS = ("kradar_dataset", "rdr_pc", "rdr_sparse_data", "dir_sp_rdr_cube")
"""Folders in which the development kit's settings keep disks or sparse clouds, beside or within a root."""


def with_disks(roots: Iterable[Path]) -> tuple[Path, ...]:
    """Roots and, after each, the folders of its disks and of its sparse clouds: where anything of K-Radar may stand.

    Every verb comes through here. Of a sequence's own folder, such as ``dir_1to20/1``, the roots are those that hold
    it: its parent's and, of a disk, those around the disk.
    """
    folders: list[Path] = []
    for root in roots:
        for base in (root, *_around(root)) if is_sequence_folder(root) else (root,):
            folders += [] if base is root and is_sequence_folder(root) else [base]
            for disk in (base, *(base / name for name in CONTAINERS)):
                disks = sorted(folder for folder in disk.glob(DISKS) if folder.is_dir())
                folders += [*([disk] if disk is not base and disk.is_dir() else []), *disks]
    return tuple(dict.fromkeys(folders))


def _around(folder: Path) -> list[Path]:
    """The folders that hold a sequence's folder: its parent, and that of a disk's folder."""
    parent = folder.absolute().parent
    return [parent, parent.parent] if fnmatch(parent.name, DISKS) else [parent]


def is_sequence_folder(folder: Path) -> bool:
    """Whether a folder is one sequence's: called by its number, with a product, a sensor or annotations in it."""
    own = [product_path(product, "*", 0).parts[1] for product in RADAR_PRODUCTS if _stands_in_sequence(product)]
    if not is_sequence(folder.absolute().name):
        return False
    return any((folder / name).is_dir() for name in (*own, *LIDARS, "info_label", "radar_xyz_cube"))


def _stands_in_sequence(product: str) -> bool:
    return product_path(product, "*", 0).parts[0] == "*"


def only_sequence(root: Path) -> str:
    """Name of the one sequence that a folder is of; empty where it holds sequences."""
    return root.absolute().name if is_sequence_folder(root) else ""


def find_sequences(roots: Sequence[Path]) -> list[str]:
    """Sequences of which some product, LiDAR sweep or annotation stands below one of the roots, in order."""
    patterns = [product_path(product, "*", 0).parent for product in (*RADAR_PRODUCTS, *LIDARS)]
    patterns += [Path("*", "radar_xyz_cube"), Path("sp_rdr_cube_corridor", "*")]
    patterns += [*(Path(tree.format(seq="*")) for t in LABEL_TREES.values() for tree in t)]
    names: set[str] = set()
    for pattern in patterns:
        level = next(number for number, part in enumerate(pattern.parts) if "*" in part)
        for root in roots:
            for folder in root.glob(pattern.as_posix()):
                name = folder.relative_to(root).parts[level].removesuffix("_info_label_revised")
                if folder.is_dir() and is_sequence(name):
                    names.add(name)
    for root in roots:
        bare = (folder for folder in root.glob("*") if is_sequence(folder.name) and folder.name not in names)
        names |= {folder.name for folder in bare if _label_files(folder)}
    return sorted(names, key=int)


def find_labels(roots: Sequence[Path], sequence: str, versions: Iterable[str]) -> tuple[str, list[Path]] | None:
    """The annotations of the first version that a sequence has, in the order of its frames; or None.

    A folder ``<sequence>`` that holds annotations itself, as a copy of one version's tree does, is of the version that
    its parent's name or else its lines tell.
    """
    bare = [(path, labels) for root in roots if (labels := _label_files(path := root / sequence))]
    for version in versions:
        for tree in LABEL_TREES[version]:
            for root in roots:
                paths = _label_files(root / tree.format(seq=sequence))
                if paths:
                    return version, paths
        for folder, paths in bare:
            if bare_version(folder, paths) == version:
                return version, paths
    return None


def _label_files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("*_*" + any_case(".txt")) if is_stem(path.stem))


def bare_version(folder: Path, paths: Sequence[Path]) -> str:
    """Version of the annotations in a folder: by its parent's name, or by the first object met; else v2.0.

    Raises:
        FileFormatError: If a file that has to be looked into is damaged.
    """
    parent = folder.resolve().parent.name
    named = {version: [Path(tree).parent.name for tree in trees] for version, trees in LABEL_TREES.items()}
    version = next((version for version, names in named.items() if parent and parent in names), None)
    if version is not None:
        return version
    for path in paths:
        lines = parse_text(read_bytes(path, max_bytes=MAX_BYTES), path).lines
        if lines:
            flagged, numbers = bool(lines[0].availability), len(lines[0].numbers)
            return ("v1.1" if numbers == 2 else "v2.1") if flagged else ("v1.0" if numbers == 2 else "v2.0")
    return "v2.0"


def radar_geometry(roots: Sequence[Path], sequence: str) -> tuple[int, float | None, float | None]:
    """Radar index minus LiDAR index, and x and y of the radar; the published figures where there is no file.

    Raises:
        FileFormatError: If the calibration is damaged.
    """
    path = find_file(roots, Path(sequence, "info_calib", "calib_radar_lidar.txt"))
    return (frame_difference(sequence), None, None) if path is None else read_radar_calibration(path)


def index_sequence(roots: Sequence[Path], sequence: str, versions: Iterable[str], difference: int) -> list[KRadarFiles]:
    """The frames of a sequence: those that are annotated, or, without annotations, those with a LiDAR or radar file."""
    labels = find_labels(roots, sequence, versions)
    if labels is not None:
        stems = [path.stem.split("_") for path in labels[1]]
        return [
            KRadarFiles(sequence=sequence, radar=int(radar), lidar=int(lidar), label=path, version=labels[0])
            for (radar, lidar), path in zip(stems, labels[1], strict=True)
        ]
    lidars = _numbers(roots, sequence, LIDARS, lambda index: index)
    lidars |= _numbers(roots, sequence, RADAR_PRODUCTS, lambda index: index - difference)
    return [KRadarFiles(sequence=sequence, radar=number + difference, lidar=number) for number in sorted(lidars)]


def _numbers(
    roots: Sequence[Path], sequence: str, products: Iterable[str], lidar_index: Callable[[int], int]
) -> set[int]:
    numbers: set[int] = set()
    for example in (path for product in products for path in spellings(product, sequence, 0)):
        for root in roots:
            numbers |= {lidar_index(number) for number in numbered_files(root / example.parent, example)}
    return numbers


def numbered_files(folder: Path, example: Path) -> set[int]:
    """Numbers of a folder's files that are named as an example with the number 0 is."""
    prefix = example.stem.removesuffix("00000")
    stems = (path.stem.removeprefix(prefix) for path in folder.glob(f"{prefix}*{any_case(example.suffix)}"))
    return {int(digits) for digits in stems if digits.isascii() and digits.isdigit() and len(digits) <= 9}
