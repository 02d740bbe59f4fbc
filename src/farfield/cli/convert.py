"""``farfield convert``: write a data set in another layout, as a fast binary cache, or its radar tensors made light."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from farfield.cli._flags import ALL_CORES, AS_THEY_ARE, Jobs, Reading
from farfield.cli._output import check_outputs, from_data, would_write
from farfield.vocabulary.counts import count_of


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

    An interrupted conversion goes on where it stopped: files that are there, intact and from unchanged sources are
    skipped. What the target does not hold of the source is said first, a line each, by frames that are spread over the
    set, and kept in the folder's .farfield_losses.jsonl. A radar store also gets radar_store.json, which tells how many
    bytes each task needs.

    Args:
        source: Folder of the data set; its format is recognised.
        target: Folder to write into, or a .csv file with --to boxes-csv, a .json file with --to coco (the boxes in
            images); none with --to cache.
        to: The layout to write.
        dialect: With --to nuscenes: nuScenes' own tree, or T4's, a data set a scene.
        reading: How the files are read.
        format: Format of the source, if it is not to be recognised.
        boxes: Label the frames' own boxes, or the full objects' where the data set knows both.
        cloud: Which cloud to write (gaussian, uniform...); the first unless given.
        reference: Sensor in whose coordinates boxes and clouds are written, such as radar; the data's own unless given.
        products: What a radar store keeps: cells, polar3d, or both with a comma between.
        region: Where a radar store keeps cells.
        rate: Share of cells that a radar store keeps; 1 keeps every cell of the region.
        over: Whether that share is of all cells before they are cropped (K-Radar's wide clouds), of the valid ones in
            the field of view, or of the region's (its corridor's clouds).
        doppler: Keep each cell's velocity in a radar store.
        jobs: Who does the work.
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
    dataset = reading.open(source, format=format, reference=reference)
    store_products = tuple(name.strip() for name in products.split(","))
    store = StoreSettings(products=store_products, region=region, rate=rate, over=over, doppler=doppler)
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
    print(f"{outcome.written} written, {outcome.skipped} were there and intact.")
