"""Detectors as ONNX files: parity, boxes, seconds and MB, the same boxes without torch, the size of what runs them.

The machine's other work makes wall time long here; seconds of CPU are what an export takes.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np
from _report import ROOT, MissingError, Part, load_printed, part_parser, progress, run_parts
from packaging.requirements import Requirement

import farfield as ff
from farfield.datasets import Dataset
from farfield.files.boxes_csv import read_boxes_csv
from farfield.frame import Boxes, Cloud, Key

CIRRUS = ("pointpillars", "second", "sparsecentre", "pointrcnn", "voxelnet")
DETECTORS = ("rtnh-kradar-sim", "rtn", *(f"{name}-cirrus-sim" for name in CIRRUS))
PARITY, SAME_SHARE, MOST_MB, ALONE_MB = 1e-5, 0.999, 130, 170
NO_TORCH = """
import sys
BLOCKED = {"torch", "onnx", "onnxscript", "safetensors", "lightning_fabric"}
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in BLOCKED:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Blocked())  # not None among sys.modules: tyro takes that for one that is imported
from farfield.cli import main
status = main(sys.argv[1:])
assert not BLOCKED & {name.split(".")[0] for name in sys.modules}
raise SystemExit(status)
"""


def detectors(arguments: Sequence[str]) -> int:
    """Each of the seven exported and compared on its five clouds and on simulated frames, then run without torch."""
    parser = part_parser(detectors.__doc__)
    parser.add_argument("--detectors", nargs="+", default=[*DETECTORS], help="names or weights; rtn is trained here")
    parser.add_argument("--frames", type=int, default=4, help="simulated frames of each data set")
    parser.add_argument("--steps", type=int, default=60, help="of the training of RTN, of which no weights ship")
    parser.add_argument("--keep", type=Path, help="folder for the files; a temporary one unless given")
    options = parser.parse_args(arguments)
    missed = 0
    with load_printed(), tempfile.TemporaryDirectory() as temporary:
        folder = Path(options.keep or temporary)
        for name in options.detectors:
            data = _simulated(folder, "kradar" if "kradar" in name or name == "rtn" else "cirrus", options.frames)
            weights: str | Path = name
            if name == "rtn":
                weights = _trained_rtn(folder, options.steps)
                print(f"rtn: trained here for {options.steps} steps on the simulated frames, since no weights ship")
            try:
                missed |= _one(name, weights, data, folder)
            except ff.FarfieldError as error:
                print(f"{name}: {error}", flush=True)
                missed = 1
    return missed


def _simulated(folder: Path, kind: str, frames: int) -> Dataset:
    """The small preset of a kind; a folder that is there is taken as it is."""
    from farfield.simulation.recording import record

    root = folder / kind
    if not root.exists():
        sensors = {"sensors": "os2-64,cells"} if kind == "kradar" else {}
        bar, report = partial(progress, what="simulating"), partial(print, file=sys.stderr)
        record(f"{kind}-sim-mini", root, frames=frames, report=report, progress=bar, **sensors)
    return ff.open_dataset(root)


def _trained_rtn(folder: Path, steps: int) -> Path:
    from farfield.experiments.catalogue import find
    from farfield.experiments.plan import Plan
    from farfield.experiments.schema import load_experiment

    overrides = [
        "name=rtn",
        "training.workers=0",
        f"data.path={folder / 'kradar'}",
        f"training.steps={steps}",
        "training.precision=fp32",
    ]
    return Plan(load_experiment(find("rtn50-kradar-sim"), overrides), folder / "rtn").run()


def _one(name: str, weights: str | Path, data: Dataset, folder: Path) -> int:
    from farfield.detectors.exporting.parity import compared, same_share
    from farfield.detectors.exporting.plans import plan_of
    from farfield.detectors.onnx.detector import OnnxDetector
    from farfield.detectors.runtime import Detector
    from farfield.evaluation import plan_detection

    detector = Detector.load(weights, device="cpu", precision="fp32")
    before_s = time.process_time()
    try:
        done = ff.export(detector, folder / f"{name}.onnx")
    except ImportError as error:
        raise MissingError(str(error)) from error
    cpu_s = time.process_time() - before_s
    print(f"{name}: {done.seconds:.0f} s, of CPU {cpu_s:.0f} s; {done.size / 1e6:.1f} MB", flush=True)
    plan, exported, rows = plan_detection(detector, data, in_own=True), OnnxDetector(done.path), list(done.parity)
    _, graph = plan_of(detector.network)
    for index in range(len(data)):
        cloud = plan.task.frames[index].cloud(plan.task.cloud)
        rows.append(compared(f"frame {index}", cloud, detector, graph, (exported,)))
    for row in rows:
        print(f"  {row.cloud:<14}{row.points:>9,} points  {row.largest:.1e}  {row.same:8.2%} of {row.boxes} boxes")
    expected = [Boxes.empty() if frame is None else frame.boxes for frame in plan.detections()]
    got = _without_torch(done.path, data, folder)
    alike = sum(same_share(boxes, got[key]) >= SAME_SHARE for boxes, key in zip(expected, data.keys, strict=True))
    print(f"  predict without torch: {sum(map(len, expected))} boxes, the same in {alike} of {len(data)} frames")
    held = all(row.largest <= PARITY and row.same >= SAME_SHARE for row in rows) and alike == len(data)
    print(f"  {'held' if held else 'MISSED'}: at most {PARITY:g}, at least {SAME_SHARE:.1%}", flush=True)
    return int(not held)


def _without_torch(path: Path, data: Dataset, folder: Path) -> dict[Key, Boxes]:
    """The boxes of a data set by ``farfield predict``, in a process that cannot import torch."""
    out = folder / f"{path.stem}.csv"
    words = ["predict", str(path), str(data.root), "--out", str(out), "--workers", "1"]
    subprocess.run([sys.executable, "-c", NO_TORCH, *words], check=True, stdout=subprocess.DEVNULL)
    rows, boxes = read_boxes_csv(out), {}
    for key in data.keys:
        here = rows.frame == key[1]
        here = here if rows.sequence is None else here & (rows.sequence == key[0])
        boxes[key] = Boxes(
            centre_m=rows.centre_m[here], size_m=rows.size_m[here], yaw_rad=rows.yaw_rad[here], label=rows.label[here]
        )
    return boxes


def sizes(arguments: Sequence[str]) -> int:
    """MB of installed packages: the core, what the extras onnx and export add, and numpy and onnxruntime alone."""
    part_parser(sizes.__doc__).parse_args(arguments)
    core = _needed("farfield")
    parts = {name: _needed("farfield", name) - core for name in ("onnx", "export")}
    alone = _needed("numpy") | _needed("onnxruntime")
    if "onnxruntime" not in alone:
        raise MissingError("onnxruntime is not installed")
    core_mb = sum(map(_size_mb, core - {"farfield"}))
    print(f"core without Farfield itself: {core_mb:.0f} MB")
    for name, packages in parts.items():
        more = sorted(((_size_mb(package), package) for package in packages), reverse=True)
        listed = ", ".join(f"{package} {size:.0f}" for size, package in more if size >= 1)
        print(f"farfield[{name}] adds {sum(size for size, _ in more):.0f} MB: {listed}")
    added_mb, alone_mb = sum(map(_size_mb, parts["onnx"])), sum(map(_size_mb, alone))
    print(f"numpy and onnxruntime alone: {alone_mb:.0f} MB (aim below {ALONE_MB}); onnx adds at most {MOST_MB} MB")
    return int(added_mb > MOST_MB or alone_mb >= ALONE_MB)


def _needed(package: str, *extras: str) -> set[str]:
    """A package and all that it needs here, by name; what is not installed is left out."""
    names, waiting = set[str](), [(package, tuple(extras))]
    while waiting:
        name, wanted = waiting.pop()
        try:
            requires = distribution(name).requires or []
        except PackageNotFoundError:
            continue
        names.add(name)
        for requirement in map(Requirement, requires):
            marker = requirement.marker
            if marker is None or any(marker.evaluate({"extra": extra}) for extra in (*wanted, "")):
                other = requirement.name.lower().replace("_", "-")
                if other not in names or (other == package and requirement.extras):
                    waiting.append((other, tuple(requirement.extras)))
    return names


def _size_mb(package: str) -> float:
    """Bytes of a package's files, without what Python compiles of them."""
    files = [Path(str(file.locate())) for file in distribution(package).files or () if file.suffix != ".pyc"]
    return sum(path.stat().st_size for path in files if path.is_file()) / 1e6


def example(arguments: Sequence[str]) -> int:
    """examples/deploy/detect.py on a scan, in an interpreter of numpy and onnxruntime alone: boxes, seconds, MB."""
    parser = part_parser(example.__doc__)
    parser.add_argument("--python", default=sys.executable, help="of an environment of numpy and onnxruntime alone")
    parser.add_argument("--detector", default="pointpillars-cirrus-sim", help="a PointPillars")
    parser.add_argument("--keep", type=Path, help="folder of exported files and frames; a temporary one unless given")
    options = parser.parse_args(arguments)
    with load_printed(), tempfile.TemporaryDirectory() as temporary:
        folder = Path(options.keep or temporary)
        path = folder / f"{options.detector}.onnx"
        if not path.exists():
            ff.export(options.detector, path)
        kind, name = ("kradar", "os2-64") if "kradar" in options.detector else ("cirrus", "gaussian")
        cloud, scan = _simulated(folder, kind, 3)[0].cloud(name), folder / "scan.pcd"
        scan.write_bytes(_pcd(cloud))
        command = [options.python, str(ROOT / "examples" / "deploy" / "detect.py"), str(path), str(scan)]
        began = os.times()
        printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[1:]
        cpu_s = sum(os.times()[2:4]) - sum(began[2:4])
        boxes = ff.load_detector(path)(cloud)
        ours = np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad])
        theirs = np.array([list(map(float, line.split(",")[2:])) for line in printed]).reshape(-1, 7)
        equal = ours.shape == theirs.shape and np.allclose(ours, theirs, rtol=0, atol=2e-4)
        print(f"{len(printed)} boxes, {'those' if equal else 'NOT those'} of the library; {cpu_s:.1f} s of CPU")
        command = [options.python, "-c", _PACKAGES]
        print(subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip())
    return int(not equal)


def _pcd(cloud: Cloud) -> bytes:
    rows = np.column_stack([cloud.points_m, cloud.column("intensity")]).astype("<f4")
    lines = ["VERSION 0.7", "FIELDS x y z intensity", "SIZE 4 4 4 4", "TYPE F F F F", "COUNT 1 1 1 1"]
    lines += [f"WIDTH {len(rows)}", "HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {len(rows)}", "DATA binary", ""]
    return "\n".join(lines).encode() + rows.tobytes()


_PACKAGES = """
import sys
from importlib.metadata import distributions
from pathlib import Path
files = [path for path in Path(sys.prefix).rglob("*") if path.is_file() and not path.is_symlink()]
names = sorted({item.metadata["Name"] for item in distributions()})
size_mb = sum(path.stat().st_size for path in files) / 1e6
print(f"environment: {size_mb:.0f} MB in {len(names)} packages: {', '.join(names[:9])}")
"""
PARTS = {
    "detectors": Part(detectors, "--detectors pointpillars-kradar-sim --frames 1 --keep TMP"),
    "sizes": Part(sizes),
    "example": Part(example, "--detector pointpillars-kradar-sim --keep TMP"),
}

if __name__ == "__main__":
    raise SystemExit(run_parts(__doc__, PARTS))
