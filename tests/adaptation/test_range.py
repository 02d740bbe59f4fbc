"""Adaptation from near to far: runs, controls, windows and the local loss."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from small import batch_of, small_detector

from farfield.adaptation.adversarial import shuffled_domains
from farfield.adaptation.cells import Cells
from farfield.adaptation.range import RangeAdaptation, RangeSettings, draw_windows, local_error
from farfield.detectors.weights import load_weights
from farfield.errors import ConfigError
from farfield.experiments.schema import dump_experiment
from farfield.training.checkpoints import load_checkpoint

NEAR_FAR = {"name": "range", "near_m": [0, 30], "far_m": [30, 64], "half_width_m": 18, "min_range_m": 4}
EAGER = {"warmup": 0.0, "near_points": 1}


def log_of(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]


def modules_of(folder: Path, kind: str = "modules/") -> dict[str, Any]:
    state = load_checkpoint(folder / "checkpoint.pt")
    return {name: value for name, value in state.items() if name.startswith(kind)}


@pytest.mark.parametrize("detector", ["pointpillars", "second", "voxelnet", "sparsecentre"])
def test_range_trains_each_detector_and_adds_nothing_to_its_weights(planned: Any, detector: str) -> None:
    plan = planned("run", {**NEAR_FAR, "local": EAGER}, detector, steps=4)
    weights = plan.run()
    network, _ = load_weights(weights)
    assert set(network.state_dict()) == set(small_detector(detector).state_dict())
    rows = log_of(plan.folder)
    assert rows[0]["lambda"] == 0 < rows[-1]["lambda"] < 0.1
    assert rows[0]["global"] == pytest.approx(np.log(2), abs=0.1)  # a new discriminator knows nothing
    assert rows[-1]["local"] > 0
    assert rows[-1]["n_eff"] >= 1
    assert {"discriminator_accuracy", "cells_of_source", "cells_of_target", "occupied"} <= set(rows[-1])
    assert {"variance_near", "variance_far", "rank_near", "rank_far"} <= set(rows[-1])
    assert all(np.isfinite(value) for row in rows for value in row.values())


@pytest.mark.parametrize("detector", ["pointpillars", "sparsecentre"])
def test_without_strength_training_is_plain_training_to_the_bit(planned: Any, detector: str) -> None:
    off = {**NEAR_FAR, "global": {"lambda_max": 0}, "local": {**EAGER, "weight": 0}}
    for folder, method in (("plain", {"name": "supervised"}), ("off", off), ("on", {**NEAR_FAR, "local": EAGER})):
        planned(folder, method, detector).run()
    root = planned("x", {}).folder.parent
    plain, same, other = (modules_of(root / name, "modules/detector") for name in ("plain", "off", "on"))
    assert plain.keys() == same.keys()
    assert all(torch.equal(plain[name], same[name]) for name in plain)
    assert not all(torch.equal(plain[name], other[name]) for name in plain)
    judged = modules_of(root / "off", "modules/discriminator")
    started = RangeAdaptation(small_detector(detector, seed=0), **{k: v for k, v in off.items() if k != "name"})
    fresh = started.modules["discriminator"].state_dict()
    assert not torch.equal(judged["modules/discriminator/0.weight"], fresh["0.weight"])  # it learns all the same


def test_a_resumed_run_repeats_to_the_bit(planned: Any) -> None:
    method = {
        **NEAR_FAR,
        "global": {"match_density": True, "labels": "coin"},
        "local": {**EAGER, "mixture": "shuffled"},
    }
    whole = planned("whole", method, steps=4)
    whole.run()
    cut = planned("cut", method, steps=4)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RangeAdaptation, "after_step", _stop_after_two)
        patch.setattr("farfield.training.loop.time.monotonic", iter(range(0, 10**6, 1000)).__next__)  # save each step
        with pytest.raises(KeyboardInterrupt):
            cut.run()
    assert load_checkpoint(cut.folder / "checkpoint.pt")["step"] == 2
    cut.run()
    one, other = (load_checkpoint(plan.folder / "checkpoint.pt") for plan in (whole, cut))
    names = [name for name in one if name.startswith("modules/")]
    assert {"modules/discriminator/0.weight", "modules/memory/feature", "modules/memory/entered"} <= set(names)
    assert all(torch.equal(one[name], other[name]) for name in names)
    for key, state in one["optimizer"]["state"].items():  # of the discriminator too
        assert all(torch.equal(value, other["optimizer"]["state"][key][name]) for name, value in state.items())


def _stop_after_two(self: Any, step: int) -> None:
    if step == 2:
        raise KeyboardInterrupt


def test_windows_have_one_size_and_cells_beside_the_car_are_left_out() -> None:
    settings, rng = RangeSettings(), np.random.default_rng(0)
    drawn = [draw_windows(settings, rng) for _ in range(100)]
    assert {window.near_m for window in drawn} == {(10.0, 100.0)}
    starts = np.array([window.far_m[0] for window in drawn])
    assert (starts >= 100).all()
    assert (starts <= 160).all()
    assert np.ptp(starts) > 50  # the whole far range is seen
    assert all(np.isclose(np.ptp(window.far_m), 90) for window in drawn)
    place = torch.tensor([[5.0, 0.0], [11.0, 0.0], [50.0, 49.0], [99.0, 10.0], [130.0, 0.0], [240.0, 0.0]])
    number = torch.arange(6)
    cells = Cells(number, number * 0, number, place, number + 1)
    near, far = drawn[0]._replace(far_m=(120.0, 210.0)).split(cells, settings.min_range_m)
    assert near.tolist() == [1, 3]
    assert far.tolist() == [4]
    beside = Cells(number[:1], number[:1], number[:1], torch.tensor([[6.0, 6.0]]), number[:1])
    all_near = drawn[0]._replace(near_m=(0.0, 90.0))
    assert len(all_near.split(beside, 8.0)[0]) == 1
    assert len(all_near.split(beside, 9.0)[0]) == 0


def test_the_local_loss_is_that_worked_out_by_hand_and_stops_at_near_features() -> None:
    far = torch.tensor([[1.0, 3.0]], requires_grad=True)
    near = torch.tensor([[0.0, 0.0], [2.0, 4.0]], requires_grad=True)
    mixture = torch.tensor([[0.25, 0.75]]) @ near  # (1.5, 3)
    loss = local_error(far, mixture, near)
    # (0.5^2 + 0^2) over two channels and the mean of the variances 1 and 4
    assert loss.item() == pytest.approx(0.25 / 2 / 2.5)
    loss.backward()
    assert near.grad is None
    torch.testing.assert_close(far.grad, torch.tensor([[-0.5 * 2 / 2 / 2.5, 0.0]]))


def test_a_coin_exchanges_both_domains_of_whole_frames() -> None:
    frame = torch.arange(64).repeat_interleave(2)
    domain = torch.tensor([0.0, 1.0]).repeat(64)
    coined = shuffled_domains(domain, frame, np.random.default_rng(0)).view(64, 2)
    assert torch.equal(coined.sum(1), torch.ones(64))
    assert 16 < int(coined[:, 0].sum()) < 48


def test_settings_that_do_not_fit_are_refused() -> None:
    network = small_detector("pointpillars")
    for settings, message in (
        ({"lambda": 1}, r"lambda: no such key.*\n?.*It has: near_m, far_m"),
        ({"global": {"lamda_max": 1}}, "global.lamda_max"),
        ({"global": None, "local": None}, "use the method supervised"),
        ({"near_m": [0, 100], "far_m": [50, 250]}, "a far one behind it"),
        ({}, "within the detector's reach, 64 m"),
    ):
        with pytest.raises(ConfigError, match=message):
            RangeAdaptation(network, **settings)


def test_starting_weights_must_be_those_of_the_detector(planned: Any) -> None:
    weights = planned("first", {"name": "supervised"}, steps=1).run()
    network = small_detector("pointpillars", seed=9)
    settings = {name: value for name, value in NEAR_FAR.items() if name != "name"}
    RangeAdaptation(network, start=str(weights), **settings)
    trained, _ = load_weights(weights)
    assert all(torch.equal(value, network.state_dict()[name]) for name, value in trained.state_dict().items())
    with pytest.raises(ConfigError, match="tensors differ, first"):
        RangeAdaptation(small_detector("second"), start=str(weights), **settings)


def test_the_network_that_is_asked_for_its_features_stays_as_it_was() -> None:
    network = small_detector("sparsecentre")
    before = {name: value.clone() for name, value in network.state_dict().items()}
    RangeAdaptation(network, **{name: value for name, value in NEAR_FAR.items() if name != "name"})
    assert network.training
    assert all(torch.equal(before[name], value) for name, value in network.state_dict().items())
    network.encode(batch_of(torch.zeros(0, 3)))


@pytest.mark.slow
def test_two_processes_adapt_as_one(planned: Any, tmp_path: Path) -> None:
    method = {**NEAR_FAR, "local": EAGER}
    plan = planned("one", method, batch_size=4, steps=6, learning_rate=1e-6)  # larger ones turn the last digit
    (tmp_path / "range.yaml").write_text(dump_experiment(plan.experiment))
    launch = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    for name, before in (("one", []), ("two", launch)):
        words = ["-m", "farfield.cli", "train", str(tmp_path / "range.yaml"), "--out", str(tmp_path / name)]
        subprocess.run([sys.executable, *before, *words], env=environment, check=True, capture_output=True, timeout=300)
    folders = [tmp_path / name / "tiny" for name in ("one", "two")]
    one, two = map(log_of, folders)
    assert len(one) == len(two) == 6
    for alone, shared in zip(one, two, strict=True):
        for name in ("loss", "classification", "global", "local", "discriminator_accuracy"):
            assert shared[name] == pytest.approx(alone[name], rel=2e-3), (name, alone["step"])
    memory = [modules_of(folder, "modules/memory") for folder in folders]
    assert torch.equal(memory[0]["modules/memory/following"], memory[1]["modules/memory/following"])
