"""What the options for far objects give: the sparse detector with each of them beside the one without.

usage: python benchmarks/far_options.py [--stride 2]

Loss by range and balanced ranges are scored on every ``stride``-th frame of the frozen validation split; several sweeps
on frames 0.1 s apart of another simulated set, beside a network that learnt from the same frames one by one. The runs
are trained as docs/detectors.md tells; those that are absent are left out.
"""

import argparse
from functools import partial
from typing import Any

from _report import ROOT, header, progress
from simulated_detection import EPSILONS, rows_of

from farfield.api import load_detector, open_dataset
from farfield.evaluation import detect

ON_SPLIT = {
    "plain": "sparsecentre-cirrus-sim-table",
    "far_weight 2": "sparsecentre-far-weight",
    "pasted_bands_m 0, 70, 150, 250; far_sampling 1": "sparsecentre-far-sampling",
}
ON_SWEEPS = {"one sweep": "sparsecentre-sweeps-1", "three sweeps": "sparsecentre-sweeps-3"}


def report(title: str, run: str, data: Any) -> None:
    """Score one run on the Gaussian clouds of some frames."""
    folder = ROOT / "runs" / run
    if not (folder / "weights.safetensors").is_file():
        print(f" {title}: {run} is not trained here")
        return
    detector = load_detector(folder)
    found = detect(detector, data, cloud="gaussian", annotated_only=True, progress=partial(progress, what="gaussian"))
    result = found.score("dds", epsilons=EPSILONS)
    training = detector.provenance["experiment"]["training"]
    print(f" {title}: {training['steps']} steps of {training['batch_size']}, seed {training['seed']}")
    print("  range     AP 0.5   1     2     4      aIoU    DDS    wDDS .003 .006  .009   DDS 95 %")
    print("\n".join(rows_of(result.to_json())), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stride", type=int, default=2)
    options = parser.parse_args()
    print(header(), "\n", sep="")
    split = open_dataset(ROOT / "data" / "cirrus-sim-val-v2")
    chosen = range(0, len(split), options.stride)
    print(f"cirrus-sim-val-v2, {len(chosen)} frames, Gaussian")
    for title, run in ON_SPLIT.items():
        report(title, run, split.select(chosen))
    folder = ROOT / "data" / "sim-sweeps-val"
    if folder.exists():
        sweeps = open_dataset(folder)
        print(f"\n{folder.name}: {len(sweeps)} frames 0.1 s apart, Gaussian, fingerprint {sweeps.fingerprint()[:16]}")
        for title, run in ON_SWEEPS.items():
            report(title, run, sweeps)


if __name__ == "__main__":
    main()
