"""`farfield detectors` and the pages say the same: one source."""

import json
import re
from pathlib import Path

import pytest
import shipped_figures

from farfield.cli import main
from farfield.detectors.catalogue import figures

ROOT = Path(__file__).resolve().parents[2]


def test_the_stored_figures_are_those_of_the_results() -> None:
    stored = json.loads(shipped_figures.FIGURES.read_text("utf-8"))
    assert shipped_figures.brought_in_line(stored) == stored


def test_the_listing_says_what_the_readme_says(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("torch")
    assert main(["detectors", "--epsilon", "0"]) == 0
    lines = capsys.readouterr().out.splitlines()
    readme = (ROOT / "README.md").read_text("utf-8")
    row = next(line for line in readme.splitlines() if line.startswith("| `cirrus-sim-val-v2`, Gaussian"))
    quoted = [re.findall(r"0\.\d{3}", cell)[0] for cell in row.split("|")[2:6]]
    shipped = next(line for line in lines if "pointpillars-cirrus-sim" in line)
    assert [word for word in shipped.split() if re.fullmatch(r"0\.\d{3}", word)] == quoted
    for name, spoken in (("pointpillars", "PointPillars"), ("second", "SECOND"), ("sparsecentre", "fully sparse")):
        speed = re.search(rf"{spoken} (\d+) ms", readme)
        assert speed is not None
        assert figures()["detectors"][name]["frame_ms"]["bf16"] == float(speed[1])
