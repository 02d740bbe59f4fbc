"""Every verb that writes: its command, the data that it reads, and what of its files differs from run to run."""

import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from _kradar_downloads import pack_downloads
from _report import MissingError

from farfield.cli import RESUMING, VERBS
from farfield.errors import FarfieldError
from farfield.privacy.detectors import face_model_path

TINY_TRAINING = """
name: tiny
data: {path: DATA, clouds: [gaussian]}
detector:
  {grid: {range_m: 64.0, half_width_m: 16.0, cell_m: 0.5}, widths: [8, 16, 16], depths: [0, 0, 0], neck_width: 16,
   score_threshold: 0.0}
training: {steps: 40, batch_size: 1, precision: fp32, threads: 1, workers: 0, checkpoint_every_s: 0.1}
"""
FACES = "the model that finds faces"
TIMING = "timing.json"
CLOCKS = (TIMING, "log.jsonl", "provenance.json", "course.html", "checkpoint.pt", "batches.json")
"""Files that hold what a clock measured, or a path."""


@dataclass(frozen=True)
class VerbCase:
    """A command of a verb; DATA stands in its words for what it reads, OUT for what it writes.

    Args:
        line: Its words, the verb first.
        data: What it reads, of ``DATA``.
        workers: Whether it takes ``--workers``.
        out: Name of what it writes.
        inside: It writes into what it reads: OUT is a copy of that.
        needs: Modules without which it cannot run.
        clocks: Names of further files that hold what a clock measured.
        program: What runs it, of the project, in place of the command line.
        chain: Signals in a row, each of a command that goes on, before the last is run to its end.
        unpacks: It unpacks what it deletes again, so that the bytes of its results alone tell how far it is.
    """

    line: str
    data: str
    workers: bool = True
    out: str = "out"
    inside: bool = False
    needs: tuple[str, ...] = ()
    clocks: tuple[str, ...] = ()
    program: str = ""
    chain: int = 5
    unpacks: bool = False

    @property
    def verb(self) -> str:
        """Its verb."""
        return self.line.split()[0]

    @property
    def resumes(self) -> bool:
        """Whether it goes on where it stopped, by a journal or a checkpoint."""
        return (self.verb in RESUMING and self.verb != "report") or "--film" in self.line

    def command(self, data: Path, workers: int) -> list[str]:
        """The whole command, which is run in the folder that it writes into: some files name others by their path."""
        words = [word.replace("DATA", str(data)).replace("OUT", self.out) for word in self.line.split()]
        program = [str(Path(__file__).resolve().parents[1] / self.program)] if self.program else ["-m", "farfield.cli"]
        return [sys.executable, *program, *words, *(("--workers", str(workers)) if self.workers else ())]


CASES = {
    "simulate": VerbCase("simulate cirrus-sim-mini OUT --frames 12 --sequences 2 --sensors gaussian --cache", ""),
    "simulate --recording": VerbCase(
        "simulate cirrus-sim-mini OUT --recording --frames 24 --sequences 2", "", needs=("rosbags",)
    ),
    "convert --to kitti": VerbCase("convert DATA OUT --to kitti", "frames"),
    "convert --to cirrus": VerbCase("convert DATA OUT --to cirrus", "frames"),
    "convert --to cache": VerbCase("convert OUT --to cache", "frames", inside=True),
    "convert --to radar-store": VerbCase("convert DATA OUT --to radar-store", "radar"),
    "convert --to radar-store, downloads": VerbCase(
        "convert DATA OUT --to radar-store --region narrow", "downloads", unpacks=True
    ),
    "convert --to boxes-csv": VerbCase("convert DATA OUT --to boxes-csv", "frames"),
    "convert --to boxes-csv, a file": VerbCase("convert DATA OUT --to boxes-csv", "frames", out="labels.csv"),
    "convert --to openlabel": VerbCase("convert DATA OUT --to openlabel", "frames"),
    "convert --to sustechpoints": VerbCase("convert DATA OUT --to sustechpoints", "frames"),
    "convert --to cvat": VerbCase("convert DATA OUT --to cvat", "frames"),
    "convert --to nuscenes": VerbCase("convert DATA OUT --to nuscenes", "frames"),
    "convert --to nuscenes --dialect t4": VerbCase("convert DATA OUT --to nuscenes --dialect t4", "frames"),
    "convert --to supervisely": VerbCase("convert DATA OUT --to supervisely", "frames"),
    "convert --to xtreme1": VerbCase("convert DATA OUT --to xtreme1", "frames"),
    "convert --to labelcloud": VerbCase("convert DATA OUT --to labelcloud", "frames"),
    "convert --to coco": VerbCase("convert DATA OUT --to coco", "pictured", out="boxes.json"),
    "convert --to openpcdet": VerbCase("convert DATA OUT --to openpcdet", "frames"),
    "predict": VerbCase(
        "predict pointpillars-cirrus-sim DATA --cloud gaussian --out OUT", "frames", out="boxes.csv", needs=("torch",)
    ),
    "predict --format kitti": VerbCase(
        "predict pointpillars-cirrus-sim DATA --cloud gaussian --out OUT --format kitti", "frames", needs=("torch",)
    ),
    "evaluate": VerbCase(
        "evaluate pointpillars-cirrus-sim DATA --clouds gaussian --replicates 3 --shown-frames 1 --out OUT",
        "frames",
        needs=("torch",),
    ),
    "train": VerbCase("train DATA/tiny.yaml --out OUT", "training", workers=False, needs=("torch",)),
    "adapt": VerbCase(
        "adapt DATA/runs/tiny DATA/data --frames 3 --source DATA/data --source-frames 3 --rounds 2 --steps 6 --out OUT",
        "trained",
        needs=("torch",),
    ),
    "odometry": VerbCase("odometry DATA --cloud gaussian --out OUT", "drive"),
    "depth": VerbCase("depth DATA --out OUT", "pictured"),
    "anonymize": VerbCase("anonymize DATA OUT", "faces", needs=("cv2", FACES)),
    "report --film": VerbCase("report DATA --film OUT --frames 12", "drive", out="film.gif"),
    "report": VerbCase("report DATA/scores.json --out OUT", "scores", workers=False, out="page.html"),
    "demo": VerbCase("demo --frames 4 --sequences 2 --out OUT", "", workers=False, needs=("torch",)),
    "reproduce": VerbCase(
        "reproduce cirrus --out OUT",
        "",
        needs=("torch", "embreex"),
        clocks=("measured.json", "plan.json", "clock.jsonl", "report.html"),  # the page tells the minutes that it took
        program="tests/support/tinygrid.py",
        chain=20,
    ),
    "new-dataset": VerbCase("new-dataset OUT", "", workers=False),
    "import-weights": VerbCase(
        "import-weights DATA/theirs.pth OUT --settings DATA/mine.yaml",
        "checkpoint",
        workers=False,
        out="ours.safetensors",
        needs=("torch",),
    ),
    "export": VerbCase(
        "export pointpillars-cirrus-sim OUT", "", workers=False, out="ours.onnx", needs=("torch", "onnx", "onnxruntime")
    ),
    "worst": VerbCase(
        "worst DATA/evaluation --data DATA/frames --out OUT",
        "evaluated",
        workers=False,
        out="worst.html",
        needs=("torch",),
    ),
    "stats": VerbCase("stats DATA --name frames --sweeps 10 --out OUT", "frames"),
    "compare": VerbCase("compare DATA DATA --names one,other --frames 4 --out OUT", "frames"),
    "radar": VerbCase("radar DATA --frames 0 1 --out OUT", "radar", workers=False),
    "show": VerbCase("show DATA --out OUT", "frames", workers=False, out="a.png"),
    "view": VerbCase("view DATA --html OUT", "frames", workers=False, out="page.html"),
    "track": VerbCase("track DATA/boxes.csv --out OUT", "scores", workers=False, out="tracks.csv"),
    "sync": VerbCase("sync DATA --to lidar --out OUT", "stamps", workers=False),
    "calibrate": VerbCase(
        "calibrate lidar-lidar DATA --lidars os2-64 os1-128 --frames 2 --out OUT", "lidars", workers=False
    ),
    "score": VerbCase("score DATA/boxes.csv DATA/labels.csv --json OUT", "scores", workers=False, out="scores.json"),
    "doctor": VerbCase("doctor DATA --frames 0 --json OUT", "frames", out="report.json"),
    "formats": VerbCase("formats --json OUT", "", workers=False, out="all.json"),
    "detectors": VerbCase("detectors --json OUT", "", workers=False, out="all.json"),
}
"""Commands of verbs that write."""

LEFT_OUT = {
    "compare-results": "writes nothing but its output",
    "annotate": "a server: tests/annotation/test_killed.py, benchmarks/studio_server.py journal",
    "experiments": "writes nothing but its output",
    "bench": "writes one file at its end; what it measures is each other verb's own work",
}
"""Verbs without a command here, and why."""


def _quietly(*words: str) -> None:
    command = [sys.executable, "-m", "farfield.cli", *words]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _simulated(folder: Path, *words: str) -> None:
    _quietly("simulate", *words[:1], str(folder), *words[1:], "--workers", "1")


def _faces(folder: Path) -> None:
    from matplotlib.cbook import get_sample_data
    from PIL import Image

    folder.mkdir()
    with get_sample_data("grace_hopper.jpg") as file:
        portrait = Image.open(file).convert("RGB")
    for number in range(10):
        picture = Image.new("RGB", (960, 640), (96, 104, 110))
        picture.paste(portrait, (10 * number, 20))
        picture.save(folder / f"{number:02}.png")


def _training(folder: Path) -> None:
    _simulated(folder / "data", "cirrus-sim-mini", "--frames", "6", "--sequences", "2", "--sensors", "gaussian")
    (folder / "tiny.yaml").write_text(TINY_TRAINING.replace("DATA", str(folder / "data")))


def _trained(folder: Path) -> None:
    _training(folder)
    _quietly("train", str(folder / "tiny.yaml"), "--out", str(folder / "runs"))


def _evaluated(folder: Path) -> None:
    _simulated(folder / "frames", *_CIRRUS, "4", "--sequences", "2", "--sensors", "gaussian")
    words = ("--clouds", "gaussian", "--replicates", "3", "--shown-frames", "1", "--workers", "1")
    _quietly("evaluate", "pointpillars-cirrus-sim", str(folder / "frames"), *words, "--out", str(folder / "evaluation"))


def _downloads(folder: Path) -> None:
    tree = folder.with_name(f"{folder.name} unpacked")
    _simulated(tree, "kradar-sim-mini", "--frames", "8", "--sequences", "2", "--sensors", "os2-64,polar3d")
    pack_downloads(tree, folder)
    shutil.rmtree(tree)


def _checkpoint(folder: Path) -> None:
    """Weights as OpenPCDet's PointPillars names them, drawn at random."""
    import torch

    generator, tensors, c_in = torch.Generator().manual_seed(0), {}, 8
    shapes: dict[str, tuple[int, ...]] = {"vfe.pfn_layers.0.linear.weight": (8, 10)}
    norms = {"vfe.pfn_layers.0.norm": 8}
    for block, (width, depth, up) in enumerate(((8, 1, 1), (12, 2, 2), (16, 1, 4))):
        for layer in range(depth + 1):
            shapes[f"backbone_2d.blocks.{block}.{3 * layer + 1}.weight"] = (width, c_in, 3, 3)
            norms[f"backbone_2d.blocks.{block}.{3 * layer + 2}"] = c_in = width
        shapes[f"backbone_2d.deblocks.{block}.0.weight"] = (width, 10, up, up)
        norms[f"backbone_2d.deblocks.{block}.1"] = 10
    for name, numbers in (("conv_cls", 18), ("conv_box", 42), ("conv_dir_cls", 12)):
        shapes |= {f"dense_head.{name}.weight": (numbers, 30, 1, 1), f"dense_head.{name}.bias": (numbers,)}
    for name, width in norms.items():
        shapes |= {f"{name}.{part}": (width,) for part in ("weight", "bias", "running_mean", "running_var")}
        tensors[f"{name}.num_batches_tracked"] = torch.tensor(5)
    tensors |= {name: torch.rand(shape, generator=generator) * 0.1 for name, shape in shapes.items()}
    folder.mkdir()
    torch.save({"model_state": tensors}, folder / "theirs.pth")
    grid = "{range_m: 19.2, half_width_m: 6.4, z_min_m: -3.0, z_max_m: 1.0, cell_m: 0.4}"
    (folder / "mine.yaml").write_text(f"grid: {grid}\nscore_threshold: 0.07\n")


def _stamps(folder: Path) -> None:
    folder.mkdir()
    rng = np.random.default_rng(0)
    for name, count, period in (("lidar", 60_000, 100_000_000), ("camera", 180_000, 33_333_333)):
        times = 1_700_000_000_000_000_000 + np.arange(count) * period + rng.integers(-500_000, 500_000, count)
        (folder / f"{name}.txt").write_text("\n".join(map(str, times.tolist())) + "\n")


def _scores(folder: Path) -> None:
    from farfield.datasets.example import write_example

    write_example(folder)
    (folder / "detections.csv").rename(folder / "boxes.csv")
    _quietly("score", str(folder / "boxes.csv"), str(folder / "labels.csv"), "--json", str(folder / "scores.json"))


_CIRRUS = ("cirrus-sim-mini", "--frames")
DATA: dict[str, Callable[[Path], object]] = {
    "": Path.mkdir,
    "frames": lambda folder: _simulated(folder, *_CIRRUS, "12", "--sequences", "2", "--sensors", "gaussian,uniform"),
    "drive": lambda folder: _simulated(folder, *_CIRRUS, "16", "--sequences", "1", "--sensors", "gaussian"),
    "pictured": lambda folder: _simulated(folder, "kitti-sim-mini", "--frames", "8"),
    "radar": lambda folder: _simulated(
        folder, "kradar-sim-mini", "--frames", "8", "--sensors", "os2-64,cam-front,polar3d,cube"
    ),
    "lidars": lambda folder: _simulated(folder, "kradar-sim-mini", "--frames", "4", "--sensors", "os2-64,os1-128"),
    "faces": _faces,
    "training": _training,
    "trained": _trained,
    "evaluated": _evaluated,
    "downloads": _downloads,
    "checkpoint": _checkpoint,
    "stamps": _stamps,
    "scores": _scores,
}
"""What commands read, made once into a folder."""


def chosen(names: list[str] | None) -> dict[str, VerbCase]:
    """The cases of some names; all of them for none.

    Raises:
        MissingError: If there is none of this name.
    """
    unknown = [name for name in names or () if name not in CASES]
    if unknown:
        raise MissingError(f"expected some of {', '.join(CASES)}; got {unknown[0]}")
    return {name: CASES[name] for name in names or CASES}


def lacking(case: VerbCase) -> str:
    """A module that a case needs and this machine lacks; empty if there is none."""
    return next((name for name in case.needs if not _is_there(name)), "")


def _is_there(name: str) -> bool:
    if name != FACES:
        return find_spec(name) is not None
    try:
        return face_model_path().is_file()
    except FarfieldError:
        return False


def verbs_without_case() -> list[str]:
    """Verbs of the command line that are neither tried here nor left out with a reason."""
    return sorted(set(VERBS) - {case.verb for case in CASES.values()} - set(LEFT_OUT))
