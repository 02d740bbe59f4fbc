"""docs/model-zoo.md follows the weights that ship and what is recorded of them."""

import sys
from pathlib import Path
from types import ModuleType

import pytest

from farfield.detectors import catalogue

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def model_zoo(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    sys.modules.pop("model_zoo", None)
    return __import__("model_zoo")


def test_the_page_is_what_the_catalogue_and_the_results_say(model_zoo: ModuleType) -> None:
    text = (ROOT / "docs" / "model-zoo.md").read_text(encoding="utf-8")
    assert model_zoo.page() == text, "run: python tools/model_zoo.py --write"
    names = [name for entry in catalogue.catalogue() for name in (entry.weights, *entry.further) if name]
    assert names
    assert all(f"## {name}\n" in text for name in names)
    assert text.count("**Licence**: Apache-2.0.") == len(names)


def test_weights_without_a_record_get_a_card_that_says_so(
    model_zoo: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(model_zoo, "figures", lambda: {"detectors": {}})
    monkeypatch.setattr(model_zoo, "section", lambda *_: "")
    entry = catalogue.CatalogueEntry(name="second", paper="a paper", weights="second-cirrus-sim")
    card = model_zoo.card(entry, "second-cirrus-sim", {})
    assert "**Speed**: not recorded." in card
    assert "No score of these weights is recorded." in card
    assert "1,920 frames of 160 drives of `cirrus-sim-varied`" in card


def test_weights_of_streams_name_all_that_they_learnt_from(model_zoo: ModuleType) -> None:
    donors = {"path": "open-sweeps", "donors": {"copies": 160}}
    made = {"path": "data/a", "simulate": {"preset": "kitti-sim", "sequences": 80, "frames": 8}}
    told = model_zoo.learnt_from({"experiment": {"data": {"kitti": made, "donors": donors}}})
    assert told == "640 frames of 80 drives of `kitti-sim`; `open-sweeps` with simulated road users, 160 copies a sweep"
    assert model_zoo.learnt_from({}) == "not recorded"
