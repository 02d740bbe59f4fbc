"""``farfield reproduce --summary``: every claim in a row, of the folders that there are; needs no torch."""

import json
from pathlib import Path

import pytest

from farfield.cli import main
from farfield.cli._completion import flags_of, positional_words
from farfield.papers.claim_rows import comparisons_of
from farfield.papers.claims import load


def finished(out: Path, paper: str, budget: str, verdict: str) -> Path:
    """A folder with the summary of a grid in which the first claim with trainings was decided so, and others hold."""
    claims, trees = load(paper), []
    first = next(claim.id for claim in claims if claim.runs)
    for claim in claims:
        own = verdict if claim.id == first else "holds"
        difference = {"estimate": 0.5, "interval": [0.25, 0.75], "n": 3, "trained": True}
        made = {"verdict": own, "difference": difference} if claim.runs else None
        rows = [{"role": role, "metric": metric, "decision": made} for role, metric, _ in comparisons_of(claim)]
        trees.append({"id": claim.id, "verdict": own if made else "not run", "decided": rows})
    tree = {"paper": paper, "budget": budget, "simulated": True, "seeds": 3, "steps": {"grid": 300, "rtnh": 300}}
    tree |= {"runs": {"planned": 6, "done": 6}, "claims_sha256": claims.sha256, "claims": trees}
    out.mkdir(parents=True)
    (out / "reproduction.json").write_text(json.dumps(tree))
    return out


def test_it_takes_the_finished_folders_or_those_that_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    finished(Path("runs/reproduce-cirrus-laptop"), "cirrus", "laptop", "undecided")
    finished(Path("runs/reproduce-cirrus-desk"), "cirrus", "desk", "holds")
    finished(Path("runs/reproduce-kradar-laptop"), "kradar", "laptop", "holds not")
    (tmp_path / "runs" / "reproduce-kradar-desk").mkdir()  # begun, not finished
    assert main(["reproduce", "--summary"]) == 0
    text = capsys.readouterr().out
    assert "cirrus: Of 16 claims 15 hold, 0 hold not, 0 are undecided and 1 were not run." in text
    assert "kradar: Of 7 claims 5 hold, 1 hold not, 0 are undecided and 1 were not run." in text
    assert "laptop: undecided" in " ".join(text.split())
    assert "0.500 [0.250, 0.750]" in " ".join(text.split())
    assert all(f"{name} " in text for name in ("C0", "C15", "K1", "K7")), "every claim, also those never run"
    assert max(map(len, text.splitlines())) <= 160
    other = finished(Path("elsewhere"), "kradar", "desk", "holds not")
    arguments = ["--out", str(other), "--out", "runs/reproduce-cirrus-desk"]
    assert main(["reproduce", *arguments, "kradar", "--summary"]) == 0
    text = capsys.readouterr().out
    assert "kradar: Of 7 claims 5 hold, 1 hold not" in text
    assert "cirrus:" not in text


def test_without_a_finished_folder_it_says_what_to_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["reproduce", "--summary"]) == 1
    said = capsys.readouterr().err
    assert "Run farfield reproduce cirrus or farfield reproduce kradar" in said
    finished(Path("runs/reproduce-cirrus-desk"), "cirrus", "desk", "holds")
    assert main(["reproduce", "kradar", "--summary"]) == 1
    assert "Run farfield reproduce kradar, or" in capsys.readouterr().err
    assert main(["reproduce", "--summary", "--out", "nothing"]) == 1
    assert "--out nothing: expected reproduction.json" in capsys.readouterr().err


def test_what_does_not_go_together_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reproduce"]) == 1
    assert "PAPER: expected cirrus or kradar" in capsys.readouterr().err
    assert main(["reproduce", "cirrus", "--summary", "--plan"]) == 1
    assert "--summary: expected without the flags of runs" in capsys.readouterr().err
    assert main(["reproduce", "cirrus", "--plan", "--out", "a", "--out", "b"]) == 1
    assert "--out: expected one folder without --summary, got 2" in capsys.readouterr().err
    assert main(["reproduce", "velodyne"]) == 2
    assert "expected one of cirrus, kradar, got 'velodyne'" in capsys.readouterr().err


def test_shells_complete_it() -> None:
    assert positional_words("reproduce") == ("cirrus", "kradar")
    assert "--summary" in flags_of("reproduce")
    assert flags_of("reproduce")["--precision"] == ("auto", "bf16", "fp32")
