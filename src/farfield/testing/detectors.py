"""What every detector must do, whatever its paper and whatever it reads: plain functions that raise AssertionError.

They know a detector by its name and settings alone, so that one of another package goes through them too.
"""

import copy
import pickle
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from torch import Tensor

from farfield.datasets.memory import in_memory
from farfield.detectors import DETECTORS, build_detector
from farfield.detectors.config import DetectorConfig
from farfield.detectors.features import FeatureMap, FeatureRows, PointFeatures
from farfield.detectors.inputs import POSITION, Inputs
from farfield.detectors.network import Network
from farfield.detectors.sparse import SparseTensor
from farfield.detectors.weights import load_weights, save_weights
from farfield.errors import FileFormatError
from farfield.experiments.plan import Plan
from farfield.experiments.schema import Experiment
from farfield.frame import Boxes, Cloud, Frame

LARGEST_ASSIGNER = 1_000_000
"""Bytes: what travels to every loader's worker."""


def built(name: str, settings: Mapping[str, Any], *, seed: int = 3) -> Network:
    """The network of a detector by name."""
    return build_detector(DETECTORS[name].config_class.model_validate({"name": name, **settings}), seed=seed)


def check_network(name: str, settings: Mapping[str, Any]) -> None:
    """Every check of this module, each on a network with the same first weights."""
    for check in CHECKS:
        check(built(name, settings))


def made_frame(network: Network, *, seed: int = 5, objects: int = 4) -> tuple[Inputs, Boxes]:
    """A frame of ground and boxes full of points, in every cloud that a network reads."""
    rng = np.random.default_rng(seed)
    reach_m = min(60.0, network.config.reach_m)
    x = reach_m * (0.15 + 0.7 * np.arange(objects) / max(objects - 1, 1))
    boxes = Boxes(
        centre_m=np.column_stack([x, rng.uniform(-5, 5, objects), np.full(objects, -1.2)]),
        size_m=np.tile([4.4, 1.8, 1.4], (objects, 1)),
        yaw_rad=rng.uniform(-3, 3, objects),
        label=network.config.class_names[0],
    )
    named = {}
    for source, wants in network.inputs.items():
        ground = np.column_stack([rng.uniform(1, reach_m, 2000), rng.uniform(-6, 6, 2000), rng.normal(-2, 0.02, 2000)])
        shells = [centre + rng.uniform(-1, 1, (90, 3)) * [1.5, 0.8, 0.6] for centre in boxes.centre_m]
        xyz = np.concatenate([ground, *shells])
        further = [rng.uniform(0, 1, len(xyz)) * (column != "lag_s") for column in wants.columns[3:]]
        named[source] = [torch.from_numpy(np.column_stack([xyz, *further]).astype(np.float32))]
    return Inputs(named), boxes


def arrays_of(batch: Inputs, frame: int) -> dict[str, np.ndarray]:
    """What an assigner sees of a frame."""
    return {name: tensors[frame].numpy() for name, tensors in batch.items()}


def losses_of(network: Network, batch: Inputs, boxes: list[Boxes]) -> dict[str, Tensor]:
    """The losses of a batch by name."""
    targets = [network.assigner(annotated, arrays_of(batch, index)) for index, annotated in enumerate(boxes)]
    return network.losses(network(batch, targets), targets)


def tensors_of(outputs: Any) -> list[Tensor]:
    """All tensors in whatever a network returns, in a fixed order."""
    if torch.is_tensor(outputs):
        return [outputs]
    if isinstance(outputs, dict):
        return [t for key in sorted(outputs) for t in tensors_of(outputs[key])]
    if isinstance(outputs, tuple | list):
        return [t for part in outputs for t in tensors_of(part)]
    return [t for part in vars(outputs).values() for t in tensors_of(part)] if hasattr(outputs, "__dict__") else []


def check_declared(network: Network) -> None:
    """What a network and its configuration declare is there and of its kind."""
    config = network.config
    assert isinstance(config, DetectorConfig), (
        f"expected settings that derive from farfield.detectors.DetectorConfig, as experiments and weights files want "
        f"them; got {type(config).__name__}"
    )
    names = config.class_names
    named = bool(names) and all(isinstance(name, str) for name in names)
    assert named, (
        f"expected the property class_names of {type(config).__name__} to give the names of the classes; got {names!r}"
    )
    reaches = isinstance(config.reach_m, int | float) and config.reach_m > 0
    assert reaches, f"expected the property reach_m of {type(config).__name__} to give metres; got {config.reach_m!r}"
    assert network.inputs, "expected at least one entry in inputs"
    assert network.channels > 0, "expected the number of features of a row in channels"
    assert callable(network.assigner), "expected an assigner: assigner(boxes, inputs) -> targets"
    for name in network.low_precision:
        network.get_submodule(name)
    assert callable(network.head), "expected a submodule or a method head(features, targets=None)"


def check_gradients(network: Network) -> None:
    """Outputs and losses are finite, and every parameter gets a gradient."""
    network.train()
    batch, boxes = made_frame(network)
    outputs = tensors_of(network(batch))
    assert outputs, "expected tensors in the outputs"
    assert all(torch.isfinite(part).all() for part in outputs), "expected finite outputs"
    losses = losses_of(network, batch, [boxes])
    assert isinstance(losses, dict), "expected losses by name"
    assert all(value.ndim == 0 and torch.isfinite(value) for value in losses.values()), "expected finite scalars"
    network.zero_grad()
    torch.stack([*losses.values()]).sum().backward()
    without = [key for key, p in network.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
    assert not without, f"expected a gradient for every parameter; none for {', '.join(without)}"


def check_assigner_is_small(network: Network) -> bytes:
    """The assigner pickles, and holds no network."""
    sent = pickle.dumps(network.assigner)
    assert len(sent) < LARGEST_ASSIGNER, f"expected an assigner below 1 MB pickled, got {len(sent)} bytes"
    assert b"torch" not in sent, "expected an assigner that knows no module and no tensor"
    return sent


def check_assigner(network: Network) -> None:
    """The assigner travels without the network, is small, and gives the same targets there."""
    sent = check_assigner_is_small(network)
    batch, boxes = made_frame(network)
    inputs = arrays_of(batch, 0)
    one, other = network.assigner(boxes, inputs), pickle.loads(sent)(boxes, inputs)
    assert pickle.dumps(one) == pickle.dumps(other), "expected the same targets from an assigner that travelled"
    assert pickle.dumps(one) == pickle.dumps(network.assigner(boxes, inputs)), "expected the same targets again"


def check_rows(network: Network) -> None:
    """Rows have the declared width, the frame that they belong to, and a place within reach."""
    network.eval()
    first, second = (made_frame(network, seed=seed)[0] for seed in (5, 6))
    with torch.no_grad():
        features = network.encode(first + second)
    assert isinstance(features, FeatureMap | PointFeatures), "expected a FeatureMap or PointFeatures from encode"
    assert len(features) == 2, "expected as many frames as went in"
    rows = features.rows()
    count = len(rows.values)
    assert rows.values.shape == (count, network.channels), "expected rows (n, channels)"
    assert rows.frame.shape == (count,), "expected the frame of each row"
    assert rows.place_m.shape == (count, 2), "expected the place of each row"
    assert set(rows.frame.tolist()) == {0, 1}, "expected rows of both frames"
    assert torch.equal(rows.frame, rows.frame.sort().values), "expected rows frame after frame"
    few = features.rows(limit=64, generator=torch.Generator().manual_seed(1))
    again = features.rows(limit=64, generator=torch.Generator().manual_seed(1))
    assert len(few.values) == min(64, count), "expected at most so many rows"
    assert all(torch.equal(a, b) for a, b in zip(few, again, strict=True)), "expected the same rows for one seed"
    index = {(f, *place_m): number for number, (f, place_m) in enumerate(_places(rows))}
    numbers = [index[frame, *place_m] for frame, place_m in _places(few)]
    assert torch.equal(rows.values[numbers], few.values), "expected chosen rows to be among all rows"
    even = features.rows(limit=64)
    assert len(even.values) == min(64, count), "expected rows without a generator too"


def _places(rows: FeatureRows) -> list[tuple[int, list[float]]]:
    return list(zip(rows.frame.tolist(), rows.place_m.tolist(), strict=True))


def check_place(network: Network) -> None:
    """Features change where a point is added, and the rows say that place."""
    network.eval()
    batch, _ = made_frame(network)
    spot = torch.tensor([min(60.0, network.config.reach_m) / 2, 3.0])
    added = Inputs({name: [torch.cat([c, _pillar(c, spot)]) for c in clouds] for name, clouds in batch.items()})
    with torch.no_grad():
        before, after = network.encode(batch), network.encode(added)
    if isinstance(before, PointFeatures) or isinstance(before.values, SparseTensor):
        old = {tuple(place_m) for place_m in before.rows().place_m.tolist()}
        new = torch.tensor([place_m for place_m in after.rows().place_m.tolist() if tuple(place_m) not in old])
        if not len(new):  # every place was occupied before
            return
        nearest = (new - spot).norm(dim=1).min()
    else:
        change = (after.rows().values - before.rows().values).abs().sum(1)
        nearest = (before.rows().place_m[change.argmax()] - spot).norm()
    assert float(nearest) < 12.0, f"expected the change near {spot.tolist()}; it is {float(nearest):.1f} m away"


def _pillar(cloud: Tensor, spot: Tensor) -> Tensor:
    points = cloud.new_full((40, cloud.shape[1]), 0.5)
    points[:, :2], points[:, 2] = spot, torch.linspace(-1.9, 0.5, 40)
    return points


def check_joined(network: Network) -> None:
    """Frames of two batches in one forward give what each gives alone; split parts them again."""
    network.eval()
    first, second = (made_frame(network, seed=seed, objects=objects)[0] for seed, objects in ((5, 4), (6, 2)))
    with torch.no_grad():
        parts = network.encode(first + second + first).split(1)
        alone = [network.encode(first), network.encode(second + first)]
        pairs: list[tuple[Any, Any]] = [*zip(parts, alone, strict=True)]
        for part, own in pairs:
            assert len(part) == len(own), "expected split(n) to give n frames and the rest"
            _same(part.rows(), own.rows())
            _same(network.head(part), network.head(own))
            assert set(part.aux) == set(own.aux), "expected what the head needs on both sides"


def _same(one: Any, other: Any) -> None:
    for a, b in zip(tensors_of(one), tensors_of(other), strict=True):
        assert a.shape == b.shape, f"expected the shape of a forward alone, {tuple(b.shape)}; got {tuple(a.shape)}"
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4)


def check_copies(network: Network) -> None:
    """A copy gives the same boxes: nothing hangs on the object itself."""
    network.eval()
    batch, _ = made_frame(network)
    one, other = network.predict(batch)[0], copy.deepcopy(network).predict(batch)[0]
    np.testing.assert_array_equal(one.centre_m, other.centre_m)


def check_empty(network: Network) -> None:
    """A frame without points, alone or beside another, gives boxes or none, and finite losses."""
    batch, boxes = made_frame(network)
    nothing = Inputs({name: [cloud[:0] for cloud in clouds] for name, clouds in batch.items()})
    network.eval()
    for inputs in (nothing, nothing + batch, batch + nothing):
        boxes_of_frames = network.predict(inputs)
        assert len(boxes_of_frames) == len(inputs), (
            f"expected boxes of {len(inputs)} frames, got those of {len(boxes_of_frames)}"
        )
    network.train()
    for inputs, annotated in ((nothing, [Boxes.empty()]), (nothing, [boxes]), (batch + nothing, [boxes, boxes])):
        losses = losses_of(network, inputs, annotated)
        assert all(torch.isfinite(value) for value in losses.values()), (
            "expected finite losses of frames without points; divide by normaliser(count), which is at least 1"
        )
        assert any(value.requires_grad for value in losses.values()), (
            "expected losses of frames without points that can be differentiated: take them of the outputs"
        )


def check_order(network: Network) -> None:
    """The order of a cloud's points does not matter."""
    network.eval()
    batch, _ = made_frame(network)
    draw = torch.Generator().manual_seed(2)
    turned = Inputs(
        {
            name: [cloud[torch.randperm(len(cloud), generator=draw)] for cloud in clouds]
            for name, clouds in batch.items()
        }
    )
    with torch.no_grad():
        one, other = (_in_order(network.encode(inputs).rows()) for inputs in (batch, turned))
    for a, b in zip(one, other, strict=True):
        assert a.shape == b.shape, "expected as many rows, whatever the order of the points"
        torch.testing.assert_close(
            a, b, rtol=1e-3, atol=1e-3, msg=lambda text: f"features depend on the points' order: {text}"
        )


def _in_order(rows: FeatureRows) -> tuple[Tensor, Tensor]:
    """Places and values of rows, in the order of their places."""
    order = np.lexsort(rows.place_m.numpy().T)
    return rows.place_m[order], rows.values[order]


def check_weights(network: Network) -> None:
    """A weights file gives the network again, in another process too: the same settings, the same boxes."""
    network.eval()
    batch, _ = made_frame(network)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "weights.safetensors"
        save_weights(path, network.state_dict(), config=network.config, provenance={"seed": 3})
        try:
            loaded, provenance = load_weights(path)
        except FileFormatError as error:
            raise AssertionError(
                f"expected a network that its weights file gives again, which is built on the meta device: {error}"
            ) from error
    assert provenance == {"seed": 3}, "expected the provenance from the weights file"
    assert loaded.config == network.config, "expected settings that JSON holds: config.model_dump_json()"
    one, other = network.predict(batch)[0], loaded.predict(batch)[0]
    np.testing.assert_array_equal(
        one.centre_m, other.centre_m, err_msg="boxes of loaded weights: keep what matters in the state dict or config"
    )


def check_training(network: Network) -> None:
    """An experiment trains the detector for two steps, and its weights are read again: what ``farfield train`` does."""
    settings = network.config.model_dump(mode="json")
    frames = [_frame_of(network, seed) for seed in (5, 6)]
    clouds: Any = {name: [name] for name in network.inputs}
    clouds = list(network.inputs) if len(network.inputs) == 1 else clouds
    with TemporaryDirectory() as folder:
        try:
            experiment = Experiment.model_validate(
                {
                    "name": "check",
                    "data": {"path": folder, "clouds": clouds},
                    "detector": settings,
                    "training": {"steps": 2, "batch_size": 2, "workers": 0, "accelerator": "cpu", "precision": "fp32"},
                }
            )
            path = Plan(experiment, Path(folder) / "run", {"labelled": in_memory(frames)}).run()
            loaded, _ = load_weights(path)
        except Exception as error:
            raise AssertionError(
                f"expected an experiment to train the detector; it failed with {type(error).__name__}: {error}"
            ) from error
    assert loaded.config == network.config, "expected the settings of an experiment to be those of its weights"


def _frame_of(network: Network, seed: int) -> Frame:
    """The frame of :func:`made_frame` as data sets give it, each input's cloud by the input's name."""
    batch, boxes = made_frame(network, seed=seed)
    clouds = {}
    for name, source in network.inputs.items():
        columns = dict(zip(source.columns, batch[name][0].numpy().T, strict=True))
        points_m = np.column_stack([columns.pop(axis) for axis in POSITION])
        columns.pop("lag_s", None)
        clouds[name] = Cloud(points_m, columns.pop("intensity", None), columns)
    return Frame.of(clouds=clouds, boxes=boxes, frame_id=str(seed))


CHECKS = (
    check_declared,
    check_gradients,
    check_assigner,
    check_rows,
    check_place,
    check_joined,
    check_copies,
    check_empty,
    check_order,
    check_weights,
    check_training,
)
"""What every network must do; each takes one that was just built."""
