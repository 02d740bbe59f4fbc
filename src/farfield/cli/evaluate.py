"""``farfield evaluate``."""

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from tyro.conf import Positional

from farfield.cli._flags import (
    ALL_CORES,
    AS_THEY_ARE,
    OWN_BOXES,
    OWN_SCORING,
    Jobs,
    Reading,
    Scoring,
    ShownBoxes,
    names,
)
from farfield.cli._output import bar, check_outputs, print_doubts, would_write, write_json
from farfield.vocabulary.counts import count_of

if TYPE_CHECKING:
    from farfield.datasets import Dataset
    from farfield.detectors import Detector
    from farfield.detectors.onnx.detector import OnnxDetector

_DONORS = 200
"""Sweeps into which cars are pasted."""

_FEW = 40
"""Frames for which this process is faster than others that must first import torch."""


def run(
    detector: Positional[str],
    data: Positional[Path],
    *,
    clouds: Annotated[str, tyro.conf.arg(aliases=["--cloud"])] = "",
    split: str = "",
    rotate_deg: float = 0.0,
    reading: Reading = AS_THEY_ARE,
    protocol: str | None = None,
    where: str = "",
    scoring: Scoring = OWN_SCORING,
    boxes: ShownBoxes = OWN_BOXES,
    precision: Literal["auto", "fp32", "bf16", "fp16"] = "auto",
    device: str | None = None,
    jobs: Jobs = ALL_CORES,
    shown_frames: int = 2,
    report: bool = True,
    paste_cars: Literal["", "luminar-h2", "hdl-64e", "os1-128", "os2-64"] = "",
    out: Path | None = None,
    overwrite: bool = False,
    dry_run: bool = False,
    json: Path | None = None,
) -> int:
    """Run a detector over a data set, score it by range for every scan pattern, and write a report page.

    examples:
      farfield evaluate pointpillars-cirrus-sim Cirrus_dataset1
      farfield evaluate runs/pointpillars-cirrus-sim data/val --clouds gaussian,uniform --out runs/eval
      farfield evaluate pointpillars-cirrus-sim data/kitti --range-bins-m 0,30,50,80 --region range
      farfield evaluate runs/rtnh-kradar-sim data/kradar-val --protocol kradar --region narrow
      farfield evaluate runs/second data/val --where 'range_m > 100 and weather == "sleet"'
      farfield evaluate pointpillars-cirrus-sim data/kitti --paste-cars hdl-64e

    Each result names its detector and data with their fingerprints, cloud, class, number of objects, region and
    protocol, and says whether the detector was trained on these frames. Settings that are not given take the protocol's
    defaults; farfield.evaluate(detector, data) gives the same figures. After an interruption the same command resumes;
    with other protocol settings the detector does not run again. Run times are in timing.json, apart from the scores.

    Args:
        detector: A bundled detector's name, a run's folder, a weights file, or an exported .onnx file.
        data: The data set; its format is recognised.
        clouds: Which clouds, comma-separated (default: those that suit the detector).
        split: train, val or test, or time-val and its like to cut each sequence in time (default: all frames).
        rotate_deg: Turn every frame counter-clockwise about z; 180 looks backwards.
        reading: How the files are read.
        protocol: dds, nuscenes, kitti, kradar, kradar-compat:VARIANT or a registered one (default: kradar for K-Radar
            data, dds for all others). K-Radar's also scores each weather, road and time of day.
        where: Only frames and boxes that fulfil a condition, such as 'range_m > 100 and weather == "sleet"'; columns:
            sequence, frame, weather, road, time, label, range_m, bearing_deg, x_m, y_m, z_m, length_m, width_m,
            height_m, yaw_deg, speed_m_s, and of annotated boxes points, track_id, visibility, occlusion, truncation.
        scoring: How the boxes are scored. All classes that the detector knows have a row too; large_vehicle counts as
            vehicle where no label is given.
        boxes: Which of the detector's boxes count.
        precision: fp32, bf16 or fp16; auto takes bf16 where the hardware supports it, else fp32, and prints its choice.
        device: Where to run, such as cpu or cuda:0; auto, the default, takes a GPU if there is one.
        jobs: Who does the work.
        shown_frames: Frames in the report's pictures.
        report: Draw the page; otherwise `farfield report` can draw it later from the saved results.
        paste_cars: Also write false_vehicles.html: what the detector takes for vehicles on these sweeps without their
            annotated objects, by kind, and how many over the share that it finds of simulated cars that stand in them,
            as this sensor would see them, in the first of the clouds. At most 200 annotated sweeps, spread evenly;
            needs the extra `simulate`.
        out: Folder of the evaluation and its report.html (default: runs/evaluation-DETECTOR-DATA, with a number
            appended if that holds another detector or other data of the same names).
        overwrite: Run the detector again on frames that an earlier evaluation finished.
        dry_run: Say what would be written, and write nothing.
        json: Write the result into this file as `farfield score --json` does, of several clouds by their names; -
            prints it.
    """
    from farfield.api import load_detector
    from farfield.evaluation import as_trained, suitable_clouds
    from farfield.evaluation.evaluating import EvaluationOptions, evaluate_clouds
    from farfield.evaluation.lost import LOST, lost_json
    from farfield.evaluation.record import EVALUATION, PAGE, TIMING, default_folder
    from farfield.figures.tables import class_table
    from farfield.frame.provenance import is_simulated
    from farfield.frame.where import Where
    from farfield.jobs.folders import held
    from farfield.metrics import PROTOCOLS
    from farfield.metrics.result import figure_names, value_at
    from farfield.pages.evaluation_page import write_report

    sources: tuple[Path | str | None, ...] = (detector, data, *reading.paths)
    check_outputs(sources, files={"--json": json}, folders={"--out": out})
    if where:
        Where(where)  # says what is wrong with it before anything is read
    loaded = load_detector(detector, precision=precision, device=device, **boxes.options)
    opened = reading.open(data, rotate_deg=rotate_deg)
    opened = opened.split(split) if split else opened
    print_doubts(opened)
    print(f"{loaded.precision} on {loaded.device}: {loaded.why_precision}", file=sys.stderr)
    protocol = protocol or opened.protocol
    settings = scoring.settings(PROTOCOLS[protocol])
    if scoring.label is not None:
        settings["label"] = scoring.label
    folder = out or default_folder(loaded.name, loaded.digest(), opened)
    check_outputs(sources, folders={"--out": folder})
    own = {f"{name} of --out": folder / name for name in (EVALUATION, LOST, TIMING, PAGE)}
    check_outputs((), files={"--json": json, **own})
    pasting = _pasting(loaded, opened, names(clouds), paste_cars) if paste_cars else None
    if dry_run:
        first = as_trained(opened, loaded.info)[0]
        chosen = names(clouds) or suitable_clouds(loaded.info, first)
        for cloud in chosen:
            first.cloud(cloud)  # or says why it cannot be read
        what = (
            f"{protocol} on {count_of(len(opened), 'frame')}, cloud "
            f"{', '.join(chosen)}: evaluation.json, the boxes, report.html{', false_vehicles.html' * bool(paste_cars)}"
        )
        would_write(what, folder)
        return 0
    options = EvaluationOptions(
        clouds=names(clouds) or None,
        shown_frames=shown_frames,
        protocol=protocol,
        title=f"{detector} on {opened.root.name}",
        provenance={"simulated": is_simulated(opened.root), **({"kept": boxes.changed} if boxes.changed else {})},
        bulk=jobs.options("detecting", workers=int(loaded.device.type != "cpu" or len(opened) < _FEW)),
        journals=folder,
        overwrite=overwrite,
        settings=settings,
        where=where,
    )
    with held(folder):
        evaluation = evaluate_clouds(loaded, opened, options)
        evaluation.save(folder)
        write_json(folder / LOST, lost_json(evaluation.lost))
        if evaluation.timing:  # apart, so that equal evaluations are equal files
            write_json(folder / TIMING, evaluation.timing)
        for name, result in evaluation.results.items():
            print(f"{name}:\n{evaluation.tables[name]}\n")
            print(class_table(result, evaluation.parts[name]), end="")
        if report:
            drawing = partial(bar, what="drawing", transient=True)
            page = write_report(folder / PAGE, evaluation, progress=drawing)
        if json is not None:
            results = evaluation.results
            write_json(json, dict(results) if len(results) > 1 else results[next(iter(results))])
        false_vehicles = _false_vehicles(loaded, pasting, folder) if pasting is not None else None
    for name, measured in evaluation.timing.items():
        print(f"{name}: {measured['median_ms']:.1f} ms a frame from points to boxes (median of {measured['frames']})")
    print(f"evaluation: {folder / 'evaluation.json'}; farfield worst {folder} lists what was lost")
    if report:
        print(f"report: {page.resolve()}")
    if false_vehicles is not None:
        print(f"false vehicles: {false_vehicles.resolve()}")
    figures = (value_at(result, name) for result in evaluation.results.values() for name in figure_names(result))
    if all(value is None for value in figures):
        print("exit status 1: nothing could be scored, every figure is null")
        return 1
    return 0


@dataclass(frozen=True, kw_only=True)
class _Pasting:
    """What cars are pasted into: annotated sweeps as the detector sees them, and the cloud that it reads."""

    data: "Dataset"
    cloud: str
    sensor: str


def _pasting(detector: "Detector | OnnxDetector", opened: "Dataset", clouds: list[str], sensor: str) -> _Pasting:
    """The sweeps and the cloud, checked before anything is detected."""
    from farfield.errors import ConfigError, DatasetError
    from farfield.evaluation import as_trained, suitable_clouds

    data = as_trained(opened, detector.info)
    annotated = [row for row in range(len(data)) if data.has_annotation(row)]
    if not annotated:
        raise DatasetError(
            f"{opened.root}: --paste-cars: expected annotated sweeps, out of which the objects are taken; found none. "
            "Name data with labels, or leave the flag out."
        )
    count = min(len(annotated), _DONORS)
    data = data.select([annotated[number * len(annotated) // count] for number in range(count)])
    cloud = (clouds or suitable_clouds(detector.info, data[0]))[0]
    data[0].cloud(cloud)  # or says why it cannot be read
    kind = data[0].sensors[cloud].kind if cloud in data[0].sensors else "lidar"
    if kind != "lidar":
        raise ConfigError(
            f"--paste-cars {sensor}: expected a LiDAR's cloud, into which cars are pasted as this LiDAR sees them; the "
            f"detector reads {cloud}, of a {kind}. Leave the flag out, or take a detector for LiDAR."
        )
    return _Pasting(data=data, cloud=cloud, sensor=sensor)


def _false_vehicles(detector: "Detector | OnnxDetector", pasting: _Pasting, folder: Path) -> Path:
    from farfield.evaluation.pasted_cars import field_of, try_on_donors
    from farfield.pages.false_vehicles_page import headline, write_false_vehicles
    from farfield.simulation.overlay import LIDARS

    data, cloud, sensor = pasting.data, pasting.cloud, pasting.sensor
    sweeps = (data[row] for row in bar(range(len(data)), what="pasting cars", transient=True))
    trial = try_on_donors(detector, sweeps, LIDARS[sensor], in_field=field_of(data), cloud=cloud)
    without = f"{count_of(len(data), 'sweep')} without annotated objects"
    print(f"{cloud}: {without}, cars pasted as {sensor} sees them: {headline(trial)}")
    return write_false_vehicles(folder, trial, data, detector=detector.name, cloud=cloud)
