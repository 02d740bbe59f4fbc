"""The way from an experiment's YAML to a training step: down through the rooms, never through the command line."""

import sys
import tomllib
from functools import cache
from inspect import CO_OPTIMIZED
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

pytest.importorskip("torch")
pytest.importorskip("embreex")

from farfield.experiments.plan import Plan
from farfield.experiments.schema import load_experiment

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "src" / "farfield"
EXPERIMENT = """
name: way
data: {path: DATA, clouds: [gaussian], simulate: {preset: cirrus-sim-mini, sequences: 1, frames: 1}}
detector:
  {grid: {range_m: 64.0, half_width_m: 16.0, cell_m: 0.5}, widths: [8, 8, 8], depths: [0, 0, 0], neck_width: 8}
augmentation: {pasted: {vehicle: 1}}
training: {steps: 1, batch_size: 1, precision: fp32, threads: 1, workers: 0}
"""


def floors() -> dict[str, int]:
    """The floor of each room, the lowest 0, by the import contract."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    layers = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    return {room.strip(): floor for floor, layer in enumerate(reversed(layers)) for room in layer.split("|")}


@cache
def room_of_code(code: CodeType) -> str | None:
    """The room of code of ours; None for others'."""
    path = Path(code.co_filename)
    return path.relative_to(SOURCE).parts[0].removesuffix(".py") if path.is_relative_to(SOURCE) else None


def room_of(frame: FrameType | None) -> str | None:
    """The room of the nearest code of ours at or above a frame of the stack: what a module calls while it is imported
    is called by the module, not by what imports it."""
    while frame is not None:
        room = room_of_code(frame.f_code)
        if room is not None:
            return room
        frame = frame.f_back
    return None


class Walk:
    """Notes every call from a room into one above it, and every room that is entered."""

    def __init__(self) -> None:
        self.floors, self.rooms, self.climbs = floors(), set[str](), set[tuple[str, str]]()

    def __call__(self, frame: FrameType, event: str, argument: Any) -> None:
        """As ``sys.setprofile`` calls it."""
        is_function = event == "call" and bool(frame.f_code.co_flags & CO_OPTIMIZED)
        to = room_of_code(frame.f_code) if is_function else None
        if to is None:
            return
        source = room_of(frame.f_back)
        self.rooms.add(to)
        if source is not None and self.floors.get(to, -1) > self.floors.get(source, 99):
            self.climbs.add((source, to))


def walked(path: Path, out: Path) -> Walk:
    walk = Walk()
    sys.setprofile(walk)
    try:
        Plan(load_experiment(path), out).run()
    finally:
        sys.setprofile(None)
    assert {"experiments", "simulation", "training", "datasets", "detectors", "frame"} <= walk.rooms
    assert "cli" not in walk.rooms
    assert "api" not in walk.rooms
    return walk


CLIMBS = {
    ("frame", "datasets"),  # a frame's loader, which the reader gave it
    ("frame", "simulation"),  # likewise the simulator
    ("simulation", "training"),  # the report of the training, which the recorder tells of its progress
}


def test_from_yaml_to_a_step_it_climbs_only_by_what_it_was_handed(tmp_path: Path) -> None:
    """What climbs are loaders and the report: functions that an upper room gave a lower one."""
    path = tmp_path / "way.yaml"
    path.write_text(EXPERIMENT.replace("DATA", str(tmp_path / "data")))
    for out in ("simulated first", "data there"):
        walk = walked(path, tmp_path / out)
        assert walk.climbs <= CLIMBS, (out, sorted(walk.climbs - CLIMBS))
