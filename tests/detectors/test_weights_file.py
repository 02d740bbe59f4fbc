"""The weights file: equal bytes for equal weights, and no network on the word of a hostile configuration."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from safetensors import safe_open
from safetensors.torch import save

from farfield.detectors import DETECTORS, build_detector
from farfield.detectors.provenance import provenance_of
from farfield.detectors.runtime import Detector
from farfield.detectors.weights import bundled_weights, load_weights, save_weights
from farfield.errors import ConfigError, FarfieldError, FileFormatError
from farfield.evaluation.evaluating import training_text
from farfield.evaluation.leakage import digests_text

GRID = {"range_m": 16.0, "half_width_m": 8.0, "cell_m": 0.5}


def save_tiny(path: Path, change: Any = None) -> bytes:
    config = DETECTORS["pointpillars"].config_class(grid=GRID)
    state = build_detector(config, seed=0).state_dict()
    described = config.model_dump(mode="json")
    if change is not None:
        change(described)
    class_like = type("Config", (), {"model_dump_json": lambda self: json.dumps(described)})()
    save_weights(path, state, config=class_like, provenance={"seed": 1})
    return path.read_bytes()


def test_equal_weights_are_equal_bytes(tmp_path: Path) -> None:
    """The metadata come from a hash table, whose order differs from call to call."""
    assert len({save_tiny(tmp_path / f"{number}.safetensors") for number in range(10)}) == 1
    network, provenance = load_weights(tmp_path / "0.safetensors")
    assert provenance == {"seed": 1}
    assert network.config.grid.range_m == 16.0


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("anchors.vehicle.size_m", [1e30, 1.9, 1.6]),
        ("anchors.vehicle.size_m", [0.0, 1.9, 1.6]),
        ("anchors.vehicle.size_m", [4.5, -1.9, 1.6]),
        ("anchors.vehicle.z_m", 1e30),
        ("anchors.vehicle.z_m", float("nan")),
        ("grid.range_m", -16.0),
        ("grid.range_m", 1e30),
        ("grid.z_min_m", float("-inf")),
        ("grid.z_max_m", -7.0),
        ("positive_m", 1e30),
    ],
)
def test_lengths_of_a_configuration_are_bounded(tmp_path: Path, path: str, value: Any) -> None:
    def change(described: dict[str, Any]) -> None:
        *groups, last = path.split(".")
        for name in groups:
            described = described[name]
        described[last] = value

    save_tiny(tmp_path / "w.safetensors", change)
    with pytest.raises(FileFormatError, match=f"{path.split('.')[0]}|which JSON does not have"):
        load_weights(tmp_path / "w.safetensors")


def test_a_flipped_bit_anywhere_is_refused(tmp_path: Path) -> None:
    """Header, configuration, provenance, digest and numbers: the file carries a digest of all its bytes."""
    data = save_tiny(tmp_path / "w.safetensors")
    end = 8 + int.from_bytes(data[:8], "little")
    rng = np.random.default_rng(58)
    places = [*rng.integers(0, end, 60).tolist(), *rng.integers(end, len(data), 140).tolist()]
    accepted = []
    for number in places:
        damaged = bytearray(data)
        damaged[number] ^= 1 << int(rng.integers(8))
        (tmp_path / "damaged.safetensors").write_bytes(damaged)
        try:
            load_weights(tmp_path / "damaged.safetensors")
        except FileFormatError:
            continue
        accepted.append(number)
    assert not accepted, f"{len(accepted)} of {len(places)} files with one flipped bit are accepted"


@pytest.mark.parametrize("name", sorted(bundled_weights()))
def test_what_ships_carries_its_digest(tmp_path: Path, name: str) -> None:
    data = bytearray(bundled_weights()[name].read_bytes())
    load_weights(bundled_weights()[name])
    data[-1000] ^= 1
    (tmp_path / "w.safetensors").write_bytes(data)
    with pytest.raises(FileFormatError, match="digest"):
        load_weights(tmp_path / "w.safetensors")


def without_digest(path: Path, tensors: dict[str, Any]) -> Path:
    """A file as earlier versions wrote it, with other tensors."""
    with safe_open(path, framework="pt") as file:
        metadata = {name: text for name, text in file.metadata().items() if name != "sha256"}
        own = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
    path.write_bytes(save({**own, **tensors}, metadata=metadata))
    return path


@pytest.mark.parametrize(
    ("suffix", "value"),
    [
        (".weight", float("nan")),
        (".bias", float("inf")),
        (".weight", 1e36),
        (".running_var", -1.0),
        (".running_var", float("nan")),
        (".num_batches_tracked", -(1 << 60)),
    ],
)
def test_numbers_that_no_training_leaves_are_refused(tmp_path: Path, suffix: str, value: float) -> None:
    """Of files without a digest, as earlier versions wrote them, too."""
    save_tiny(tmp_path / "w.safetensors")
    with pytest.warns(UserWarning, match=r"w\.safetensors: .* carry no digest"):
        state = load_weights(without_digest(tmp_path / "w.safetensors", {}))[0].state_dict()
    name = next(name for name in state if name.endswith(suffix))
    changed = state[name].clone()
    changed.view(-1)[0] = value
    with pytest.raises(FileFormatError, match=name.replace(".", r"\.")):
        load_weights(without_digest(tmp_path / "w.safetensors", {name: changed}))
    config = DETECTORS["pointpillars"].config_class(grid=GRID)
    with pytest.raises(FarfieldError, match=name.replace(".", r"\.")):
        save_weights(tmp_path / "other.safetensors", {**state, name: changed}, config=config, provenance={})
    assert not (tmp_path / "other.safetensors").exists()


def test_numbers_of_another_type_are_refused(tmp_path: Path) -> None:
    save_tiny(tmp_path / "w.safetensors")
    state = load_weights(tmp_path / "w.safetensors")[0].state_dict()
    name = next(name for name in state if name.endswith(".weight"))
    with pytest.raises(FileFormatError, match="int32"):
        load_weights(without_digest(tmp_path / "w.safetensors", {name: state[name].view(torch.int32)}))


def test_a_network_in_memory_is_checked_too() -> None:
    network = build_detector(DETECTORS["pointpillars"].config_class(grid=GRID), seed=0)
    next(network.parameters()).data[0] = float("nan")
    with pytest.raises(ConfigError, match=r"finite in fp32, got nan"):
        Detector(network, precision="fp32", device="cpu")


def test_what_a_network_cannot_compute_is_not_nothing() -> None:
    """Finite weights whose sums overflow, as float16's may, gave NaN for scores and so no box."""
    network = build_detector(DETECTORS["pointpillars"].config_class(grid=GRID), seed=0).eval()
    for parameter in network.parameters():
        parameter.data.mul_(1e9)
    name, source = next(iter(network.inputs.items()))
    points = torch.rand(500, len(source.columns)) * 8
    with pytest.raises(FarfieldError, match="not a number"):
        network.predict({name: [points]})


@pytest.mark.parametrize(
    "provenance",
    [
        [],
        {"experiment": "own"},
        {"experiment": None},
        {"experiment": {"data": 7}},
        {"experiment": {"data": {"source": 7}}},
        {"experiment": {"data": {"path": 7}}},
        {"experiment": {"data": {"path": "x", "clouds": 7}}},
        {"experiment": {"data": {"path": "x", "simulate": "cirrus-sim"}}},
        {"streams": ["labelled"]},
        {"streams": {"labelled": "x"}},
        {"streams": {"labelled": {"frame_digests": ["npy:0"]}}},
        {"start": "x"},
        {"start": {"weights": 7}},
        {"adapted": {"start_frame_digests": 7}},
        {"environment": "x"},
        {"frames": "many"},
    ],
)
def test_a_provenance_of_other_types_is_read_as_far_as_it_can_be(tmp_path: Path, provenance: Any) -> None:
    """It raised KeyError, AttributeError or StopIteration where it was said what a detector learnt from; then others'
    weights were refused for it."""
    save_tiny(tmp_path / "w.safetensors")
    with safe_open(tmp_path / "w.safetensors", framework="pt") as file:
        metadata = {name: text for name, text in file.metadata().items() if name != "sha256"}
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
    (tmp_path / "w.safetensors").write_bytes(save(tensors, metadata={**metadata, "provenance": json.dumps(provenance)}))
    with pytest.warns(UserWarning, match="not known as far as it stands there|carry no digest") as warned:
        read = load_weights(tmp_path / "w.safetensors")[1]
    assert len(warned) == 2
    name = next(iter(provenance)) if provenance else "provenance"
    assert name in str([warning.message for warning in warned])
    Detector(build_detector(DETECTORS["pointpillars"].config_class(grid=GRID), seed=0), provenance=read, device="cpu")
    training_text(read)
    assert digests_text(read) is None, "nothing of it says that all is known"
    if not isinstance(provenance, dict):
        return
    config = DETECTORS["pointpillars"].config_class(grid=GRID)
    with pytest.raises(FarfieldError, match="provenance"):
        save_weights(tmp_path / "new.safetensors", tensors, config=config, provenance=provenance)
    assert not (tmp_path / "new.safetensors").exists()


def test_what_can_be_read_of_anothers_provenance_stays() -> None:
    streams = {"a": {"frame_digests": "npy:0123456789ab", "frames": "7"}, "b": {"frame_digests": 5}}
    data = {"path": "x", "clouds": ["lidar"], "options": 3}
    record = {"experiment": {"data": data}, "streams": streams, "start": "x", "own": [1, {"kept": True}]}
    with pytest.warns(UserWarning, match=r"streams\.a\.frames.*streams\.b\.frame_digests") as warned:
        read = provenance_of(Path("w.safetensors"), json.dumps(record))
    assert "experiment.data.options" in str(warned[0].message)
    assert read == {
        "experiment": {"data": {"path": "x", "clouds": ["lidar"], "options": {}}},
        "streams": {"a": {"frame_digests": "npy:0123456789ab"}, "b": {}},
        "start": {},
        "own": [1, {"kept": True}],
    }


def test_a_record_that_could_not_be_read_again_is_not_written(tmp_path: Path) -> None:
    network, _ = load_weights(next(iter(bundled_weights().values())))
    for odd in ({"a": "caf\udce9"}, {"a": float("nan")}, {"a": 1 << 70}):
        with pytest.raises((FileFormatError, ValueError)):
            save_weights(tmp_path / "w.safetensors", network.state_dict(), config=network.config, provenance=odd)
    assert not (tmp_path / "w.safetensors").exists()
