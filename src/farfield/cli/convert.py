"""``farfield convert``: write a data set in another layout, as a fast binary cache, or its radar tensors made light."""

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from farfield.cli._flags import ALL_CORES, AS_THEY_ARE, Jobs, Reading
from farfield.cli._output import check_outputs, from_data, leave_card, would_write
from farfield.vocabulary.counts import count_of

if TYPE_CHECKING:
    from farfield.datasets.kradar.store import StoreSettings


def run(
    source: tyro.conf.Positional[Path],
    target: tyro.conf.Positional[Path | None] = None,
    /,
    *,
    to: Literal[
        "kitti",
        "openpcdet",
        "cirrus",
        "boxes-csv",
        "openlabel",
        "sustechpoints",
        "cvat",
        "supervisely",
        "xtreme1",
        "labelcloud",
        "nuscenes",
        "coco",
        "cache",
        "radar-store",
    ],
    dialect: Literal["nuscenes", "t4"] = "nuscenes",
    reading: Reading = AS_THEY_ARE,
    format: str | None = None,
    boxes: Literal["boxes", "full_boxes"] = "boxes",
    cloud: Annotated[str | None, tyro.conf.arg(aliases=["--clouds"])] = None,
    reference: str | None = None,
    products: str = "cells",
    region: Literal["narrow", "wide", "cube"] = "wide",
    rate: float = 1.0,
    over: Literal["all", "valid", "region"] = "all",
    doppler: bool = True,
    jobs: Jobs = ALL_CORES,
    keep: bool = False,
    verify: bool = False,
    overwrite: bool = False,
    dry_run: bool = False,
) -> None:
    """Write a data set in another layout, its ASCII clouds as a binary cache, or its radar tensors as a light store.

    examples:
      farfield convert Cirrus_dataset1 --to cache
      farfield convert Cirrus_dataset1 data/as_kitti --to kitti
      farfield convert Cirrus_dataset1 data/custom --to openpcdet
      farfield convert data/sim labels.csv --to boxes-csv
      farfield convert data/kradar labels.csv --to boxes-csv --reference radar
      farfield convert data/kitti data/as_cirrus --to cirrus
      farfield convert data/sim data/scenes --to sustechpoints
      farfield convert data/sim data/task --to cvat
      farfield convert data/sim data/project --to supervisely
      farfield convert data/sim data/as_nuscenes --to nuscenes
      farfield convert data/kitti image_boxes.json --to coco
      farfield convert data/kradar data/store --to radar-store
      farfield convert data/kradar data/store --to radar-store --verify
      farfield convert downloads data/store --to radar-store --roots /media/disk2/downloads

    An interrupted conversion resumes: files that are intact and whose sources are unchanged are skipped. What the
    target format cannot hold is listed first, from frames spread over the data set, and stored in the folder's
    .farfield_losses.jsonl. A radar store also gets radar_store.json with the bytes that each task needs. A folder of
    K-Radar's downloads is converted archive by archive: the disk space and time needed are printed first, unpacked
    files are deleted once their part of the store is verified, sources are never changed, and annotations, calibrations
    and weather are unpacked into the store, which then opens by itself.

    Args:
        source: Folder of the data set, whose format is recognised; with --to radar-store also one of K-Radar's zip
            archives as they were downloaded (those of further disks by --roots).
        target: Folder to write into, or a .csv file with --to boxes-csv, a .json file with --to coco (the boxes in
            images); none with --to cache.
        to: The layout to write.
        dialect: With --to nuscenes: nuScenes' own tree, or T4's, a data set a scene.
        reading: How the files are read.
        format: Format of the source, if it is not to be recognised.
        boxes: Label the frames' own boxes, or the full objects' where the data set knows both.
        cloud: Which cloud to write (gaussian, uniform...) (default: the first).
        reference: Sensor in whose coordinates boxes and clouds are written, such as radar (default: the data's own).
        products: What a radar store keeps: cells, polar3d, or both with a comma between.
        region: Where a radar store keeps cells.
        rate: Share of cells that a radar store keeps; 1 keeps every cell of the region.
        over: Whether that share is of all cells before they are cropped (K-Radar's wide clouds), of the valid ones in
            the field of view, or of the region's (its corridor's clouds).
        doppler: Keep each cell's velocity in a radar store.
        jobs: Who does the work.
        keep: Leave what was unpacked of downloads, in the store's folder unpacked.
        verify: Only compare what was written with its checksums and its source.
        overwrite: Write everything anew.
        dry_run: Say what would be written, and write nothing.
    """
    from farfield.datasets.convert import check_apart, convert, losses
    from farfield.datasets.convert import verify as verify_all
    from farfield.datasets.kradar.store import StoreSettings
    from farfield.errors import ConfigError, DatasetError

    if dialect != "nuscenes" and to != "nuscenes":
        raise ConfigError(f"--dialect {dialect}: expected --to nuscenes, whose dialects there are, got --to {to}")
    layout = "t4" if dialect == "t4" else to
    if verify and (target is None or to == "cache"):
        raise ConfigError("convert: expected the folder that was written with --verify, got none")
    if target is not None and not verify and to != "cache":
        as_file = (to, target.suffix) in (("boxes-csv", ".csv"), ("coco", ".json"))
        check_outputs(
            (source, *reading.paths),
            files={"target": target if as_file else None},
            folders={"target": None if as_file else target},
            apart=True,
        )
    store_products = tuple(name.strip() for name in products.split(","))
    store = StoreSettings(products=store_products, region=region, rate=rate, over=over, doppler=doppler)
    unnamed = format is None and reading.mapping is None
    if to == "radar-store" and target is not None and unnamed and _are_downloads(source):
        _convert_downloads((source, *reading.roots), target, store, jobs, (keep, verify, overwrite, dry_run))
        return
    if keep:
        raise ConfigError("--keep: expected a folder of archives with --to radar-store, whose unpacked files it keeps")
    dataset = reading.open(source, format=format, reference=reference)
    if verify and target is not None:
        faults = verify_all(dataset, target, to=layout, boxes=boxes, cloud=cloud, store=store)
        if faults:
            shown = "".join(f"\n  {fault}" for fault in faults[:20]) + ("\n  ..." if len(faults) > 20 else "")
            fix = "Convert again without --verify to fix them."
            raise DatasetError(f"{target}: expected all to be intact, found {len(faults)} that are not. {fix}{shown}")
        print(f"{count_of(len(dataset), 'frame')}: what was written is intact.")
        return
    if dry_run:
        if target is not None:
            check_apart(target, dataset, beside=True)
        for loss in losses(dataset, layout, boxes=boxes, cloud=cloud, store=store):
            print(loss)
        would_write(
            f"{count_of(len(dataset), 'frame')} of {dataset.name} as {to}", target or source, from_data(dataset)
        )
        return
    outcome = convert(
        dataset,
        target,
        to=layout,
        boxes=boxes,
        cloud=cloud,
        overwrite=overwrite,
        store=store,
        bulk=jobs.options("writing"),
        announce=print,
    )
    if target is not None and target.is_dir() and to != "cache":
        leave_card(target, f"A data set in the layout {to}" if to != "radar-store" else "A radar store", dataset)
    print(f"{outcome.written} written, {outcome.skipped} had been written before.")


def _are_downloads(source: Path) -> bool:
    """Whether a folder holds archives and no data set besides."""
    from farfield.datasets.downloads import archives_in
    from farfield.datasets.recognition import recognise

    return source.is_dir() and recognise(source) is None and bool(archives_in([source]))


def _convert_downloads(
    roots: tuple[Path, ...], target: Path, store: "StoreSettings", jobs: Jobs, flags: tuple[bool, bool, bool, bool]
) -> None:
    """A store of K-Radar's archives."""
    from farfield.datasets.kradar.downloads import convert_downloads, find_downloads, plan_downloads, verify_downloads
    from farfield.errors import DatasetError

    keep, verify, overwrite, dry_run = flags
    downloads = find_downloads(roots)
    if verify:
        faults = verify_downloads(downloads, target, store)
        if faults:
            shown = "".join(f"\n  {fault}" for fault in faults[:20])
            raise DatasetError(f"{target}: expected all to be intact, found {len(faults)} that are not.{shown}")
        print(f"{count_of(len(downloads.radar), 'frame')}: what was written is intact.")
        return
    if dry_run:
        print(plan_downloads(downloads, downloads.radar, store, workers=max(jobs.workers, 1), keep=keep))
        for fault in downloads.faults:
            print(f"warning: {fault}", file=sys.stderr)
        would_write(f"{count_of(len(downloads.radar), 'frame')} of K-Radar as a radar store", target)
        return
    outcome = convert_downloads(
        downloads,
        target,
        store,
        keep=keep,
        overwrite=overwrite,
        bulk=jobs.options("writing"),
        announce=partial(print, file=sys.stderr, flush=True),
    )
    leave_card(target, "A radar store", target)
    for fault in outcome.faults:
        print(f"warning: {fault}", file=sys.stderr)
    print(f"{outcome.written} written, {outcome.skipped} had been written before.")
