"""A training as it runs: scored on held-out frames, stopped by Ctrl-C, prolonged."""

import json
import signal
import threading
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from farfield.cli import main
from farfield.detectors.weights import load_weights
from farfield.errors import ConfigError
from farfield.experiments.plan import Plan, logged
from farfield.experiments.schema import load_experiment
from farfield.training import loop
from farfield.training.checkpoints import load_checkpoint
from farfield.training.report import TrainingReport

ONE_CLASS = "detector.anchors={vehicle: {size_m: [4.6, 1.9, 1.7], z_m: -1.1}}"
VALIDATED = "training.validation={every_steps: 2, frames: 1}"


@pytest.fixture(autouse=True)
def ctrl_c():
    """Ctrl-C as a terminal has it: what runs in the background may have been told to ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


class Said(TrainingReport):
    """Keeps the lines, and sends a signal after a step."""

    def __init__(self, after: int = 0, number: int = signal.SIGINT) -> None:
        self.lines: list[str] = []
        self.after, self.number = after, number

    def say(self, text: str) -> None:
        self.lines.append(text)

    def step(self, step: int, losses: dict[str, float]) -> None:
        if step == self.after:
            signal.raise_signal(self.number)


def plan(experiment: Path, folder: Path, *overrides: str) -> Plan:
    return Plan(load_experiment(experiment, [*overrides]), folder)


def test_it_is_scored_every_few_steps_and_the_best_weights_are_kept(experiment, tmp_path):
    said, folder = Said(), tmp_path / "run"
    plan(experiment, folder, "training.steps=5", VALIDATED).run(said)
    rows = {row["step"]: row["validation"] for row in logged(folder) if "validation" in row}
    assert list(rows) == [2, 4, 5], "every second step and the last"
    best = json.loads((folder / "best.json").read_text())
    assert best["validation"] == max(rows.values())
    _, provenance = load_weights(folder / "best.safetensors")
    assert provenance["validation"] == {"step": best["step"], "score": best["validation"]}
    assert sum("mean AP" in line for line in said.lines) == 3
    assert provenance["frames"] == 2, "the held-out frame is not trained on"


def test_weights_are_those_of_the_best_step_and_not_of_the_last(experiment, tmp_path, monkeypatch):
    from farfield.experiments.validation import Validation

    scores = iter([0.1, 0.6, 0.3])
    monkeypatch.setattr(Validation, "score", lambda self, network: next(scores))
    folder = tmp_path / "run"
    plan(experiment, folder, "training.steps=6", VALIDATED).run()
    best = json.loads((folder / "best.json").read_text())
    assert (best["step"], best["validation"]) == (4, 0.6)
    best, last = (load_weights(folder / f"{name}.safetensors")[0].state_dict() for name in ("best", "weights"))
    assert any(not torch.equal(best[name], last[name]) for name in best)


def test_validation_changes_no_weight(experiment, tmp_path):
    """The last weights are those of a training on the same frames without it."""
    plan(experiment, tmp_path / "a", "training.steps=3", "training.validation={every_steps: 1, frames: 1}").run()
    plan(experiment, tmp_path / "b", "training.steps=3", "training.validation={every_steps: 9, frames: 1}").run()
    one, two = (load_weights(tmp_path / name / "weights.safetensors")[0].state_dict() for name in "ab")
    assert all(torch.equal(one[name], two[name]) for name in one)


def test_frames_without_a_box_of_its_classes_are_refused_in_words(experiment, tmp_path):
    with pytest.raises(ConfigError, match=r"training\.validation: none of the 1 frame has a box of vehicle"):
        plan(
            experiment, tmp_path / "run", VALIDATED, "training.steps=2", "data.aliases={vehicle: car}", ONE_CLASS
        ).run()


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_before_the_first_checkpoint_keeps_what_is_done(experiment, tmp_path, monkeypatch, number, status):
    from farfield.cli import train

    class Interrupting(Said):
        def __init__(self, *_: object) -> None:
            super().__init__(after=2, number=number)

    monkeypatch.setattr(train, "LineReport", Interrupting)
    monkeypatch.setattr(train, "BarReport", Interrupting)
    words = ["train", str(experiment), "--out", str(tmp_path), "-o", "training.checkpoint_every_s=1000"]
    try:
        ended = main(words)
    except SystemExit as end:
        ended = end.code
    assert ended == status
    kept = load_checkpoint(tmp_path / "tiny" / "checkpoint.pt")
    assert kept["step"] == 3, "the signal came while step 2 was reported"
    assert not (tmp_path / "tiny" / "weights.safetensors").exists()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_stopped_run_goes_on_to_the_same_weights(experiment, tmp_path):
    changes = ["training.steps=4", "training.checkpoint_every_s=1000"]
    plan(experiment, tmp_path / "whole", *changes).run()
    with pytest.raises(KeyboardInterrupt):
        plan(experiment, tmp_path / "stopped", *changes).run(Said(after=2))
    plan(experiment, tmp_path / "stopped", *changes).run()
    one, two = (load_weights(tmp_path / name / "weights.safetensors")[0].state_dict() for name in ("whole", "stopped"))
    assert all(torch.equal(one[name], two[name]) for name in one)


def test_a_second_signal_ends_at_once():
    from farfield.training.processes import stop_signals

    with stop_signals() as stop:
        signal.raise_signal(signal.SIGINT)
        assert stop.number == signal.SIGINT
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    worked = []
    thread = threading.Thread(target=lambda: worked.append(stop_signals().__enter__().number))
    thread.start()
    thread.join()
    assert worked == [0], "outside the main thread signals stay as they are"


def test_freed_memory_is_given_back_now_and_then(experiment, tmp_path, monkeypatch):
    times = []
    monkeypatch.setattr(loop, "_STEPS_BEFORE_MEMORY_IS_GIVEN_BACK", 2)
    monkeypatch.setattr(loop, "give_back_freed_memory", lambda: times.append(True))
    plan(experiment, tmp_path / "run", "training.steps=5").run(TrainingReport())
    assert len(times) == 2


def test_a_run_is_prolonged(experiment, tmp_path):
    folder = tmp_path / "run"
    plan(experiment, folder, "training.steps=2").run()
    plan(experiment, folder, "training.steps=4").run()
    assert [row["step"] for row in logged(folder)] == [1, 2, 3, 4]
    _, provenance = load_weights(folder / "weights.safetensors")
    assert provenance["prolonged"] == [{"step": 2, "from": 2, "to": 4}]
    assert provenance["experiment"]["training"]["steps"] == 4
    with pytest.raises(ConfigError, match=r"has done 4 steps; training\.steps may be raised, not set to 3"):
        plan(experiment, folder, "training.steps=3").run()


def test_it_says_what_it_will_do_before_it_does_it(experiment, tmp_path, capsys):
    words = ["train", str(experiment), "--out", str(tmp_path / "runs"), "-o", "training.steps=3", "-o", VALIDATED]
    assert main([*words, "--dry-run"]) == 0
    said = capsys.readouterr().err
    assert "trains pointpillars (0.0" in said
    assert "to 64 m; classes vehicle" in said
    assert "3 frames of 1 drive" in said
    assert "3 steps of 2 frames, 2.0 passes over the data, learning rate up to 0.003, fp32 on the" in said
    assert "validation every 2 steps on up to 1 frame held out" in said
    assert f"run: {tmp_path / 'runs' / 'tiny'}, which begins" in said
    assert not (tmp_path / "runs").exists()
    assert main([*words, "--dry-run", "-o", "data.path=absent"]) == 1
    lines = Said()
    plan(experiment, tmp_path / "run", "training.steps=1").run(lines)
    assert lines.lines[0].startswith("trains pointpillars")
    plan(experiment, tmp_path / "run", "training.steps=1").announce(lines)
    assert "which goes on from its checkpoint" in lines.lines[-1]


def test_data_to_be_simulated_are_named_and_not_made(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["train", "pointpillars-cirrus-sim", "--dry-run"]) == 0
    assert "which is not there and is simulated first: cirrus-sim" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
