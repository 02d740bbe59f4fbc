"""Ship trained weights of the radar experiments: float16 files, their scores, what `farfield detectors` and docs show.

usage: python benchmarks/ship_radar_weights.py [RTNH_RUN POINTPILLARS_RUN] [--weights-only]
                                               [--drives N] [--frames N] [--workers N]

A RUN is the folder of a finished training: ``farfield train rtnh-kradar-sim`` and ``pointpillars-kradar-sim`` with
``-o training.steps=1500 -o data.simulate.frames=4`` make the shipped ones. In this order it

1. writes both files in float16 into src/farfield/detectors/weights_data, their provenance without folders of a machine;
2. scores what was written, as it will be loaded, on drives of seed 13 (``radar_detectors.py``, whose output becomes
   results/radar_detectors_shipped.txt; the drives are simulated into data/kradar-sim-shipped unless they are there);
3. brings figures.json and the table of docs/detectors.md in line with it (``shipped_figures.py``);
4. runs ``farfield demo --radar`` and puts its picture into docs/images/radar_demo.jpg.
"""

import argparse
import shutil
import subprocess
import sys
from copy import deepcopy
from pathlib import Path
from typing import Any

from _report import ROOT
from shipped_figures import FIGURES, RADAR_RESULTS, RADAR_WEIGHTS

from farfield.detectors.weights import load_weights, resolve_weights, save_weights
from farfield.files.atomic import write_bytes

PICTURE = ROOT / "docs" / "images" / "radar_demo.jpg"
SCORED = "kradar-sim-shipped"


def without_machine(provenance: dict[str, Any]) -> dict[str, Any]:
    """The provenance whose data stand in ``data/NAME``, wherever the machine had them."""
    kept = deepcopy(provenance)
    data = kept["experiment"]["data"]
    for part in [data] if "path" in data else data.values():
        part["path"] = f"data/{Path(part['path']).name}"
    return {**kept, "scored": SCORED}


def ship(run: str | Path, name: str, folder: Path = FIGURES.parent) -> Path:
    """Write the weights of a run in float16 under a name; return the file."""
    network, provenance = load_weights(resolve_weights(run))
    trained = provenance["experiment"]["detector"]["name"]
    if not name.startswith(f"{trained}-"):
        raise SystemExit(f"{run}: expected a run of {name.partition('-')[0]}, got {trained}")
    target = folder / f"{name}.safetensors"
    state, config = network.state_dict(), network.config
    save_weights(target, state, config=config, provenance=without_machine(provenance), half=True)
    return target


def printed(script: str, *words: str) -> bytes:
    """What one of the benchmarks prints."""
    command = [sys.executable, str(ROOT / "benchmarks" / script), *words]
    return subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="*", default=[f"runs/{name}" for name in RADAR_WEIGHTS])
    parser.add_argument("--weights-only", action="store_true", help="write the two files and do no more")
    parser.add_argument("--drives", type=int, default=116)
    parser.add_argument("--frames", type=int, default=348, help="of all drives together")
    parser.add_argument("--workers", type=int, default=0)
    options = parser.parse_args()
    if len(options.runs) != len(RADAR_WEIGHTS):
        parser.error(f"expected a run for each of {', '.join(RADAR_WEIGHTS)}, got {len(options.runs)}")
    for run, name in zip(options.runs, RADAR_WEIGHTS, strict=True):
        path = ship(run, name)
        print(f"written: {path.relative_to(ROOT)}, {path.stat().st_size:,} bytes", flush=True)
    if options.weights_only:
        return
    numbers = ("--drives", str(options.drives), "--frames", str(options.frames), "--workers", str(options.workers))
    text = printed(
        *("radar_detectors.py", "--runs", *RADAR_WEIGHTS, "--against", *RADAR_WEIGHTS, "--into", SCORED, *numbers)
    )
    write_bytes(RADAR_RESULTS, text)
    print(f"written: {RADAR_RESULTS.relative_to(ROOT)}", flush=True)
    print(printed("shipped_figures.py").decode(), end="", flush=True)
    demo = ROOT / "runs" / "radar-demo"
    subprocess.run([sys.executable, "-m", "farfield.cli", "demo", "--radar", "--out", str(demo)], cwd=ROOT, check=True)
    shutil.copyfile(demo / "radar-evaluation" / "weathers.jpg", PICTURE)
    print(f"written: {PICTURE.relative_to(ROOT)}, {PICTURE.stat().st_size:,} bytes")


if __name__ == "__main__":
    main()
