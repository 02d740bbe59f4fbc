"""Trainings that start from other weights: what matches by name, shape and class is taken; parts may be frozen."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from small import SMALL, small_detector
from test_training import words_of_train

from farfield.cli import main
from farfield.detectors.features import FeatureMap
from farfield.detectors.network import AnchorRow
from farfield.detectors.weights import load_weights, resolve_weights, save_weights
from farfield.errors import ConfigError
from farfield.experiments.schema import load_experiment
from farfield.training.checkpoints import load_checkpoint
from farfield.training.param_groups import frozen_modules, frozen_names
from farfield.training.transfer import nearest_sizes, start_network

SHIPPED = "pointpillars-cirrus-sim"
OTHER_CLASSES = {
    "pointpillars": {"anchors": {n: {"size_m": [4, 2, 1.5], "z_m": -1.0} for n in ("tram", "pedestrian", "vehicle")}},
    "pointrcnn": {"sizes_m": {"tram": [9, 2.5, 3], "pedestrian": [0.8, 0.7, 1.7], "vehicle": [4, 2, 1.5]}},
    "rtn": {"anchors": {n: {"size_m": [4.2, 2.1, 2.0], "z_m": -1.0} for n in ("tram", "vehicle")}},
    "sparsecentre": {"classes": ["tram", "pedestrian", "vehicle"]},
}


def stored(tmp_path, name, seed=5, **changes):
    network = small_detector(name, seed=seed, **changes)
    path = tmp_path / f"{name}.safetensors"
    save_weights(path, network.state_dict(), config=network.config, provenance={})
    return network, path


@pytest.mark.parametrize("name", SMALL)
def test_the_same_settings_take_everything(name, tmp_path):
    theirs, path = stored(tmp_path, name)
    ours = small_detector(name, seed=8)
    found = start_network(ours, str(path))
    assert found.share == 1.0
    assert (len(found.fresh), len(found.by_class), len(found.unused)) == (0, 0, 0)
    for key, value in theirs.state_dict().items():
        assert torch.equal(ours.state_dict()[key], value), key


@pytest.mark.parametrize("name", OTHER_CLASSES)
def test_other_classes_take_the_rows_of_those_that_are_shared(name, tmp_path):
    theirs, path = stored(tmp_path, name)
    ours = small_detector(name, seed=8, **OTHER_CLASSES[name])
    before = {key: value.clone() for key, value in ours.state_dict().items()}
    found = start_network(ours, str(path))
    assert 0.5 < found.share < 1.0
    assert found.by_class
    both = [each for each in ours.config.class_names if each in theirs.config.class_names]
    assert found.classes == {"shared": both, "fresh": ["tram"]}
    rows, their_rows = ours.class_rows(), theirs.class_rows()
    assert set(rows) == {*found.by_class}
    for key in rows:
        (axis, mine), (_, other) = rows[key], their_rows[key]
        new, old, was = (tree[key].movedim(axis, 0) for tree in (ours.state_dict(), theirs.state_dict(), before))
        assert len(mine) == len(new)
        for row, word in enumerate(mine):
            like = word._replace(label="vehicle") if isinstance(word, AnchorRow) and "tram" in word else word
            assert torch.equal(new[row], old[other.index(like)] if like in other else was[row])
            assert ("tram" in str(word)) == (word not in other)


def test_shared_classes_score_as_before_training(tmp_path):
    """The head's rows by class: heat of a class that both know is the same to the bit, whatever its place."""
    theirs, path = stored(tmp_path, "sparsecentre")
    ours = small_detector("sparsecentre", seed=8, classes=["pedestrian", "tram", "vehicle"])
    start_network(ours, str(path))
    features = torch.randn(50, ours.head.heat.in_features)
    mine, other = ours.head.heat(features), theirs.head.heat(features)
    torch.testing.assert_close(mine[:, [2, 0]], other, rtol=0, atol=1e-6)


def test_a_new_class_has_the_box_of_the_anchor_nearest_in_size(tmp_path):
    """Its boxes start as those of theirs, in units of its own anchor; its logits start anew."""
    sizes = {"vehicle": [4.2, 2.0, 1.6], "large_vehicle": [9.0, 2.6, 3.2], "pedestrian": [0.8, 0.7, 1.7]}
    anchors = {name: {"size_m": size, "z_m": -1.0} for name, size in sizes.items()}
    theirs, path = stored(tmp_path, "pointpillars", anchors=anchors)
    mine = {"van": {"size_m": [5.0, 2.0, 2.0], "z_m": -1.0}, "pedestrian": anchors["pedestrian"]}
    mine["tram"] = {"size_m": [30.0, 2.6, 3.4], "z_m": 0.0}
    ours = small_detector("pointpillars", seed=8, anchors=mine)
    assert nearest_sizes(ours.config.anchor_sizes_m, sizes) == {"van": "vehicle", "tram": "large_vehicle"}
    before = ours.head.weight.clone()
    found = start_network(ours, str(path))
    assert "anchor of van from vehicle, nearest in size" in found.by_class["head.weight"]
    assert "anchor of tram from large_vehicle" in str(found)
    assert found.classes == {"shared": ["pedestrian"], "fresh": ["van", "tram"]}
    features = torch.randn(2, ours.head.in_channels, 5, 4)
    one, other = (
        network.head(FeatureMap(values=features, cell_m=1.0, origin_m=(0.0, 0.0))) for network in (ours, theirs)
    )
    codes, there = (maps.codes.unflatten(1, (-1, 6)) for maps in (one, other))
    order = [0, 1, 4, 5, 2, 3]  # slots of vehicle, pedestrian, large_vehicle there
    torch.testing.assert_close(codes, there[:, :, order], rtol=0, atol=1e-6)
    logits, others = (maps.logits.unflatten(1, (-1, 6)) for maps in (one, other))
    torch.testing.assert_close(logits[:, :, 2:4], others[:, :, 4:6], rtol=0, atol=1e-6)
    assert torch.equal(ours.head.weight[:2], before[:2]), "logits of a new class"
    assert nearest_sizes({"any": (1.0, 1.0, 1.0)}, {}) == {}


def test_a_permuted_list_of_equal_length_is_no_match_by_shape(tmp_path):
    theirs, path = stored(tmp_path, "sparsecentre", classes=["vehicle", "pedestrian"])
    ours = small_detector("sparsecentre", seed=8, classes=["pedestrian", "vehicle"])
    start_network(ours, str(path))
    assert torch.equal(ours.head.heat.weight, theirs.head.heat.weight[[1, 0]])


def test_other_widths_are_fresh_and_named(tmp_path):
    _, path = stored(tmp_path, "pointpillars")
    found = start_network(small_detector("pointpillars", seed=8, neck_width=48), str(path))
    assert any(name.startswith("head.") for name in found.fresh)
    assert "48" in str(found.fresh)
    assert "neck_width: 32, now 48" in " ".join(found.settings)
    assert any("fresh" in line for line in found.lines())


def test_nothing_in_common_is_an_error(tmp_path):
    _, path = stored(tmp_path, "pointpillars")
    with pytest.raises(ConfigError, match=r"pointpillars.*second"):
        start_network(small_detector("second"), str(path))


def test_frozen_parts_are_found_by_name_and_pattern():
    network = small_detector("pointpillars")
    assert frozen_names(network, ["encoder"]) == {n for n, _ in network.named_parameters() if n.startswith("encoder.")}
    assert frozen_names(network, ["*.bias"]) == {n for n, _ in network.named_parameters() if n.endswith(".bias")}
    norms = [m for m in frozen_modules(network, ["backbone"]) if isinstance(m, torch.nn.BatchNorm2d)]
    assert norms
    with pytest.raises(ConfigError, match=r"backbones.*encoder, backbone, head"):
        frozen_names(network, ["backbones"])
    with pytest.raises(ConfigError, match="every"):
        frozen_names(network, ["*"])


def test_the_short_form_and_the_long_one_are_one(experiment):
    short = load_experiment(experiment, [f"training.start_from={SHIPPED}", "training.start.freeze=[encoder]"])
    long = load_experiment(experiment, [f"training.start={{weights: {SHIPPED}, freeze: [encoder]}}"])
    assert short == long
    assert "start" not in load_experiment(experiment).training.model_dump()
    with pytest.raises(ConfigError, match="weights"):
        load_experiment(experiment, ["training.start.freeze=[encoder]"])
    with pytest.raises(ConfigError, match=r"start_from"):
        load_experiment(experiment, [f"training.start_from={SHIPPED}", "training.start.weights=other"])


FINE = """
name: fine
data: {path: DATA, clouds: [gaussian]}
detector:
  name: pointpillars
  grid: {range_m: 64.0, half_width_m: 16.0, cell_m: 0.5}
  anchors:
    vehicle: {size_m: [4.6, 1.95, 1.7], z_m: -1.15}
    trailer: {size_m: [8.0, 2.5, 3.0], z_m: -0.5}
training:
  start_from: pointpillars-cirrus-sim
  start: {freeze: [encoder, backbone]}
  steps: 8
  batch_size: 1
  precision: fp32
  threads: 1
  workers: 0
  weight_decay: 0.1
  checkpoint_every_s: 0.001
"""


@pytest.fixture
def fine(data, tmp_path):
    path = tmp_path / "fine.yaml"
    path.write_text(FINE.replace("DATA", str(data)))
    return path


def test_fine_tuning_with_other_classes_starts_reports_and_resumes(fine, tmp_path, capsys):
    """From shipped weights, killed in between: the same weights as without, frozen parts as they came."""
    assert main(words_of_train(fine, tmp_path / "whole")) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert f"starts from {SHIPPED}" in said
    assert "shared: vehicle" in said
    assert "fresh: trailer" in said
    command = [sys.executable, "-m", "farfield.cli", *words_of_train(fine, tmp_path / "cut")]
    run, log = subprocess.Popen(command, stderr=subprocess.DEVNULL), tmp_path / "cut" / "fine" / "log.jsonl"
    until = time.monotonic() + 120
    while time.monotonic() < until and not (log.is_file() and len(log.read_text().splitlines()) >= 2):
        time.sleep(0.02)
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    begun = load_checkpoint(tmp_path / "cut" / "fine" / "checkpoint.pt")["step"]
    assert 0 < begun < 8, "killed while it ran"
    assert main(words_of_train(fine, tmp_path / "cut")) == 0
    assert f"resumes after step {begun} of 8" in " ".join(capsys.readouterr().err.split())
    whole, cut = (load_weights(tmp_path / each / "fine" / "weights.safetensors") for each in ("whole", "cut"))
    shipped, _ = load_weights(resolve_weights(SHIPPED))
    for key, value in whole[0].state_dict().items():
        assert torch.equal(value, cut[0].state_dict()[key]), key
        if not key.startswith("head."):
            assert torch.equal(value, shipped.state_dict()[key]), key
    assert not torch.equal(whole[0].head.weight, shipped.head.weight[: len(whole[0].head.weight)])
    stored = json.loads((tmp_path / "cut" / "fine" / "start.json").read_text())
    assert stored["share"] > 0.9
    assert stored["classes"] == {"shared": ["vehicle"], "fresh": ["trailer"]}
    for _, provenance in (whole, cut):
        assert provenance["start"]["sha256"] == stored["sha256"]
    assert np.isfinite([json.loads(line)["loss"] for line in log.read_text().splitlines()]).all()


def test_a_resumed_run_needs_its_start_no_more(fine, tmp_path, capsys):
    network, path = stored(tmp_path, "pointpillars")
    del network
    fine.write_text(fine.read_text().replace("start_from: pointpillars-cirrus-sim", ""))
    start = json.dumps({"weights": str(path), "freeze": [], "least_taken": 0.0})
    words = words_of_train(fine, tmp_path, f"training.start={start}", "training.steps=2")
    assert main(words) == 0
    path.unlink()
    assert main(words) == 0
    assert "all 2 steps are done" in " ".join(capsys.readouterr().err.split())
