"""Methods over several streams and modules, and the plan of a run."""

import json
import os
import pickle
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from farfield_example.method import GradientReversal
from small import SMALL, small_detector

from farfield.datasets import open_dataset
from farfield.datasets.cirrus import CirrusWriter
from farfield.detectors.runtime import Detector
from farfield.errors import ConfigError, DatasetError
from farfield.experiments.plan import Plan
from farfield.experiments.schema import Experiment
from farfield.training.augmentation import draw_change
from farfield.training.checkpoints import load_checkpoint, save_checkpoint
from farfield.training.config import AugmentationConfig
from farfield.training.method import METHODS, ParamGroup, Stream, Supervised
from farfield.training.samples import TrainingSamples, batch_shares, bindings

RUN = """
import sys
from pathlib import Path
from farfield_example.method import GradientReversal
from farfield.experiments.plan import Plan
from farfield.experiments.schema import load_experiment
from farfield.training.method import METHODS
METHODS.register("reversal")(GradientReversal)
Plan(load_experiment(Path(sys.argv[1])), Path(sys.argv[2])).run()
"""


@pytest.fixture(scope="session")
def bare(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The frames of ``data`` without their annotations."""
    root = tmp_path_factory.mktemp("bare")
    for frame in open_dataset(data):
        CirrusWriter(root).write(frame)
    for path in root.rglob("dataset1_annotation/*.json"):
        path.unlink()
    return root


@pytest.fixture
def reversal() -> Any:
    METHODS.register("reversal")(GradientReversal)
    yield
    METHODS._registered.pop("reversal")


def planned(data: Path, bare: Path, folder: Path, detector: str = "pointpillars", **training: Any) -> Plan:
    """A run of gradient reversal from the Gaussian clouds of ``data`` to the uniform ones of ``bare``."""
    settings = {"steps": 3, "batch_size": 4, "precision": "fp32", "threads": 1, "workers": 0, "log_every_steps": 1}
    tree = {
        "name": "reversal",
        "data": {
            "source": {"path": str(data), "clouds": ["gaussian"]},
            "target": {"path": str(bare), "clouds": ["uniform"]},
        },
        "method": {"name": "reversal", "weight": 0.2, "cells": 1_000_000},  # all: processes would draw others
        "detector": {"name": detector, **SMALL[detector].settings},
        "training": {**settings, **training},
    }
    return Plan(Experiment.model_validate(tree), folder)


def test_two_streams_train_in_one_forward_and_export_a_detector(
    data: Path, bare: Path, tmp_path: Path, reversal: None
) -> None:
    assert open_dataset(bare)[0].annotation is None
    plan = planned(data, bare, tmp_path / "run")
    weights = plan.run()
    detector = Detector.load(weights, precision="fp32")
    assert detector.learnt_clouds == ("gaussian",)
    assert len(detector.detect([open_dataset(data)[0]])) == 1
    state = load_checkpoint(tmp_path / "run" / "checkpoint.pt")
    assert "modules/judge/weight" in state
    assert {f"streams/{name}/fingerprint" for name in ("source", "target")} <= set(state)
    assert plan.run() == weights  # nothing left to do


def environment() -> dict[str, str]:
    path = os.pathsep.join([str(Path(__file__).parents[2] / "examples"), os.environ.get("PYTHONPATH", "")])
    return {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": path}


@pytest.mark.slow
def test_two_processes_share_streams_and_modules_as_one(data: Path, bare: Path, tmp_path: Path) -> None:
    from farfield.experiments.schema import dump_experiment

    plan = planned(data, bare, tmp_path, steps=6, learning_rate=1e-5)  # larger ones turn the last digit into the second
    (tmp_path / "reversal.yaml").write_text(dump_experiment(plan.experiment))
    (tmp_path / "run.py").write_text(RUN)
    words = [str(tmp_path / "run.py"), str(tmp_path / "reversal.yaml")]
    launch = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    for name, before in (("one", []), ("two", launch)):
        command = [sys.executable, *before, *words, str(tmp_path / name)]
        subprocess.run(command, env=environment(), check=True, capture_output=True, timeout=300)
    one, two = (
        [json.loads(line) for line in (tmp_path / name / "log.jsonl").read_text().splitlines()]
        for name in ("one", "two")
    )
    assert [row["step"] for row in one] == [row["step"] for row in two] == list(range(1, 7))
    for alone, shared in zip(one, two, strict=True):
        assert set(alone) == set(shared) >= {"domain_source", "domain_target", "classification"}
        for name in set(alone) - {"time"}:
            assert shared[name] == pytest.approx(alone[name], rel=1e-4), name


@pytest.mark.slow
@pytest.mark.parametrize("detector", ["pointpillars", pytest.param("sparsecentre", marks=pytest.mark.whole)])
def test_a_killed_run_of_several_modules_resumes_to_the_same_bits(
    detector: str, data: Path, bare: Path, tmp_path: Path
) -> None:
    from farfield.experiments.schema import dump_experiment

    plan = planned(data, bare, tmp_path, detector, steps=20, checkpoint_every_s=0.001)
    (tmp_path / "reversal.yaml").write_text(dump_experiment(plan.experiment))

    def start(name: str) -> "subprocess.Popen[bytes]":
        words = [sys.executable, "-c", RUN, str(tmp_path / "reversal.yaml"), str(tmp_path / name)]
        return subprocess.Popen(words, env=environment())

    assert start("whole").wait(600) == 0
    cut, log, until = start("cut"), tmp_path / "cut" / "log.jsonl", time.monotonic() + 300
    while not (log.exists() and len(log.read_text().splitlines()) >= 6):
        assert time.monotonic() < until
        assert cut.poll() is None
        time.sleep(0.01)
    cut.send_signal(signal.SIGKILL)
    cut.wait(30)
    assert 0 < load_checkpoint(tmp_path / "cut" / "checkpoint.pt")["step"] < 20
    assert start("cut").wait(600) == 0
    one, other = (load_checkpoint(tmp_path / name / "checkpoint.pt") for name in ("whole", "cut"))
    modules = [name for name in one if name.startswith("modules/")]
    assert any(name.startswith("modules/judge/") for name in modules)
    assert all(torch.equal(one[name], other[name]) for name in modules)
    assert all(torch.equal(one["average"][name], other["average"][name]) for name in one["average"])
    Detector.load(tmp_path / "cut")


def test_a_plan_launches_nothing_and_travels(data: Path, bare: Path, tmp_path: Path, reversal: None) -> None:
    plan = planned(data, bare, tmp_path / "never", accelerator="cpu", devices=2)
    sent = pickle.dumps(plan)
    assert len(sent) < 100_000
    assert pickle.loads(sent) == plan
    assert not torch.distributed.is_initialized()
    assert not (tmp_path / "never").exists()


def test_streams_and_data_must_fit(data: Path, bare: Path, tmp_path: Path, reversal: None) -> None:
    tree = planned(data, bare, tmp_path).experiment.model_dump(mode="json")
    one = {**tree, "data": tree["data"]["source"]}
    with pytest.raises(ConfigError, match="expected data for source, target"):
        Plan(Experiment.model_validate(one), tmp_path).run()
    with pytest.raises(ConfigError, match="a setting does not fit"):
        Plan(Experiment.model_validate({**tree, "method": {"name": "reversal", "strength": 1}}), tmp_path).run()
    with pytest.raises(ConfigError, match="shares of the streams"):
        batch_shares(3, GradientReversal.streams)
    assert batch_shares(6, {"a": Stream(share=2.0), "b": Stream()}) == {"a": 4, "b": 2}


def test_frames_without_annotation_are_no_background(data: Path, bare: Path, tmp_path: Path) -> None:
    """They once trained as empty ones."""
    tree = {
        "name": "tiny",
        "data": {"path": str(bare), "clouds": ["gaussian"]},
        "detector": {"name": "pointpillars", **SMALL["pointpillars"].settings},
        "training": {"steps": 1, "batch_size": 1, "precision": "fp32", "threads": 1, "workers": 0},
    }
    with pytest.raises(DatasetError, match=r"3 of 3 frames have no annotation.*unannotated=skip"):
        Plan(Experiment.model_validate(tree), tmp_path / "refused").run()
    for path in (bare / "Cirrus_dataset1").rglob("*.json"):
        raise AssertionError(f"expected no annotation, found {path}")
    network = small_detector("pointpillars")
    samples = TrainingSamples(
        open_dataset(bare),
        inputs=network.inputs,
        clouds=("gaussian",),
        classes=("vehicle",),
        assigner=network.assigner,
        augmentation=AugmentationConfig(),
    )
    with pytest.raises(DatasetError, match="not annotated"):
        samples[0]
    tree["training"]["unannotated"] = "skip"
    with pytest.raises(DatasetError, match="expected annotated frames to train on, found none"):
        Plan(Experiment.model_validate(tree), tmp_path / "skipped").run()


class Players(Supervised):
    """A detector, a player that takes turns with it, and a teacher that only follows."""

    def __init__(self, network: Any) -> None:
        super().__init__(network)
        self.modules["player"] = torch.nn.Linear(4, 1)
        self.modules["teacher"] = torch.nn.Linear(4, 1)
        self.seen: list[int] = []

    def frozen(self) -> tuple[str, ...]:
        return ("teacher",)

    def step(self, batch: Any, step: int, optimise: Any) -> Any:
        if step % 2:
            return None
        loss = {"player": self.modules["player"](torch.ones(1, 4)).square().sum()}
        optimise(loss, ("player",))
        return loss

    def after_step(self, step: int) -> None:
        self.seen.append(step)


def test_a_method_may_step_by_itself_and_freeze_modules(data: Path, tmp_path: Path) -> None:
    from farfield.training.config import TrainingConfig
    from farfield.training.loop import Training

    method = Players(small_detector("pointpillars"))
    network = method.modules["detector"]
    samples = TrainingSamples(
        open_dataset(data),
        inputs=network.inputs,
        clouds=("gaussian",),
        classes=("vehicle",),
        assigner=network.assigner,
        augmentation=AugmentationConfig(),
    )
    before = {name: value.clone() for name, value in method.modules.state_dict().items()}
    config = TrainingConfig(steps=1, batch_size=1, precision="fp32", threads=1, workers=0, log_every_steps=1)
    Training(method, {"labelled": samples}, config, tmp_path).run()
    after = method.modules.state_dict()
    changed = {name.split(".")[0] for name in before if not torch.equal(before[name], after[name])}
    assert changed == {"player"}
    Training(method, {"labelled": samples}, config.model_copy(update={"steps": 2}), tmp_path, step=1).run()
    assert method.seen[-1] == 1
    assert torch.equal(before["teacher.weight"], method.modules["teacher"].weight)
    assert not torch.equal(before["detector.head.weight"], method.modules["detector"].head.weight)


def test_checkpoints_of_the_first_form_are_read(experiment: Path, tmp_path: Path) -> None:
    from farfield.experiments.schema import load_experiment
    from farfield.training.checkpoints import load_run

    Plan(load_experiment(experiment, ["training.steps=2"]), tmp_path / "run").run()
    path = tmp_path / "run" / "checkpoint.pt"
    state = load_checkpoint(path)
    old = {key: value for key, value in state.items() if not key.startswith(("modules/", "streams/"))}
    old["network"] = {k.removeprefix("modules/detector/"): v for k, v in state.items() if k.startswith("modules/")}
    old["average"] = {k.removeprefix("detector."): v for k, v in state["average"].items()}
    save_checkpoint(path, old)
    run = load_run(path, json.loads(state["provenance"]), _modules(experiment))
    assert run is not None
    assert run.step == 2
    assert all(torch.equal(run.modules[f"detector.{name}"], value) for name, value in old["network"].items())


def _modules(experiment: Path) -> Any:
    from farfield.detectors import build_detector
    from farfield.experiments.schema import load_experiment

    return Supervised(build_detector(load_experiment(experiment).detector, seed=0)).modules


def test_what_travels_to_a_loaders_worker_is_small(data: Path) -> None:
    """RTNH at its published widths once sent 69 MB to each."""
    from farfield.detectors import DETECTORS, build_detector

    network = build_detector(DETECTORS["rtnh"].config_class())
    samples = TrainingSamples(
        open_dataset(data),
        inputs=network.inputs,
        clouds=("radar",),
        classes=("vehicle",),
        assigner=network.assigner,
        augmentation=AugmentationConfig(),
    )
    assert len(pickle.dumps(samples)) < 1_000_000


def test_several_inputs_take_the_same_turn() -> None:
    from farfield.detectors.inputs import CloudInput

    inputs = {"lidar": CloudInput(), "radar": CloudInput(columns=("x_m", "y_m", "z_m", "power"))}
    bound = bindings(inputs, {"lidar": ["gaussian", "uniform"], "radar": ["radar"]})
    assert bound == ({"lidar": "gaussian", "radar": "radar"}, {"lidar": "uniform", "radar": "radar"})
    with pytest.raises(ConfigError, match="clouds for each of the inputs"):
        bindings(inputs, ("gaussian",))
    with pytest.raises(ConfigError, match="Expected clouds for the inputs"):
        bindings(inputs, {"lidar": ["gaussian"]})


def test_one_change_moves_points_boxes_and_velocities_alike() -> None:
    from farfield.frame import Boxes

    box = Boxes(
        centre_m=np.array([[10.0, 4.0, -1.0]]),
        size_m=np.array([[4.0, 2.0, 1.5]]),
        yaw_rad=np.array([0.4]),
        label="vehicle",
        velocity_m_s=np.array([[3.0 * np.cos(0.4), 3.0 * np.sin(0.4)]]),
    )
    config = AugmentationConfig(flip_probability=1.0, rotation_rad=1.0, scale=0.1, height_m=0.2)
    change = draw_change(config, np.random.default_rng(2))
    assert change.mirror
    moved = change.boxes(box)
    heading = np.arctan2(*moved.velocity_m_s[0, ::-1])
    assert np.isclose(heading, moved.yaw_rad[0])  # it still drives where it looks
    assert np.isclose(np.linalg.norm(moved.velocity_m_s), 3.0 * change.factor)
    ends = np.array([[10.0, 4.0, -1.0, 0.0], *(np.append(corner, 0.0) for corner in box.corners_m()[0])], np.float32)
    np.testing.assert_allclose(change.points(ends)[0, :3], moved.centre_m[0], atol=1e-5)
    corners = {tuple(np.round(corner, 3)) for corner in change.points(ends)[1:, :3].astype(float)}
    assert corners == {tuple(np.round(corner, 3)) for corner in moved.corners_m()[0].astype(np.float32).astype(float)}


class Slow(Players):
    """A player with a pace of its own, and figures for the log."""

    def on_train_start(self, steps: int, seed: int) -> None:
        self.course = (steps, seed)

    def step(self, batch: Any, step: int, optimise: Any) -> None:
        return None

    def losses(self, batch: Any, step: int) -> Any:
        found = super().losses(batch, step)
        return {**found, "player": 1e6 * self.modules["player"](torch.ones(1, 4)).square().sum()}

    def param_groups(self) -> dict[str, ParamGroup]:
        return {"player": ParamGroup(rate=self.rate, clip=1.0)}

    def figures(self) -> dict[str, float]:
        return {"pace": self.rate}

    rate = 0.0


def test_a_module_may_learn_at_a_pace_of_its_own(data: Path, tmp_path: Path) -> None:
    """Its gradient, a million times the others', neither shrinks theirs nor moves it further than its rate allows."""
    from farfield.training.config import TrainingConfig
    from farfield.training.loop import Training

    found = {}
    for name, kind in (("plain", Supervised), ("slow", Slow)):
        method = kind(small_detector("pointpillars"))
        network = method.modules["detector"]
        samples = TrainingSamples(
            open_dataset(data),
            inputs=network.inputs,
            clouds=("gaussian",),
            classes=("vehicle",),
            assigner=network.assigner,
            augmentation=AugmentationConfig(),
        )
        before = {name: value.clone() for name, value in method.modules.state_dict().items()}
        loop = {"precision": "fp32", "threads": 1, "workers": 0, "log_every_steps": 1, "seed": 5}
        config = TrainingConfig(steps=2, batch_size=1, **loop)
        Training(method, {"labelled": samples}, config, tmp_path / name).run()
        found[name] = (method, before)
    slow, before = found["slow"]
    assert torch.equal(before["player.weight"], slow.modules["player"].weight)
    assert slow.course == (2, 5)
    assert json.loads((tmp_path / "slow" / "log.jsonl").read_text().splitlines()[-1])["pace"] == 0.0
    plain = found["plain"][0].modules["detector"].state_dict()
    assert all(torch.equal(value, plain[name]) for name, value in slow.modules["detector"].state_dict().items())


def test_hooks_of_earlier_names_still_work_with_a_warning() -> None:
    with pytest.warns(DeprecationWarning, match="begins is called on_train_start now"):

        class Early(Supervised):
            def begins(self, steps: int, seed: int) -> None:
                self.course = (steps, seed)

    method = Early(small_detector("pointpillars"))
    method.on_train_start(3, 1)
    assert method.course == (3, 1)
