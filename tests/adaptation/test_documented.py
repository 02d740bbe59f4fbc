"""What docs/adaptation.md shows is an experiment, and its columns are those of the log."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("torch")

from farfield.adaptation.device import DeviceSettings
from farfield.adaptation.pattern import PatternSettings
from farfield.adaptation.range import RangeSettings
from farfield.adaptation.teacher import TeacherSettings
from farfield.experiments.schema import Experiment

PAGE = (Path(__file__).parents[2] / "docs" / "adaptation.md").read_text(encoding="utf-8")
BLOCKS = [yaml.safe_load(block) for block in re.findall(r"^```yaml\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)]
SETTINGS = {
    "range": RangeSettings,
    "pattern": PatternSettings,
    "device": DeviceSettings,
    "teacher": TeacherSettings,
}


@pytest.mark.parametrize("tree", BLOCKS, ids=lambda tree: tree["method"]["name"])
def test_the_pages_experiments_are_valid(tree: dict[str, Any]) -> None:
    experiment = Experiment.model_validate({"name": "shown", **tree})
    SETTINGS[experiment.method.name].model_validate(experiment.method.settings)


def test_the_page_shows_each_method() -> None:
    assert [tree["method"]["name"] for tree in BLOCKS] == list(SETTINGS)
