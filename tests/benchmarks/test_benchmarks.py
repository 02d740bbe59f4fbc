"""Every benchmark runs in its tiny setting and prints what its results file promises."""

import importlib.util
import json
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from whole import WHOLE

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = sorted(path.stem for path in (ROOT / "benchmarks").glob("[a-z]*.py"))
REAL = (ROOT.parent / "shared" / "real").is_dir()
NUMBER = r"-?\d+(?:,\d{3})*(?:\.\d+)?"
HEADER = ("command  python benchmarks/", "machine  ", "date     20", "python   3.", "commit   ")

PROMISED = Path(__file__).with_name("promised_lines.txt")
"""What each part prints, as the beginnings of lines: regular expressions, in which N is a number."""

SHARED = {
    *(
        "calibration real",
        "captures odometry",
        "captures ouster",
        "detectors real",
        "evaluation kradar",
        "evaluation labels",
        "evaluation dds",
        "privacy faces",
    ),
    *("radar projection", "radar turning", "radar_detectors makes", "roadside background", "studio_checks tracks"),
    *("tracking identities", "tracking tuning", "vehicle_bodies boxes"),
    *("real_road false", "real_road far", "real_road near"),
}
"""Parts that need real data and are left out without them."""


LONG = {
    "bulk_work": "mechanism",
    "calibration": "board",
    "calibration_checks": "sigma",
    "detector_speed": "lidar",
    "fuzz_readers": "hostile",
    "odometry": "deskewing",
    "simulator": "frames",
}
"""Scripts that take minutes even at their smallest, and the part that is run; FARFIELD_WHOLE=1 runs all parts."""


LONGEST = {
    *("adaptation", "cpu_limit", "evaluation", "exporting", "interruptions", "learning_from_labels", "privacy"),
    *("radar_products", "sparse_convolution", "studio_checks", "studio_drive", "studio_fitting", "studio_page"),
    *("tracking",),
}
"""Scripts that take more than half a minute at their smallest: they run with FARFIELD_WHOLE=1 only."""


def reproduction(folder: Path) -> Path:
    """What ``farfield reproduce`` leaves, with one claim of two runs."""
    figures = {"estimate": 0.1, "interval": [0.05, 0.15]}
    side = {"cloud": "x", "part": "whole", "metric": "DDS"}
    decided = {
        "role": "claim",
        "a": {"run": "a", **side},
        "b": {"run": "b", **side},
        "metric": "DDS",
        "published": 0.077,
    }
    decided |= {"power": 0.8, "decision": {"difference": figures, "verdict": "holds"}}
    found = {
        "trained_on": [{"device": "cpu", "precision": "fp32", "torch": "2.0", "commit": "abc", "runs": 2}],
        "runs": {"done": 2, "planned": 2},
        "simulated": True,
        "seeds": 2,
        "steps": {"grid": 300},
        "environment": {"commit": "abc"},
        "claims_sha256": "0" * 64,
        "claims": [{"id": "C1", "verdict": "holds", "words": "nearer is better", "decided": [decided]}],
    }
    (folder / "runs" / "a").mkdir(parents=True)
    (folder / "runs" / "a" / "clock.jsonl").write_text(json.dumps({"processor_s": 60.0, "training_s": 30.0}) + "\n")
    (folder / "reproduction.json").write_text(json.dumps(found))
    return folder


def promised() -> dict[str, dict[str, list[str]]]:
    """The lines by script and part."""
    pieces = re.split(r"^==== (\w+) ?(.*)\n", PROMISED.read_text(encoding="utf-8"), flags=re.MULTILINE)
    lines: dict[str, dict[str, list[str]]] = {}
    for script, part, text in zip(pieces[1::3], pieces[2::3], pieces[3::3], strict=True):
        lines.setdefault(script, {})[part] = text.strip("\n").split("\n")
    return lines


def missing(printed: str, lines: Sequence[str]) -> list[str]:
    """The promised lines that were not printed."""
    return [
        line
        for line in lines
        if not re.search("^" + re.sub(r"\bN\b", lambda _: NUMBER, line), printed, flags=re.MULTILINE)
    ]


def test_every_script_has_its_lines_and_its_results() -> None:
    assert sorted(promised()) == SCRIPTS
    results = sorted(path.name for path in (ROOT / "benchmarks" / "results").iterdir())
    assert results == [f"{name}.txt" for name in SCRIPTS]


def test_a_missing_or_broken_line_is_noticed() -> None:
    assert missing("a 1.5\nb none\n", ("a N$", "b N$", "c")) == ["b N$", "c"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "script", [pytest.param(name, marks=pytest.mark.whole) if name in LONGEST else name for name in SCRIPTS]
)
def test_a_benchmark_runs_and_prints_what_it_promises(script: str, tmp_path: Path) -> None:
    for module in ("torch", "embreex", "numba", "cv2", "starlette", "rosbags"):
        if importlib.util.find_spec(module) is None:
            pytest.skip(f"{module} is not installed")
    output = tmp_path / "results.txt"
    command = [sys.executable, f"benchmarks/{script}.py", "--tiny", "--output", str(output)]
    one = "" if WHOLE else LONG.get(script, "")
    command[2:2] = [one] if one else []
    command += [str(reproduction(tmp_path / "run"))] if script == "reproduce" else []
    command += ["--archive", str(tmp_path / "cloud.npz")] if script == "gpu_check" else []
    done = subprocess.run(command, cwd=ROOT, env=os.environ, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    pieces = re.split(r"^==== (.+)\n", output.read_text(encoding="utf-8"), flags=re.MULTILINE)
    sections = dict(zip(pieces[1::2], pieces[2::2], strict=True))
    parts = {name: lines for name, lines in promised()[script].items() if name == one or not one}
    if script == "gpu_check":  # its section bears the device's name
        sections = {"": next(iter(sections.values()))}
    assert [*sections] == [*parts]
    for name, lines in parts.items():
        text = sections[name]
        assert missing(text, HEADER) == []
        if f"{script} {name}" in SHARED and not REAL:
            assert "\nleft out: " in text
        else:
            assert missing(text, lines) == [], text
            assert text.strip() in done.stdout
