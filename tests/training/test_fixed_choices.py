"""What a clock or a load decides as a run begins holds to its end: number type and threads of its checkpoint."""

from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from farfield.detectors import devices
from farfield.detectors.weights import load_weights
from farfield.experiments.plan import Plan
from farfield.experiments.schema import load_experiment
from farfield.frame import provenance
from farfield.training.checkpoints import load_checkpoint, resumed_otherwise
from farfield.training.config import TrainingConfig
from farfield.training.processes import fixed_choices
from farfield.training.report import TrainingReport

SLOW, FAST = {"fp32": 9.0, "bf16": 1.0}, {"fp32": 1.0, "bf16": 9.0}
"""What timing the processor gives: once bfloat16 wins, and once, by a load, float32."""


class KilledError(Exception):
    """In place of a signal."""


class Stopping(TrainingReport):
    """Ends a training at a step, and keeps what it says."""

    def __init__(self, step: int = 0) -> None:
        self.at, self.lines = step, list[str]()

    def step(self, step: int, losses: dict[str, float]) -> None:
        del losses
        if step == self.at:
            raise KilledError

    def say(self, text: str) -> None:
        self.lines.append(text)


@pytest.fixture(autouse=True)
def own_threads(monkeypatch: pytest.MonkeyPatch):
    """Nothing orders a number of threads, and no commit comes in between; the process has its own again at the end."""
    before = torch.get_num_threads()
    monkeypatch.setattr(provenance, "git_commit", lambda: "0123456789ab")
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    yield
    torch.set_num_threads(before)


def measure(monkeypatch: pytest.MonkeyPatch, times: dict[str, float]) -> None:
    """Let the processor be one that emulates bfloat16, timed so."""
    monkeypatch.setattr(devices, "flags_of_cpu", lambda: {"avx512": True})
    monkeypatch.setattr(devices, "kept_times", lambda: {"dense": times, "rows": times})


def run(experiment: Path, folder: Path, report: Stopping, *words: str) -> Path:
    settings = ["training.precision=auto", "training.accelerator=cpu", "training.steps=6", *words]
    return Plan(load_experiment(experiment, settings), folder).run(report)


def test_another_measurement_does_not_change_a_run_that_goes_on(
    experiment: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure(monkeypatch, SLOW)
    whole = run(experiment, tmp_path / "whole", Stopping())
    with pytest.raises(KilledError):
        run(experiment, tmp_path / "cut", Stopping(4))
    assert load_checkpoint(tmp_path / "cut" / "checkpoint.pt")["step"] == 3
    measure(monkeypatch, FAST)
    report = Stopping()
    cut = run(experiment, tmp_path / "cut", report)
    assert load_weights(cut)[1]["precision"] == "bf16"
    assert any("bf16 on the CPU" in line for line in report.lines)
    assert cut.read_bytes() == whole.read_bytes()
    other = run(experiment, tmp_path / "other", Stopping())  # the measurement does decide
    assert load_weights(other)[1]["precision"] == "fp32"
    one, two = (load_weights(path)[0].state_dict() for path in (whole, other))
    assert not all(torch.equal(one[name], two[name]) for name in one)


def test_another_number_of_cores_does_not_change_a_run_that_goes_on(
    experiment: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ("training.threads=0", "training.precision=fp32")
    torch.set_num_threads(2)
    whole = run(experiment, tmp_path / "whole", Stopping(), *words)
    with pytest.raises(KilledError):
        run(experiment, tmp_path / "cut", Stopping(4), *words)
    torch.set_num_threads(1)  # as where a process may use fewer cores
    cut = run(experiment, tmp_path / "cut", Stopping(), *words)
    assert load_weights(cut)[1]["threads"] == 2
    assert cut.read_bytes() == whole.read_bytes()
    torch.set_num_threads(1)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")  # an order stands, is said and recorded
    with pytest.raises(KilledError):
        run(experiment, tmp_path / "ordered", Stopping(4), *words)
    monkeypatch.delenv("OMP_NUM_THREADS")
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    torch.set_num_threads(2)
    report = Stopping()
    ordered = run(experiment, tmp_path / "ordered", report, *words)
    (line,) = load_weights(ordered)[1]["resumed_otherwise"]
    assert line == {"step": 3, "changes": {"threads": [1, 2]}}
    assert any("threads was 1, is 2" in text for text in report.lines)


def test_a_changed_checkout_gives_other_bytes_and_the_same_weights(
    experiment: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As once where files were edited while a benchmark of interruptions compared bytes."""
    paths = []
    for commit in ("0123456789ab", "0123456789ab-dirty"):
        monkeypatch.setattr(provenance, "git_commit", lambda commit=commit: commit)
        paths.append(run(experiment, tmp_path / commit, Stopping(), "training.precision=fp32", "training.steps=1"))
    assert paths[0].read_bytes() != paths[1].read_bytes()
    one, two = (load_weights(path)[0].state_dict() for path in paths)
    assert all(torch.equal(one[name], two[name]) for name in one)
    saved, now = (load_weights(path)[1] for path in paths)
    (change,) = resumed_otherwise(saved, now, 1)
    assert change["changes"] == {"environment.commit": ["0123456789ab", "0123456789ab-dirty"]}


def test_settings_go_before_a_checkpoint_and_another_device_chooses_anew() -> None:
    cpu = TrainingConfig(accelerator="cpu")
    began = {"precision": "bf16", "threads": 3, "device_kind": "CPU"}
    fixed = fixed_choices(cpu, began)
    assert (fixed.precision, fixed.threads) == ("bf16", 3)
    assert fixed_choices(cpu, {}) == cpu
    assert fixed_choices(cpu, {**began, "device_kind": "GPU"}).precision == "auto"
    assert fixed_choices(cpu, {"precision": "odd", "threads": "many"}) == cpu
    own = TrainingConfig(accelerator="cpu", precision="fp32", threads=1)
    assert fixed_choices(own, began) == own


def test_earlier_changes_of_a_run_stay_in_its_record() -> None:
    earlier = [{"step": 2, "changes": {"threads": [1, 2]}}]
    saved = {"threads": 2, "environment": {"commit": "a"}, "resumed_otherwise": earlier}
    now = {"threads": 2, "environment": {"commit": "a-dirty"}}
    assert resumed_otherwise(saved, now, 5) == [
        *earlier,
        {"step": 5, "changes": {"environment.commit": ["a", "a-dirty"]}},
    ]
    assert resumed_otherwise(saved, saved, 5) == earlier
