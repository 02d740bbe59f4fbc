"""What is measured: every verb that works in bulk, by the function beneath it, and every detector whose weights ship.

A verb's function gets a clock in the place of its progress bar, which adds up what its units of work take: what a
command does once, such as imports and pages, is no part of its rate. All of it runs in this process with one thread, as
one of many workers does; a detector on a GPU has the GPU besides.
"""

import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from farfield.datasets import Dataset, open_dataset
from farfield.jobs import JobOptions
from farfield.sizing.workloads import CAMERA, CAMERAS, CELLS, CLOUD, CLOUDS, LABELS, TESSERACT

if TYPE_CHECKING:
    from farfield.detectors import Detector
    from farfield.detectors.onnx.detector import OnnxDetector

FRAMES, FEW = 4, 2
"""Frames of the Cirrus car, and of the K-Radar car, whose tensors have a quarter of a gigabyte each."""
SEED = 1
SHOWN_DETECTOR = "pointpillars-cirrus-sim"
"""With which predict and evaluate are measured."""
NOT_MEASURED = {
    "adapt": "trains; what it searches in bulk is predict's rate, and it measures its own steps before it begins",
    "demo": "simulate, doctor and evaluate one after the other",
    "reproduce": "trains; --plan measures its steps and prints what they would cost",
}
"""Verbs that work in bulk and have no rate of their own, and why."""

Precision = Literal["", "fp32", "bf16", "fp16"]
_PRECISIONS: tuple[Precision, ...] = ("fp32", "bf16")


@dataclass(kw_only=True)
class UnitClock:
    """Stands in the place of a progress bar, and notes how long each unit of work takes.

    Args:
        seconds: Of each unit, in the order in which they were done.
    """

    seconds: list[float] = field(default_factory=list)

    def __call__(self, numbers: Iterable[int]) -> Iterator[int]:
        """Pass the numbers through."""
        began = time.perf_counter()
        for number in numbers:
            yield number
            ended = time.perf_counter()
            self.seconds.append(ended - began)
            began = ended

    @property
    def options(self) -> JobOptions:
        """Work in this process under this clock."""
        return JobOptions(workers=1, progress=self)


class BenchFrames:
    """Simulated frames to measure on; each kind is written when it is first asked for.

    Args:
        folder: Where they are written.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @cached_property
    def cirrus(self) -> Dataset:
        """Sweeps of both patterns, a tenth of a second apart, with labels and pictures."""
        return self._recorded("cirrus-sim", "cirrus", FRAMES, "gaussian,uniform,camera")

    @cached_property
    def kradar(self) -> Dataset:
        """The os2-64, the radar's cells and the front camera."""
        return self._recorded("kradar-sim", "kradar", FEW, "os2-64,cells,cam-front")

    @cached_property
    def tensors(self) -> Dataset:
        """4D tensors alone."""
        return self._recorded("kradar-sim", "tensors", FEW, "tesseract")

    def _recorded(self, preset: str, name: str, frames: int, sensors: str) -> Dataset:
        from farfield.simulation.recording import record

        root = self.folder / name
        record(preset, root, frames=frames, sequences=1, seed=SEED, stride_s=0.1, sensors=sensors, workers=1)
        return open_dataset(root)

    def sizes(self) -> dict[str, dict[str, float]]:
        """Bytes of each part of a frame, of what was written so far."""
        sizes: dict[str, dict[str, float]] = {}
        for name in ("cirrus", "kradar", "tensors"):
            if name not in vars(self):
                continue
            parts = sizes.setdefault("cirrus" if name == "cirrus" else "kradar", {})
            data: Dataset = getattr(self, name)
            for path in {Path(file) for index in range(len(data)) for file in data.files(index)}:
                for part in parts_of(path.relative_to(data.root).as_posix()):
                    parts[part] = parts.get(part, 0.0) + path.stat().st_size / len(data)
        return sizes


def parts_of(name: str) -> tuple[str, ...]:
    """The parts of a frame that a file holds, by its name below a data set in the layout of Cirrus or K-Radar."""
    if name.endswith(".xyz"):
        return (CLOUD, CLOUDS) if "_gaussian/" in name else (CLOUDS,)
    if "os2-64/" in name:
        return (CLOUD, CLOUDS)
    if "_camera/" in name or "cam-front/" in name:
        return (CAMERA, CAMERAS)
    if "radar_tesseract/" in name:
        return (TESSERACT,)
    if name.endswith(".h5"):
        return (CELLS,)
    return (LABELS,) if "_annotation/" in name or "label" in name else ()


def bytes_of(folder: Path) -> int:
    """Bytes of all files below a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


@dataclass(frozen=True, kw_only=True)
class BenchCase:
    """One thing to measure.

    Args:
        name: What it is called.
        kind: A verb, or a detector.
        frames_of: The data set whose simulated frames it works on.
        precision: Number type of a network.
        on: Where its time goes.
        reads: The parts of a frame that it reads, twice where it reads them twice.
        measure: Works on the frames and writes into a folder, which is absent; gives seconds and bytes written a frame.
    """

    name: str
    kind: Literal["verb", "detector"]
    frames_of: Literal["cirrus", "kradar"]
    precision: Precision = ""
    on: Literal["core", "GPU"] = "core"
    reads: tuple[str, ...] = ()
    measure: Callable[[Path], tuple[float, float]]

    @property
    def label(self) -> str:
        """Name, frames and precision: no two cases have the same."""
        return " ".join(filter(None, (self.name, self.precision, f"({self.frames_of})")))


def verb_cases(frames: BenchFrames, device: str | None, gpu: str) -> list[BenchCase]:
    """Every verb that works in bulk, but for :data:`NOT_MEASURED`.

    Args:
        frames: To work on.
        device: Where detectors run.
        gpu: The GPU's name; empty for the processor.
    """
    detecting: dict[str, Any] = {"on": "GPU" if gpu else "core", "frames_of": "cirrus"}
    detectors = _LoadedDetectors(device)
    cirrus = partial(BenchCase, kind="verb", frames_of="cirrus")
    kradar = partial(BenchCase, kind="verb", frames_of="kradar")
    return [
        cirrus(name="simulate", measure=partial(_simulate, "cirrus-sim", None)),
        kradar(name="simulate", measure=partial(_simulate, "kradar-sim", "os2-64,cells")),
        cirrus(name="convert --to kitti", reads=(CLOUD, CAMERA, LABELS), measure=partial(_convert, frames, "kitti")),
        cirrus(name="convert --to boxes-csv", reads=(LABELS,), measure=partial(_convert, frames, "boxes-csv")),
        cirrus(name="convert --to cache", reads=(CLOUDS,), measure=partial(_cache, frames)),
        kradar(name="convert --to radar-store", reads=(TESSERACT,), measure=partial(_store, frames)),
        cirrus(name="doctor", reads=(CLOUDS, CAMERAS, LABELS), measure=partial(_doctor, frames, "cirrus")),
        cirrus(name="stats", reads=(CLOUDS, LABELS, LABELS), measure=partial(_stats, frames, "cirrus")),
        kradar(name="stats", reads=(CLOUD, CELLS, LABELS, LABELS), measure=partial(_stats, frames, "kradar")),
        cirrus(name="compare", reads=(CLOUDS, LABELS), measure=partial(_count, frames)),
        cirrus(name="odometry", reads=(CLOUD, CLOUD), measure=partial(_odometry, frames)),
        kradar(name="depth", reads=(CLOUD, CLOUD), measure=partial(_depth, frames)),
        cirrus(name="anonymize", reads=(CAMERAS, CAMERAS), measure=partial(_anonymize, frames)),
        cirrus(name="report --film", reads=(CLOUDS, CAMERAS, LABELS), measure=partial(_film, frames)),
        BenchCase(
            name="predict", kind="verb", reads=(CLOUD,), **detecting, measure=partial(_predict, frames, detectors)
        ),
        BenchCase(
            name="evaluate",
            kind="verb",
            reads=(CLOUD, LABELS),
            **detecting,
            measure=partial(_evaluate, frames, detectors),
        ),
    ]


def detector_cases(frames: BenchFrames, device: str | None, gpu: str) -> list[BenchCase]:
    """Every detector whose weights ship, in fp32 and in half precision; none without torch.

    Args:
        frames: To detect in.
        device: Where to run.
        gpu: The GPU's name; empty for the processor.
    """
    from importlib.util import find_spec

    if find_spec("torch") is None:
        return []
    from farfield.detectors.weights import bundled_weights

    detectors = _LoadedDetectors(device)
    on: Literal["core", "GPU"] = "GPU" if gpu else "core"
    return [
        BenchCase(
            name=name,
            kind="detector",
            frames_of="kradar" if "kradar" in name else "cirrus",
            precision=precision,
            on=on,
            reads=(CELLS,) if name.startswith("rt") else (CLOUD,),
            measure=partial(_detect, frames, detectors, name, precision),
        )
        for name in bundled_weights()
        for precision in _PRECISIONS
    ]


class _LoadedDetectors:
    """Detectors that are loaded once, one at a time: each has some hundred megabytes beside it."""

    def __init__(self, device: str | None) -> None:
        self.device = device
        self._loaded: tuple[tuple[str, str], Any] | None = None

    def get(self, name: str, precision: str) -> "Detector | OnnxDetector":
        """The detector of a name in a number type."""
        from farfield.api import load_detector

        if self._loaded is None or self._loaded[0] != (name, precision):
            self._loaded = None
            self._loaded = ((name, precision), load_detector(name, precision=precision, device=self.device))
        return self._loaded[1]


def _simulate(preset: str, sensors: str | None, out: Path) -> tuple[float, float]:
    """Without the first frame, with which a drive's world is built."""
    from farfield.simulation.recording import record

    clock = UnitClock()
    record(preset, out, frames=3, sequences=1, seed=SEED, sensors=sensors, workers=1, progress=clock)
    after = clock.seconds[1:]
    return sum(after) / len(after), bytes_of(out) / 3


def _convert(frames: BenchFrames, to: Any, out: Path) -> tuple[float, float]:
    from farfield.datasets.convert import convert

    clock, data = UnitClock(), frames.cirrus
    convert(data, out, to=to, bulk=clock.options)
    return sum(clock.seconds) / len(data), bytes_of(out) / len(data)


def _cache(frames: BenchFrames, out: Path) -> tuple[float, float]:
    """On a copy: whoever reads these frames later would read the cache."""
    from farfield.datasets.convert import convert

    clock, data = UnitClock(), frames.cirrus
    shutil.copytree(data.root, out)
    before = bytes_of(out)
    convert(open_dataset(out), to="cache", bulk=clock.options)
    return sum(clock.seconds) / len(data), (bytes_of(out) - before) / len(data)


def _store(frames: BenchFrames, out: Path) -> tuple[float, float]:
    from farfield.datasets.convert import convert

    clock, data = UnitClock(), frames.tensors
    convert(data, out, to="radar-store", bulk=clock.options)
    return sum(clock.seconds) / len(data), bytes_of(out) / len(data)


def _doctor(frames: BenchFrames, name: str, out: Path) -> tuple[float, float]:
    from farfield.inspection.doctor import examine

    del out
    clock, data = UnitClock(), getattr(frames, name)
    examine(data, max_clouds=0, bulk=clock.options)
    return sum(clock.seconds) / len(data), 0.0


def _stats(frames: BenchFrames, name: str, out: Path) -> tuple[float, float]:
    from farfield.inspection.comparison import count_dataset
    from farfield.inspection.statistics.census import take_census

    del out
    clock, data = UnitClock(), getattr(frames, name)
    take_census(data, clock.options)
    count_dataset(data, name, 0, clock.options)
    return sum(clock.seconds) / len(data), 0.0


def _count(frames: BenchFrames, out: Path) -> tuple[float, float]:
    from farfield.inspection.comparison import count_dataset

    del out
    clock, data = UnitClock(), frames.cirrus
    count_dataset(data, "frames", 0, clock.options)
    return sum(clock.seconds) / len(data), 0.0


def _odometry(frames: BenchFrames, out: Path) -> tuple[float, float]:
    from farfield.odometry.drives import odometry

    clock, data = UnitClock(), frames.cirrus
    odometry(data, out, bulk=clock.options)
    return sum(clock.seconds) / len(data), bytes_of(out) / len(data)


def _depth(frames: BenchFrames, out: Path) -> tuple[float, float]:
    from farfield.depth.writing import DepthSettings, write_depth_maps

    clock, data = UnitClock(), frames.kradar
    settings = DepthSettings(cloud="os2-64", camera="cam-front")
    write_depth_maps(data, out, settings, survey=clock.options, bulk=clock.options)
    return sum(clock.seconds) / len(data), bytes_of(out) / len(data)


def _anonymize(frames: BenchFrames, out: Path) -> tuple[float, float]:
    from farfield.privacy.anonymising import anonymise
    from farfield.privacy.sources import find_sources

    clock, data = UnitClock(), frames.cirrus
    anonymise(find_sources(data.root), out, find=clock.options, cover=clock.options)
    return sum(clock.seconds) / len(data), bytes_of(out) / len(data)


def _film(frames: BenchFrames, out: Path) -> tuple[float, float]:
    from farfield.pages.film import make_film

    clock, data = UnitClock(), frames.cirrus
    out.mkdir()
    make_film(out / "drive.gif", data, bulk=clock.options)
    return sum(clock.seconds) / len(data), bytes_of(out) / len(data)


def _predict(frames: BenchFrames, detectors: _LoadedDetectors, out: Path) -> tuple[float, float]:
    from farfield.evaluation import plan_detection

    clock, data = UnitClock(), frames.cirrus
    out.mkdir()
    detector = detectors.get(SHOWN_DETECTOR, "auto")
    plan = plan_detection(detector, data, cloud="gaussian", bulk=clock.options, journal=out / "boxes.jsonl")
    for _ in plan.detections():
        pass
    return sum(clock.seconds) / len(data), bytes_of(out) / len(data)


def _evaluate(frames: BenchFrames, detectors: _LoadedDetectors, out: Path) -> tuple[float, float]:
    from farfield.evaluation.evaluating import EvaluationOptions, evaluate_clouds

    clock, data = UnitClock(), frames.cirrus
    out.mkdir()
    options = EvaluationOptions(clouds=("gaussian",), shown_frames=0, bulk=clock.options, journals=out)
    evaluate_clouds(detectors.get(SHOWN_DETECTOR, "auto"), data, options)
    return sum(clock.seconds) / len(data), bytes_of(out) / len(data)


def _detect(
    frames: BenchFrames, detectors: _LoadedDetectors, name: str, precision: str, out: Path
) -> tuple[float, float]:
    """From a cloud in memory to boxes after suppression, as every evaluation times it."""
    from farfield.evaluation import detect

    del out
    data = frames.kradar if "kradar" in name else frames.cirrus.select(range(FEW))
    detections = detect(detectors.get(name, precision), data, bulk=UnitClock().options)
    return sum(detections.ms) / len(detections.ms) / 1e3, 0.0
