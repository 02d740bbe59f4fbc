"""``farfield predict``."""

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from farfield.cli._progress import hands

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from farfield.datasets import Dataset
    from farfield.datasets.cloud_files import CloudFiles
    from farfield.detection import Found
    from farfield.files.boxes_csv import BoxRows
    from farfield.frame import Boxes, Key


def run(
    detector: Positional[str],
    files: Positional[tuple[Path, ...]],
    *,
    out: Path | None = None,
    cloud: str | None = None,
    score_threshold: float = 0.1,
    rotate_deg: float = 0.0,
    reference: str = "",
    precision: Literal["auto", "fp32", "bf16", "fp16"] = "auto",
    device: str | None = None,
    workers: int = 0,
    engine: str = "local",
    picture: Path | None = None,
) -> int:
    """Detect objects in clouds or in a whole data set, and write the boxes as CSV.

    examples:
      farfield predict pointpillars-cirrus-sim scan.pcd
      farfield predict runs/pointpillars-cirrus-sim a.xyz b.bin --out boxes.csv
      farfield predict pointpillars-cirrus-sim Cirrus_dataset1 --cloud uniform --out uniform.csv --picture first.png

    The columns are those that `farfield score --format boxes-csv` reads. Interrupted with --out, the same command goes
    on where it stopped.

    Args:
        detector: A bundled detector's name, a run's folder, or a weights file.
        files: Clouds (.pcd, .bin, .npy, .xyz, .ffcloud), or one data set's folder.
        out: The CSV file; printed unless given.
        cloud: Which of a data set's clouds; the first that suits the detector unless given.
        score_threshold: Boxes below this score are left out.
        rotate_deg: Turn every frame counter-clockwise about z first.
        reference: Coordinates of the written boxes: those of the data unless given, or those in which the detector
            sees the frames, such as radar.
        precision: fp32, bf16, fp16, or what suits the device.
        device: Where to run, such as cpu or cuda:0; auto, the default, takes a GPU if there is one.
        workers: Processes; 0 takes as many as there are cores, frames and memory for, one on a GPU.
        engine: Where the work is done.
        picture: Draw the first frame from above into this file.
    """
    from farfield.api import load_detector, show
    from farfield.bulk.folders import sweep_out_file
    from farfield.detection import search
    from farfield.errors import ConfigError
    from farfield.files.boxes_csv import format_boxes_csv_parts, write_boxes_csv_parts

    frames = _frames(files, rotate_deg)
    loaded = load_detector(detector, precision=precision, device=device, cloud=cloud)
    journal = None if out is None else out.parent / f".{out.name}.unfinished.jsonl"
    bulk = hands(workers or int(loaded.device.type != "cpu"), engine, "detecting")
    chosen = partial(search, loaded, frames, cloud=cloud, bulk=bulk, journal=journal)
    prepared = chosen()
    own, seen = frames[0], prepared.work.seen[0]
    if reference and reference not in (own.reference, seen.reference):
        known = " or ".join(dict.fromkeys((own.reference, seen.reference)))
        raise ConfigError(f"--reference: expected {known}, got {reference!r}")
    shown = seen if reference == seen.reference else own
    prepared = prepared if shown is seen else chosen(in_own=True)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        sweep_out_file(out)
    found = _Sure(frames.keys, prepared.found({}), score_threshold)
    if out is not None and journal is not None:
        write_boxes_csv_parts(out, found.rows())
        journal.unlink(missing_ok=True)
        print(f"{found.count} boxes in {len(frames)} frames: {out}")
    else:
        for text in format_boxes_csv_parts(found.rows()):
            sys.stdout.write(text)
    if picture is not None:
        show(shown, found.first).savefig(picture, dpi=120)
        print(f"picture: {picture}")
    return 0


class _Sure:
    """The boxes above a score, frame by frame; only those of the first frame are kept."""

    def __init__(self, keys: "Sequence[Key]", found: "Iterator[Found | None]", score_threshold: float) -> None:
        self.keys, self.found, self.threshold = keys, found, score_threshold
        self.count = 0
        self.first: Boxes | None = None

    def rows(self) -> "Iterator[BoxRows]":
        """Rows of the CSV file, one frame at a time."""
        from farfield.recording.convert import box_rows

        for key, found in zip(self.keys, self.found, strict=True):
            if found is None:
                continue
            boxes = found.boxes
            boxes = boxes if boxes.score is None else boxes[boxes.score >= self.threshold]
            self.first = boxes if self.first is None else self.first
            self.count += len(boxes)
            yield box_rows([(key, boxes)])


def _frames(files: tuple[Path, ...], rotate_deg: float) -> "Dataset | CloudFiles":
    from farfield.datasets import open_dataset
    from farfield.datasets.cloud_files import CloudFiles
    from farfield.errors import DatasetError

    if len(files) == 1 and files[0].is_dir():
        return open_dataset(files[0], rotate_deg=rotate_deg)
    missing = [str(path) for path in files if not path.is_file()]
    if missing or not files:
        raise DatasetError(
            f"Expected cloud files or one data set's folder; not there: {', '.join(missing) or 'nothing given'}."
        )
    if rotate_deg:
        raise DatasetError("--rotate-deg turns the frames of a data set; put the clouds into a folder and name that.")
    return CloudFiles(files)
