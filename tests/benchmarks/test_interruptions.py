"""The benchmark of interruptions tries every verb that writes: a new verb needs a command there, or a reason."""

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from farfield.cli import RESUMING, VERBS
from farfield.datasets.convert import TARGETS

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def tried(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import _interrupted_verbs

    yield _interrupted_verbs
    for name in ("_interrupted_verbs", "_report", "_forked_commands", "interruptions"):
        sys.modules.pop(name, None)


def test_every_verb_is_interrupted_or_left_out_with_a_reason(tried: ModuleType) -> None:
    assert tried.verbs_without_case() == []
    verbs = {case.verb for case in tried.CASES.values()}
    assert not verbs & set(tried.LEFT_OUT)
    assert verbs | set(tried.LEFT_OUT) == set(VERBS)
    assert all(len(reason) > 20 for reason in tried.LEFT_OUT.values())


def test_a_verb_without_a_command_is_noticed(tried: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(VERBS, "new-verb", "write something")
    assert tried.verbs_without_case() == ["new-verb"]


def test_the_verbs_that_resume_are_ended_in_chains(tried: ModuleType) -> None:
    assert set(VERBS) >= RESUMING
    assert {case.verb for case in tried.CASES.values() if case.resumes} == RESUMING - set(tried.LEFT_OUT)


def test_each_target_of_convert_that_has_files_of_its_own_is_tried(tried: ModuleType) -> None:
    lines = [case.line.partition("--to ")[2] for name, case in tried.CASES.items() if name.startswith("convert")]
    assert set(TARGETS) == {line.partition("--dialect ")[2] or line.split()[0] for line in lines}


def test_rows_are_kept_and_those_that_hold_are_not_tried_again(
    tried: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("psutil")
    import interruptions

    names: list[str] = []

    def attempt(bench: interruptions.Bench, name: str, case: object) -> str:
        del case
        names.append(name)
        if name == "score" and names.count(name) == 1:
            bench.fault(name, "a test", "it is broken")
        return f"try {names.count(name)}"

    def run(*only: str) -> str:
        words = ["--home", str(tmp_path), *(("--only", *only) if only else ())]
        interruptions._each(interruptions._parser(interruptions.run_twice).parse_args(words), "a target", attempt)
        return capsys.readouterr().out

    monkeypatch.setattr(interruptions, "CASES", {name: tried.CASES[name] for name in ("sync", "score", "new-dataset")})
    text = run("sync", "score")
    assert "not tried yet: new-dataset" in text
    assert "1 faults\n  score, a test: it is broken" in text
    text = run("new-dataset")  # the others' rows are there still
    assert names == ["sync", "score", "new-dataset"]
    assert "MISSED" in text
    assert "not tried yet" not in text
    text = run("sync", "score", "new-dataset")
    assert names == ["sync", "score", "new-dataset", "score"]
    assert "MISSED" not in text
    assert "0 faults" in text


def test_a_row_for_which_the_code_changed_is_none(
    tried: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("psutil")
    import interruptions

    commits = iter(["abc", "abc-dirty", "abc-dirty", "abc-dirty"])
    monkeypatch.setattr(interruptions, "git_commit", lambda: next(commits))
    monkeypatch.setattr(interruptions, "CASES", {"sync": tried.CASES["sync"]})

    def attempt(bench: interruptions.Bench, name: str, case: object) -> str:
        del case
        if not bench.count:
            bench.fault(name, "a test", "other bytes")
        bench.count += 1
        return "a try"

    for words, faults in (("left out: the code changed meanwhile", "0 faults"), ("a try", "1 faults")):
        interruptions._each(
            interruptions._parser(interruptions.run_twice).parse_args(["--home", str(tmp_path)]), "", attempt
        )
        text = capsys.readouterr().out
        assert words in text
        assert faults in text
