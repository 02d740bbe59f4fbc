"""Loading in part: what is taken, adapted, fresh or unused; parts that are frozen; rates by part; statistics anew."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

torch = pytest.importorskip("torch")

from small import cloud_of, small_detector
from test_processes import ENVIRONMENT
from test_starting import stored
from test_training import words_of_train

import farfield as ff
from farfield.cli import main
from farfield.detectors.weights import load_weights
from farfield.errors import ConfigError
from farfield.experiments.plan import Plan
from farfield.experiments.schema import load_experiment
from farfield.frame import Cloud
from farfield.training.checkpoints import load_checkpoint
from farfield.training.loop import Training
from farfield.training.param_groups import groups_of, one_cycle, rates_of
from farfield.training.transfer import by_average, by_columns, by_kernel


def scene(seed=0, count=400):
    rng = torch.Generator().manual_seed(seed)
    points = torch.rand(count, 3, generator=rng) * torch.tensor([60.0, 36.0, 3.6]) - torch.tensor([0.0, 18.0, 2.8])
    extra = {name: torch.rand(count, generator=rng).numpy() for name in ("power", "doppler_m_s")}
    return Cloud(points.numpy(), torch.rand(count, generator=rng).numpy(), extra)


def maps(network, cloud):
    with torch.no_grad():
        return network.eval()({"points": [cloud_of(network, cloud)]})


def tensors_of(outputs):
    values = outputs if isinstance(outputs, tuple | list) else vars(outputs).values()
    return [value for value in values if isinstance(value, torch.Tensor)]


@pytest.mark.parametrize("name", ["pointpillars", "rtnh", "rtn", "second", "voxelnet"])
def test_the_same_architecture_takes_everything_and_answers_bit_for_bit(name, tmp_path):
    theirs, path = stored(tmp_path, name)
    ours = small_detector(name, seed=8)
    found = ff.transfer(ours, path)
    assert found.share == 1.0
    assert found.shares == {"taken": 1.0, "adapted": 0.0, "by_class": 0.0, "fresh": 0.0}
    for one, other in zip(*(tensors_of(maps(network, scene())) for network in (ours, theirs)), strict=True):
        assert torch.equal(one, other)


def test_three_columns_by_average_answer_repeated_input_as_one_did():
    rng = torch.Generator().manual_seed(1)
    old, image = torch.randn(8, 1, 3, 3, generator=rng), torch.randn(2, 1, 9, 9, generator=rng)
    value, count, said = by_average(torch.zeros(8, 3, 3, 3), old)
    wide = torch.nn.functional.conv2d(image.expand(-1, 3, -1, -1), value, padding=1)
    assert (wide - torch.nn.functional.conv2d(image, old, padding=1)).abs().max() < 1e-5
    assert (count, said) == (value.numel(), "the mean of 1 columns in each of 3")


def test_a_new_column_by_name_changes_no_bit(tmp_path):
    theirs, path = stored(tmp_path, "rtnh")
    ours = small_detector("rtnh", seed=8, use_doppler=True)
    found = ff.transfer(ours, path)
    assert found.adapted == {"encoder.linear.weight": "columns by name; at zero: doppler_m_s"}
    assert found.fresh == {}
    for one, other in zip(*(tensors_of(maps(network, scene())) for network in (ours, theirs)), strict=True):
        assert torch.equal(one, other)
    back = small_detector("rtnh", seed=9)
    again = ff.transfer(back, dict(ours.state_dict()))
    assert "the mean of 5 columns" in again.adapted["encoder.linear.weight"]


@pytest.mark.parametrize(
    ("name", "changes", "column"),
    [
        ("pointpillars", {"use_intensity": True}, "intensity"),
        ("second", {"use_intensity": True}, "intensity"),
        ("sparsecentre", {"use_intensity": True}, "intensity"),
        ("rtn", {"use_doppler": True}, "doppler_m_s"),
        ("pointrcnn", {"inputs": ["height", "range", "intensity"]}, "intensity"),
        ("voxelnet", {"use_lag": True}, "lag_s"),
    ],
)
def test_every_detector_names_the_columns_that_it_reads(name, changes, column, tmp_path):
    _, path = stored(tmp_path, name)
    ours = small_detector(name, seed=8, **changes)
    for key, (axis, names) in ours.input_columns().items():
        assert ours.state_dict()[key].shape[axis] == len(names) == len(set(names))
    found = ff.transfer(ours, path)
    assert set(found.adapted) == set(ours.input_columns())
    assert all(column in said for said in found.adapted.values())
    assert found.fresh == {}


def test_columns_of_the_same_number_are_not_taken_by_place():
    own = torch.zeros(4, 4)
    value, count, said = by_columns(
        own, torch.arange(16.0).view(4, 4), (1, ["x", "y", "z", "power"]), (1, ["y", "x", "z", "rcs"])
    )
    assert value[0].tolist() == [1, 0, 2, 0]
    assert count == 12
    assert said == "columns by name; at zero: power; dropped: rcs"


def test_kernels_lie_in_the_middle():
    small, large = torch.randn(4, 2, 3, 3), torch.zeros(4, 2, 7, 7)
    value, count, said = by_kernel(large, small)
    assert torch.equal(value[:, :, 2:5, 2:5], small)
    assert value.count_nonzero() == small.numel() == count
    assert said == "kernel of 3 x 3 in the middle of 7 x 7"
    cropped, _, _ = by_kernel(torch.zeros(4, 2, 1, 1), value)
    assert torch.equal(cropped, small[:, :, 1:2, 1:2])
    image = torch.randn(1, 2, 5, 8, 8)
    deep, _, _ = by_kernel(torch.zeros(4, 2, 3, 3, 3), small)
    flat = torch.nn.functional.conv2d(image[:, :, 2], small, padding=1)
    torch.testing.assert_close(torch.nn.functional.conv3d(image, deep, padding=1)[:, :, 2], flat)
    sparse, _, _ = by_kernel(torch.zeros(27, 2, 4), torch.randn(9, 2, 4))
    assert sparse[:9].count_nonzero() == sparse[18:].count_nonzero() == 0
    assert sparse[9:18].count_nonzero() == 72
    assert by_kernel(torch.zeros(4, 2, 4, 4), torch.zeros(4, 2, 2, 2)) is None
    assert by_kernel(torch.zeros(4, 3, 3, 3), torch.zeros(4, 2, 3, 3)) is None


def test_five_classes_to_three_score_alike_before_training(tmp_path):
    names = ["vehicle", "pedestrian", "bicycle", "large_vehicle", "motorcycle"]
    theirs, path = stored(tmp_path, "sparsecentre", classes=names)
    ours = small_detector("sparsecentre", seed=8, classes=["motorcycle", "vehicle", "bicycle"])
    found = ff.transfer(ours, path)
    assert found.classes == {"shared": ["motorcycle", "vehicle", "bicycle"], "fresh": []}
    features = torch.randn(50, ours.head.heat.in_features)
    torch.testing.assert_close(ours.head.heat(features), theirs.head.heat(features)[:, [4, 0, 2]], rtol=0, atol=1e-6)
    fresh = small_detector("sparsecentre", seed=8, classes=["motorcycle", "vehicle", "bicycle"])
    before = fresh.head.heat.weight.clone()
    assert all(name.startswith("head.") for name in ff.transfer(fresh, path, head="fresh").fresh)
    assert torch.equal(fresh.head.heat.weight, before)


def test_renamed_and_left_out_parts(tmp_path):
    theirs, _ = stored(tmp_path, "pointpillars")
    odd = {name.replace("backbone.", "trunk.", 1): value for name, value in theirs.state_dict().items()}
    ours = small_detector("pointpillars", seed=8)
    found = ff.transfer(ours, odd, rename={"trunk": "backbone"}, skip=["head", "*.norm.bias"])
    assert {name.partition(".")[0] for name in found.taken} == {"encoder", "backbone"}
    assert set(found.fresh) == {"encoder.norm.bias", "head.weight", "head.bias"}
    assert 0.8 < found.share < 0.9
    assert sum(found.shares.values()) == pytest.approx(1.0)
    assert found.shapes["head.weight"] == list(ours.head.weight.shape)
    assert "skip" in str(found)


def test_no_fitting_name_is_an_error_with_the_three_nearest():
    ours = small_detector("pointpillars")
    odd = {f"net.{name}": value for name, value in small_detector("pointpillars", seed=5).state_dict().items()}
    with pytest.raises(ConfigError, match="nothing fits") as caught:
        ff.transfer(ours, odd)
    said = str(caught.value)
    assert said.count("net.") == 3
    largest = max(ours.state_dict(), key=lambda name: ours.state_dict()[name].numel())
    assert f"net.{largest}" in said
    with pytest.raises(ConfigError, match="rename"):
        ff.transfer(ours, {"head.bias": ours.state_dict()["head.bias"]})
    few = ff.transfer(ours, {"head.bias": ours.state_dict()["head.bias"]}, least_taken=0.0)
    assert few.taken == ["head.bias"]


def test_numbers_that_are_not_finite_are_refused(tmp_path):
    network = small_detector("pointpillars")
    state = {name: value.clone() for name, value in network.state_dict().items()}
    state["head.bias"][0] = float("nan")
    with pytest.raises(ConfigError, match=r"not finite.*head\.bias"):
        ff.transfer(network, state)


def test_rates_by_part_are_those_asked_for(experiment, tmp_path):
    _, path = stored(tmp_path, "pointpillars", widths=[8, 16, 16], depths=[0, 0, 0], neck_width=16)
    start = {"weights": str(path), "rates": {"encoder": 0.1, "backbone": 0.3, "backbone.necks": 0.6}}
    words = [f"training.start={json.dumps(start)}", "training.warmup=0.25", "detector.out_stride=2"]
    settings = load_experiment(experiment, words)
    network = small_detector("pointpillars")
    rates = rates_of(network, settings.training.start)
    assert {rates[name] for name in rates if name.startswith("backbone.necks")} == {0.6}
    assert {rates[name] for name in rates if name.startswith("head")} == {1.0}
    parameters = list(network.parameters())
    by_id = {id(p): rates[name] for name, p in network.named_parameters()}
    groups = groups_of(parameters, by_id, weight_decay=0.1)
    assert sorted({group["rate"] for group in groups}) == [0.1, 0.3, 0.6, 1.0]
    assert sum(len(group["params"]) for group in groups) == len(parameters)
    assert all(p.ndim > 1 for group in groups if group["weight_decay"] for p in group["params"])
    seen = {}
    before = Training._minimise

    def note(self, losses, names):
        seen[self.step] = {group["rate"]: group["lr"] for group in self._optimizer.param_groups}
        before(self, losses, names)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Training, "_minimise", note)
        Plan(settings, tmp_path / "run").run()
    for step in (0, 3, 11):  # the first, the end of the warm-up, the last
        for rate, used in seen[step].items():
            assert used == pytest.approx(rate * one_cycle(step, settings.training))
    assert seen[3][1.0] == pytest.approx(settings.training.learning_rate)
    assert len(seen[0]) == 4
    with pytest.raises(ConfigError, match=r"rates: backbones"):
        rates_of(network, settings.training.start.model_copy(update={"rates": {"backbones": 1.0}}))


def test_layer_decay_slows_the_first_parts_most():
    from farfield.training.config import StartConfig

    rates = rates_of(small_detector("rtn"), StartConfig(weights="any", layer_decay=0.5))
    assert {name.partition(".")[0]: rate for name, rate in rates.items()} == {"trunk": 0.25, "neck": 0.5, "head": 1.0}
    with pytest.raises(ValueError, match="both"):
        StartConfig(weights="any", layer_decay=0.5, rates={"head": 1.0})


HALF = {"freeze": {"encoder": 1.0, "backbone": 0.5}}
QUICK = ("training.steps=50", "training.batch_size=2", "training.weight_decay=0.1", "training.learning_rate=0.01")
STILL = ("detector.out_stride=2", "augmentation.pasted={}")


def frozen_run(experiment, tmp_path, *, steps=50):
    _, path = stored(tmp_path, "pointpillars", widths=[8, 16, 16], depths=[0, 0, 0], neck_width=16)
    start = json.dumps({"weights": str(path), **HALF})
    words = [*QUICK, *STILL, f"training.start={start}", f"training.steps={steps}"]
    return words, load_weights(path)[0].state_dict()


def parts_equal(state, other, part):
    return all(torch.equal(value, other[name]) for name, value in state.items() if name.startswith(f"{part}."))


def test_frozen_parts_keep_every_bit_until_they_thaw(experiment, tmp_path):
    """AdamW with decay, averaged weights and batch statistics: nothing of a frozen part moves."""
    words, theirs = frozen_run(experiment, tmp_path)
    seen = {}
    before = Training._minimise

    def note(self, losses, names):
        before(self, losses, names)
        seen[self.step] = {k: v.clone() for k, v in self.modules["detector"].state_dict().items()}
        seen["groups"] = {id(p) for group in self._optimizer.param_groups for p in group["params"]}
        seen["encoder"] = {id(p) for p in self.modules["detector"].encoder.parameters()}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Training, "_minimise", note)
        weights = Plan(load_experiment(experiment, words), tmp_path / "run").run()
    averaged = load_weights(weights)[0].state_dict()
    assert parts_equal(averaged, theirs, "encoder")
    assert not seen["encoder"] & seen["groups"], "always frozen: not in the optimiser"
    assert parts_equal(seen[24], theirs, "backbone")
    assert parts_equal(seen[24], theirs, "encoder")
    assert not parts_equal(seen[25], theirs, "backbone"), "thawed"
    assert not parts_equal(seen[0], theirs, "head")
    assert not parts_equal(averaged, theirs, "backbone")


def in_two(words):
    """Run the command line in two processes; what they said is shown where they end badly."""
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    command += ["-m", "farfield.cli", *words, "-o", "training.devices=2"]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_two_processes_freeze_alike(experiment, tmp_path):
    words, theirs = frozen_run(experiment, tmp_path, steps=8)
    start = next(word for word in words if "start" in word).replace('"backbone": 0.5', '"backbone": 1.0')
    in_two([*words_of_train(experiment, tmp_path, *words), "-o", start])
    averaged = load_weights(tmp_path / "tiny" / "weights.safetensors")[0].state_dict()
    assert parts_equal(averaged, theirs, "encoder")
    assert parts_equal(averaged, theirs, "backbone")
    assert not parts_equal(averaged, theirs, "head")


def test_two_processes_thaw_at_the_step_of_one(experiment, tmp_path):
    """The backbone goes with the fifth of eight steps: from there on it normalises by each batch."""
    words, theirs = frozen_run(experiment, tmp_path, steps=8)
    words.append("training.learning_rate=1e-4")  # larger ones turn the last digits of two processes into the first
    in_two(words_of_train(experiment, tmp_path / "two", *words))
    assert main(words_of_train(experiment, tmp_path / "one", *words)) == 0
    late = next(word for word in words if "start" in word).replace('"backbone": 0.5', '"backbone": 1.0')
    assert main(words_of_train(experiment, tmp_path / "never", *words, late)) == 0
    one, two, never = (
        [json.loads(line)["loss"] for line in (tmp_path / name / "tiny" / "log.jsonl").read_text().splitlines()]
        for name in ("one", "two", "never")
    )
    assert two == pytest.approx(one, rel=1e-5)
    assert never[:4] == one[:4]
    assert min(abs(a - b) for a, b in zip(never[4:], one[4:], strict=True)) > 3 * max(
        abs(a - b) for a, b in zip(two, one, strict=True)
    ), "what thawing does is larger than the roundings of two processes"
    weights = load_weights(tmp_path / "two" / "tiny" / "weights.safetensors")[0].state_dict()
    assert parts_equal(weights, theirs, "encoder")
    assert not parts_equal(weights, theirs, "backbone")


@pytest.mark.parametrize("reach", [4, 12], ids=["before it thaws", "after"])
def test_a_killed_run_thaws_at_the_same_step(experiment, tmp_path, reach):
    words, _ = frozen_run(experiment, tmp_path, steps=16)
    assert main(words_of_train(experiment, tmp_path / "whole", *words)) == 0
    command = [sys.executable, "-m", "farfield.cli", *words_of_train(experiment, tmp_path / "cut", *words)]
    run, log = subprocess.Popen(command, stderr=subprocess.DEVNULL), tmp_path / "cut" / "tiny" / "log.jsonl"
    until = time.monotonic() + 120
    while time.monotonic() < until and not (log.is_file() and len(log.read_text().splitlines()) >= reach):
        time.sleep(0.005)
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    assert 0 < load_checkpoint(tmp_path / "cut" / "tiny" / "checkpoint.pt")["step"] < 16
    assert main(words_of_train(experiment, tmp_path / "cut", *words)) == 0
    one, other = (load_weights(tmp_path / each / "tiny" / "weights.safetensors")[0] for each in ("whole", "cut"))
    assert all(torch.equal(value, other.state_dict()[name]) for name, value in one.state_dict().items())


def test_statistics_are_taken_anew_before_the_first_step(experiment, tmp_path, capsys):
    _, path = stored(tmp_path, "pointpillars", widths=[8, 16, 16], depths=[0, 0, 0], neck_width=16)
    start = {"weights": str(path), "statistics": {"reestimate_batches": 3}, "freeze": ["encoder", "backbone"]}
    words = [*STILL, f"training.start={json.dumps(start)}", "training.steps=2", "training.batch_size=2"]
    assert main(words_of_train(experiment, tmp_path, *words)) == 0
    assert "batch statistics taken anew from 3 batches" in " ".join(capsys.readouterr().err.split())
    theirs, ours = load_weights(path)[0], load_weights(tmp_path / "tiny" / "weights.safetensors")[0]
    norm = ours.encoder.norm
    assert not torch.equal(norm.running_mean, theirs.encoder.norm.running_mean)
    assert norm.running_mean.abs().sum() > 0
    assert float(norm.num_batches_tracked) == 3
    assert torch.equal(norm.weight, theirs.encoder.norm.weight)
    assert norm.momentum == 0.1


def test_a_dry_run_says_what_is_taken_and_who_learns(experiment, tmp_path, capsys):
    words, _ = frozen_run(experiment, tmp_path)
    assert main([*words_of_train(experiment, tmp_path / "none", *words), "--dry-run"]) == 0
    said = capsys.readouterr().out
    assert "100.0 % of the parameters" in said
    assert "encoder: 3 tensors, 80 parameters, frozen, not in the optimiser" in said or "frozen, not in" in said
    assert "frozen for the first 25 of 50 steps" in said
    assert not (tmp_path / "none").exists()


def test_a_start_said_in_few_words_is_known_as_before(experiment):
    settings = load_experiment(experiment, ["training.start_from=pointpillars-cirrus-sim"])
    assert settings.training.model_dump()["start"] == {"weights": "pointpillars-cirrus-sim", "freeze": ()}


def test_the_score_before_and_after_taking_statistics_anew_is_told(experiment, tmp_path, capsys):
    """No step is taken: the weights are those that were loaded, with other statistics."""
    _, path = stored(tmp_path, "pointpillars", widths=[8, 16, 16], depths=[0, 0, 0], neck_width=16)
    start = {"weights": str(path), "statistics": {"reestimate_batches": 3}}
    words = [*STILL, f"training.start={json.dumps(start)}", "training.steps=0", "training.batch_size=2"]
    words.append("training.validation={frames: 2}")
    assert main(words_of_train(experiment, tmp_path, *words)) == 0
    said = " ".join(capsys.readouterr().err.split())
    kept = json.loads((tmp_path / "tiny" / "statistics.json").read_text())
    assert kept["batches"] == 3
    assert 0 <= kept["before"] <= 1
    assert 0 <= kept["after"] <= 1
    assert f"{kept['before']:.3f} mean AP on held-out frames before, {kept['after']:.3f} after" in said
    theirs, ours = (load_weights(each)[0].state_dict() for each in (path, tmp_path / "tiny" / "weights.safetensors"))
    moved = {name for name, value in ours.items() if not torch.equal(value, theirs[name])}
    assert moved
    assert all(name.endswith(("running_mean", "running_var", "num_batches_tracked")) for name in moved)
