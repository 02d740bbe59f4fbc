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
from farfield.training.checkpoints import BestScore, begin_log, load_checkpoint, resume_optimizer, save_checkpoint


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
        case "a sparse moment":
            moments[number]["exp_avg"] = torch.zeros_like(moments[number]["exp_avg"]).to_sparse()
        case "a moment without numbers":
            moments[number]["exp_avg"] = torch.zeros_like(moments[number]["exp_avg"], device="meta")
        case "a module without numbers":
            state[module] = torch.zeros_like(state[module], device="meta")
        case "a sparse module":
            state[module] = state[module].to_sparse()
        case "provenance of another kind":
            state["provenance"] = "[1]"
        case "provenance nested":
            state["provenance"] = "[" * 100_000
        case "streams of another kind":
            state["provenance"] = json.dumps({**json.loads(state["provenance"]), "streams": [1]})
        case "steps of another kind":
            provenance = json.loads(state["provenance"])
            provenance["experiment"]["training"]["steps"] = "many"
            state["provenance"] = json.dumps(provenance)
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
    "a sparse moment",
    "a moment without numbers",
    "a module without numbers",
    "a sparse module",
    "provenance of another kind",
    "provenance nested",
    "streams of another kind",
    "steps of another kind",
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


def test_large_moments_go_on_and_an_optimisers_settings_are_the_experiments(tmp_path: Path) -> None:
    """Where gradients are hardly clipped their squares pass any limit of weights."""
    parameter = torch.nn.Parameter(torch.ones(3))
    optimizer = torch.optim.AdamW([parameter], lr=0.1, weight_decay=0.5)
    moments = {"step": torch.ones(()), "exp_avg": torch.full((3,), -1e8), "exp_avg_sq": torch.full((3,), 1e16)}
    group = {"params": [0], "lr": float("nan"), "weight_decay": -9.0, "betas": "strange"}
    resume_optimizer(tmp_path, {"state": {0: moments}, "param_groups": [group]}, optimizer)
    assert optimizer.param_groups[0]["weight_decay"] == 0.5
    assert optimizer.param_groups[0]["lr"] == 0.1
    assert torch.equal(optimizer.state[parameter]["exp_avg_sq"], moments["exp_avg_sq"])


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "[" * 100_000,
        '{"step": 1, "validation": NaN}',
        '{"step": 1, "validation": 7}',
        '{"step": Infinity, "validation": 0.5}',
        '{"step": 1.5, "validation": 0.5}',
        '{"step": "1", "validation": 0.5}',
        '{"step": true, "validation": 0.5}',
        '{"step": -1, "validation": 0.5}',
        '{"step": 1, "validation": 0.5, "sha256": "0"}',
        '{"step": 1, "validation": 0.5, "sha257": "0"}',
    ],
)
def test_a_damaged_best_score_is_refused(tmp_path: Path, text: str) -> None:
    """It was taken for none: the next score, however low, then took the place of the best weights."""
    assert BestScore.read(tmp_path) is None
    (tmp_path / "best.json").write_text(text)
    with pytest.raises(FileFormatError, match=r"best\.json"):
        BestScore.read(tmp_path)
    (tmp_path / "best.json").write_text(json.dumps({"step": 1, "validation": 0.5}))
    assert BestScore.read(tmp_path) == BestScore(1, 0.5), "as earlier versions wrote it"


def test_a_flipped_bit_of_the_best_score_is_refused(tmp_path: Path) -> None:
    """A 0.5 that became 0.9 kept every later score from being the best."""
    BestScore(137, 0.5217).write(tmp_path)
    assert BestScore.read(tmp_path) == BestScore(137, 0.5217)
    path = tmp_path / "best.json"
    data, accepted = path.read_bytes(), []
    for bit in range(8 * (len(data) - 1)):
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        try:
            BestScore.read(tmp_path)
        except FileFormatError:
            continue
        accepted.append(bytes(damaged))
    assert not accepted


DAMAGED_LINES = (
    "",
    "[]",
    "7",
    '{"step": 3, "lo',
    '{"step": Infinity}',
    '{"step": NaN}',
    '{"step": 3.5}',
    '{"step": "3"}',
    '{"step": -3}',
    '{"loss": 1.0}',
    '{"step": 3, "loss": "low"}',
    '{"step": 3, "loss": null}',
    '{"step": 3, "loss": [1]}',
    '{"step": 3, "loss": 1' + "0" * 400 + "}",
    '{"step": 3, "loss": ' + "[" * 100_000,
)


def test_damaged_files_beside_a_checkpoint_are_named(experiment: Path, tmp_path: Path) -> None:
    _, path = begun(experiment, tmp_path / "run")
    log = path.with_name("log.jsonl")
    lines = log.read_text()
    assert [row["step"] for row in logged(path.parent)] == [1, 2]
    for line in DAMAGED_LINES:
        log.write_text(lines + line + '\n{"step": 4}\n')
        with pytest.raises(FileFormatError, match=r"log\.jsonl, line 3"):
            logged(path.parent)
    for torn in ('{"step": 3, "lo', "\0\0\0", "\0\0\n", '{"step": 3, \0\0\0\n'):
        log.write_text(lines + torn)
        assert [row["step"] for row in logged(path.parent)] == [1, 2], "a process that was killed left a torn line"
        begin_log(log, anew=False)
        assert log.read_text() == lines
    settings = load_experiment(experiment, ["training.steps=3", "training.start_from=pointpillars-cirrus-sim"])
    start = {"weights": "pointpillars-cirrus-sim", "sha256": "0", "share": 1.0}
    for tree in ({}, [], 7, {**start, "weights": 7}, {**start, "frame_digests": ["a"]}):
        (path.parent / "start.json").write_text(json.dumps(tree))
        with pytest.raises(FileFormatError, match=r"start\.json"):
            Plan(settings, path.parent).run()


def test_a_device_in_a_checkpoints_place_is_refused(tmp_path: Path) -> None:
    (tmp_path / "checkpoint.pt").symlink_to("/dev/zero")
    with pytest.raises(FileFormatError, match="a device or a pipe"):
        load_checkpoint(tmp_path / "checkpoint.pt")
