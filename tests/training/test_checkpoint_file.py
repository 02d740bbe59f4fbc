"""Checkpoints that changed since they were written, or hold another run's shapes, are refused before torch has them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from farfield.errors import FileFormatError
from farfield.experiments.plan import Plan, logged
from farfield.experiments.schema import Experiment, load_experiment
from farfield.training.checkpoints import BestScore, load_checkpoint, save_checkpoint


def begun(experiment: Path, folder: Path) -> tuple[Experiment, Path]:
    """A run of two steps that is to go on to three, and its checkpoint."""
    Plan(load_experiment(experiment, ["training.steps=2", "augmentation.pasted={}"]), folder).run()
    (folder / "weights.safetensors").unlink()
    return load_experiment(experiment, ["training.steps=3", "augmentation.pasted={}"]), folder / "checkpoint.pt"


def test_a_flipped_bit_anywhere_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, {"step": 2, "average": {"a": torch.arange(1000.0)}, "provenance": "{}"})
    assert load_checkpoint(path)["step"] == 2
    data, rng, accepted = path.read_bytes(), np.random.default_rng(58), []
    for number in rng.integers(0, len(data), 200).tolist():
        damaged = bytearray(data)
        damaged[number] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        try:
            load_checkpoint(path)
        except FileFormatError:
            continue
        accepted.append(number)
    assert not accepted, f"{len(accepted)} of 200 checkpoints with one flipped bit are accepted"


def test_of_earlier_versions_the_numbers_are_compared_with_their_checksums(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.pt"
    torch.save({"step": 2, "average": {"a": torch.arange(1000.0)}, "provenance": "{}"}, path)
    assert load_checkpoint(path)["step"] == 2
    data = bytearray(path.read_bytes())
    data[data.index(torch.arange(1000.0).numpy().tobytes()) + 2000] ^= 1
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match="checksum"):
        load_checkpoint(path)


def first(tree: dict[str, Any], beginning: str) -> str:
    return next(name for name in tree if name.startswith(beginning) and tree[name].ndim)


def damage(state: dict[str, Any], kind: str) -> None:
    """Change a state as no run leaves it."""
    module, average = first(state, "modules/"), state["average"]
    moments = state["optimizer"]["state"]
    number = next(iter(moments))
    groups = state["optimizer"]["param_groups"]
    match kind:
        case "a module's shape":
            state[module] = state[module].reshape(-1)[:1].clone()
        case "a module's NaN":
            state[module].view(-1)[0] = float("nan")
        case "an average's shape":
            name = first(average, "detector.")
            average[name] = average[name].reshape(-1)[:1].clone()
        case "an average's name":
            average["strange"] = average.pop(first(average, "detector."))
        case "an average's NaN":
            average[first(average, "detector.")].view(-1)[0] = float("nan")
        case "a moment's shape":
            moments[number]["exp_avg"] = torch.zeros(1)
        case "a moment's NaN":
            moments[number]["exp_avg_sq"].view(-1)[0] = float("nan")
        case "a negative moment":
            moments[number]["exp_avg_sq"].view(-1)[0] = -1.0
        case "a moment's type":
            moments[number]["exp_avg"] = moments[number]["exp_avg"].to(torch.int64)
        case "a moment's lack":
            del moments[number]["exp_avg_sq"]
        case "a moment's number":
            moments[10_000] = moments.pop(number)
        case "a moment's list":
            moments[number] = [1, 2]
        case "a group's lack":
            groups.pop()
        case "a group's parameters":
            groups[0]["params"] = groups[0]["params"][1:]
        case "a group's rate":
            groups[0]["lr"] = float("nan")
        case "an optimiser's step":
            moments[number]["step"] = torch.zeros(3)
        case "no optimiser":
            state["optimizer"] = {}
        case "a list for an optimiser":
            state["optimizer"] = [1]
        case "a step below 0":
            state["step"] = -1
        case "half a step":
            state["step"] = 1.5


KINDS = (
    "a module's shape",
    "a module's NaN",
    "an average's shape",
    "an average's name",
    "an average's NaN",
    "a moment's shape",
    "a moment's NaN",
    "a negative moment",
    "a moment's type",
    "a moment's lack",
    "a moment's number",
    "a moment's list",
    "a group's lack",
    "a group's parameters",
    "a group's rate",
    "an optimiser's step",
    "no optimiser",
    "a list for an optimiser",
    "a step below 0",
    "half a step",
)


def test_states_that_no_run_leaves_are_refused(experiment: Path, tmp_path: Path) -> None:
    settings, path = begun(experiment, tmp_path / "run")
    data, accepted = path.read_bytes(), {}
    for kind in KINDS:
        path.write_bytes(data)
        state = load_checkpoint(path)
        damage(state, kind)
        save_checkpoint(path, state)
        try:
            Plan(settings, tmp_path / "run").run()
        except Exception as error:  # ours, or what torch raises
            if not isinstance(error, FileFormatError) or error.path != path:
                accepted[kind] = f"{type(error).__name__}: {error}"
        else:
            accepted[kind] = "goes on"
            (tmp_path / "run" / "weights.safetensors").unlink()
    assert not accepted, accepted
    path.write_bytes(data)
    Plan(settings, tmp_path / "run").run()


@pytest.mark.parametrize("text", ["", "{", '{"step": 1, "validation": NaN}', '{"step": 1, "validation": 7}', "[]"])
def test_a_damaged_best_score_is_refused(tmp_path: Path, text: str) -> None:
    """It was taken for none: the next score, however low, then took the place of the best weights."""
    assert BestScore.read(tmp_path) is None
    (tmp_path / "best.json").write_text(text)
    with pytest.raises(FileFormatError, match=r"best\.json"):
        BestScore.read(tmp_path)
    (tmp_path / "best.json").write_text(json.dumps({"step": 1, "validation": 0.5}))
    assert BestScore.read(tmp_path) == BestScore(1, 0.5)


def test_damaged_files_beside_a_checkpoint_are_named(experiment: Path, tmp_path: Path) -> None:
    _, path = begun(experiment, tmp_path / "run")
    log = path.with_name("log.jsonl")
    assert [row["step"] for row in logged(path.parent)] == [1, 2]
    log.write_text(log.read_text() + '{"step": 3, "lo\n')
    with pytest.raises(FileFormatError, match=r"log\.jsonl, line 3"):
        logged(path.parent)
    settings = load_experiment(experiment, ["training.steps=3", "training.start_from=pointpillars-cirrus-sim"])
    (path.parent / "start.json").write_text("{}")
    with pytest.raises(FileFormatError, match=r"start\.json"):
        Plan(settings, path.parent).run()
