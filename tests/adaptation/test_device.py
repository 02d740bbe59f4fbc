"""Adaptation between devices: heads and statistics of their own, label shares, exported weights, controls."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from small import batch_of, small_detector

from farfield.adaptation.device import DeviceAdaptation
from farfield.adaptation.networks import with_own_head, with_own_statistics
from farfield.datasets import open_dataset
from farfield.detectors.runtime import Detector
from farfield.detectors.weights import load_weights
from farfield.errors import ConfigError, DatasetError
from farfield.experiments.frames import part_of
from farfield.training.checkpoints import load_checkpoint
from farfield.training.method import METHODS, Batch, Method, Stream

TWO = {"source": {"clouds": ["gaussian"]}, "target": {"clouds": ["uniform"]}}
THREE = {**TWO, "rest": {"clouds": ["uniform"]}}


@pytest.mark.parametrize("detector", ["pointpillars", "sparsecentre", "second", "voxelnet"])
@pytest.mark.parametrize("norm", ["shared", "per_domain"])
def test_each_domain_gets_a_detector_of_its_own(planned: Any, detector: str, norm: str) -> None:
    plan = planned("run", {"name": "device", "norm": norm, "rest": True}, detector, THREE, batch_size=3, steps=2)
    plan.run()
    target, _ = load_weights(plan.folder / "weights.safetensors")
    source, _ = load_weights(plan.folder / "weights_source.safetensors")
    own, theirs = target.state_dict(), source.state_dict()
    assert own.keys() == theirs.keys() == small_detector(detector).state_dict().keys()
    differing = {name for name in own if not torch.equal(own[name], theirs[name])}
    heads = {name for name in differing if name.startswith("head.")}
    assert heads
    trunk = differing - heads
    if norm == "shared":
        assert not trunk
    else:
        assert trunk
        assert all(name.endswith(("running_mean", "running_var")) for name in trunk)
    clouds = [
        Detector.load(plan.folder / f"{name}.safetensors").learnt_clouds for name in ("weights", "weights_source")
    ]
    assert clouds == [("uniform",), ("gaussian",)]
    rows = [json.loads(line) for line in (plan.folder / "log.jsonl").read_text().splitlines()]
    assert rows[0]["device"] == pytest.approx(np.log(2), abs=0.1)
    assert {"rank_source", "rank_target", "discriminator_accuracy", "lambda"} <= set(rows[-1])
    assert any(name.startswith("source_") for name in rows[-1])


class Both(Method):
    """Two heads on one trunk, without a discriminator: what lambda = 0 must equal."""

    streams: Mapping[str, Stream] = {"source": Stream(), "target": Stream()}  # type: ignore[misc]

    def __init__(self, network: Any) -> None:
        self.modules = torch.nn.ModuleDict({"detector": network, "source": with_own_head(network)})

    def losses(self, batch: Mapping[str, Batch], step: int) -> dict[str, Any]:
        source, target = batch["source"], batch["target"]
        parts = self.modules["detector"].encode(source.inputs + target.inputs).split(len(source))
        found = {}
        for name, module, features, frames in (
            ("target", "detector", parts[1], target),
            ("source", "source", parts[0], source),
        ):
            network = self.modules[module]
            losses = network.losses(network.head(features, frames.targets), frames.targets)
            found |= {f"{name}_{part}": value for part, value in losses.items()}
        return found


def test_lambda_of_zero_is_training_on_both_to_the_bit(planned: Any) -> None:
    METHODS.register("both")(Both)
    try:
        planned("plain", {"name": "both"}, "pointpillars", TWO).run()
    finally:
        METHODS._registered.pop("both")
    planned("off", {"name": "device", "adversarial": {"lambda_max": 0}}, "pointpillars", TWO).run()
    planned("on", {"name": "device"}, "pointpillars", TWO).run()
    root = planned("x", {}).folder.parent
    plain, off, on = (load_checkpoint(root / name / "checkpoint.pt") for name in ("plain", "off", "on"))
    names = [name for name in plain if name.startswith("modules/")]
    assert all(torch.equal(plain[name], off[name]) for name in names)
    assert not all(torch.equal(plain[name], on[name]) for name in names)


@pytest.mark.parametrize("norm", ["shared", "per_domain"])
def test_a_resumed_run_repeats_to_the_bit(planned: Any, norm: str, monkeypatch: pytest.MonkeyPatch) -> None:
    method = {"name": "device", "norm": norm}
    whole, cut = (planned(name, method, "pointpillars", TWO) for name in ("whole", "cut"))
    whole.run()
    with monkeypatch.context() as patch:
        patch.setattr(DeviceAdaptation, "after_step", _stop_after_two)
        patch.setattr("farfield.training.loop.time.monotonic", iter(range(0, 10**6, 1000)).__next__)  # save each step
        with pytest.raises(KeyboardInterrupt):
            cut.run()
    cut.run()
    one, other = (load_checkpoint(plan.folder / "checkpoint.pt") for plan in (whole, cut))
    assert all(torch.equal(value, other[name]) for name, value in one.items() if name.startswith("modules/"))
    assert all(torch.equal(value, other["average"][name]) for name, value in one["average"].items())


def _stop_after_two(self: Any, step: int) -> None:
    if step == 2:
        raise KeyboardInterrupt


def test_a_twin_shares_what_it_is_to_share() -> None:
    network = small_detector("sparsecentre")
    head, statistics = with_own_head(network), with_own_statistics(network, own_head=False)
    shared = {id(parameter) for parameter in network.parameters()}
    assert {name for name, p in head.named_parameters() if id(p) not in shared} == {
        name for name, _ in network.named_parameters() if name.startswith("head.")
    }
    assert all(id(parameter) in shared for parameter in statistics.parameters())
    cloud = torch.rand(500, 3) * torch.tensor([60.0, 30.0, 3.0]) - torch.tensor([0.0, 15.0, 2.0])
    before = {name: value.clone() for name, value in network.named_buffers()}
    statistics.encode(batch_of(cloud))
    assert all(torch.equal(before[name], value) for name, value in network.named_buffers())
    head.encode(batch_of(cloud))
    assert not all(torch.equal(before[name], value) for name, value in network.named_buffers())
    with pytest.raises(ConfigError, match="that of pointrcnn is not"):
        DeviceAdaptation(small_detector("pointrcnn"))


class Sequences:
    """The keys of a data set, and what was selected of them."""

    root = "somewhere"

    def __init__(self, keys: list[tuple[str, str]]) -> None:
        self.keys = keys

    def select(self, indices: list[int]) -> "Sequences":
        return Sequences([self.keys[index] for index in indices])


def test_shares_of_labels_are_whole_sequences_and_nested(without_shape_checks: None) -> None:
    data: Any = Sequences([(f"road{number:02d}", str(frame)) for number in range(8) for frame in range(number + 1)])
    parts = {share: set(part_of(data, (0.0, share)).keys) for share in (0.25, 0.5, 1.0)}
    assert parts[0.25] < parts[0.5] < parts[1.0] == set(data.keys)
    assert [len({sequence for sequence, _ in part}) for part in parts.values()] == [2, 4, 8]
    rest = set(part_of(data, (0.25, 1.0)).keys)
    assert not rest & parts[0.25]
    assert rest | parts[0.25] == parts[1.0]
    assert part_of(data, (0.0, 0.5)).keys == [key for key in data.keys if key in parts[0.5]]  # in their order
    others = {frozenset(part_of(data, (0.0, 0.25), draw).keys) for draw in range(6)}
    assert len(others) > 2
    with pytest.raises(DatasetError, match=r"8 sequences in the part 0 to 0\.05"):
        part_of(data, (0.0, 0.05))


def test_a_part_is_that_of_the_experiment(planned: Any, data: Any) -> None:
    with pytest.raises(DatasetError, match=r"1 sequence in the part 0 to 0\.25"):
        planned("run", {"name": "device"}, "pointpillars", {**TWO, "target": {"part": [0, 0.25]}}).run()
    assert len(part_of(open_dataset(data), (0.0, 1.0))) == 3
    with pytest.raises(ValueError, match="two rising shares"):
        planned("run", {"name": "device"}, "pointpillars", {**TWO, "target": {"part": [0.5, 0.25]}})
