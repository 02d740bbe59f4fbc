"""What a training says while it runs: that it goes on, what its losses are on average, what to do next."""

import io
import json
import shlex

import pytest

torch = pytest.importorskip("torch")

from rich.console import Console
from test_training import words_of_train

from farfield.cli import main
from farfield.cli._training_report import LineReport
from farfield.errors import ConfigError


def test_printed_losses_are_means_over_the_last_steps(tmp_path):
    shown = io.StringIO()
    report = LineReport(Console(file=shown, width=200), tmp_path, every=4)
    report.on_train_start(0, 8)
    for step, loss in enumerate([8.0, 4.0, 2.0, 2.0, 1.0, 1.0, 1.0, 0.0], 1):
        report.step(step, {"loss": loss, "box": 2 * loss})
    first, middle, last = [line for line in shown.getvalue().splitlines() if line.startswith("step")]
    assert "loss 8.000 box 16.000" in first
    assert "loss 4.000 box 8.000" in middle, "(8 + 4 + 2 + 2) / 4"
    assert "loss 0.750 box 1.500" in last


def test_the_log_holds_every_step_and_every_loss(experiment, tmp_path):
    assert main(words_of_train(experiment, tmp_path, "training.log_every_steps=5", "training.steps=7")) == 0
    rows = [json.loads(line) for line in (tmp_path / "tiny" / "log.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == list(range(1, 8))
    for row in rows:
        assert row["loss"] == pytest.approx(row["classification"] + row["box"] + row["direction"], rel=1e-5)


def test_a_run_ends_with_its_page_and_report_writes_it_anew(experiment, tmp_path, capsys):
    assert main(words_of_train(experiment, tmp_path, "training.steps=3")) == 0
    page = tmp_path / "tiny" / "course.html"
    assert str(page) in "".join(capsys.readouterr().err.split("\n"))
    written = page.read_text()
    assert "All 3 steps are done." in written
    assert "training.steps" in written
    page.unlink()
    log = tmp_path / "tiny" / "log.jsonl"
    log.write_text("".join(log.read_text().splitlines(keepends=True)[:2]))  # as while it runs
    assert main(["report", str(tmp_path / "tiny"), "--out", str(tmp_path / "now.html"), "--title", "mine"]) == 0
    assert "2 of 3 steps are done." in (tmp_path / "now.html").read_text()
    assert "<h1>mine</h1>" in (tmp_path / "now.html").read_text()
    assert not page.exists()


def test_going_on_and_being_done_are_said(experiment, tmp_path, capsys):
    words = words_of_train(experiment, tmp_path, "training.steps=2")
    assert main(words) == 0
    assert "resumes" not in capsys.readouterr().err
    assert main(words) == 0
    assert "all 2 steps are done" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("split", ["", "train"])
def test_the_next_command_runs_as_it_stands(experiment, tmp_path, capsys, monkeypatch, split):
    """It names this run and these data; of data that were split, the part that it did not learn from."""
    monkeypatch.chdir(tmp_path)
    words = words_of_train(experiment, tmp_path / "my runs", "training.steps=1")
    words += ["-o", f"data.split={split}"] if split else []
    if split:
        monkeypatch.setattr("farfield.datasets.base.Dataset.split", lambda data, name: data.named(name))
        monkeypatch.setattr("farfield.datasets.base.Dataset.named", _named, raising=False)
    assert main(words) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("next: ")]
    command = shlex.split(said[-1].removeprefix("next: "), comments=True)
    assert command[:2] == ["farfield", "evaluate"]
    seen = {}

    def stop(detector, data, options):
        seen.update(detector=detector, data=data)
        raise ConfigError("far enough")

    monkeypatch.setattr("farfield.evaluation.evaluating.evaluate_clouds", stop)
    assert main(command[1:]) == 1
    assert "far enough" in capsys.readouterr().err
    assert seen["detector"].name == "tiny"
    assert getattr(seen["data"], "asked", "") == ("val" if split else "")
    assert len(seen["data"]) == 3


def _named(data, name):
    data.asked = name
    return data
