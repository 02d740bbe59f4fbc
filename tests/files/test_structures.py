"""Structural edits whose meaning is known give the model, words about it or an error: the benchmark tries 40,000."""

import re
from pathlib import Path

import numpy as np
import pytest
from _structures import Case, Family, Reading, Tally, apart, run_cases
from fuzz_structures import FAULTY, counts, families

from farfield.errors import ConfigError

FAMILIES = families()
SLOW_CASES = 3000
"""Of all families together."""
LEAST_CASES = 40
"""Of one family, of which few may be readable."""
UNSEEN_CASES = 30
"""Of a generated tree of another's format, whose every file is written and read anew."""
QUICK = [name for name in FAMILIES if not name.startswith("unseen ")]
"""Generated trees are read whole by tests of their own."""


def faults(tally: Tally) -> list[str]:
    return tally.faults if any(tally.outcomes[kind] for kind in FAULTY) else []


def tried(family: Family, count: int, folder: Path) -> Tally:
    run_cases(family, range(1), folder)  # imports come with the first use, and take their time
    return run_cases(family, range(count), folder)


@pytest.mark.parametrize("name", QUICK)
def test_no_edit_changes_a_number_without_a_word(name: str, tmp_path: Path) -> None:
    assert faults(tried(FAMILIES[name], 4, tmp_path)) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", FAMILIES)
def test_hundreds_of_edits_change_no_number_without_a_word(name: str, tmp_path: Path) -> None:
    number = (
        max(LEAST_CASES, counts([FAMILIES[name] for name in QUICK], SLOW_CASES)[name])
        if name in QUICK
        else UNSEEN_CASES
    )
    tally = tried(FAMILIES[name], number, tmp_path)
    assert faults(tally) == []
    assert tally.outcomes["same"] + tally.outcomes["said"] > 0  # something was read


def raise_config_error() -> Reading:
    raise ConfigError("expected metres, such as --units m")


def raise_value_error() -> Reading:
    raise ValueError("a bug")


@pytest.mark.parametrize(
    ("case", "result", "fault"),
    [
        (Case((), "same", lambda: Reading([1.0]), lambda values: apart("x", values, [1.0])), "same", None),
        (Case((), "same", lambda: Reading([1.0]), lambda values: apart("x", values, [2.0])), "silent", "1.0 in place"),
        (Case((), "either", lambda: Reading([1.0]), lambda values: apart("x", values, [2.0])), "silent", "1.0"),
        (Case((), "refused", lambda: Reading([1.0]), lambda values: ""), "silent", "read, not refused"),
        (Case((), "said", lambda: Reading(1, "two rows"), lambda values: "", words="two"), "said", None),
        (Case((), "said", lambda: Reading(1, "two rows"), lambda values: "", words="three"), "silent", "three"),
        (Case((), "refused", raise_config_error, lambda values: "", words="--units"), "refused", None),
        (Case((), "refused", raise_config_error, lambda values: "", words="--scale"), "silent", "--scale"),
        (Case((), "either", raise_config_error, lambda values: ""), "refused", None),
        (Case((), "same", raise_config_error, lambda values: ""), "overrefused", "expected metres"),
        (Case((), "refused", raise_value_error, lambda values: ""), "foreign", "ValueError: a bug"),
    ],
)
def test_a_case_is_judged_by_its_oracle(case: Case, result: str, fault: str | None, tmp_path: Path) -> None:
    tally = run_cases(Family("made", lambda random, folder: case), range(1), tmp_path)
    assert dict(tally.outcomes) == {result: 1}
    assert bool(faults(tally)) == (fault is not None)
    assert fault is None or re.search(fault, tally.faults[0])


def test_a_case_depends_on_its_number_alone(tmp_path: Path) -> None:
    drawn: list[float] = []
    family = Family("made", lambda random, folder: drawn.append(random.uniform()) or accepted())  # type: ignore[func-returns-value]
    run_cases(family, range(6), tmp_path)
    run_cases(family, range(3, 5), tmp_path)
    assert drawn[3:5] == drawn[6:8]
    assert len({*np.round(drawn[:6], 6)}) == 6


def accepted() -> Case:
    return Case((), "same", lambda: Reading(None), lambda values: "")
