"""``farfield predict``."""

import sys
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from tyro.conf import Positional

from farfield.cli._flags import ALL_CORES, AS_THEY_ARE, OWN_BOXES, Jobs, Reading, ReadingFlags, ShownBoxes
from farfield.cli._output import check_outputs, leave_card, print_doubts, would_write
from farfield.vocabulary.counts import count_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from farfield.datasets import Dataset
    from farfield.evaluation import FrameDetections
    from farfield.frame import Boxes, Frame, Key

_WORDS = {
    "boxes-csv": "",
    "kitti": " as KITTI's results",
    "nuscenes": " as nuScenes' results",
    "argoverse2": " as a submission to Argoverse 2",
    "waymo": " as Waymo's Objects",
    "kradar": " as K-Radar's kit writes them",
    "openpcdet": " as OpenPCDet's texts",
    "mmdetection3d": " as mmdetection3d's JSON",
}


def run(
    detector: Positional[str],
    files: Positional[tuple[Path, ...]],
    *,
    out: Path | None = None,
    to: Annotated[
        Literal["boxes-csv", "kitti", "nuscenes", "argoverse2", "waymo", "kradar", "openpcdet", "mmdetection3d"] | None,
        tyro.conf.arg(aliases=["--format"]),
    ] = None,
    cloud: Annotated[str | None, tyro.conf.arg(aliases=["--clouds"])] = None,
    boxes: ShownBoxes = OWN_BOXES,
    split: str = "",
    rotate_deg: float = 0.0,
    reference: str = "",
    reading: Reading = AS_THEY_ARE,
    precision: Literal["auto", "fp32", "bf16", "fp16"] = "auto",
    device: str | None = None,
    jobs: Jobs = ALL_CORES,
    picture: Path | None = None,
    dry_run: bool = False,
) -> int:
    """Detect objects in clouds or in a whole data set, and write the boxes as CSV, KITTI's or nuScenes' results.

    examples:
      farfield predict pointpillars-cirrus-sim scan.pcd
      farfield predict runs/pointpillars-cirrus-sim a.xyz b.bin --out boxes.csv
      farfield predict pointpillars-cirrus-sim Cirrus_dataset1 --cloud uniform --out uniform.csv --picture first.png
      farfield predict pointpillars-cirrus-sim argoverse2/val --out detections.feather
      farfield predict pointpillars-cirrus-sim own --classes vehicle:Car,pedestrian --score-threshold 0.3
      farfield predict pointpillars-cirrus-sim data/kitti --out results --to kitti
      farfield predict pointpillars-cirrus-sim nuscenes --out results.json --to nuscenes
      farfield predict rtnh-kradar-sim data/kradar --out results --to kradar

    `farfield score --format` reads each of them. What a format cannot hold is listed before anything is written. With
    --out, an interrupted command resumes.

    Args:
        detector: A bundled detector's name, a run's folder, a weights file, or an exported .onnx file.
        files: Clouds (.pcd, .ply, .bin, .npy, .npz, .xyz, .las, .laz, .ffcloud), or one data set's folder.
        out: Where to write: a file ending in .csv, nuScenes' .json, Argoverse 2's .feather, Waymo's .bin, or a folder
            with --to kitti, kradar, openpcdet or mmdetection3d (default: print CSV).
        to: Format to write (default: by the suffix of --out): boxes-csv, kitti (FRAME.txt a frame, in a folder for each
            of several sequences; boxes in the camera), nuscenes (one JSON of samples by their tokens, boxes in the
            world: of data in its schema alone; by its suffix alone .json takes any frames under their own names),
            argoverse2 or waymo (submissions; boxes in the vehicle's coordinates, frames named by their stamps), kradar
            (one score cut of K-Radar's kit: all and each condition), openpcdet (its KITTI texts) or mmdetection3d (its
            inferencer's JSON a frame).
        cloud: Which of a data set's clouds (default: the first that suits the detector).
        boxes: Which boxes are written: those that load_detector gives with the same settings. Without
            --score-threshold the weights' own threshold counts, and pictures leave out boxes below 0.3.
        split: train, val or test, or time-val and its like to cut each sequence in time (default: all frames).
        rotate_deg: Turn every frame counter-clockwise about z first.
        reference: Coordinates of the written boxes (default: those of the data), such as radar for a radar detector's
            own.
        reading: How the files are read.
        precision: fp32, bf16 or fp16; auto takes bf16 where the hardware supports it, else fp32, and prints its choice.
        device: Where to run, such as cpu or cuda:0; auto, the default, takes a GPU if there is one.
        jobs: Who does the work.
        picture: Draw the first frame from above into this file, and its camera images with their boxes beside it, as
            FILE-CAMERA.
        dry_run: Say what would be written, and write nothing.
    """
    from farfield.api import load_detector
    from farfield.datasets.convert import check_apart
    from farfield.datasets.result_files import FOLDERS, ResultWriter, result_format, rows_of
    from farfield.errors import ConfigError
    from farfield.evaluation import plan_detection, suitable_clouds
    from farfield.files.boxes_csv import format_boxes_csv_parts
    from farfield.jobs.folders import held

    chosen_format = result_format(out, to)
    as_folder = chosen_format in FOLDERS
    check_outputs(
        (*files, detector, *reading.paths),
        files={"--out": None if as_folder else out, "--picture": picture},
        folders={"--out": out if as_folder else None},
    )
    loaded = load_detector(detector, precision=precision, device=device, cloud=cloud, **boxes.options)
    frames = _frames(files, rotate_deg, reading)
    frames = frames.split(split) if split else frames
    if out is not None:
        check_apart(out, frames)
    print_doubts(frames, cloud)
    print(f"{loaded.precision} on {loaded.device}: {loaded.why_precision}", file=sys.stderr)
    journal = None if out is None else out.parent / f".{out.name}.unfinished.jsonl"
    bulk = jobs.options("detecting", workers=int(loaded.device.type != "cpu"))
    chosen = partial(plan_detection, loaded, frames, cloud=cloud, bulk=bulk, journal=journal)
    prepared = chosen()
    own, view = frames[0], prepared.task.frames[0]
    if reference and reference not in (own.reference, view.reference):
        references = " or ".join(dict.fromkeys((own.reference, view.reference)))
        raise ConfigError(f"--reference: expected {references}, got {reference!r}")
    shown = prepared.task.frames if reference == view.reference else frames
    prepared = prepared if shown is prepared.task.frames else chosen(in_own=True)
    strict = to is not None
    results = ResultWriter(chosen_format, shown, frames.keys, loaded.kind, loaded.class_names, strict)
    if out is not None:
        results.check()
        print("".join(f"{loss}\n" for loss in results.losses()), end="")
    if dry_run:
        shown[0].cloud(cloud or suitable_clouds(loaded.info, shown[0])[0])  # reads it, or says why it cannot
        would_write(f"the boxes of {count_of(len(frames), 'frame')} as {chosen_format}", out or "the output")
        return 0
    with nullcontext() if out is None else held(out, file=not as_folder):
        predictions = _CountedPredictions(frames.keys, prepared.detections())
        if out is not None and journal is not None:
            results.write(out, predictions)
            journal.unlink(missing_ok=True)
            if chosen_format == "kitti":
                leave_card(out, f"Boxes that {Path(detector).name} predicted", frames)
            print("".join(f"note: {note}\n" for note in results.notes), end="")
            least = loaded.config.score_threshold
            print(
                f"{count_of(predictions.count, 'box', 'boxes')} of score {least:g} "
                f"or more in {count_of(len(frames), 'frame')}"
                f"{_WORDS[chosen_format]}: {out}"
            )
            if not predictions.count:
                print("note: nothing was found; farfield doctor FOLDER says whether units, axes and intensities suit")
        else:
            for text in format_boxes_csv_parts(rows_of(predictions, shown[0].reference)):
                sys.stdout.write(text)
    if picture is not None:
        _draw(picture, shown[0], predictions.first, boxes.score_threshold)
    return 0


def _draw(path: Path, frame: "Frame", predictions: "Boxes | None", least: float | None) -> None:
    """The frame from above, and each camera's image with the boxes projected into it, beside one another as files."""
    from farfield.api import show
    from farfield.datasets.labels.json_labels import file_name
    from farfield.evaluation.report_data import shown_predictions
    from farfield.figures.camera import camera_picture
    from farfield.figures.style import save_figure
    from farfield.vocabulary.scores import SHOWN_SCORE

    shown_score = SHOWN_SCORE if least is None else least
    save_figure(path, show(frame, predictions, shown_score=shown_score), dpi=120)
    print(f"picture: {path}")
    boxes, left_out = shown_predictions(predictions, shown_score)
    for name in frame.images:
        camera = frame.cameras.get(name)
        if camera is None:
            print(f"note: no picture of the camera {name}: it has no calibration, so no place for boxes")
            continue
        target = path.with_name(f"{path.stem}-{file_name(name)}{path.suffix}")
        save_figure(target, camera_picture(frame.images[name], camera, predicted=boxes, title=left_out), dpi=120)
        print(f"picture: {target}")


class _CountedPredictions:
    """The boxes frame by frame; only those of the first frame are remembered."""

    def __init__(self, keys: "Sequence[Key]", predictions: "Iterator[FrameDetections | None]") -> None:
        self.keys, self.predictions = keys, predictions
        self.count = 0
        self.first: Boxes | None = None

    def __iter__(self) -> "Iterator[tuple[Key, Boxes]]":
        for key, frame in zip(self.keys, self.predictions, strict=True):
            if frame is None:
                continue
            boxes = frame.boxes
            self.first = boxes if self.first is None else self.first
            self.count += len(boxes)
            yield key, boxes


def _frames(files: tuple[Path, ...], rotate_deg: float, reading: ReadingFlags) -> "Dataset":
    from farfield.datasets.memory import CloudFiles
    from farfield.errors import DatasetError
    from farfield.frame.cloud import CLOUD_SUFFIXES

    alone = files[0] if len(files) == 1 else None
    if alone is not None and (alone.is_dir() or not (alone.is_file() or alone.suffix.lower() in CLOUD_SUFFIXES)):
        return reading.open(files[0], rotate_deg=rotate_deg)
    missing = [str(path) for path in files if not path.is_file()]
    if missing or not files:
        raise DatasetError(
            f"Expected cloud files or one data set's folder; not there: {', '.join(missing) or 'nothing given'}."
        )
    if rotate_deg:
        raise DatasetError("--rotate-deg turns the frames of a data set; put the clouds into a folder and name that.")
    data = CloudFiles(files, **reading.cloud_options)
    for kind, sentence in data.remarks:
        print(f"{kind}: {sentence}", file=sys.stderr)
    return data
