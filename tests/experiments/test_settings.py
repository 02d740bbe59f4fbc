"""Settings of an experiment: one name for one thing, old names accepted, errors that list the keys, extends."""

import re
from pathlib import Path

import pytest
import yaml

torch = pytest.importorskip("torch")

from farfield.detectors import build_detector
from farfield.detectors.weights import bundled_weights, load_weights
from farfield.errors import ConfigError
from farfield.experiments.catalogue import shipped
from farfield.experiments.schema import dump_experiment, experiment_of, load_experiment

WINDOW = {"range_m": 64.0, "half_width_m": 16.0}


def of(detector, *overrides):
    return experiment_of({"name": "a", "data": {"path": "x"}, "detector": detector}, overrides)


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("second", [0.25, 0.25, 0.45]),
        ("voxelnet", [0.4, 0.4, 0.8]),
        ("sparsecentre", [0.4, 0.4, 0.5]),
        ("rtnh", [0.4, 0.4, 0.8]),
    ],
)
def test_voxel_m_is_the_old_name_of_cell_m(name, size):
    new = of({"name": name, "grid": {**WINDOW, "cell_m": size}})
    assert of({"name": name, "grid": {**WINDOW, "voxel_m": size}}) == new
    assert list(new.detector.grid.cell_m) == size
    assert "voxel_m" not in dump_experiment(new)
    assert of({"name": name, "grid": {**WINDOW, "cell_m": [0.3, 0.3, 0.5]}}, f"detector.grid.voxel_m={size}") == new
    with pytest.raises(ConfigError, match=r"voxel_m is the old name of cell_m"):
        of({"name": name, "grid": {**WINDOW, "cell_m": size, "voxel_m": size}})


def test_one_number_is_a_cube():
    assert of({"name": "rtnh", "grid": {"cell_m": 0.4}}).detector.grid.cell_m == (0.4, 0.4, 0.4)


def test_window_is_the_old_name_of_grid():
    new = of({"name": "pointrcnn", "grid": WINDOW})
    assert of({"name": "pointrcnn", "window": WINDOW}) == new
    assert new.detector.reach_m == 64.0
    assert "window" not in dump_experiment(new)
    assert of({"name": "pointrcnn", "grid": WINDOW}, "detector.window.range_m=80").detector.reach_m == 80.0


def test_shipped_experiments_and_docs_use_today_s_names():
    for entry in shipped():
        detector = yaml.safe_load(entry.path.read_text())["detector"]
        assert "window" not in detector, entry.name
        assert "voxel_m" not in detector.get("grid", {}), entry.name
        assert {"range_m", "half_width_m"} <= set(detector["grid"]), entry.name


@pytest.mark.parametrize("name", bundled_weights())
def test_shipped_weights_load_under_today_s_names(name):
    network, provenance = load_weights(bundled_weights()[name])
    assert network.config.grid.range_m == (72.0 if name.endswith("kradar-sim") else 250.0)
    detector = of(provenance["experiment"]["detector"]).detector
    calibrated = network.config.score_bands  # by what came after the training that the experiment describes
    assert detector.model_copy(update={"score_bands": calibrated}) == network.config
    assert build_detector(detector).state_dict().keys() == network.state_dict().keys()


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("detector.widht=3", ("detector.widht", "widths", "score_threshold", "grid")),
        ("detector.grid.cel_m=1", ("detector.grid.cel_m", "Did you mean cell_m", "range_m")),
        ("training.step=1", ("training.step", "Did you mean steps", "learning_rate", "start_from")),
        ("data.pth=1", ("data.pth", "Did you mean path", "clouds", "sweeps")),
        ("foo=1", ("foo", "augmentation", "detector", "training", "extends")),
        ("augmentation.weather={probabilty: 1}", ("augmentation.weather.probabilty", "probability", "kinds")),
        ("detector.anchors={car: {size: 3}}", ("detector.anchors.car.size", "size_m", "z_m")),
        ("data={a: {path: x, bla: 1}, b: {path: y}}", ("data.a.bla", "clouds")),
        ("training.start={weights: x, frozen: 1}", ("training.start.frozen", "freeze")),
    ],
)
def test_an_unknown_key_s_error_lists_the_keys(override, words):
    with pytest.raises(ConfigError) as caught:
        of({"name": "pointpillars"}, override)
    for word in words:
        assert word in str(caught.value)


BASE = """
name: base
data: {path: there, clouds: [gaussian], split: train}
detector:
  name: pointpillars
  grid: {range_m: 64.0, half_width_m: 16.0, cell_m: 0.5}
  anchors: {vehicle: {size_m: [4, 2, 1.5], z_m: -1.0}}
augmentation: {pasted: {vehicle: 3}}
training: {steps: 7, batch_size: 2}
"""


def test_an_experiment_extends_another(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "base.yaml").write_text(BASE)
    child = tmp_path / "sub" / "child.yaml"
    child.write_text(
        "extends: ../base.yaml\nname: child\ndetector:\n  grid: {range_m: 80}\n"
        "  anchors: {tram: {size_m: [9, 3, 3], z_m: 0}}\naugmentation: {pasted: {}}\ntraining: {steps: 9}\n"
    )
    found = load_experiment(child, ["training.batch_size=3"])
    assert (found.name, found.data.split, found.training.steps, found.training.batch_size) == ("child", "train", 9, 3)
    assert (found.detector.grid.range_m, found.detector.grid.half_width_m) == (80.0, 16.0)
    assert found.detector.class_names == ("tram",), "names are no settings: a list of classes replaces the other"
    assert found.augmentation.pasted == {}
    assert "extends" not in dump_experiment(found)
    (tmp_path / "again.yaml").write_text(dump_experiment(found))
    assert load_experiment(tmp_path / "again.yaml") == found


def test_a_shipped_experiment_can_be_extended(tmp_path):
    child = tmp_path / "mine.yaml"
    child.write_text("extends: pointpillars-cirrus-sim\nname: mine\ndata: {path: mine, simulate: null}\n")
    found = load_experiment(child)
    assert (found.detector.name, str(found.data.path), found.data.simulate) == ("pointpillars", "mine", None)
    assert found.data.clouds == ("gaussian", "uniform")


def test_another_detector_replaces_the_first(tmp_path):
    (tmp_path / "base.yaml").write_text(BASE)
    (tmp_path / "mine.yaml").write_text("extends: base.yaml\nname: mine\ndetector: {name: pointrcnn}\n")
    assert load_experiment(tmp_path / "mine.yaml").detector.name == "pointrcnn"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("extends: nowhere.yaml\nname: a\n", "nowhere.yaml"),
        ("extends: mine.yaml\nname: a\n", "extends itself"),
        ("extends: base.yaml\n", "a name of its own"),
        ("extends: [1]\nname: a\n", "extends"),
    ],
)
def test_what_cannot_be_extended_is_named(tmp_path, text, words):
    (tmp_path / "base.yaml").write_text(BASE)
    (tmp_path / "mine.yaml").write_text(text)
    with pytest.raises(ConfigError, match=words):
        load_experiment(tmp_path / "mine.yaml")


def test_the_experiment_of_the_page_is_one(tmp_path):
    page = (Path(__file__).resolve().parents[2] / "docs" / "detectors.md").read_text(encoding="utf-8")
    section = page.partition("## Training from other weights")[2].partition("\n## ")[0]
    (block,) = re.findall(r"^```yaml\n(.*?)^```", section, flags=re.MULTILINE | re.DOTALL)
    (tmp_path / "mine.yaml").write_text(block)
    found = load_experiment(tmp_path / "mine.yaml")
    assert found.detector.class_names == ("vehicle", "tram")
    assert found.training.start.freeze == ("encoder",)
    assert found.training.batch_size == 4
