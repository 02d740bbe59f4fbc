"""``farfield evaluate``."""

import sys
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

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
from farfield.cli._output import bar, print_doubts, would_write, write_json

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
    scoring: Scoring = OWN_SCORING,
    boxes: ShownBoxes = OWN_BOXES,
    precision: Literal["auto", "fp32", "bf16", "fp16"] = "auto",
    device: str | None = None,
    jobs: Jobs = ALL_CORES,
    shown_frames: int = 2,
    report: bool = True,
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

    A line says what its figures are of: detector and data with their fingerprints, cloud, class, number of objects,
    region, protocol, and whether the detector learnt from these frames. What is not given is the protocol's own
    default; farfield.evaluate(detector, data) gives the same figures.
    Interrupted, the same command goes on where it stopped; with other settings of the protocol nothing is detected
    anew. What the clock measured stands in timing.json, apart from what was computed.

    Args:
        detector: A bundled detector's name, a run's folder, or a weights file.
        data: The data set; its format is recognised.
        clouds: Which clouds, comma-separated; by default those that suit the detector.
        split: train, val or test, or time-val and its like to cut each sequence in time; all frames unless given.
        rotate_deg: Turn every frame counter-clockwise about z; 180 looks backwards.
        reading: How the files are read.
        protocol: dds, nuscenes, kitti, kradar, kradar-compat:VARIANT or a registered one; kradar on K-Radar's layout
            and dds on all others unless given. K-Radar's also scores each weather, road and time of day.
        scoring: How the boxes are scored. All classes that the detector knows have a row too; large_vehicle counts as
            vehicle where no label is given.
        boxes: Which of the detector's boxes count.
        precision: fp32, bf16, fp16; auto takes what the device multiplies itself, and says so. In bf16
            and fp16 on a processor, numbers change by about 0.002 with the order of a cloud's points, in fp32 by a
            millionth.
        device: Where to run, such as cpu or cuda:0; auto, the default, takes a GPU if there is one.
        jobs: Who does the work.
        shown_frames: Frames in the report's pictures.
        report: Draw the page; without it `farfield report` draws it later from what is kept.
        out: Folder of the evaluation and its report.html; runs/evaluation-DETECTOR-DATA unless given, with a number
            behind it where another detector or other data of these names were evaluated there.
        overwrite: Detect anew what an evaluation before found.
        dry_run: Say what would be written, and write nothing.
        json: Write the result into this file as `farfield score --json` does, of several clouds by their names; -
            prints it.
    """
    from farfield.api import load_detector
    from farfield.evaluation import as_trained, suitable_clouds
    from farfield.evaluation.evaluating import EvaluationOptions, evaluate_clouds
    from farfield.evaluation.record import default_folder
    from farfield.figures.tables import class_table
    from farfield.frame.provenance import is_simulated
    from farfield.metrics import PROTOCOLS
    from farfield.metrics.result import figure_names, value_at
    from farfield.pages.evaluation_page import write_report

    opened = reading.open(data, rotate_deg=rotate_deg)
    opened = opened.split(split) if split else opened
    print_doubts(opened)
    loaded = load_detector(detector, precision=precision, device=device, **boxes.options)
    print(f"{loaded.precision} on {loaded.device}: {loaded.why_precision}", file=sys.stderr)
    protocol = protocol or opened.protocol
    settings = scoring.settings(PROTOCOLS[protocol])
    if scoring.label is not None:
        settings["label"] = scoring.label
    folder = out or default_folder(loaded.name, loaded.digest(), opened)
    if dry_run:
        first = as_trained(opened, loaded.info)[0]
        chosen = names(clouds) or suitable_clouds(loaded.info, first)
        for cloud in chosen:
            first.cloud(cloud)  # or says why it cannot be read
        what = f"{protocol} on {len(opened)} frames, cloud {', '.join(chosen)}: evaluation.json, the boxes, report.html"
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
    )
    evaluation = evaluate_clouds(loaded, opened, options)
    evaluation.save(folder)
    if evaluation.timing:  # apart, so that equal evaluations are equal files
        write_json(folder / "timing.json", evaluation.timing)
    for name, result in evaluation.results.items():
        print(f"{name}:\n{evaluation.tables[name]}\n")
        print(class_table(result, evaluation.parts[name]), end="")
    if report:
        drawing = partial(bar, what="drawing", transient=True)
        page = write_report(folder / "report.html", evaluation, progress=drawing)
    if json is not None:
        results = evaluation.results
        write_json(json, dict(results) if len(results) > 1 else results[next(iter(results))])
    for name, measured in evaluation.timing.items():
        print(f"{name}: {measured['median_ms']:.1f} ms a frame from points to boxes (median of {measured['frames']})")
    print(f"evaluation: {folder / 'evaluation.json'}")
    if report:
        print(f"report: {page.resolve()}")
    figures = (value_at(result, name) for result in evaluation.results.values() for name in figure_names(result))
    if all(value is None for value in figures):
        print("exit status 1: nothing could be scored, every figure is null")
        return 1
    return 0
