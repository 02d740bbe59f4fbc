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


def test_the_listing_has_a_column_a_weather(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("torch")
    from farfield.detectors import catalogue

    ap = {name: 10.0 + place for place, name in enumerate(shipped_figures.WEATHERS)}
    known = {"cloud": "radar", "parameters_m": 4.31, "schedule": "1500 steps of 2", "ap_3d": ap, "ap_bev": ap}
    about = {"data": "some drives", "weights": {name: {"detector": "x", **known} for name in ("there", "not-there")}}
    monkeypatch.setattr(catalogue, "figures", lambda: {"detectors": {}, "radar": about})
    monkeypatch.setattr(catalogue, "_bundled_names", lambda: ["rtnh-other", "there"])
    assert main(["detectors"]) == 0
    said = capsys.readouterr().out
    row = next(line for line in said.splitlines() if line.startswith("there "))
    assert row.split() == ["there", "radar", "4.31", "M", *(f"{value:.1f}" for value in ap.values())]
    assert "not-there" not in said
    assert "sleet" in said
    assert "some drives" in said
    first = next(line for line in said.splitlines() if line.startswith("rtnh "))
    assert "rtnh-other" in first


def test_all_weights_that_ship_are_known_and_offered() -> None:
    pytest.importorskip("torch")
    from farfield.datasets.memory import in_memory
    from farfield.detectors.catalogue import catalogue
    from farfield.detectors.weights import bundled_weights
    from farfield.studio.options import StudioSettings
    from farfield.studio.session.detecting import offered

    entries = {entry.name: entry for entry in catalogue()}
    assert entries["pointpillars"].weights == "pointpillars-cirrus-sim"
    assert entries["pointpillars"].further == ("pointpillars-kradar-sim", "pointpillars-roads")
    assert entries["rtnh"].weights == "rtnh-kradar-sim"
    assert {name for entry in entries.values() for name in (entry.weights, *entry.further) if name} == set(
        bundled_weights()
    )
    assert set(bundled_weights()) <= {row.name for row in offered(StudioSettings(), in_memory([]))}
