"""A small own folder, its detections, and what farfield says of them: for the wrong inputs of tests/inputs."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from farfield.cli import main

FRAMES = 4
HEADER = "frame,label,x,y,z,l,w,h,yaw_rad,track_id"
CAR = "4.4,1.9,1.6"
Capsys = pytest.CaptureFixture[str]


def sweep(number: int) -> np.ndarray:
    """A road and one car that drives a metre a frame: x, y, z, intensity."""
    random = np.random.default_rng(number)
    road = np.column_stack([random.uniform(3, 48, 900), random.uniform(-20, 20, 900), random.normal(-1.6, 0.03, 900)])
    car = random.uniform(-0.5, 0.5, (300, 3)) * (4.2, 1.8, 1.4) + (11 + number, 2, -0.75)
    points = np.concatenate([road, car])
    return np.column_stack([points, np.full(len(points), 0.3)]).astype(np.float32)


def row(
    frame: int | str, *, x: float | str | None = None, label: str = "vehicle", yaw: str = "0", track: str = "3"
) -> str:
    name = f"{frame:04d}" if isinstance(frame, int) else frame
    place = 11 + frame if x is None and isinstance(frame, int) else x
    return f"{name},{label},{place},2,-0.75,{CAR},{yaw},{track}"


def table(rows: Sequence[str], header: str = HEADER) -> str:
    return "\n".join([header, *rows]) + "\n"


def own_folder(folder: Path) -> Path:
    """Four sweeps and their table of boxes."""
    folder.mkdir()
    for number in range(FRAMES):
        np.save(folder / f"{number:04d}.npy", sweep(number))
    (folder / "labels.csv").write_text(table([row(number) for number in range(FRAMES)]))
    return folder


def detections(path: Path) -> Path:
    """The same boxes with scores."""
    path.write_text(table([f"{row(number)},0.9" for number in range(FRAMES)], f"{HEADER},score"))
    return path


def run(capsys: Capsys, *words: Path | str) -> tuple[int, str]:
    """Exit status and all that was printed."""
    capsys.readouterr()
    try:
        status = main([str(word) for word in words])
    except SystemExit as end:
        status = int(end.code or 0)
    printed = capsys.readouterr()
    return status, printed.out + printed.err


def score(capsys: Capsys, predictions: Path, labels: Path, *words: str) -> tuple[int, str]:
    return run(capsys, "score", predictions, labels, "--replicates", "0", *words)


def findings(capsys: Capsys, folder: Path) -> str:
    """What the doctor warns of or fails for, a finding a line."""
    status, text = run(capsys, "doctor", folder, "--workers", "1", "--json", "-")
    if not text.startswith("{"):
        assert status == 1
        return text
    report = json.loads(text[: text.rindex("}") + 1])
    return "\n".join(
        f"{one['topic']}: {one['what']} {one['where']}" for one in report["findings"] if one["severity"] != "ok"
    )


def says(text: str, *words: str) -> None:
    for word in words:
        assert word.lower() in text.lower(), f"SILENT: expected {word!r} in: {text[-900:]}"


def refused(outcome: tuple[int, str], *words: str) -> None:
    status, text = outcome
    assert status == 1 or status == 2, f"SILENT: {text[-900:]}"
    says(text, *words)
