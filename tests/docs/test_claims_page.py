"""docs/claims.md follows the declared claims and what the results recorded of them."""

import sys
from pathlib import Path
from types import ModuleType

import pytest

from farfield.papers.claims import CLAIMS, load
from farfield.papers.grid import load_grid

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def claims_tool(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    sys.modules.pop("claims", None)
    return __import__("claims")


def test_the_page_is_what_the_results_say_and_has_every_claim(claims_tool: ModuleType) -> None:
    text = (ROOT / "docs" / "claims.md").read_text(encoding="utf-8")
    assert claims_tool.page() == text, "run: python tools/claims.py --write"
    for paper in CLAIMS:
        for claim in load(paper):
            assert f"| **{claim.id}** {claim.words} |" in text


def test_a_section_is_read_to_the_last_comparison(claims_tool: ModuleType) -> None:
    claims, grid = load("kradar"), load_grid("kradar")
    text = claims_tool.sections()["kradar, laptop"]
    _, decided = claims_tool.recorded_of(text, "laptop", claims, grid, None)
    assert set(decided.steps.values()) == {210}
    assert decided.core_minutes == 115
    verdicts = {claim.id: claim.verdict for claim in decided.claims}
    assert (verdicts["K2"], verdicts["K4"], verdicts["K5"]) == ("holds not", "holds", "undecided")
    fog = decided.by_id["K2"].decided[1]
    assert fog.decision is not None
    assert (fog.decision.difference.estimate, fog.decision.difference.interval) == (-0.158, (-0.297, -0.019))
    assert fog.power == 0.31
    assert decided.by_id["K1"].decided[1].decision is None, "its control was not run"
    changed = text.replace("- pointpillars weather/fog, ap3d", "- rtn weather/fog, ap3d")
    with pytest.raises(SystemExit, match="K2: expected a comparison that its claims declare"):
        claims_tool.recorded_of(changed, "laptop", claims, grid, None)


def test_plans_give_core_minutes_by_budget(claims_tool: ModuleType) -> None:
    planned = claims_tool.planned_minutes(claims_tool.sections()["plans"])
    assert planned["kradar", "workstation"] == 2013
    assert planned["cirrus", "gpu"] == 4139405
    assert planned["cirrus", "desk"] == 2506
