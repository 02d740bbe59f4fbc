import itertools
import json
import os
import pickle
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from small import SMALL

from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.datasets.maps import Sweeps
from farfield.detectors.devices import chosen_device, name_of
from farfield.detectors.inputs import CloudInput
from farfield.detectors.weights import load_weights
from farfield.errors import ConfigError, FileFormatError
from farfield.experiments.catalogue import shipped
from farfield.experiments.schema import dump_experiment, load_experiment
from farfield.frame import Boxes
from farfield.geometry.boxes import count_points_in_boxes
from farfield.simulation.recording import record
from farfield.training.augmentation import SAMPLES_PER_FRAME, ObjectBank, augment, cut_out
from farfield.training.checkpoints import load_checkpoint
from farfield.training.config import AugmentationConfig, TrainingConfig
from farfield.training.loop import lay_out_gradients
from farfield.training.param_groups import one_cycle
from farfield.training.samples import TrainingSamples


def words_of_train(experiment: Path, out: Path, *overrides: str) -> list[str]:
    return ["train", str(experiment), "--out", str(out), *(word for one in overrides for word in ("-o", one))]


def train(experiment: Path, out: Path, *overrides: str) -> subprocess.Popen:
    command = [sys.executable, "-m", "farfield.cli", *words_of_train(experiment, out, *overrides)]
    quiet = subprocess.DEVNULL
    return subprocess.Popen(command, stdout=quiet, stderr=quiet, env={**os.environ, "OMP_NUM_THREADS": "1"})


RADARS = ("rtn", "rtnh")


def record_kradar(root: Path) -> None:
    """Six frames of three drives with the radar's cells, which LiDAR frames lack."""
    record("kradar-sim-mini", root, sensors="os2-64,sparse", workers=1)


def small_setting(name: str) -> str:
    return f"detector={json.dumps({'name': name, **SMALL[name].settings})}"


def test_a_fused_step_is_a_plain_one_however_a_gradient_lies_in_memory():
    weight = torch.randn(8, 6, 3, 3).to(memory_format=torch.channels_last)
    plain, fused = (torch.nn.Parameter(weight.clone(memory_format=torch.preserve_format)) for _ in range(2))
    gradient = torch.randn(8, 6, 3, 3)
    for parameter, settings in ((plain, {"foreach": False}), (fused, {"fused": True})):
        parameter.grad = gradient.clone()
        lay_out_gradients([parameter])
        assert torch.equal(parameter.grad, gradient)
        torch.optim.AdamW([parameter], lr=0.1, **settings).step()
    torch.testing.assert_close(fused, plain)


SLOW_ONES = ([pytest.mark.slow], [pytest.mark.slow, pytest.mark.whole])


@pytest.mark.parametrize(
    "name", [name if name == "pointpillars" else pytest.param(name, marks=SLOW_ONES[name != "rtnh"]) for name in SMALL]
)
def test_killed_training_resumes_to_the_same_weights(name, experiment, data, made_once, tmp_path):
    words, opened = [small_setting(name)], partial(open_dataset, data)
    if name in RADARS:
        kradar, seen = made_once("kradar", record_kradar), {"reference": "radar"}
        words.append(f"data={json.dumps({'path': str(kradar), 'clouds': ['radar'], 'options': seen})}")
        opened = partial(open_dataset, kradar, **seen)
    assert main(words_of_train(experiment, tmp_path / "whole", *words)) == 0
    log = tmp_path / "cut" / "tiny" / "log.jsonl"
    cut = train(experiment, tmp_path / "cut", *words)
    until = time.monotonic() + 300
    while not (log.exists() and len(log.read_text().splitlines()) >= 4):  # six samples an epoch: inside the second one
        assert time.monotonic() < until
        assert cut.poll() is None
        time.sleep(0.01)
    cut.send_signal(signal.SIGKILL)
    cut.wait(30)
    reached = load_checkpoint(tmp_path / "cut" / "tiny" / "checkpoint.pt")["step"]
    assert 0 < reached < 12
    assert main(words_of_train(experiment, tmp_path / "cut", *words)) == 0
    one, other = (
        load_weights(tmp_path / run / "tiny" / "weights.safetensors")[0].state_dict() for run in ("whole", "cut")
    )
    assert all(torch.equal(one[name], other[name]) for name in one)
    raw = [load_checkpoint(tmp_path / run / "tiny" / "checkpoint.pt") for run in ("whole", "cut")]
    modules = [name for name in raw[0] if name.startswith("modules/detector/")]
    assert len(modules) == len(one)
    assert all(torch.equal(raw[0][name], raw[1][name]) for name in modules)
    provenance = load_weights(tmp_path / "cut" / "tiny" / "weights.safetensors")[1]
    assert provenance["data_fingerprint"] == opened().fingerprint()
    assert provenance["experiment"]["training"]["seed"] == 0
    assert torch.__version__.startswith(provenance["environment"]["versions"]["torch"].split("+")[0])


def samples(data, **changes) -> TrainingSamples:
    settings = {
        "inputs": {"points": CloudInput()},
        "clouds": ("gaussian", "uniform"),
        "classes": ("vehicle", "large_vehicle"),
        "assigner": lambda boxes, inputs: boxes,
        "augmentation": AugmentationConfig(pasted={"vehicle": 3}),
        "seed": 4,
    }
    return TrainingSamples(open_dataset(data), **{**settings, **changes})


def test_samples_are_a_function_of_seed_and_position(data):
    first, second = samples(data), samples(data)
    assert first.epoch_length == 6
    for position in (0, 5, 6, 17):
        a, b = first[position], second[position]
        assert torch.equal(a.inputs["points"], b.inputs["points"])
        np.testing.assert_array_equal(a.targets.centre_m, b.targets.centre_m)
    assert not torch.equal(first[0].inputs["points"], samples(data, seed=5)[0].inputs["points"])


def test_bank_depends_on_the_position_alone(data):
    """Whatever was asked for before, and in whatever process: the bank rolls on, and each frame passes through it."""
    settings = {"augmentation": AugmentationConfig(pasted={"vehicle": 3}, bank_frames=2)}
    used, fresh = samples(data, **settings), pickle.loads(pickle.dumps(samples(data, assigner=len, **settings)))
    read = []
    used._bank.cut = lambda number: read.append(number) or samples(data, **settings)._cut_out(number)
    for position in (0, SAMPLES_PER_FRAME - 1):
        used._bank.at(position)
    assert len(read) == 2
    for position in range(0, 5 * SAMPLES_PER_FRAME, SAMPLES_PER_FRAME):
        used._bank.at(position)
    assert sorted(read) == list(range(6))  # one frame more a time, none read twice while it stays
    for position in (5 * SAMPLES_PER_FRAME, 3):
        one, other = used._bank.at(position).objects, fresh._bank.at(position).objects
        assert one.keys() == other.keys()
        for name in one:
            assert [len(points) for points, _ in one[name]] == [len(points) for points, _ in other[name]]


def test_starting_reads_few_frames(data):
    made = samples(data, augmentation=AugmentationConfig(pasted={"vehicle": 3}, bank_frames=2))
    read = []
    made.prepare(7, lambda numbers: read.extend(numbers) or numbers)
    assert len(read) == 2


def test_every_sample_comes_once_an_epoch(data):
    made = samples(data, augmentation=AugmentationConfig(flip_probability=0, rotation_rad=0, scale=0))
    once = sorted(len(made[position].inputs["points"]) for position in range(6))
    again = sorted(len(made[position].inputs["points"]) for position in range(6, 12))
    assert once == again == sorted(len(made.load(number)[0]) for number in range(6))


def test_aliases_and_min_points_choose_the_boxes(data):
    merged = samples(data, aliases={"large_vehicle": "vehicle"}, classes=("vehicle",))
    assert set(merged.load(0)[1].label) <= {"vehicle"}
    few, many = samples(data, min_points=1).load(0), samples(data, min_points=30).load(0)
    assert len(many[1]) < len(few[1])
    assert (count_points_in_boxes(few[0][:, :3], few[1], margin_m=0.05) >= 1).all()


def test_augmentation_keeps_points_in_their_boxes(data, rng):
    points, boxes = samples(data).load(0)
    inside = count_points_in_boxes(points[:, :3], boxes, margin_m=0.01)
    for _ in range(10):
        moved, turned = augment(
            points, boxes, AugmentationConfig(flip_probability=0.5, rotation_rad=1.0, scale=0.1), rng
        )
        np.testing.assert_allclose(count_points_in_boxes(moved[:, :3], turned, margin_m=0.01), inside, atol=2)
        assert len(moved) == len(points)


def test_learning_rate_rises_and_falls():
    config = TrainingConfig(steps=100, learning_rate=1.0, warmup=0.3)
    rates = [one_cycle(step, config) for step in range(100)]
    assert rates[0] == pytest.approx(0.1)
    assert max(rates) == rates[30] == pytest.approx(1.0)
    assert rates[-1] < 0.01
    assert all(a < b for a, b in itertools.pairwise(rates[:31]))
    assert all(a > b for a, b in itertools.pairwise(rates[30:]))


def test_experiment_round_trips_and_refuses_unknown_keys(experiment, tmp_path):
    read = load_experiment(experiment, ["training.steps=7", "detector.grid.range_m=100"])
    assert (read.training.steps, read.detector.grid.range_m) == (7, 100.0)
    (tmp_path / "again.yaml").write_text(dump_experiment(read))
    assert load_experiment(tmp_path / "again.yaml") == read
    with pytest.raises(ConfigError, match=r"training\.step: there is no such key"):
        load_experiment(experiment, ["training.step=7"])
    with pytest.raises(ConfigError, match=r"key\.key=value"):
        load_experiment(experiment, ["nonsense"])
    with pytest.raises(ConfigError, match="found nothing"):
        load_experiment(tmp_path / "absent.yaml")


def test_trained_sweeps_are_those_of_prediction(experiment, data, tmp_path):
    """The weights tell how many sweeps they were trained on; prediction stacks as many."""
    from farfield.api import load_detector
    from farfield.detectors.info import describe
    from farfield.evaluation import as_trained
    from farfield.experiments.plan import Plan

    settings = ["training.steps=1", "data.sweeps=3", "detector.use_lag=true"]
    Plan(load_experiment(experiment, settings), tmp_path / "run").run()
    detector, opened = load_detector(tmp_path / "run"), open_dataset(data)
    stacked = as_trained(opened, describe(detector))
    assert len(stacked[2].cloud("gaussian")) > 2 * len(opened[2].cloud("gaussian"))
    assert as_trained(stacked, describe(detector)) is stacked
    assert as_trained(stacked.select([1]), describe(detector))[0].cloud("gaussian").extra["lag_s"].max() > 0
    assert as_trained(opened, describe(lambda frame: Boxes.empty())) is opened


def test_run_of_another_experiment_is_not_continued(experiment, tmp_path):
    from farfield.experiments.plan import Plan

    Plan(load_experiment(experiment, ["training.steps=1"]), tmp_path / "run").run()
    assert json.loads((tmp_path / "run" / "log.jsonl").read_text().splitlines()[-1])["step"] == 1
    kept = (tmp_path / "run" / "experiment.yaml").read_bytes()
    other = ["training.steps=2", "training.learning_rate=0.1", "augmentation.scale=0"]
    said = (
        r"another experiment: augmentation.scale was 0.05, is 0.0; training.learning_rate was 0.003, is 0.1\. .*-o name"
    )
    with pytest.raises(ConfigError, match=said):
        Plan(load_experiment(experiment, other), tmp_path / "run").run()
    assert (tmp_path / "run" / "experiment.yaml").read_bytes() == kept, "a refused run leaves the other's files alone"


@pytest.mark.parametrize("content", [b"", b"not a checkpoint", b"\x80\x04\x95\x00."])
def test_damaged_checkpoints_are_refused(tmp_path, content):
    (tmp_path / "checkpoint.pt").write_bytes(content)
    with pytest.raises(FileFormatError, match="checkpoint"):
        load_checkpoint(tmp_path / "checkpoint.pt")


@pytest.mark.parametrize("path", [entry.path for entry in shipped()], ids=lambda p: p.stem)
def test_shipped_experiments_are_valid(path):
    from farfield.detectors import build_detector

    network = build_detector(load_experiment(path).detector, seed=0)
    assert network.config.reach_m >= (69 if "kitti" in path.stem else 72 if "kradar" in path.stem else 250)


def test_tensorboard_log_is_written_when_asked_for(experiment, tmp_path):
    pytest.importorskip("tensorboard")
    from farfield.experiments.plan import Plan

    Plan(load_experiment(experiment, ["training.steps=1", "training.tensorboard=true"]), tmp_path / "run").run()
    (events,) = (tmp_path / "run").glob("events.out.tfevents.*")
    assert events.stat().st_size > 0


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_both_precisions_take_a_step(experiment, tmp_path, precision):
    from farfield.experiments.plan import Plan

    settings = load_experiment(experiment, ["training.steps=1", f"training.precision={precision}"])
    weights = Plan(settings, tmp_path / "run").run()
    assert json.loads((tmp_path / "run" / "log.jsonl").read_text())["loss"] > 0
    said = load_weights(weights)[1]
    assert said["precision"] == precision
    assert said["device"] == name_of(chosen_device())


def test_frames_with_far_boxes_come_more_often(data):
    plain, opened = AugmentationConfig(), open_dataset(data)
    range_m = [np.hypot(*frame.boxes[np.isin(frame.boxes.label, ["vehicle"])].centre_m[:, :2].T) for frame in opened]
    edge = float(np.sort(np.concatenate(range_m))[-5])
    far = np.array([(values >= edge).sum() for values in range_m])
    assert far.sum() == 5
    changes = {"augmentation": plain, "classes": ("vehicle",), "far_from_m": edge}
    made = samples(data, far_sampling=1.0, **changes)
    drawn = np.bincount(np.concatenate([made._order(epoch) for epoch in range(400)]) // 2, minlength=3)
    weight = 1 + far / far.mean()
    np.testing.assert_allclose(drawn / drawn.sum(), weight / weight.sum(), atol=0.02)
    again = pickle.loads(pickle.dumps(samples(data, far_sampling=1.0, assigner=len, **changes)))
    np.testing.assert_array_equal(again._order(3), made._order(3))
    read = []
    made = samples(data, far_sampling=1.0, **changes)
    made.prepare(0, lambda numbers: read.extend(numbers) or numbers)
    assert read == [0, 1, 2]  # the annotation of each frame, before the first step
    assert made._order(3).tolist() == again._order(3).tolist()


def test_min_points_counts_the_present_sweep_only(data):
    """A box that only earlier sweeps filled is not asked for, nor cut out to be pasted."""
    place = np.array([[20.0, 0.0, 0.0]])
    car = Boxes(centre_m=place, size_m=np.array([[4.0, 2.0, 2.0]]), yaw_rad=np.zeros(1), label="vehicle")
    rows = np.array([[20, 0, 0, 0, 0], [20, 0, 0, 0.1, 1], [20, 0, 0, 0.1, 1]], dtype=np.float32)
    assert len(cut_out(rows, car, min_points=1)) == 1
    assert len(cut_out(rows, car, min_points=2)) == 0
    one, two = samples(data, min_points=3), samples(data, min_points=3)
    two.data = two.data.mapped(Sweeps(3))
    assert [len(two.load(number)[1]) for number in range(6)] == [len(one.load(number)[1]) for number in range(6)]
    assert len(two.load(5)[0]) > 2 * len(one.load(5)[0])


def test_far_boxes_weigh_more_in_the_loss():
    from farfield.detectors.anchors.grid import cirrus_anchors
    from farfield.detectors.pointpillars.network import PointPillars, PointPillarsConfig

    grid = {"range_m": 200.0, "half_width_m": 16.0, "cell_m": 0.5}
    settings = {"grid": grid, "widths": [8, 8, 8], "neck_width": 8, "anchors": {"vehicle": cirrus_anchors()["vehicle"]}}
    plain, weighted = (
        PointPillars(PointPillarsConfig.model_validate({**settings, "far_weight": value})) for value in (0.0, 2.0)
    )
    weighted.load_state_dict(plain.state_dict())
    near, far = (
        Boxes(
            centre_m=np.array([[x, 0.0, -1.0]]),
            size_m=np.array([[length, 1.9, 1.6]]),
            yaw_rad=np.array([0.1]),
            label="vehicle",
        )
        for x, length in ((20.0, 4.5), (150.0, 18.0))
    )
    none = {"points": np.zeros((0, 3), np.float32)}
    assert set(plain.assigner(far, none).weight) == {1.0}
    np.testing.assert_allclose(weighted.assigner(near, none).weight, 1 + 2 * 0.2)
    np.testing.assert_allclose(weighted.assigner(far, none).weight, 1 + 2 * 1.5)
    both = Boxes.concatenate([near, far])
    maps = plain.eval()({"points": [torch.zeros(0, 3)]})
    parts = {
        name: [float(network.losses(maps, [network.assigner(b, none)])["box"].detach()) for b in (near, far, both)]
        for name, network in (("plain", plain), ("weighted", weighted))
    }
    count = [len(plain.assigner(boxes, none).positive) for boxes in (near, far)]
    shares = np.array(count) * [1.4, 4.0]
    expected = (parts["plain"][0] * shares[0] + parts["plain"][1] * shares[1]) / shares.sum()
    assert parts["weighted"][2] == pytest.approx(expected, rel=1e-5)
    assert parts["weighted"][2] != pytest.approx(parts["plain"][2], rel=1e-3)


def test_pasted_objects_keep_their_velocities() -> None:
    car = Boxes(centre_m=np.array([[20.0, 0, 0]]), size_m=np.array([[4.0, 2, 2]]), yaw_rad=np.zeros(1), label="car")
    bank = ObjectBank()
    points = np.array([[20, 0, 0, 0, 0]] * 6, dtype=np.float32)
    bank.add(cut_out(points, car.replace(velocity_m_s=np.array([[5.0, 1.0, 0.0]])), min_points=5))
    away = car.replace(centre_m=np.array([[20.0, 9, 0]]))
    for there, expected in ((away, [np.nan] * 3), (away.replace(velocity_m_s=np.ones((1, 3))), [1.0] * 3)):
        _, boxes = bank.paste(points[:0], there, {"car": 1}, np.random.default_rng(0))
        np.testing.assert_array_equal(boxes.velocity_m_s, [expected, [5.0, 1.0, 0.0]])
