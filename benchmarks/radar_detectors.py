"""Radar detectors: average precision by weather beside LiDAR's, and one network on real radars of three makes."""

import hashlib
import json
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from _report import ROOT, SHARED_REAL, MissingError, Part, part_parser, progress, run_parts

from farfield.api import load_detector, open_dataset
from farfield.datasets import Dataset
from farfield.datasets.maps import CommonRadar
from farfield.detectors.runtime import Detector
from farfield.detectors.weights import bundled_weights, resolve_weights
from farfield.evaluation import detect
from farfield.experiments.plan import Plan
from farfield.experiments.schema import experiment_of
from farfield.files.atomic import write_text
from farfield.metrics import Detections
from farfield.metrics.bootstrap import Bootstrap, replicate_weights
from farfield.simulation.recording import record
from farfield.training.method import LABELLED

WEATHERS = ("normal", "overcast", "fog", "rain", "sleet", "light_snow", "heavy_snow")
PROTOCOLS = ("kradar", "kradar-compat:rtnh_narrow")
DEFAULT_RUNS = [f"runs/{name}-kradar-sim" for name in ("rtnh", "rtn50", "rtnx101", "pointpillars")]
WIDTH = 38
REPLICATES = 200
SETTINGS = ("widths", "planes", "power", "positions", "height", "form", "proposals")
PUBLISHED = {
    "RTNH": (47.4, 49.9, 56.7, 52.8, 42.0, 41.5, 50.6, 44.5),
    "RTN": (40.1, 45.6, 48.8, 46.9, 32.9, 22.6, 36.8, 36.8),
    "PointPillars": (45.4, 52.3, 61.0, 42.2, 44.5, 22.7, 40.6, 29.7),
}


def evaluated(run: str, data: Any, fingerprint: str, *, draws: int, kept_in: Path | None) -> dict[str, Any]:
    """Results of a run by protocol, from its folder if these weights were scored on these frames before.

    With ``draws`` also those on so many other draws of drives.
    """
    weights = resolve_weights(run)
    key = hashlib.sha256(weights.read_bytes() + fingerprint.encode()).hexdigest()
    beside = kept_in or (ROOT / "runs" / "shipped" if weights in bundled_weights().values() else weights.parent)
    kept = beside / f"{weights.stem}-kradar-{fingerprint[:8]}.json"
    if kept.is_file():
        known = json.loads(kept.read_text())
        enough = not draws or len(known.get("resampled", {}).get("total", [])) == draws
        if known["key"] == key and enough:
            return dict(known)
    detector = load_detector(run)
    cloud = detector.provenance["experiment"]["data"]["clouds"][0]
    found = detect(detector, data, cloud=cloud, annotated_only=True, progress=partial(progress, what=cloud))
    results: dict[str, Any] = {"key": key, "cloud": cloud, "precision": detector.precision}
    for protocol in PROTOCOLS:
        ours: dict[str, Any] = {"region": "narrow", "classes": ("vehicle",)} if protocol == "kradar" else {}
        scored = found.score(protocol, **ours)
        result = {**scored.to_json(), "convention": scored.convention}
        results[protocol] = {name: result[name] for name in ("ap", "conditions", "ranges", "convention", "counts")}
    if draws:
        results["resampled"] = resampled(found, draws)
    results["parameters"] = sum(parameter.numel() for parameter in detector.network.parameters())
    kept.parent.mkdir(parents=True, exist_ok=True)
    write_text(kept, json.dumps(results))
    return results


def resampled(found: Detections, draws: int) -> dict[str, list[float | None]]:
    """AP_3d of Sedan at IoU 0.3, per cent, in all and by weather, on draws of as many drives.

    The draws depend on the number of drives alone: those of two runs pair.
    """
    drives = sorted({drive for drive, _ in found.annotations})
    frames = {drive: [key for key in found.annotations if key[0] == drive] for drive in drives}
    drawn: dict[str, list[float | None]] = {name: [] for name in ("total", *WEATHERS)}
    for times in replicate_weights(len(drives), draws, np.random.default_rng(0)):
        keys = {
            (f"{drive}, time {number}", key[1]): key
            for drive, count in zip(drives, times.astype(int), strict=True)
            for number in range(count)
            for key in frames[drive]
        }
        again = Detections(
            boxes={new: found.boxes[key] for new, key in keys.items() if key in found.boxes},
            annotations={new: found.annotations[key] for new, key in keys.items()},
            conditions={new: {"weather": found.conditions[key]["weather"]} for new, key in keys.items()},
        )
        result = again.score(
            "kradar",
            region="narrow",
            classes=("vehicle",),
            ious=(0.3,),
            range_bins_m=(0.0, 80.0),
            bootstrap=Bootstrap(replicates=0),
        ).to_json()
        for name, figure in zip(drawn, weathers_row(result, "3d"), strict=True):
            drawn[name].append(figure)
    return drawn


def difference(ours: list[dict[str, Any]], others: list[dict[str, Any]]) -> list[str]:
    """How far the mean of some runs lies above that of others, in all and in each weather that there is."""
    texts = []
    for place, name in enumerate(("total", *WEATHERS)):
        figures = [[weathers_row(run["kradar"], "3d")[place] for run in runs] for runs in (ours, others)]
        if None in figures[0] + figures[1]:
            continue
        draws = [np.array([run["resampled"][name] for run in runs], dtype=float) for runs in (ours, others)]
        low, high = np.nanquantile(draws[0].mean(axis=0) - draws[1].mean(axis=0), [0.025, 0.975])
        texts.append(f"{name:<11} {np.mean(figures[0]) - np.mean(figures[1]):+.1f} [{low:+.1f}, {high:+.1f}]")
    return texts


def weathers_row(result: dict[str, Any], measure: str, iou: str = "0.3") -> list[float | None]:
    """AP in per cent: in all, then by weather."""
    parts = [result, *(result["conditions"]["weather"].get(name) for name in WEATHERS)]
    figures = [None if part is None else part["ap"]["vehicle"][measure][iou] for part in parts]
    return [None if figure is None else 100 * figure for figure in figures]


def line(name: str, what: str, figures: "list[float | None] | tuple[float, ...]") -> str:
    """One line of the table."""
    cells = " ".join("     -" if figure is None else f"{figure:6.1f}" for figure in figures)
    return f"{name:<{WIDTH}} {what:<9} {cells}"


def schedule(provenance: dict[str, Any]) -> str:
    """What a run was trained with, in one line."""
    experiment = provenance["experiment"]
    training, data = experiment["training"], experiment["data"]
    settings = {key: experiment["detector"][key] for key in SETTINGS if key in experiment["detector"]}
    return (
        f"{training['steps']} steps of {training['batch_size']}, peak {training['learning_rate']}, seed "
        f"{training['seed']}, {provenance['frames']} frames, cloud {' and '.join(data['clouds'])}, reader "
        f"{data['options']}, {settings}, {provenance.get('precision')}"
    )


def run_weathers(arguments: Sequence[str]) -> None:
    """The K-Radar paper's Table 4 in shape: radar and LiDAR detectors by weather, on simulated K-Radar drives.

        python benchmarks/radar_detectors.py weathers [--runs RUN ...] [--against A B] [--data DATA] [--seed SEED]
                                                [--drives N] [--frames N] [--weather WEATHER] [--into NAME]

    A RUN is the folder of a finished training, or the name of weights that ship: ``farfield train NAME-kradar-sim``
    makes the default ones, others have one setting more (``-o training.seed=1``, ``-o detector.positions=metres``), as
    their lines say. Drives of seed 11 are learnt from, those of seed 12 (58 drives, 348 frames) served to choose
    settings, and by default a run is scored on those of seed 13, which chose nothing. ``--weather sleet --seed 14
    --drives 232 --frames 464`` scores on drives in that weather alone, more of them than the mixed set holds. Scores
    are kept beside the weights (in runs/shipped for those that ship), by data set, so that a cut run goes on where it
    stopped. The simulator's LiDAR window takes snow and ice ("icing"): the LiDAR's figures in sleet and heavy snow
    follow from that input as well. ``tools/shipped_figures.py weights`` calls this for the weights that ship.

    ``--against A B`` tells how far the mean of the runs A lies above that of the runs B, with a 95 % interval: what the
    difference would have been, had other drives been drawn, the same ones for both.
    """
    parser = part_parser(run_weathers.__doc__)
    parser.add_argument("--data", type=Path, help="these drives, simulating none")
    parser.add_argument("--runs", nargs="+", default=DEFAULT_RUNS)
    parser.add_argument(
        "--against",
        nargs=2,
        action="append",
        default=[],
        metavar=("A", "B"),
        help="names of runs, those of one side joined by commas; may be given several times",
    )
    parser.add_argument("--draws", type=int, default=REPLICATES, help="of drives, for the intervals")
    parser.add_argument("--kept", type=Path, help="where scores are kept, in place of beside the weights")
    simulated = parser.add_argument_group(
        "drives to simulate", "into data/kradar-sim-test or data/kradar-sim-WEATHER, unless they are there"
    )
    simulated.add_argument("--seed", type=int, default=13)
    simulated.add_argument("--drives", type=int, default=116)
    simulated.add_argument("--frames", type=int, default=696, help="of all drives together")
    simulated.add_argument("--weather", choices=WEATHERS, help="of every drive")
    simulated.add_argument("--into", help="another name of their folder below data/")
    simulated.add_argument("--folder", type=Path, help="their folder, in place of one below data/")
    simulated.add_argument("--workers", type=int, default=0)
    options = parser.parse_args(arguments)
    compared = {name for pair in options.against for side in pair for name in side.split(",")}
    if unknown := compared - {Path(run).name for run in options.runs}:
        parser.error(f"--against: expected names of --runs, got {', '.join(sorted(unknown))}")
    folder = ROOT / "data" / (options.into or f"kradar-sim-{options.weather or 'test'}")
    folder = options.data or options.folder or folder
    if options.data is None:
        record(
            *("kradar-sim", folder),
            sequences=options.drives,
            frames=options.frames,
            weather=options.weather,
            stride_s=1.0,
            seed=options.seed,
            sensors="os2-64,cells",
            workers=options.workers,
            progress=partial(progress, what="simulating"),
            report=partial(print, file=sys.stderr),  # it names folders of this machine
        )
    data = open_dataset(folder)
    fingerprint = data.fingerprint()
    print(f"{folder.name}: {len(data)} frames of {len(set(data.sequences))} drives, fingerprint {fingerprint[:16]}")
    results = {}
    for run in options.runs:
        provenance = load_detector(run).provenance
        name = Path(run).name
        print(f"{name:<{WIDTH}} {schedule(provenance)}", flush=True)
        results[name] = evaluated(
            run, data, fingerprint, draws=options.draws * (name in compared), kept_in=options.kept
        )
    for protocol in PROTOCOLS:
        print(f"\n{protocol}: AP of Sedan at IoU 0.3, per cent")
        heads = ("total", "normal", "overc.", "fog", "rain", "sleet", "l.snow", "h.snow")
        print(line("", "", ()) + " ".join(f"{name:>6}" for name in heads))
        for measure in ("3d", "bev"):
            for name, result in results.items():
                print(line(name, f"AP_{measure}", weathers_row(result[protocol], measure)))
        print(next(iter(results.values()))[protocol]["convention"])
    print("\nkradar: AP_3d of Sedan at IoU 0.3 by range, per cent")
    bins = list(next(iter(results.values()))["kradar"]["ranges"])
    print(line("", "", ()) + " ".join(f"{name:>6}" for name in bins))
    for name, result in results.items():
        known = [result["kradar"]["ranges"][within] for within in bins]
        print(
            line(name, "AP_3d", [None if part is None else 100 * part["ap"]["vehicle"]["3d"]["0.3"] for part in known])
        )
    if options.against:
        print(f"\nkradar, AP_3d: A above B with 95 % intervals over drives, {options.draws} draws")
        for names in options.against:
            ours, others = ([results[name] for name in side.split(",")] for side in names)
            print(f"{' above '.join(names)}")
            print("\n".join(f"  {text}" for text in difference(ours, others)))
    print("\npublished on the real drives, AP_3d, whole schedules")
    print("\n".join(line(name, "AP_3d", figures) for name, figures in PUBLISHED.items()))
    print("\nparameters (times: detector_speed.py radar)")
    for name, result in results.items():
        print(f"{name:<{WIDTH}} {result['parameters'] / 1e6:6.2f} M")


FORMS: dict[str, dict[str, Any]] = {
    "radiate": {
        "column": "strength",
        "unit": "db",
        "db_per_one": 127.5,
        "doppler": False,
        "height": False,
        "cell_m": 0.4,
    },
    "astyx": {"column": "magnitude_db", "unit": "db"},
    "view_of_delft": {"column": "rcs_dbsm", "unit": "db"},
}
OPTIONS: dict[str, dict[str, Any]] = {"radiate": {"radar_share": 0.05}}
RANGE_M, HALF_WIDTH_M = 64.0, 16.0
ANCHORS = {
    "vehicle": {"size_m": [4.4, 2.0, 1.8], "z_m": -0.6, "positive_iou": 0.45, "negative_iou": 0.2},
    "bicycle": {"size_m": [1.9, 0.8, 1.7], "z_m": -0.6, "positive_iou": 0.4, "negative_iou": 0.2},
    "pedestrian": {"size_m": [0.8, 0.8, 1.7], "z_m": -0.6, "positive_iou": 0.35, "negative_iou": 0.15},
}
STEPS = 50
FEWEST_OBJECTS, FEWEST_FRAMES = 100, 30
"""From which an AP is worth printing: a recall of one half is known to 0.1, if frames differ."""
Z_95 = 1.96


def seen(root: Path, name: str) -> Dataset:
    """A data set's frames in the common form, its floor taken from all of them."""
    data = open_dataset(root / name, **OPTIONS.get(name, {}))
    form = CommonRadar(**{"floor_db": (0.0,), **FORMS[name]}).fitted(data[index] for index in range(len(data)))
    return data.mapped(form)


def plan(data: Dataset, folder: Path, start: dict[str, Any] | None, steps: int) -> Plan:
    """A short training."""
    grid = {
        "range_m": RANGE_M,
        "half_width_m": HALF_WIDTH_M,
        "z_min_m": -6.0,
        "z_max_m": 8.0,
        "cell_m": [0.8, 0.8, 14.0],
    }
    network = {"name": "rtn", "grid": grid, "planes": 8, "depths": [1, 1], "strides": [2, 2], "neck_width": 16}
    training = {"steps": steps, "batch_size": 1, "min_points": 0, "threads": 1, "workers": 0, "unannotated": "skip"}
    tree = {
        "name": folder.name,
        "data": {"path": "given", "clouds": ["radar"]},
        "detector": {**network, "use_doppler": True, "use_flags": True, "proposals": "anchors", "anchors": ANCHORS},
        "training": {**training, "precision": "fp32", **({} if start is None else {"start": start})},
    }
    return Plan(experiment_of(tree), folder, data={LABELLED: data})


def objects(found: Detections) -> dict[str, int]:
    """Objects of the network's classes in its grid, by class."""
    counted = dict.fromkeys(ANCHORS, 0)
    for annotation in found.annotations.values():
        ahead, left = annotation.boxes.centre_m[:, :2].T
        for label in annotation.boxes.label[(ahead > 0) & (ahead < RANGE_M) & (np.abs(left) < HALF_WIDTH_M)]:
            if str(label) in counted:
                counted[str(label)] += 1
    return counted


def worth(count: int, frames: int) -> str:
    """What may be said of so many objects of a class: Wilson's interval of a recall of one half, at 95 %."""
    if count >= FEWEST_OBJECTS and frames >= FEWEST_FRAMES:
        return f"{count}"
    if not count:
        return "none"
    known = Z_95 * np.sqrt(0.25 / count + Z_95**2 / (4 * count**2)) / (1 + Z_95**2 / count)
    return f"{count} in {frames} frames: n too small for AP, a recall of 0.5 +-{known:.2f} at best"


def makes_row(name: str, data: Dataset, folder: Path, start: dict[str, Any] | None, steps: int) -> list[str]:
    """Train or go on, detect, and say what was met."""
    weights = plan(data, folder, start, steps).run()
    losses = [json.loads(line)["loss"] for line in (folder / "log.jsonl").read_text(encoding="utf-8").splitlines()]
    found = detect(Detector.load(weights), data, cloud="radar", annotated_only=True)
    points = int(np.median([len(data[index].cloud("radar")) for index in range(len(data))]))
    boxes = sum(len(each) for each in found.boxes.values())
    said = [f"{label} {worth(count, len(data))}" for label, count in objects(found).items()]
    return [
        f"{name:<14}{len(data):7d}{points:8d}{steps:7d}{np.mean(losses[:10]):11.3f}{np.mean(losses[-10:]):9.3f}{boxes:8d}"
        f"   {said[0]}",
        *(f"{'':<67}{each}" for each in said[1:]),
    ]


def run_makes(arguments: Sequence[str]) -> None:
    """Real radar frames of three makes in one form: fifty steps on RADIATE's turns, then on Astyx' and View-of-Delft's.

    The frames are so few that what is learnt from is all there is: nothing is claimed of accuracy, and the table says
    how wide the interval of a recall would be. A second run goes on where the first ended.

        python benchmarks/radar_detectors.py makes [--real SHARED_REAL] [--work FOLDER]
    """
    parser = part_parser(run_makes.__doc__)
    parser.add_argument("--real", type=Path, default=SHARED_REAL)
    parser.add_argument("--work", type=Path, help="keeps the runs; a temporary folder otherwise")
    parser.add_argument("--steps", type=int, default=STEPS)
    options = parser.parse_args(arguments)
    if not (options.real / "radiate").is_dir():
        raise MissingError(f"no real frames in {options.real.name}")
    with TemporaryDirectory() as temporary:
        work = options.work or Path(temporary)
        lines = [
            "one network; the other two go on from RADIATE's weights, all of them taken; boxes on what was learnt from",
            "",
            f"{'':<14}{'frames':>7}{'points':>8}{'steps':>7}{'loss first':>11}{'last ten':>9}{'boxes':>8}   objects",
            *makes_row("radiate", seen(options.real, "radiate"), work / "radiate", None, options.steps),
        ]
        for name in ("astyx", "view_of_delft"):
            start = {"weights": str(work / "radiate")}
            lines += makes_row(name, seen(options.real, name), work / name, start, options.steps)
    print("\n".join(lines))


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "weathers": Part(
                    run_weathers,
                    "--runs rtnh-kradar-sim pointpillars-kradar-sim --against rtnh-kradar-sim pointpillars-kradar-sim"
                    " --drives 2 --frames 2 --workers 1 --folder TMP/drives --draws 2 --kept TMP/kept",
                ),
                "makes": Part(run_makes, "--steps 2"),
            },
        )
    )
