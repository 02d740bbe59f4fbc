"""The K-Radar paper's Table 4 in shape: radar and LiDAR detectors by weather, on simulated K-Radar drives.

usage: python benchmarks/radar_detectors.py [--runs RUN ...] [--against A B] [--data DATA] [--seed SEED]
                                            [--drives N] [--frames N] [--weather WEATHER] [--into NAME]

A RUN is the folder of a finished training, or the name of weights that ship: ``farfield train NAME-kradar-sim`` makes
the default ones, others have one setting more (``-o training.seed=1``, ``-o detector.positions=metres``), as their
lines say. Drives of seed 11 are learnt from, those of seed 12 (58 drives, 348 frames) served to choose settings, and by
default a run is scored on those of seed 13, which chose nothing. ``--weather sleet --seed 14 --drives 232
--frames 464`` scores on drives in that weather alone, more of them than the mixed set holds. Scores are kept beside the
weights (in runs/shipped for those that ship), by data set, so that a cut run goes on where it stopped. The simulator's
LiDAR window takes snow and ice ("icing"): the LiDAR's figures in sleet and heavy snow follow from that input as well.
``ship_radar_weights.py`` calls this for the weights that ship.

``--against A B`` tells how far the mean of the runs A lies above that of the runs B, with a 95 % interval: what the
difference would have been, had other drives been drawn, the same ones for both.
"""

import argparse
import hashlib
import json
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _report import ROOT, header, progress

from farfield.api import load_detector, open_dataset
from farfield.detectors.weights import bundled_weights, resolve_weights
from farfield.evaluation import detect
from farfield.files.atomic import write_text
from farfield.metrics import Detections
from farfield.metrics.bootstrap import Bootstrap, replicate_weights
from farfield.simulation.recording import record

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


def evaluated(run: str, data: Any, fingerprint: str, *, draws: bool) -> dict[str, Any]:
    """Results of a run by protocol, from its folder if these weights were scored on these frames before.

    With ``draws`` also those on other draws of drives.
    """
    weights = resolve_weights(run)
    key = hashlib.sha256(weights.read_bytes() + fingerprint.encode()).hexdigest()
    beside = ROOT / "runs" / "shipped" if weights in bundled_weights().values() else weights.parent
    kept = beside / f"{weights.stem}-kradar-{fingerprint[:8]}.json"
    if kept.is_file():
        known = json.loads(kept.read_text())
        enough = not draws or len(known.get("resampled", {}).get("total", [])) == REPLICATES
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
        results["resampled"] = resampled(found)
    results["parameters"] = sum(parameter.numel() for parameter in detector.network.parameters())
    kept.parent.mkdir(parents=True, exist_ok=True)
    write_text(kept, json.dumps(results))
    return results


def resampled(found: Detections) -> dict[str, list[float | None]]:
    """AP_3d of Sedan at IoU 0.3, per cent, in all and by weather, on REPLICATES draws of as many drives.

    The draws depend on the number of drives alone: those of two runs pair.
    """
    drives = sorted({drive for drive, _ in found.annotations})
    frames = {drive: [key for key in found.annotations if key[0] == drive] for drive in drives}
    drawn: dict[str, list[float | None]] = {name: [] for name in ("total", *WEATHERS)}
    for times in replicate_weights(len(drives), REPLICATES, np.random.default_rng(0)):
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
        for name, figure in zip(drawn, row(result, "3d"), strict=True):
            drawn[name].append(figure)
    return drawn


def difference(ours: list[dict[str, Any]], others: list[dict[str, Any]]) -> list[str]:
    """How far the mean of some runs lies above that of others, in all and in each weather that there is."""
    texts = []
    for place, name in enumerate(("total", *WEATHERS)):
        figures = [[row(run["kradar"], "3d")[place] for run in runs] for runs in (ours, others)]
        if None in figures[0] + figures[1]:
            continue
        draws = [np.array([run["resampled"][name] for run in runs], dtype=float) for runs in (ours, others)]
        low, high = np.nanquantile(draws[0].mean(axis=0) - draws[1].mean(axis=0), [0.025, 0.975])
        texts.append(f"{name:<11} {np.mean(figures[0]) - np.mean(figures[1]):+.1f} [{low:+.1f}, {high:+.1f}]")
    return texts


def row(result: dict[str, Any], measure: str, iou: str = "0.3") -> list[float | None]:
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
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
    simulated = parser.add_argument_group(
        "drives to simulate", "into data/kradar-sim-test or data/kradar-sim-WEATHER, unless they are there"
    )
    simulated.add_argument("--seed", type=int, default=13)
    simulated.add_argument("--drives", type=int, default=116)
    simulated.add_argument("--frames", type=int, default=696, help="of all drives together")
    simulated.add_argument("--weather", choices=WEATHERS, help="of every drive")
    simulated.add_argument("--into", help="another name of their folder below data/")
    simulated.add_argument("--workers", type=int, default=0)
    options = parser.parse_args()
    compared = {name for pair in options.against for side in pair for name in side.split(",")}
    if unknown := compared - {Path(run).name for run in options.runs}:
        parser.error(f"--against: expected names of --runs, got {', '.join(sorted(unknown))}")
    print(header(), "\n", sep="")
    folder = options.data or ROOT / "data" / (options.into or f"kradar-sim-{options.weather or 'test'}")
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
        results[name] = evaluated(run, data, fingerprint, draws=name in compared)
    for protocol in PROTOCOLS:
        print(f"\n{protocol}: AP of Sedan at IoU 0.3, per cent")
        heads = ("total", "normal", "overc.", "fog", "rain", "sleet", "l.snow", "h.snow")
        print(line("", "", ()) + " ".join(f"{name:>6}" for name in heads))
        for measure in ("3d", "bev"):
            for name, result in results.items():
                print(line(name, f"AP_{measure}", row(result[protocol], measure)))
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
        print(f"\nkradar, AP_3d: A above B with 95 % intervals over drives, {REPLICATES} draws")
        for names in options.against:
            ours, others = ([results[name] for name in side.split(",")] for side in names)
            print(f"{' above '.join(names)}")
            print("\n".join(f"  {text}" for text in difference(ours, others)))
    print("\npublished on the real drives, AP_3d, whole schedules")
    print("\n".join(line(name, "AP_3d", figures) for name, figures in PUBLISHED.items()))
    print("\nparameters (times: radar_detector_speed.py)")
    for name, result in results.items():
        print(f"{name:<{WIDTH}} {result['parameters'] / 1e6:6.2f} M")


if __name__ == "__main__":
    main()
