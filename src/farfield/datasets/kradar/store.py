"""Radar tensors made light: every frame's cells of a region, a few hundred kilobytes instead of hundreds of megabytes.

The store stands in K-Radar's layout (``radar_cells/<sequence>/cells_00033.h5``, ``rdr_polar_3d/...``), so that
``KRadar(data, roots=[store])`` reads it. A conversion that was broken off resumes where it stopped, by the journal.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from farfield.datasets.base import Dataset
from farfield.datasets.kradar.layout import CAMERAS, LIDARS, RADAR_PRODUCTS, product_path
from farfield.datasets.kradar.products import read_moments, read_radar, write_radar
from farfield.datasets.losses import Capacity, Loss
from farfield.errors import ConfigError, DatasetError
from farfield.files.atomic import write_text
from farfield.files.radar_cells import write_radar_cells
from farfield.jobs import HERE, JobJournal, JobOptions, Outcome, Unit, UnitResult, faults, run
from farfield.jobs.folders import held
from farfield.radar.axes import POWER_UNIT
from farfield.radar.cells import OVERS, RATES, Over, RadarCells, cells_of_cube, find_region
from farfield.radar.products import Moments, doppler_cube, polar3d_from_moments, zyx_cube

STORED = ("cells", "polar3d")
SOURCES = ("tesseract", "cube", "polar3d")  # what cells are made of, the best first
JOURNAL_NAME = ".farfield_convert.jsonl"


@dataclass(frozen=True, kw_only=True)
class StoreSettings:
    """What a store keeps of each frame.

    Args:
        products: ``"cells"`` and ``"polar3d"`` (16 MB a frame; only from tesseracts).
        region: Region of the cells, ``"narrow"``, ``"wide"`` or ``"cube"``.
        rate: 1 keeps every cell of the region, so that any density can be chosen when the cells are read; one of
            ``farfield.radar.cells.RATES`` keeps those above that quantile, and any lower density.
        over: Whether the quantile counts ``"all"`` cells of the cube, its ``"valid"`` ones in the field of view, or
            those of the ``"region"``.
        doppler: Keep each cell's mean velocity, where the source tells it.

    Raises:
        ConfigError: If one is none of those possible.
    """

    products: tuple[str, ...] = ("cells",)
    region: str = "wide"
    rate: float | int = 1.0
    over: Over = "all"
    doppler: bool = True

    def __post_init__(self) -> None:
        find_region(self.region)
        if not self.products or not set(self.products) <= set(STORED):
            raise ConfigError(f"radar store: expected products from {', '.join(STORED)}; got {self.products!r}")
        if self.rate != 1 and self.rate not in RATES:
            raise ConfigError(f"radar store: expected rate 1 or one of {', '.join(map(str, RATES))}; got {self.rate}")
        if self.over not in OVERS:
            raise ConfigError(f"radar store: expected over one of {', '.join(OVERS)}; got {self.over!r}")

    @property
    def text(self) -> str:
        """All settings in one line: another line, another store."""
        rate = f"{self.region} {float(self.rate)} {self.over} {'doppler' if self.doppler else 'no doppler'}"
        return f"radar-store 1 {' '.join(sorted(self.products))} {rate}"


STORE_HOLDS = Capacity(title="a radar store", read_by="kradar", holds=frozenset({"radar"}), one_cloud=False)
_BESIDE = "the store is opened together with the data set, which keeps all else: --roots STORE"


def store_losses(settings: StoreSettings) -> tuple[Loss, ...]:
    """What of the tensors a store leaves out, by its settings; all else stays where it is."""
    lost = ["cells outside the region " + settings.region] if "polar3d" not in settings.products else []
    lost += [f"all but the strongest {settings.rate:g} of the cells"] if settings.rate != 1 else []
    lost += [] if settings.doppler else ["the velocity of each cell"]
    lost += ["the spectrum over Doppler, of which power and mean velocity are kept"]
    return (Loss(item="radar", title=STORE_HOLDS.title, names=tuple(lost), reason=_BESIDE),)


def convert_to_store(
    dataset: Dataset,
    target: Path,
    settings: StoreSettings | None = None,
    *,
    overwrite: bool = False,
    bulk: JobOptions = HERE,
) -> Outcome:
    """Write the store of a K-Radar tree, or go on with it; what stands there intact is skipped.

    Args:
        dataset: K-Radar, or some frames of it, with tesseracts, cubes or polar maps.
        target: Folder of the store.
        settings: What to keep.
        overwrite: Write everything anew.
        bulk: How; a worker takes about half a gigabyte and, from packed tesseracts, two cores.

    Returns:
        How many frames were written, and how many stood there.

    Raises:
        DatasetError: If no frame has a product that the store can be made from.
    """
    settings = settings or StoreSettings()
    units = _units(dataset, settings)
    if not units:
        sources = "radar_tesseract" if settings.products == ("polar3d",) else "radar_tesseract, radar_zyx_cube or polar"
        raise DatasetError(f"{dataset.root}: expected frames with {sources} files to convert, found none")
    with held(target):
        journal = JobJournal(target / JOURNAL_NAME, settings.text, overwrite=overwrite)
        outcome = run(ConvertFrame(target, settings), units, bulk, journal=journal)
        if outcome.written or not (target / MANIFEST_NAME).is_file():
            write_manifest(dataset, target, settings.text)
    return outcome


@dataclass(frozen=True)
class StoreTask:
    """One frame to convert.

    Args:
        sequence: Its sequence.
        index: Its radar index.
        source: Product that it is converted from.
        path: File of that product.
    """

    sequence: str
    index: int
    source: str
    path: Path

    @property
    def unit(self) -> Unit:
        """The same as a unit of work."""
        return Unit(f"{self.sequence}/{self.index:05d}", (self.path,), self)


def _units(dataset: Dataset, settings: StoreSettings) -> list[Unit]:
    return [job.unit for index in range(len(dataset)) if (job := _job(dataset, index, settings)) is not None]


def _job(dataset: Dataset, index: int, settings: StoreSettings) -> StoreTask | None:
    """The frame's best source, if it has one."""
    sequence, stem = dataset.keys[index]
    number = int(stem.split("_")[0])
    by_place = {path.parts[-3:]: path for path in dataset.files(index)}
    for source in SOURCES if "cells" in settings.products else SOURCES[:1]:
        path = by_place.get(product_path(source, sequence, number).parts)
        if path is not None:
            return StoreTask(sequence, number, source, path)
    return None


@dataclass(frozen=True)
class ConvertFrame:
    """Converts one frame.

    Args:
        target: Folder of the store.
        settings: What to keep.
    """

    target: Path
    settings: StoreSettings
    memory_bytes = 900_000_000

    def __call__(self, unit: Unit) -> UnitResult:
        """Write the frame's files."""
        return UnitResult(files=tuple(convert_frame(unit.parameters, self.target, self.settings)))


def convert_frame(job: StoreTask, target: Path, settings: StoreSettings) -> list[Path]:
    """Convert one frame.

    Args:
        job: The frame.
        target: Folder of the store.
        settings: What to keep.

    Returns:
        The files written.

    Raises:
        FileFormatError: If the source is damaged.
    """
    moments = _moments(job)
    written = []
    if "polar3d" in settings.products and job.source == "tesseract" and moments is not None:
        path = _made(target / product_path("polar3d", job.sequence, job.index))
        write_radar(path, "polar3d", polar3d_from_moments(moments.mean_power_63, moments.velocity_moment))
        written.append(path)
    if "cells" in settings.products:
        path = _made(target / product_path("cells", job.sequence, job.index))
        cells = _cells(job, moments, settings).select(settings.region, settings.rate, over=settings.over)
        attributes = {"source": job.source, "region": settings.region, "rate": str(float(settings.rate))}
        write_radar_cells(
            path,
            index=cells.index,
            code=cells.code,
            quantiles=cells.quantiles,
            doppler=cells.doppler,
            attributes=attributes | {"over": settings.over},
        )
        written.append(path)
    return written


def _made(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _moments(job: StoreTask) -> Moments | None:
    """The sums over Doppler that a source gives; a polar map lacks the first bin: its mean must do."""
    if job.source == "tesseract":
        return read_moments(job.path)
    if job.source == "cube":
        return None
    power, velocity = (
        np.ascontiguousarray(channel.transpose(0, 2, 1), dtype=np.float32)
        for channel in cast(np.ndarray, read_radar(job.path, "polar3d"))
    )
    power *= np.float32(POWER_UNIT)
    return Moments(power, power, power * velocity)


def _cells(job: StoreTask, moments: Moments | None, settings: StoreSettings) -> RadarCells:
    if moments is None:
        cube = np.ascontiguousarray(cast(np.ndarray, read_radar(job.path, "cube")), dtype=np.float32)
        return cells_of_cube(cube, settings.region)
    doppler = doppler_cube(moments.mean_power_63, moments.velocity_moment) if settings.doppler else None
    return cells_of_cube(zyx_cube(moments.mean_power), settings.region, doppler_m_s=doppler)


def verify_store(dataset: Dataset, target: Path, settings: StoreSettings | None = None) -> list[str]:
    """Compare a store with what its journal and the source say; nothing is written.

    Args:
        dataset: The source.
        target: Folder of the store.
        settings: What it should keep.

    Returns:
        What is wrong, one line a frame: missing, damaged (by checksum), or made from another source or with other
        settings.

    Raises:
        DatasetError: If there is no store.
    """
    settings = settings or StoreSettings()
    path = target / JOURNAL_NAME
    if not path.is_file():
        raise DatasetError(f"{target}: expected a radar store, found no {JOURNAL_NAME}")
    journal = JobJournal(path, settings.text)
    return faults(_units(dataset, settings), journal)


# The manifest: which gigabytes of K-Radar each task needs, of those that a tree holds and of the published set.
# Published sizes are estimates: the report's figures for the largest sequence (tesseracts 360 GB, cubes 72, os1-128 14,
# os2-64 7, a camera 4.5) over its 1,195 frames, times the 34,994 annotated ones; the polar maps' 16.2 MB a frame.

MANIFEST_NAME = "radar_store.json"
_ANNOTATED, _LARGEST = 34_994, 1_195
_LARGEST_GB = {"tesseract": 360.0, "cube": 72.0, "os1-128": 14.0, "os2-64": 7.0, **dict.fromkeys(CAMERAS, 4.5)}
PUBLISHED_BYTES = {name: round(gb * 1e9 * _ANNOTATED / _LARGEST) for name, gb in _LARGEST_GB.items()} | {
    "polar3d": 16_207_920 * _ANNOTATED,
    "labels": round(0.5e6 * _ANNOTATED / _LARGEST),
}
"""Bytes of a modality in the whole published set, about; a modality of unknown size is absent."""

# Every entry is a choice: the first alternative that a tree holds is enough.
TASKS: dict[str, tuple[tuple[str, ...], ...]] = {
    "train RTNH (sparse radar)": (("cells", "sparse", "cube", "tesseract"), ("labels",)),
    "train RTN (dense radar)": (("cells", "cube", "tesseract"), ("labels",)),
    "train a LiDAR baseline": (("os2-64",), ("labels",)),
    "view frames": (("cells", "sparse", "polar3d", "cube", "tesseract"), ("os2-64",), ("cam-front",), ("labels",)),
    "score files of boxes": (("labels",),),
    "make a store of cells": (("tesseract", "cube", "polar3d"),),
    "study Doppler": (("polar3d", "tesseract", "cells"),),
}


def modalities(dataset: Dataset) -> dict[str, tuple[int, int]]:
    """Number of files and bytes of each modality that a tree holds; labels are those that the reader uses."""
    folders = {product_path(name, "1", 0).parts[-2 if name in _IN_SEQUENCE else -3]: name for name in _KNOWN}
    counts = dict.fromkeys((*_KNOWN, "labels"), (0, 0))
    counted_paths: set[Path] = set()
    for index in range(len(dataset)):
        for path in dataset.files(index):
            modality = next((folders[part] for part in path.parts[-3:-1] if part in folders), None)
            name = modality or ("labels" if path.suffix.lower() == ".txt" else None)
            if name is not None and path not in counted_paths:
                counted_paths.add(path)
                count, size = counts[name]
                counts[name] = count + 1, size + path.stat().st_size
    return {name: counted for name, counted in counts.items() if counted[0]}


_KNOWN = (*RADAR_PRODUCTS, *LIDARS, *CAMERAS)
_IN_SEQUENCE = tuple(name for name in _KNOWN if product_path(name, "1", 0).parts[0] == "1")


def needs(held: dict[str, tuple[int, int]]) -> dict[str, Any]:
    """What each task reads: of the tree, and of the published set.

    Args:
        held: What :func:`modalities` returns.

    Returns:
        By task: ``reads`` (modalities), ``missing`` (choices of which the tree holds none), ``bytes`` (of what it
        reads), ``published_reads`` and ``published_bytes_about`` (the smallest published choice).
    """
    tasks = {}
    for task, choices in TASKS.items():
        reads = [next((name for name in choice if name in held), None) for choice in choices]
        sized = [[name for name in choice if name in PUBLISHED_BYTES] for choice in choices]
        smallest = [min(names, key=PUBLISHED_BYTES.__getitem__) for names in sized]
        tasks[task] = {
            "reads": [name for name in reads if name is not None],
            "missing": [" or ".join(choice) for name, choice in zip(reads, choices, strict=True) if name is None],
            "bytes": sum(held[name][1] for name in reads if name is not None),
            "published_reads": smallest,
            "published_bytes_about": sum(PUBLISHED_BYTES[name] for name in smallest),
        }
    return tasks


def write_manifest(dataset: Dataset, target: Path, settings: str) -> Path:
    """Write the manifest of a store: its settings, its size, the source's modalities and what each task needs.

    Args:
        dataset: The source.
        target: Folder of the store.
        settings: The store's settings in one line.
    """
    store = {
        name: [path.stat().st_size for path in target.glob(product_path(name, "*", 0).parent.joinpath("*").as_posix())]
        for name in ("cells", "polar3d")
    }
    held = modalities(dataset)
    stored = {name: (len(sizes), sum(sizes)) for name, sizes in store.items() if sizes}
    text = {
        "settings": settings,
        "store": {name: {"files": count, "bytes": size} for name, (count, size) in stored.items()},
        "source": {name: {"files": count, "bytes": size} for name, (count, size) in held.items()},
        "published_bytes_about": PUBLISHED_BYTES,
        "tasks": needs(held | stored),
    }
    path = target / MANIFEST_NAME
    write_text(path, json.dumps(text, indent=1) + "\n")
    return path
