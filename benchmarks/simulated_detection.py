"""DDS and wDDS by range of detectors on the frozen validation split, both scan patterns; one model against two.

usage: python benchmarks/simulated_detection.py [DATA] [--models NAME_OR_RUN ...] [--json OUT]

DATA is what ``farfield simulate cirrus-sim-val-v2 DATA --cache`` wrote; it is made where it is absent.
Trained and scored on simulation only.
"""

import argparse
import json
from functools import partial
from pathlib import Path

from _report import ROOT, header, progress

from farfield.api import load_detector, open_dataset
from farfield.evaluation import detect, median_ms
from farfield.simulation.recording import record

EPSILONS = (0.0, 0.003, 0.006, 0.009)


def rows_of(result: dict) -> list[str]:
    """One line a range: counts, AP by threshold, aIoU, DDS and the weighted ones, with the interval of DDS."""
    lines = []
    for name, part in [*result["ranges"].items(), ("overall", result)]:
        if part is None:
            lines.append(f"  {name:<9} -")
            continue
        low_high = (result["intervals"].get(name) or {}).get("dds", {}).get("0", {}).get("dds")
        interval = f"[{low_high[0]:.3f}, {low_high[1]:.3f}]" if low_high else ""
        aps = " ".join(f"{value:.3f}" for value in part["ap"].values())
        scores = " ".join(f"{part['dds'][key]['dds']:.4f}" for key in part["dds"])
        lines.append(f"  {name:<9} {aps}   {part['dds']['0']['aiou']:.3f}   {scores}   {interval}")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, nargs="?", default=ROOT / "data" / "cirrus-sim-val-v2")
    parser.add_argument("--models", nargs="+", default=["pointpillars-cirrus-sim"])
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    print(header(), "\n", sep="")
    if not options.data.exists():
        simulating = partial(progress, what="simulating")
        record("cirrus-sim-val-v2", options.data, cache=True, progress=simulating, report=print)
    data = open_dataset(options.data)
    print(f"{options.data.name}: {len(data)} frames, fingerprint {data.fingerprint()[:16]}")
    found = {}
    for model in options.models:
        detector = load_detector(model)
        trained = detector.provenance.get("experiment", {})
        clouds, steps = (trained.get(group, {}).get(key) for group, key in (("data", "clouds"), ("training", "steps")))
        print(f"\n{model}: trained on {clouds}, {steps} steps")
        for cloud in ("gaussian", "uniform"):
            seen = detect(detector, data, cloud=cloud, annotated_only=True, progress=partial(progress, what=cloud))
            result, taken = seen.score("dds", epsilons=EPSILONS), median_ms(seen)
            found[f"{model}/{cloud}"] = result.to_json()
            print(f" {cloud}: {taken:.0f} ms a frame ({detector.precision})")
            print("  range     AP 0.5   1     2     4      aIoU    DDS    wDDS .003 .006  .009   DDS 95 %")
            print("\n".join(rows_of(found[f"{model}/{cloud}"])), flush=True)
    print(f"\n{result.convention}")
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
