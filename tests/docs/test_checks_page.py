"""docs/checks.md names flags that there are, and what it says of wrong inputs comes true."""

import re
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from farfield.cli import VERBS, main
from farfield.cli._completion import flags_of

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "checks.md").read_text("utf-8")
DATA = "my-sweeps"
ROW = re.compile(r"^\| ([^|]+) \| `farfield ([^`]+)` \| (\d) \| `([^`]+)` \|$", re.MULTILINE)
EXAMPLES = ROW.findall(PAGE.partition("## Try it")[2].partition("\n## ")[0])


def _clouds(change: Callable[[np.ndarray], np.ndarray]) -> None:
    for path in sorted(Path(DATA).glob("*.npy")):
        np.save(path, change(np.load(path)))


def _table(name: str, change: Callable[[dict[str, str]], Mapping[str, object]]) -> None:
    path = Path(DATA, name)
    header, *lines = (line.split(",") for line in path.read_text("utf-8").splitlines())
    rows = [dict(zip(header, line, strict=True)) for line in lines]
    cells = [map(str, (row | change(row)).values()) for row in rows]
    path.write_text("".join(",".join(line) + "\n" for line in [header, *cells]), "utf-8")


def _pointer() -> None:
    text = "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 110528\n"
    Path(DATA, "0001.npy").write_text(text, "utf-8")


def _bright() -> None:
    points = np.load(Path(DATA, "0002.npy"))
    points[5, 3] = 3.0
    np.save(Path(DATA, "0002.npy"), points)


def _mirrored() -> None:
    _clouds(lambda points: points * np.array([1.0, -1.0, 1.0, 1.0], dtype=np.float32))
    _table("labels.csv", lambda row: {"y": -float(row["y"]), "yaw_rad": -float(row["yaw_rad"])})


def _by_columns(shown: str) -> str:
    """The cells of a table below one another, whose text runs over several lines."""
    rows = [[cell.strip() for cell in line.split("│")] for line in shown.splitlines() if line.startswith("│")]
    return "\n".join(" ".join(filter(None, column)) for column in zip(*rows, strict=True))


FAULTS: dict[str, Callable[[], None]] = {
    "`0001.npy` is a pointer of Git LFS": _pointer,
    "points in centimetres": lambda: _clouds(lambda points: points * np.array([100, 100, 100, 1], dtype=np.float32)),
    "one intensity of 3, others to 0.6": _bright,
    "the same, overruled": _bright,
    "a box at 1e12 m": lambda: _table("labels.csv", lambda row: {"x": "1e12"}),
    "z is a box's bottom": lambda: _table("labels.csv", lambda row: {"z": float(row["z"]) - float(row["h"]) / 2}),
    "y right in clouds and labels": _mirrored,
    "`calibration.yaml` holds something else": lambda: (
        Path(DATA, "calibration.yaml").write_text("gain: 1\n", "utf-8") and None
    ),
    "predictions 1.5 m too far ahead": lambda: _table("detections.csv", lambda row: {"x": float(row["x"]) + 1.5}),
    "a setting that is no number": lambda: None,
}


def test_every_flag_of_the_page_is_one_of_the_parsers() -> None:
    flags = {flag for verb in VERBS for flag in flags_of(verb)}
    named = set(re.findall(r"(?<![\w-])--[a-z][a-z0-9-]*", PAGE))
    assert named >= {"--intensity-scale", "--point-times", "--columns"}
    assert named - flags == set()


def test_the_flags_that_overrule_stand_in_every_verb_that_reads_a_data_set() -> None:
    section = PAGE.partition("## The flags that overrule")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| `(--[\w-]+)` \| `(\w+)` \|", section, re.MULTILINE)
    reading = [verb for verb in VERBS if "--intensity-scale" in flags_of(verb)]
    assert {"doctor", "predict", "evaluate", "convert", "score"} <= set(reading)
    assert len(rows) == 9
    assert [(verb, flag) for flag, _ in rows for verb in reading if flag not in flags_of(verb)] == []


def test_every_example_is_tried() -> None:
    assert [what for what, *_ in EXAMPLES] == [*FAULTS]


@pytest.mark.parametrize(("what", "command", "status", "words"), EXAMPLES, ids=[row[0] for row in EXAMPLES])
def test_an_example_of_the_page_comes_true(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    what: str, command: str, status: str, words: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(["new-dataset", DATA]) == 0
    FAULTS[what]()
    capsys.readouterr()
    further = ["--workers", "1"] if command.startswith("doctor") else ["--replicates", "0"]
    assert main([*shlex.split(command), *further]) == int(status)
    shown = capsys.readouterr()
    assert words in _by_columns(shown.out) + shown.err + shown.out
