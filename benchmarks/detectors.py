"""The seed's Tables I and II on the frozen validation split: every detector, the same data and budget for all.

usage: python benchmarks/detectors.py [--runs RUN ...] [--data DATA] [--figures]

A RUN is the folder of a finished training. Results are kept beside the weights, so that a cut run goes on where it
stopped. ``--figures`` also measures speed and writes src/farfield/detectors/weights_data/figures.json, which
``farfield detectors`` shows. Trained and scored on simulation only.
"""

import argparse
import hashlib
import json
import platform
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from _report import ROOT, git, header, progress
from detector_speed import busy_cloud, milliseconds

from farfield.api import load_detector, open_dataset
from farfield.detectors.weights import bundled_weights, resolve_weights
from farfield.evaluation import detect, median_ms
from farfield.files.atomic import write_text
from farfield.frame.provenance import processor
from farfield.simulation.recording import record

SPLIT = "cirrus-sim-val-v2"
EPSILONS = (0.0, 0.003, 0.006, 0.009)
CLOUDS = ("gaussian", "uniform")
RANGES = ("0-70", "70-150", "150-250", "overall")
FIGURES = ROOT / "src" / "farfield" / "detectors" / "weights_data" / "figures.json"
DEFAULT_RUNS = [
    f"runs/{name}-cirrus-sim-table" for name in ("pointpillars", "voxelnet", "second", "pointrcnn", "sparsecentre")
]


def evaluated(run: str, data: Any) -> dict[str, Any]:
    """Results of a run by cloud, from its folder if these weights were scored on this split before."""
    weights = resolve_weights(run)
    digest = hashlib.sha256(weights.read_bytes()).hexdigest()
    kept = weights.with_name(f"{weights.stem}-{SPLIT}.json")
    if kept.is_file() and (known := json.loads(kept.read_text()))["weights_sha256"] == digest:
        return dict(known)
    detector = load_detector(run)
    results: dict[str, Any] = {"weights_sha256": digest, "precision": detector.precision, "clouds": {}}
    for cloud in CLOUDS:
        seen = detect(detector, data, cloud=cloud, annotated_only=True, progress=partial(progress, what=cloud))
        found = seen.score("dds", epsilons=EPSILONS)
        results["clouds"][cloud] = {**found.to_json(), "convention": str(found.convention), "frame_ms": median_ms(seen)}
    write_text(kept, json.dumps(results))
    return results


def part_of(result: dict[str, Any], name: str) -> dict[str, Any] | None:
    """One range of a result, or the whole."""
    return result if name == "overall" else result["ranges"][name]


def dds_of(result: dict[str, Any], name: str) -> dict[str, float | None]:
    """DDS by epsilon of one range."""
    part = part_of(result, name)
    return {key: None if part is None else value["dds"] for key, value in (part or {"dds": {}})["dds"].items()}


def table(results: dict[str, dict[str, Any]], cloud: str) -> str:
    """One line a detector and range: AP by threshold, aIoU, DDS and wDDS, and the interval of DDS."""
    lines = [f"{'detector':<14} {'range':<8} AP 0.5   1     2     4     aIoU   DDS    .003   .006   .009   DDS 95 %"]
    for name, result in results.items():
        for where in RANGES:
            part = part_of(result["clouds"][cloud], where)
            if part is None:
                continue
            low_high = (result["clouds"][cloud]["intervals"].get(where) or {}).get("dds", {}).get("0", {}).get("dds")
            aps = " ".join(f"{value:.3f}" for value in part["ap"].values())
            scores = " ".join(f"{part['dds'][key]['dds']:.4f}" for key in part["dds"])
            interval = f"[{low_high[0]:.3f}, {low_high[1]:.3f}]" if low_high else ""
            lines.append(f"{name:<14} {where:<8} {aps}  {part['dds']['0']['aiou']:.3f}  {scores} {interval}")
    return "\n".join(lines)


def schedule(provenance: dict[str, Any]) -> str:
    """What a run was trained with, in one line."""
    experiment = provenance["experiment"]
    training, data = experiment["training"], experiment["data"]
    made = data["simulate"] or {}
    seen = training["steps"] * training["batch_size"]
    return (
        f"{training['steps']} steps of {training['batch_size']} ({seen} samples), peak {training['learning_rate']}, "
        f"seed {training['seed']}, {provenance['frames']} frames of {made.get('preset')} (seed {made.get('seed')}), "
        f"clouds {' and '.join(data['clouds'])}, {provenance.get('precision')}, {provenance.get('threads')} threads, "
        f"commit {provenance['environment']['commit']}"
    )


def figures_of(run: str, result: dict[str, Any], points: int) -> dict[str, Any]:
    """The record of one detector for ``farfield detectors``."""
    cloud, speeds, parameters = busy_cloud(points, seed=1), {}, 0
    for precision in ("bf16", "fp32"):
        detector = load_detector(run, precision=precision, device="cpu")
        parameters = sum(p.numel() for p in detector.network.parameters())
        speeds[precision] = float(np.median(milliseconds(detector, cloud, 12)))
    name = detector.config.name
    shipped = [key for key in bundled_weights() if key == f"{name}-cirrus-sim"]
    return {
        "weights": shipped[0] if shipped else "",
        "parameters": parameters,
        "frame_ms": {key: round(value, 1) for key, value in speeds.items()},
        "scores": {c: {r: dds_of(result["clouds"][c], r) for r in RANGES} for c in CLOUDS},
        "setting": {"schedule": schedule(detector.provenance)},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=ROOT / "data" / SPLIT)
    parser.add_argument("--runs", nargs="+", default=DEFAULT_RUNS)
    parser.add_argument("--points", type=int, default=60_000, help="points of the frame that is timed")
    parser.add_argument("--figures", action="store_true", help="also time the detectors and write figures.json")
    options = parser.parse_args()
    print(header(), "\n", sep="")
    if not options.data.exists():
        record(SPLIT, options.data, cache=True, progress=partial(progress, what="simulating"), report=print)
    data = open_dataset(options.data)
    frozen = json.loads((ROOT / "src" / "farfield" / "simulation" / f"{SPLIT}.json").read_text())
    print(f"{SPLIT}: {len(data)} frames, sha256 {frozen['sha256']}, fingerprint {data.fingerprint()[:16]}\n")
    results = {}
    for run in options.runs:
        detector = load_detector(run)
        label = detector.config.name if detector.config.name not in results else run
        print(f"{label:<14} {schedule(detector.provenance)}", flush=True)
        results[label] = evaluated(run, data)
    for cloud in CLOUDS:
        print(f"\n{cloud.capitalize()}\n{table(results, cloud)}")
    print(f"\n{next(iter(results.values()))['clouds']['gaussian']['convention']}")
    if not options.figures:
        return
    budget = schedule(load_detector(options.runs[-1]).provenance).split(", peak")[0]
    records = {
        load_detector(run).config.name: figures_of(run, result, options.points)
        for run, result in zip(options.runs, results.values(), strict=True)
    }
    stored = {
        "split": SPLIT,
        "sha256": frozen["sha256"],
        "budget": budget,
        "points": f"{options.points} points in 250 m x 100 m, points to boxes, median",
        "precision": "bf16 and fp32",
        "machine": f"{processor()}, {torch.get_num_threads()} threads, {platform.system()}",
        "date": time.strftime("%Y-%m-%d", time.gmtime()),
        "commit": git(ROOT, "rev-parse", "--short", "HEAD"),
        "detectors": records,
    }
    write_text(FIGURES, json.dumps(stored, indent=1) + "\n")
    print("\nspeed, points to boxes:")
    for name, kept in records.items():
        times = ", ".join(f"{key} {value:.0f} ms" for key, value in kept["frame_ms"].items())
        print(f"{name:<14} {kept['parameters'] / 1e6:6.2f} M parameters   {times}")


if __name__ == "__main__":
    main()
