"""Peak memory beside the published figures, and which runs lack it."""

from typing import Any

import pytest

pytest.importorskip("torch")

from farfield.papers.page import MEMORY, memory_rows, missing_memory, only_scored, with_memory


def row(run: str, published: float | None, n: int) -> dict[str, Any]:
    nothing = {"mean": None, "s": None, "by_seed": {}}
    cells = {"overall": {"ap3d": {"published": 0.4, **nothing}, MEMORY: {"published": published, **nothing}}}
    return {"run": run, "words": run, "cloud": "radar", "published": run, "n": n, "cells": cells}


TIMING = {
    "runs": {
        "s0-rtn-a": {"runs": ["rtn"], "clock": [{"peak_memory_mb": 900.0}, {"peak_memory_mb": 1000.0}]},
        "s1-rtn-a": {"runs": ["rtn"], "clock": [{"peak_memory_mb": 1200.0}]},
        "s0-mute-a": {"runs": ["mute"], "clock": [{"peak_memory_mb": None}]},
        "s0-far-a": {"runs": ["far"], "clock": [{"peak_memory_mb": 300.0, "brought": True}]},
        "s2-rtn-a": {"runs": ["rtn"], "clock": [{"peak_memory_mb": 400.0, "brought": True}]},
    }
}
TABLE = {"number": "9", "metrics": {"ap3d": "AP3D"}, "rows": [row("rtn", 257.0, 2), row("large", 520.0, 0)]}


def test_a_table_that_prints_memory_gets_ours_with_its_spread() -> None:
    found = with_memory(TABLE, TIMING)
    ours = [each["cells"]["overall"][MEMORY] for each in found["rows"]]
    assert ours[0] == {"published": 257.0, "mean": 1100.0, "s": 141.4213562373095}
    assert ours[1] == {"published": 520.0, "mean": None, "s": None}
    assert list(found["metrics"]) == ["ap3d", MEMORY]
    assert "process" in found["metrics"][MEMORY]
    other = {**TABLE, "rows": [row("rtn", None, 2)]}
    assert with_memory(other, TIMING) is other


def test_weights_that_were_brought_and_those_scored_anew() -> None:
    trained, scored = {"training_s": 60.0}, {"training_s": 0.0, "brought": True}
    assert only_scored({"clock": [scored, scored]})
    assert not only_scored({"clock": [trained, scored]})
    assert not only_scored({"clock": [{"training_s": 0.0}]}), "killed at scoring, after it had trained here"
    assert not only_scored({"clock": []})


def test_what_is_missing_is_said_with_its_reason() -> None:
    assert memory_rows(TIMING) == [("rtn", "1,100 MB")]
    summary = {"left_out": {"large": "a large one"}, "tables": [TABLE, {"rows": [row("late_one", None, 0)]}]}
    assert missing_memory(summary, TIMING) == [
        "Not run at this budget: large.",
        "Not finished: late one.",
        "Trained elsewhere: far.",
        "Done where the system does not say it: mute.",
    ]
    assert missing_memory({"tables": []}, {"runs": {}}) == []
