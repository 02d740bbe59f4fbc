"""``farfield predict``."""

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from farfield.cli._progress import bar

if TYPE_CHECKING:
    from farfield.frame import Boxes, Frame


def run(
    detector: Positional[str],
    files: Positional[tuple[Path, ...]],
    *,
    out: Path | None = None,
    cloud: str | None = None,
    score_threshold: float = 0.1,
    rotate_deg: float = 0.0,
    reference: str = "",
    precision: Literal["auto", "fp32", "bf16"] = "auto",
    device: str | None = None,
    picture: Path | None = None,
) -> int:
    """Detect objects in clouds or in a whole data set, and write the boxes as CSV.

    examples:
      farfield predict pointpillars-cirrus-sim scan.pcd
      farfield predict runs/pointpillars-cirrus-sim a.xyz b.bin --out boxes.csv
      farfield predict pointpillars-cirrus-sim Cirrus_dataset1 --cloud uniform --out uniform.csv --picture first.png

    The columns are those that `farfield score --format boxes-csv` reads.

    Args:
        detector: A bundled detector's name, a run's folder, or a weights file.
        files: Clouds (.pcd, .bin, .npy, .xyz, .ffcloud), or one data set's folder.
        out: The CSV file; printed unless given.
        cloud: Which of a data set's clouds; the first that suits the detector unless given.
        score_threshold: Boxes below this score are left out.
        rotate_deg: Turn every frame counter-clockwise about z first.
        reference: Coordinates of the written boxes: those of the data unless given, or those in which the detector
            sees the frames, such as radar.
        precision: fp32, bf16, or what suits the processor.
        device: Where to run, such as cpu or cuda:0.
        picture: Draw the first frame from above into this file.
    """
    from farfield.api import load_detector, show
    from farfield.detection import as_trained, back_in_own, detect
    from farfield.errors import ConfigError
    from farfield.files.boxes_csv import format_boxes_csv, write_boxes_csv
    from farfield.frame import Frame
    from farfield.recording.convert import box_rows

    frames = _frames(files, rotate_deg)
    loaded = load_detector(detector, precision=precision, device=device, cloud=cloud)
    seen = as_trained(frames, loaded)
    found = detect(loaded, frames, cloud=cloud, progress=partial(bar, what="detecting"))
    found = found.replaced({key: _sure(boxes, score_threshold) for key, boxes in found.boxes.items()})
    known = (frames[0].reference, found.reference)
    if reference and reference not in known:
        raise ConfigError(f"--reference: expected {' or '.join(dict.fromkeys(known))}, got {reference!r}")
    written = found if reference == found.reference else back_in_own(found, frames, seen)
    rows = box_rows((Frame(sequence=key[0], frame_id=key[1]), boxes) for key, boxes in written.boxes.items())
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_boxes_csv(out, rows)
        print(f"{len(rows)} boxes in {len(frames)} frames: {out}")
    else:
        sys.stdout.write(format_boxes_csv(rows))
    if picture is not None:
        show(seen[0], found.boxes[seen[0].key]).savefig(picture, dpi=120)
        print(f"picture: {picture}")
    return 0


def _sure(boxes: "Boxes", score_threshold: float) -> "Boxes":
    return boxes if boxes.score is None else boxes[boxes.score >= score_threshold]


def _frames(files: tuple[Path, ...], rotate_deg: float) -> "list[Frame]":
    from farfield.datasets import open_dataset
    from farfield.datasets.cloud_files import read_cloud
    from farfield.errors import DatasetError
    from farfield.frame import Frame

    if len(files) == 1 and files[0].is_dir():
        return open_dataset(files[0], rotate_deg=rotate_deg)  # type: ignore[return-value]
    missing = [str(path) for path in files if not path.is_file()]
    if missing or not files:
        raise DatasetError(
            f"Expected cloud files or one data set's folder; not there: {', '.join(missing) or 'nothing given'}."
        )
    if rotate_deg:
        raise DatasetError("--rotate-deg turns the frames of a data set; put the clouds into a folder and name that.")
    return [Frame.of(read_cloud(path), sequence="files", frame_id=path.stem) for path in files]
