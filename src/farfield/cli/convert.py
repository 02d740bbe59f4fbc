"""``farfield convert``: write a data set in another layout, or as a fast binary cache."""

from pathlib import Path
from typing import Literal

import tyro


def run(
    source: tyro.conf.Positional[Path],
    target: tyro.conf.Positional[Path | None] = None,
    /,
    *,
    to: Literal["kitti", "cirrus", "boxes-csv", "cache"],
    mapping: Path | None = None,
    format: str | None = None,
    boxes: Literal["boxes", "full_boxes"] = "boxes",
    cloud: str | None = None,
    overwrite: bool = False,
) -> None:
    """Write a data set in another layout, or its ASCII clouds as a binary cache beside them.

    examples:
      farfield convert Cirrus_dataset1 --to cache
      farfield convert Cirrus_dataset1 data/as_kitti --to kitti
      farfield convert data/sim labels.csv --to boxes-csv
      farfield convert data/kitti data/as_cirrus --to cirrus

    An interrupted conversion goes on where it stopped: files that are there, intact and from unchanged sources are
    skipped.

    Args:
        source: Folder of the data set; its format is recognised.
        target: Folder to write into, or a .csv file with --to boxes-csv; none with --to cache.
        to: The layout to write.
        mapping: Mapping file of a Cirrus copy that deviates from the documented layout.
        format: Format of the source, if it is not to be recognised.
        boxes: Label the frames' own boxes, or the full objects' where the data set knows both.
        cloud: Which cloud to write (gaussian, uniform, merged...); the first unless given.
        overwrite: Write everything anew.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from farfield.datasets import open_dataset
    from farfield.datasets.convert import convert

    dataset = open_dataset(source, format=format) if mapping is None else open_dataset(source, mapping=mapping)
    columns = (TextColumn("writing"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("writing", total=None)
        outcome = convert(
            dataset,
            target,
            to=to,
            boxes=boxes,
            cloud=cloud,
            overwrite=overwrite,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    Console().print(f"{outcome.written} written, {outcome.skipped} were there and intact.", highlight=False)
