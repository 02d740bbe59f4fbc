"""``farfield predict``."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from farfield.cli._progress import bar

if TYPE_CHECKING:
    from farfield.frame import Frame


def run(
    detector: Positional[str],
    files: Positional[tuple[Path, ...]],
    *,
    out: Path | None = None,
    cloud: str | None = None,
    score_threshold: float = 0.1,
    rotate_deg: float = 0.0,
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
        cloud: Which of a data set's clouds; its first unless given.
        score_threshold: Boxes below this score are left out.
        rotate_deg: Turn every frame counter-clockwise about z first.
        precision: fp32, bf16, or what suits the processor.
        device: Where to run, such as cpu or cuda:0.
        picture: Draw the first frame from above into this file.
    """
    from farfield.api import as_trained, load_detector, show
    from farfield.files.boxes_csv import format_boxes_csv, write_boxes_csv
    from farfield.recording.convert import box_rows

    frames = _frames(files, rotate_deg)
    loaded = load_detector(detector, precision=precision, device=device, cloud=cloud)
    frames = as_trained(frames, loaded)
    found = []
    for index in bar(range(len(frames)), "detecting"):
        frame = frames[index]
        boxes = loaded(frame)
        found.append((frame, boxes[boxes.score >= score_threshold] if boxes.score is not None else boxes))
    rows = box_rows(found)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_boxes_csv(out, rows)
        print(f"{len(rows)} boxes in {len(frames)} frames: {out}")
    else:
        sys.stdout.write(format_boxes_csv(rows))
    if picture is not None:
        show(*found[0]).savefig(picture, dpi=120)
        print(f"picture: {picture}")
    return 0


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
