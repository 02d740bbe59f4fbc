"""The weights file: equal bytes for equal weights, and no network on the word of a hostile configuration."""

import json
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")

from farfield.detectors import DETECTORS, build_detector
from farfield.detectors.weights import load_weights, save_weights
from farfield.errors import FileFormatError

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
    with pytest.raises(FileFormatError, match=path.split(".")[0]):
        load_weights(tmp_path / "w.safetensors")
