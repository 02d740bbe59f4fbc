"""K-Radar's downloads to a radar store: archive by archive and sequence by sequence, without unpacking all of them.

A frame's radar file is unpacked, converted, and deleted once its part of the store is verified and stands in the
journal; killed at any moment, the command resumes where it stopped, and unpacks nothing again. Annotations,
calibrations and the weather are unpacked into the store, which then opens as K-Radar by itself. Sources are only read.
"""

import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

from farfield.datasets.downloads import archives_in
from farfield.datasets.kradar.layout import LABEL_TREES, is_sequence, is_stem, product_path
from farfield.datasets.kradar.reader import KRadar
from farfield.datasets.kradar.store import (
    JOURNAL_NAME,
    SOURCES,
    StoreSettings,
    StoreTask,
    convert_frame,
    write_manifest,
)
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.archives import ArchiveMember, ZipListing, list_zip, unpack
from farfield.files.marks import mark_of
from farfield.files.outputs import check_room
from farfield.files.sizes import sized
from farfield.jobs import HERE, JobJournal, JobOptions, JobRun, Outcome, Unit, UnitResult
from farfield.jobs.folders import held
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.kradar import CELLS_IN_VIEW

UNPACKED = "unpacked"
"""Folder of a store in which radar files lie between unpacking and deletion, or for good with ``keep``."""
_POLAR_BYTES = 16_207_920
_CELL_BYTES, _DOPPLER_BYTES = 1.37, 1.59  # packed, of noise as simulated: power, and velocity besides
_DELETED_AT = 4  # frames that are done before what they were unpacked to is deleted together
_FILE = re.compile(r"(tesseract|cube|polar3d)_(\d{5})\.(mat|npy)")
_NUMBERED = re.compile(r"0*([1-9]\d?)(?!\d)")
_BESIDE = ("info_calib", "info_label", "time_info")
_LABEL_FOLDERS = tuple(
    sorted({part for trees in LABEL_TREES.values() for tree in trees for part in Path(tree).parts[:-1]} - {"{seq}"})
)


@dataclass(frozen=True)
class RadarDownload:
    """A frame's radar file in the downloads.

    Args:
        sequence: Its sequence.
        index: Its radar index.
        source: Which product it is.
        members: Where it lies, in archives; the next is taken where one is damaged.
    """

    sequence: str
    index: int
    source: str
    members: tuple[ArchiveMember, ...]

    @property
    def unit(self) -> Unit:
        """The same as a unit of work."""
        archives = tuple(dict.fromkeys(member.archive for member in self.members))
        return Unit(f"{self.sequence}/{self.index:05d}", archives, self)


@dataclass(frozen=True, kw_only=True)
class KRadarDownloads:
    """What of K-Radar lies in archives.

    Args:
        listings: All archives.
        radar: The radar file of each frame, the best product that there is, by archive and sequence.
        beside: Annotations, calibrations and weather by their path in a store.
    """

    listings: tuple[ZipListing, ...]
    radar: tuple[RadarDownload, ...]
    beside: Mapping[str, ArchiveMember]

    @property
    def faults(self) -> tuple[str, ...]:
        """Archives that cannot be used and members that are refused, a sentence each."""
        cut = [f"{listing.path.name}: {listing.fault}" for listing in self.listings if listing.fault]
        refused = [f"{listing.path.name}: {text}" for listing in self.listings for text in listing.refused[:5]]
        return (*cut, *refused)

    @property
    def sequences(self) -> tuple[str, ...]:
        """Sequences with a radar file, in order."""
        return tuple(dict.fromkeys(frame.sequence for frame in self.radar))


def find_downloads(roots: Iterable[Path]) -> KRadarDownloads:
    """What of K-Radar lies in the archives of some folders, without unpacking any.

    Where a sequence's annotations are there, its annotated frames alone are taken.

    Args:
        roots: Folders, such as of several disks.
    """
    listings = tuple(list_zip(path) for path in archives_in(roots))
    radar: dict[tuple[str, int], dict[str, list[ArchiveMember]]] = {}
    beside: dict[str, ArchiveMember] = {}
    for member in (member for listing in listings for member in listing.members):
        if (frame := radar_file(member)) is not None:
            sequence, index, source = frame
            radar.setdefault((sequence, index), {}).setdefault(source, []).append(member)
        elif (path := file_beside(member)) is not None:
            beside.setdefault(path, member)
    labelled: dict[str, set[int]] = {}
    for text in map(PurePosixPath, beside):
        if is_stem(text.stem):
            sequence = next(
                (part.removesuffix("_info_label_revised") for part in text.parts[-3:-1] if part[:1].isdigit()), ""
            )
            labelled.setdefault(sequence, set()).add(int(text.stem.split("_")[0]))
    frames = []
    for (sequence, index), members in radar.items():
        if sequence in labelled and index not in labelled[sequence]:
            continue
        source = next(name for name in SOURCES if name in members)
        frames.append(RadarDownload(sequence, index, source, tuple(members[source])))
    frames.sort(key=lambda frame: (int(frame.sequence), frame.members[0].archive, frame.index))
    return KRadarDownloads(listings=listings, radar=tuple(frames), beside=beside)


def radar_file(member: ArchiveMember) -> tuple[str, int, str] | None:
    """Sequence, radar index and product of a member that is a radar file; None where it is none."""
    path = PurePosixPath(member.name)
    match = _FILE.fullmatch(path.name)
    sequence = _sequence(path.parts[:-1], member.archive)
    return None if match is None or not sequence else (sequence, int(match[2]), match[1])


def _sequence(folders: Sequence[str], archive: Path) -> str:
    """A member's sequence: the last folder that is a number, else the number that its archive's name begins with."""
    named = next((part for part in reversed(folders) if is_sequence(part)), "")
    match = _NUMBERED.match(archive.stem)
    return named or (match[1] if match is not None else "")


def file_beside(member: ArchiveMember) -> str | None:
    """Where in a store an annotation, a calibration or a weather's file goes; None where a member is none of these."""
    path = PurePosixPath(member.name)
    parts = path.parts
    for row, part in enumerate(parts[:-1]):
        if part in _LABEL_FOLDERS or part.endswith("_info_label_revised"):
            return "/".join(parts[row:])
        if part in _BESIDE:
            sequence = _sequence(parts[:row], member.archive)
            return "/".join((sequence, *parts[row:])) if sequence else None
    if path.name == "description.txt":
        sequence = _sequence(parts[:-1], member.archive)
        return f"{sequence}/description.txt" if sequence else None
    return None


@dataclass(frozen=True)
class ConvertDownload:
    """Unpacks one frame's radar file, unless it lies there whole, and converts it.

    Args:
        target: Folder of the store.
        settings: What the store keeps.
        disk_bytes: What a frame takes on the disk.
    """

    target: Path
    settings: StoreSettings
    disk_bytes: float = 0.0
    memory_bytes = 900_000_000

    def __call__(self, unit: Unit) -> UnitResult:
        """Write the frame's files; a file that is damaged in every archive is a value of its own, and no error."""
        frame: RadarDownload = unit.parameters
        path = unpacked_path(self.target, frame)
        fault = ""
        for member in frame.members:
            try:
                if not (path.is_file() and path.stat().st_size == member.bytes and mark_of(path)[1] == member.crc):
                    unpack(member, path)
                files = convert_frame(
                    StoreTask(frame.sequence, frame.index, frame.source, path), self.target, self.settings
                )
            except FileFormatError as error:
                path.unlink(missing_ok=True)
                fault = str(error).replace(str(path), f"{member.archive.name}, {member.name}")
            else:
                return UnitResult(files=tuple(files))
        return UnitResult(value={"fault": fault[:500]})


def stored_bytes(settings: StoreSettings, source: str) -> float:
    """Bytes of a frame in a store, about; at most, where a rate keeps the strongest cells of more than the region.

    Args:
        settings: What the store keeps.
        source: Product that the frame is made of; cubes tell no velocity.
    """
    own = float(_POLAR_BYTES) if "polar3d" in settings.products and source == SOURCES[0] else 0.0
    if "cells" in settings.products:
        cells = CELLS_IN_VIEW[settings.region] * (settings.rate if settings.over == "region" else 1.0)
        own += cells * (_CELL_BYTES + _DOPPLER_BYTES * (settings.doppler and source != "cube"))
    return own


def unpacked_path(target: Path, frame: RadarDownload) -> Path:
    """Where a frame's radar file is unpacked to: in K-Radar's own layout."""
    return target / UNPACKED / product_path(frame.source, frame.sequence, frame.index)


@dataclass(frozen=True, kw_only=True)
class DownloadPlan:
    """How much there is to do.

    Args:
        frames: Frames that are left, of all that have a radar file.
        all_frames: All of them.
        packed_bytes: What the frames that are left take in their archives.
        unpacked_bytes: What they unpack to together.
        store_bytes: What the store grows by, about.
        peak_bytes: What is needed on the disk at most, about.
        seconds: How long it takes, about; None where nothing has been measured.
    """

    frames: int
    all_frames: int
    packed_bytes: int
    unpacked_bytes: int
    store_bytes: int | float
    peak_bytes: int | float
    seconds: float | None = None

    def __str__(self) -> str:
        if not self.frames:
            return f"all {count_of(self.all_frames, 'frame')} are in the store"
        text = (
            f"{self.frames} of {count_of(self.all_frames, 'frame')} to convert: {sized(self.packed_bytes)} in the "
            f"archives, {sized(self.unpacked_bytes)} unpacked; the disk needs about {sized(self.peak_bytes)}, of which "
            f"the store keeps {sized(self.store_bytes)}"
        )
        if self.seconds is None:
            return text + "; how long it takes is said after the first frames"
        hours, minutes = divmod(round(self.seconds / 60), 60)
        return text + f"; about {f'{hours} h {minutes} min' if hours else f'{max(self.seconds / 60, 0.1):.1f} min'}"


def plan_downloads(
    downloads: KRadarDownloads,
    left: Sequence[RadarDownload],
    settings: StoreSettings,
    *,
    workers: int,
    keep: bool,
    frame_bytes: float | None = None,
    frame_seconds: float | None = None,
) -> DownloadPlan:
    """How much is to do.

    Args:
        downloads: All of it.
        left: Frames that are left.
        settings: What the store keeps.
        workers: Processes at work, each with a frame unpacked.
        keep: Whether what is unpacked stays.
        frame_bytes: Bytes of a frame in the store, where measured.
        frame_seconds: Seconds for a frame, where measured.
    """
    sizes = [frame.members[0].bytes for frame in left]
    own = [stored_bytes(settings, frame.source) if frame_bytes is None else frame_bytes for frame in left]
    beside = sum(member.bytes for member in downloads.beside.values())
    # as one more is unpacked by each worker, those wait that are done but not yet as many as are deleted together
    at_once = sum(sizes) if keep else sum(sorted(sizes)[-(workers + _DELETED_AT - 1) :])
    stored = sum(own)
    return DownloadPlan(
        frames=len(left),
        all_frames=len(downloads.radar),
        packed_bytes=sum(frame.members[0].packed for frame in left),
        unpacked_bytes=sum(sizes),
        store_bytes=stored,
        peak_bytes=stored + at_once + beside,
        seconds=None if frame_seconds is None else frame_seconds * len(left),
    )


@dataclass(kw_only=True)
class DownloadOutcome(Outcome):
    """What became of the downloads.

    Args:
        faults: Archives and frames that could not be used, a sentence each.
    """

    faults: list[str] = field(default_factory=list)


def convert_downloads(
    downloads: KRadarDownloads,
    target: Path,
    settings: StoreSettings | None = None,
    *,
    keep: bool = False,
    overwrite: bool = False,
    bulk: JobOptions = HERE,
    announce: Callable[[str], None] | None = None,
) -> DownloadOutcome:
    """Write the store of K-Radar's downloads, or go on with it.

    Args:
        downloads: What :func:`find_downloads` gave.
        target: Folder of the store, beside the downloads.
        settings: What to keep.
        keep: Leave what was unpacked, in the store's folder ``unpacked``, which opens as K-Radar.
        overwrite: Write everything anew.
        bulk: How.
        announce: Is told how much disk and time it takes: before the work, and after the first frames were measured.

    Returns:
        How many frames were written and stood there, and what could not be used.

    Raises:
        DatasetError: If no archive holds radar files that can be converted.
        ConfigError: If the disk has no room, or the target is where the archives are.
    """
    settings, announce = settings or StoreSettings(), announce or _silent
    usable = [radar for radar in downloads.radar if "cells" in settings.products or radar.source == SOURCES[0]]
    downloads = replace(downloads, radar=tuple(usable))
    if not downloads.radar:
        shown = "".join(f"\n  {fault}" for fault in downloads.faults[:10])
        raise DatasetError(
            f"Expected archives with radar_tesseract, radar_zyx_cube or rdr_polar_3d, found none.{shown}"
        )
    if any(target.resolve() == listing.path.resolve().parent for listing in downloads.listings):
        raise ConfigError(f"{target}: expected a folder beside the downloads, got theirs. Name another one.")
    units = [frame.unit for frame in downloads.radar]
    with held(target):
        journal = JobJournal(target / JOURNAL_NAME, settings.text + " of downloads", overwrite=overwrite)
        left = [unit.parameters for unit in units if not journal.has(unit)]
        workers = bulk.num_workers(ConvertDownload(target, settings), len(left)) if left else 1
        plan = plan_downloads(downloads, left, settings, workers=workers, keep=keep)
        announce(str(plan))
        check_room(target, plan.peak_bytes)
        _delete_unpacked(target, journal, units, keep)
        _unpack_beside(downloads.beside, target)
        with JobRun(ConvertDownload(target, settings), units, bulk, journal=journal) as running:
            pending, clock = list[Unit](), _Clock(announce, downloads, left, settings, workers, keep)
            for number in bulk.progress(running):
                if running.here:
                    running.enter(number, running.work(running.unit(number)))
                pending.append(running.unit(number))
                if len(pending) >= _DELETED_AT:
                    _delete_unpacked(target, journal, pending, keep)
                    pending.clear()
                clock.count(journal)
            _delete_unpacked(target, journal, pending, keep)
        faults = [*downloads.faults, *_frame_faults(journal, units)]
        _remove_empty(target / UNPACKED)
        if journal.file_sizes():
            write_manifest(KRadar(target), target, settings.text)
    outcome = running.outcome
    return DownloadOutcome(written=outcome.written, skipped=outcome.skipped, clocks=outcome.clocks, faults=faults)


def _silent(sentence: str) -> None:
    del sentence


class _Clock:
    """Measures the first frames, and says what that makes of the rest."""

    def __init__(
        self,
        announce: Callable[[str], None],
        downloads: KRadarDownloads,
        left: Sequence[RadarDownload],
        settings: StoreSettings,
        workers: int,
        keep: bool,
    ) -> None:
        self.announce, self.downloads, self.left, self.settings = announce, downloads, left, settings
        self.workers, self.keep, self.first_s, self.counted = workers, keep, 0.0, 0

    def count(self, journal: JobJournal) -> None:
        """A frame was done."""
        self.counted += 1
        if self.counted == 1:  # what a process does once, such as its tables, is no measure of a frame
            self.first_s = time.monotonic()
        elif self.counted == 2 + 2 * self.workers and len(self.left) > self.counted:
            journal.commit()
            own = journal.file_sizes().values()
            products = len(self.settings.products)
            seconds = (time.monotonic() - self.first_s) / (self.counted - 1)
            plan = plan_downloads(
                self.downloads,
                self.left[self.counted :],
                self.settings,
                workers=self.workers,
                keep=self.keep,
                frame_bytes=products * sum(own) / max(len(own), 1),
                frame_seconds=seconds,
            )
            self.announce(str(plan))


def _delete_unpacked(target: Path, journal: JobJournal, units: Iterable[Unit], keep: bool) -> None:
    """Delete what frames were unpacked to whose part of the store is on the disk, whole, byte by byte."""
    journal.commit()
    for unit in () if keep else units:
        path = unpacked_path(target, unit.parameters)
        if path.is_file() and not journal.fault(unit, every_byte=True):
            path.unlink()


def _unpack_beside(beside: Mapping[str, ArchiveMember], target: Path) -> None:
    """Unpack annotations, calibrations and weather that do not stand in the store already."""
    for name, member in beside.items():
        path = target / name
        if not (path.is_file() and path.stat().st_size == member.bytes and mark_of(path)[1] == member.crc):
            unpack(member, path)


def _frame_faults(journal: JobJournal, units: Sequence[Unit]) -> Iterator[str]:
    values: Iterable[Any] = journal.values([unit.name for unit in units])
    for unit, value in zip(units, values, strict=True):
        if isinstance(value, dict) and value.get("fault"):
            yield f"{unit.name}: {value['fault']}"


def _remove_empty(folder: Path) -> None:
    """Remove a folder and those in it, if no file is left in any."""
    for inner in sorted(folder.rglob("*"), key=lambda path: -len(path.parts)) if folder.is_dir() else ():
        if inner.is_dir() and not any(inner.iterdir()):
            inner.rmdir()
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def verify_downloads(downloads: KRadarDownloads, target: Path, settings: StoreSettings | None = None) -> list[str]:
    """Compare a store with its journal and the archives; nothing is written.

    Args:
        downloads: What :func:`find_downloads` gave.
        target: Folder of the store.
        settings: What it should keep.

    Returns:
        What is wrong, a line each.

    Raises:
        DatasetError: If there is no store.
    """
    path = target / JOURNAL_NAME
    if not path.is_file():
        raise DatasetError(f"{target}: expected a radar store, found no {JOURNAL_NAME}")
    journal = JobJournal(path, (settings or StoreSettings()).text + " of downloads")
    units = [frame.unit for frame in downloads.radar]
    wrong = [f"{unit.name}: {fault}" for unit in units if (fault := journal.fault(unit, every_byte=True))]
    return wrong or list(_frame_faults(journal, units))
