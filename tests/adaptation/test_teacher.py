"""The mean teacher: pseudo boxes and what is ignored, views, averages, controls, errors."""

import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from small import batch_of, small_detector

from farfield.adaptation.pseudo_labels import PseudoLabels, StrongAugmentation, split_by_score, strong_view, targets_of
from farfield.adaptation.teacher import MeanTeacher, TeacherSettings
from farfield.detectors.weights import load_weights
from farfield.errors import ConfigError, FarfieldError
from farfield.frame import Boxes
from farfield.training.checkpoints import load_checkpoint
from farfield.training.method import METHODS, Batch, Method, Stream

TWO = {"source": {"clouds": ["gaussian"]}, "target": {"clouds": ["uniform"]}}
EAGER = {"score_threshold": 0.0, "max_boxes": 20}  # a network that has learnt nothing finds something
CANDIDATES = {"pointpillars": {"candidates": 20}, "sparsecentre": {"candidates": 20}}


@pytest.fixture
def start(planned: Any) -> Any:
    """Train weights to start from, of a detector by name."""
    return partial(first_weights, planned)


def first_weights(planned: Any, detector: str = "pointpillars") -> str:
    changes = EAGER | CANDIDATES[detector]
    plan = planned(f"start-{detector}", {"name": "supervised"}, detector, None, steps=2, changes=changes)
    return str(plan.run())


def run(planned: Any, folder: str, method: dict[str, Any], detector: str = "pointpillars", **training: Any) -> Path:
    changes = EAGER | CANDIDATES[detector]
    plan = planned(folder, {"name": "teacher", **method}, detector, TWO, changes=changes, **training)
    plan.run()
    return plan.folder


def method_of(start: str, **changes: Any) -> dict[str, Any]:
    return {"start": start, "positive": 0.0105, "negative": 0.0, **changes}


@pytest.mark.parametrize("detector", ["pointpillars", "sparsecentre"])
@pytest.mark.parametrize("norm", ["shared", "per_domain"])
def test_a_student_learns_what_its_teacher_finds(planned: Any, start: Any, detector: str, norm: str) -> None:
    weights = start(detector)
    folder = run(planned, "run", method_of(weights, norm=norm), detector)
    rows = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    assert rows[0]["pseudo_boxes"] + rows[0]["ignored_boxes"] > 0
    assert {name.split("_")[0] for name in rows[0]} >= {"source", "target", "pseudo"}
    state = load_checkpoint(folder / "checkpoint.pt")
    before = load_weights(Path(weights))[0].state_dict()
    drift = {}
    for module in ("detector", "teacher"):
        pairs = [(state[f"modules/{module}/{name}"], value) for name, value in before.items() if "head" in name]
        drift[module] = sum(float((a - b).abs().sum()) for a, b in pairs if a.is_floating_point())
    assert 0 < drift["teacher"] < 0.02 * drift["detector"]  # three steps at 0.999
    network, _ = load_weights(folder / "weights.safetensors")
    assert network.state_dict().keys() == before.keys()


def test_the_teacher_is_the_students_average() -> None:
    network = small_detector("pointpillars", score_threshold=0.0)
    method = object.__new__(MeanTeacher)
    method.settings = TeacherSettings(start="x", decay=0.9)
    teacher = small_detector("pointpillars", seed=5)
    method.modules = torch.nn.ModuleDict({"detector": network, "teacher": teacher})
    name = "backbone.blocks.0.0.0.weight"
    one, other = network.get_parameter(name).detach().clone(), teacher.get_parameter(name).detach().clone()
    method.after_step(0)
    torch.testing.assert_close(teacher.get_parameter(name).detach(), 0.9 * other + 0.1 * one)
    assert torch.equal(network.get_parameter(name), one)


class OnMixture(Method):
    """Labels of the source alone, statistics of both: what a weight of 0 must equal."""

    streams: Mapping[str, Stream] = MeanTeacher.streams  # type: ignore[misc]

    def __init__(self, network: Any, start: str) -> None:
        network.load_state_dict(load_weights(Path(start))[0].state_dict())
        self.modules = torch.nn.ModuleDict({"detector": network})
        self.settings, self.seed = StrongAugmentation(), 0

    def losses(self, batch: Mapping[str, Batch], step: int) -> dict[str, Any]:
        rng = MeanTeacher.generator(self, step)  # type: ignore[arg-type]
        target = batch["target"].inputs
        changes = [self.settings.draw(rng) for _ in range(len(target))]
        view = strong_view(target, changes, self.settings.thinning, rng)
        network, frames = self.modules["detector"], batch["source"]
        source, _ = network.encode(frames.inputs + view).split(len(frames))
        return network.losses(network.head(source, frames.targets), frames.targets)


def test_a_weight_of_zero_is_plain_training_on_the_mixture_to_the_bit(planned: Any, start: Any) -> None:
    weights = start()
    METHODS.register("mixture")(OnMixture)
    try:
        changes = EAGER | CANDIDATES["pointpillars"]
        plan = planned("plain", {"name": "mixture", "start": weights}, "pointpillars", TWO, changes=changes)
        plan.run()
    finally:
        METHODS._registered.pop("mixture")
    off = run(planned, "off", method_of(weights, weight=0))
    on = run(planned, "on", method_of(weights))
    plain, off_state, on_state = (load_checkpoint(each / "checkpoint.pt") for each in (plan.folder, off, on))
    names = [name for name in plain if name.startswith("modules/")]
    assert all(torch.equal(plain[name], off_state[name]) for name in names)
    assert not all(torch.equal(plain[name], on_state[name]) for name in names)


def test_a_resumed_run_repeats_to_the_bit(planned: Any, start: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    method = method_of(start(), norm="per_domain")
    whole = run(planned, "whole", method)
    follow = MeanTeacher.after_step
    with monkeypatch.context() as patch:
        patch.setattr(MeanTeacher, "after_step", lambda self, step: _stop(step) or follow(self, step))
        patch.setattr("farfield.training.loop.time.monotonic", iter(range(0, 10**6, 1000)).__next__)  # save each step
        with pytest.raises(KeyboardInterrupt):
            run(planned, "cut", method)
    cut = run(planned, "cut", method)
    one, other = (load_checkpoint(folder / "checkpoint.pt") for folder in (whole, cut))
    names = [name for name in one if name.startswith("modules/")]
    assert "modules/counts/empty" in names
    assert all(torch.equal(one[name], other[name]) for name in names)


def _stop(step: int) -> None:
    if step == 2:
        raise KeyboardInterrupt


def test_a_teacher_that_finds_nothing_is_an_error(planned: Any, start: Any) -> None:
    with pytest.raises(FarfieldError, match=r"in 2 steps the teacher found no box with a score of 1 or more"):
        run(planned, "run", method_of(start(), positive=1.0, patience=2))


def test_what_a_teacher_needs() -> None:
    network = small_detector("pointpillars")
    for settings, message in (
        ({}, "start: missing"),
        ({"start": "x", "negative": 0.7}, r"expected negative up to positive \(0.6\)"),
        ({"start": "x", "negative": 0.01}, r"score_threshold up to negative \(0.01\).*got 0.05"),
        ({"start": "nowhere"}, "Expected a bundled detector"),
    ):
        with pytest.raises(FarfieldError, match=message):
            MeanTeacher(network, **settings)


def boxes_at(*x: float, score: tuple[float, ...] | None = None) -> Boxes:
    n = len(x)
    return Boxes(
        centre_m=np.column_stack([x, np.zeros(n), np.full(n, -1.0)]),
        size_m=np.tile([4.2, 2.0, 1.6], (n, 1)),
        yaw_rad=np.zeros(n),
        label="vehicle",
        score=None if score is None else np.array(score),
    )


def test_middling_boxes_are_ignored() -> None:
    found = split_by_score(boxes_at(10, 20, 30, 40, score=(0.9, 0.6, 0.25, 0.2)), 0.6, 0.25)
    assert found.confident.centre_m[:, 0].tolist() == [10, 20]
    assert found.ignored.centre_m[:, 0].tolist() == [30]
    assert found.confident.score is None


@pytest.mark.parametrize("detector", ["pointpillars", "second", "voxelnet", "sparsecentre", "rtn", "rtnh"])
def test_no_loss_pulls_at_what_is_ignored(detector: str) -> None:
    """With an object there the network's loss has a gradient for its box; with background one against it."""
    network = small_detector(detector)
    name = next(iter(network.inputs))
    columns = len(network.inputs[name].columns)
    cloud = torch.rand(4000, columns) * torch.tensor([60.0, 30.0, 3.0] + [1.0] * (columns - 3))
    cloud[:, 1:3] -= torch.tensor([15.0, 2.5])
    cloud[:400, :3] = torch.rand(400, 3) * torch.tensor([4.0, 2.0, 1.5]) + torch.tensor([28.0, -1.0, -1.8])
    clouds, none = {name: cloud}, boxes_at()
    with torch.no_grad():
        outputs = network(batch_of(cloud))
    background = targets_of(network.assigner, PseudoLabels(none, none), clouds)
    unsure = targets_of(network.assigner, PseudoLabels(none, boxes_at(30.0)), clouds)
    sure = targets_of(network.assigner, PseudoLabels(boxes_at(30.0), none), clouds)
    plain, ignored, object_ = (
        {part: float(value) for part, value in network.losses(outputs, [targets]).items()}
        for targets in (background, unsure, sure)
    )
    classified = next(part for part in plain if part in ("classification", "heat"))
    assert ignored[classified] < plain[classified]
    assert all(ignored[part] == 0 for part in ("box", "direction", "vote") if part in ignored)
    assert object_["box"] > 0


def test_the_strong_view_moves_points_and_boxes_alike() -> None:
    boxes, rng = boxes_at(10.0, 30.0), np.random.default_rng(4)
    strong = StrongAugmentation(flip_probability=1.0, rotation_rad=1.0, scale=0.1, height_m=0.3, thinning=0.0)
    change = strong.draw(rng)
    cloud = torch.from_numpy(np.column_stack([boxes.centre_m, np.ones(2)])).float()
    view = strong_view(batch_of(cloud), [change], 0.0, rng)["points"][0]
    moved = PseudoLabels(boxes, boxes[:1]).moved(change)
    np.testing.assert_allclose(view[:, :3].numpy(), moved.confident.centre_m, atol=1e-5)
    assert view[:, 3].tolist() == [1.0, 1.0]
    with torch.autocast("cpu", torch.bfloat16):
        again = strong_view(batch_of(cloud), [change], 0.0, rng)["points"][0]
    assert torch.equal(again, view)
    assert torch.equal(cloud[:, :3], torch.tensor(boxes.centre_m).float())  # the teacher's stays
    thinned = strong_view(batch_of(torch.ones(1000, 3)), [change], 0.9, np.random.default_rng(0))["points"][0]
    assert 100 < len(thinned) < 1000


def test_pointrcnn_has_nothing_that_is_ignored() -> None:
    network = small_detector("pointrcnn")
    cloud = torch.rand(100, len(network.inputs["points"].columns))
    with pytest.raises(ConfigError, match="targets that can ignore boxes"):
        targets_of(network.assigner, PseudoLabels(boxes_at(), boxes_at()), {"points": cloud})
