"""What docs/adaptation.md shows is an experiment, and its columns are those of the log."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import ValidationError

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
    kind, given = SETTINGS[experiment.method.name], experiment.method.settings
    assert given.keys() <= kind.model_validate(given).model_dump(by_alias=True).keys()
    with pytest.raises(ValidationError, match="no_such_setting"):
        kind.model_validate({**given, "no_such_setting": 1})


def test_the_page_shows_each_method() -> None:
    assert [tree["method"]["name"] for tree in BLOCKS] == list(SETTINGS)


@pytest.mark.parametrize("detector", ["pointpillars", "sparsecentre"])
@pytest.mark.parametrize(
    ("method", "streams"),
    [
        ({"name": "range", "near_m": [0, 30], "far_m": [30, 64], "local": {"warmup": 0, "near_points": 1}}, None),
        ({"name": "pattern", "loss": "paired"}, {"labelled": {"clouds": ["gaussian", "uniform"]}}),
        ({"name": "pattern"}, {"labelled": {"clouds": ["gaussian", "uniform"]}}),
        ({"name": "device", "norm": "per_domain"}, {"source": {}, "target": {"clouds": ["uniform"]}}),
    ],
    ids=["range", "paired", "unpaired", "device"],
)
def test_half_precision_trains_as_well(planned: Any, method: dict[str, Any], streams: Any, detector: str) -> None:
    found = {}
    for precision in ("fp32", "bf16"):
        plan = planned(precision, method, detector, streams, precision=precision, steps=2)
        plan.run()
        found[precision] = json.loads((plan.folder / "log.jsonl").read_text().splitlines()[-1])
    assert found["fp32"].keys() == found["bf16"].keys()
    for name in ("loss", "occupied", "lambda", "global", "local", "paired", "unpaired", "device"):
        if name in found["fp32"]:
            assert found["bf16"][name] == pytest.approx(found["fp32"][name], rel=0.1, abs=1e-4), name
