"""``farfield evaluate``."""

import sys
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.conf import Positional

from farfield.cli._detector_options import OWN, BoxFlags
from farfield.cli._dry import would_write
from farfield.cli._progress import bar, hands
from farfield.cli._words import deprecated, names, parse_options, write_json

_FEW = 40
"""Frames for which this process is faster than others that must first import torch."""


def run(
    detector: Positional[str],
    data: Positional[Path],
    *,
    clouds: Annotated[str, tyro.conf.arg(aliases=["--cloud"])] = "",
    split: str = "",
    rotate_deg: float = 0.0,
    mapping: Path | None = None,
    columns: int | None = None,
    protocol: str = "",
    label: str | None = None,
    range_bins_m: str = "",
    epsilons: str = "",
    epsilon: str = "",
    region: str = "",
    options: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE ...")] = (),
    replicates: int = 200,
    kept: BoxFlags = OWN,
    precision: Literal["auto", "fp32", "bf16", "fp16"] = "auto",
    device: str | None = None,
    workers: int = 0,
    engine: str = "local",
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
        mapping: Mapping YAML of a Cirrus copy that deviates from the documented layout, or of an own folder's classes.
        columns: Columns of .bin files; what the numbers themselves show unless given.
        protocol: dds, nuscenes, kitti, kradar, kradar-compat:VARIANT or a registered one; kradar on K-Radar's layout
            and dds on all others unless given. K-Radar's also scores each weather, road and time of day.
        label: The class to score by range; unless given the most frequent one that the detector knows (large_vehicle
            counts as vehicle), or with K-Radar's protocols every class that it knows. All its classes have a row too.
        range_bins_m: Edges of the range bins; 0,70,150,250 or K-Radar's 0,20,40,60,80 unless given.
        epsilons: wDDS weights; for dds 0,0.003,0.006,0.009 unless given, for nuscenes 0.
        epsilon: The old name of epsilons.
        region: For dds window (x 0..250, |y| <= 50 m, the default), range, or none; for nuscenes and kitti none is the
            default. K-Radar's: wide (the default), narrow, none, or six bounds in the radar's frame.
        options: Further settings of the protocol, such as min_points=5 ap=area distance=bev.
        replicates: Bootstrap replicates of the 95 % intervals; 0 for none.
        kept: Which of the detector's boxes count.
        precision: fp32, bf16, fp16; auto takes what the device multiplies itself, and says so.
        device: Where to run, such as cpu or cuda:0; auto, the default, takes a GPU if there is one.
        workers: Processes; 0 takes as many as there are cores, frames and memory for, one on a GPU or for few frames.
        engine: Where the work is done.
        shown_frames: Frames in the report's pictures.
        report: Draw the page; without it `farfield report` draws it later from what is kept.
        out: Folder of the evaluation and its report.html; runs/evaluation-DETECTOR-DATA unless given, with a number
            behind it where another detector or other data of these names were evaluated there.
        overwrite: Detect anew what an evaluation before found.
        dry_run: Say what would be written, and write nothing.
        json: Write the result into this file as `farfield score --json` does, of several clouds by their names; -
            prints it.
    """
    from farfield.api import load_detector, open_dataset
    from farfield.evaluation import as_trained, suitable_clouds
    from farfield.evaluation.evaluating import EvaluationOptions, evaluate_clouds
    from farfield.evaluation.record import default_folder
    from farfield.figures.tables import class_table
    from farfield.frame.provenance import is_simulated
    from farfield.metrics import PROTOCOLS, Bootstrap
    from farfield.metrics.options import numbers
    from farfield.metrics.result import figure_names, value_at
    from farfield.pages.evaluation_page import write_report

    epsilons = deprecated("--epsilon", epsilon, "--epsilons", epsilons)
    reading: dict[str, Any] = {"mapping": mapping} if mapping else {}
    reading |= {"bin_columns": columns} if columns else {}
    opened = open_dataset(data, rotate_deg=rotate_deg, **reading)
    opened = opened.split(split) if split else opened
    loaded = load_detector(detector, precision=precision, device=device, **kept.options)
    print(f"{loaded.precision} on {loaded.device}: {loaded.why_precision}", file=sys.stderr)
    protocol = protocol or opened.protocol
    given: dict[str, Any] = {
        "label": label,
        "range_bins_m": numbers(range_bins_m, "--range-bins-m") if range_bins_m else None,
        "epsilons": numbers(epsilons, "--epsilons") if epsilons else None,
        "region": region or None,
        "bootstrap": Bootstrap(replicates=replicates) if "bootstrap" in PROTOCOLS[protocol].options() else None,
    }
    given |= parse_options(PROTOCOLS[protocol], options, tuple(given))
    folder = out or default_folder(loaded.name, loaded.digest(), opened)
    if dry_run:
        first = as_trained(opened, loaded.info)[0]
        read = names(clouds) or suitable_clouds(loaded.info, first)
        for each in read:
            first.cloud(each)  # or says why it cannot be read
        what = (
            f"{protocol} on {len(opened)} frames, cloud {', '.join(read)}: evaluation.json, what is found, report.html"
        )
        would_write(what, folder)
        return 0
    chosen = EvaluationOptions(
        clouds=names(clouds) or None,
        shown_frames=shown_frames,
        protocol=protocol,
        title=f"{detector} on {opened.root.name}",
        provenance={"simulated": is_simulated(opened.root), **({"kept": kept.said} if kept.said else {})},
        bulk=hands(workers or int(loaded.device.type != "cpu" or len(opened) < _FEW), engine, "detecting"),
        journals=folder,
        overwrite=overwrite,
        settings={name: value for name, value in given.items() if value is not None},
    )
    evaluation = evaluate_clouds(loaded, opened, chosen)
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
    known = (value_at(result, name) for result in evaluation.results.values() for name in figure_names(result))
    if all(value is None for value in known):
        print("exit status 1: nothing could be scored, every figure is null")
        return 1
    return 0
