import json
import sys
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

sys.path.append(str(Path(__file__).parents[1] / "detectors"))
import their_forward as their
from kit_rtnh import KitRTNH

from farfield.api import load_detector
from farfield.cli import main
from farfield.datasets.recipes import recipe_of_provenance
from farfield.detectors import build_detector
from farfield.detectors.weights import load_weights
from farfield.experiments.catalogue import find
from farfield.experiments.schema import load_experiment

SETTINGS = """
grid: {range_m: 19.2, half_width_m: 6.4, z_min_m: -3.0, z_max_m: 1.0, cell_m: 0.4}
score_threshold: 0.07
"""


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    torch.save({"model_state": their.pillar_weights()}, "theirs.pth")
    Path("mine.yaml").write_text(SETTINGS)
    return tmp_path


def test_an_imported_checkpoint_detects(home, rng, capsys):
    arguments = ["import-weights", "theirs.pth", "ours.safetensors", "--settings", "mine.yaml", "--every-key"]
    assert main(arguments) == 0
    shown = capsys.readouterr().out
    assert "OpenPCDet checkpoint as pointpillars" in shown
    assert "vfe.pfn_layers.0.linear.weight -> encoder.linear.weight" in shown
    network, provenance = load_weights(home / "ours.safetensors")
    assert network.config.score_threshold == 0.07
    assert provenance["imported_from"] == "OpenPCDet"
    assert len(provenance["checkpoint_sha256"]) == 64
    np.save("scan.npy", rng.uniform([0, -6, -3, 0], [19, 6, 1, 1], (500, 4)).astype(np.float32))
    options = ["--out", "boxes.csv", "--score-threshold", "0", "--device", "cpu"]
    assert main(["predict", "ours.safetensors", "scan.npy", *options]) == 0
    assert len(Path("boxes.csv").read_text().splitlines()) > 3


def test_keys_without_a_place_stop_the_import_unless_allowed(home, capsys):
    torch.save({"model_state": {**their.pillar_weights(), "roi_head.fc.weight": torch.zeros(2)}}, "more.pth")
    arguments = ["import-weights", "more.pth", "ours.safetensors", "--settings", "mine.yaml"]
    assert main(arguments) == 1
    assert "unknown: roi_head.fc.weight" in capsys.readouterr().err
    assert not Path("ours.safetensors").exists()
    assert main([*arguments, "--allow-unknown"]) == 0
    assert "UNKNOWN, left out as allowed: roi_head.fc.weight" in capsys.readouterr().out
    assert load_weights(Path("ours.safetensors"))[1]["left_out"] == ["roi_head.fc.weight"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["absent.pth", "x.safetensors"], "found nothing"),
        (["theirs.pth", "x.pt"], "ends in .safetensors"),
        (["theirs.pth", "x.safetensors", "--settings", "absent.yaml"], "absent.yaml: expected a YAML file"),
        (["theirs.pth", "x.safetensors", "--settings", "list.yaml"], "expected a mapping"),
        (["theirs.pth", "x.safetensors", "--settings", "typo.yaml"], "grids"),
        (["theirs.pth", "x.safetensors", "--kind", "second"], "backbone_3d"),
    ],
)
def test_mistakes_are_told(home, capsys, arguments, message):
    Path("list.yaml").write_text("- grid")
    Path("typo.yaml").write_text("grids: 3")
    assert main(["import-weights", *arguments]) == 1
    assert message in capsys.readouterr().err
    assert not Path("x.safetensors").exists()


@pytest.fixture
def kit_file(home):
    torch.save(KitRTNH("wide", layers=24, widths=(6, 8, 10), neck=7, cell=5).saved(), "RTNH_wide_10.pt")
    return "RTNH_wide_10.pt"


def test_a_checkpoint_of_the_kit_detects_in_the_radar_s_coordinates(home, kit_file, rng, capsys):
    assert main(["import-weights", kit_file, "wide.safetensors"]) == 0
    shown = capsys.readouterr().out
    assert "K-Radar's kit checkpoint as rtnh: 99 keys used, 15 ignored" in shown
    assert "no real checkpoint of the kit was seen" in shown
    network, provenance = load_weights(home / "wide.safetensors")
    assert network.config.lifted_channels == 6
    assert provenance["imported_from"] == "K-Radar's kit"
    detector = load_detector("wide.safetensors", device="cpu")
    assert (detector.reference, detector.learnt_clouds, detector.kind) == ("radar", ("radar",), "radar")
    assert recipe_of_provenance(provenance)["maps"]


def test_the_experiment_of_the_wide_form_is_the_network_of_the_kit(home):
    torch.save(KitRTNH("wide", layers=24).saved(), "full.pt")
    assert main(["import-weights", "full.pt", "full.safetensors"]) == 0
    network, _ = load_weights(home / "full.safetensors")
    ours = build_detector(load_experiment(find("rtnh-wide-kradar")).detector)
    assert {name: tensor.shape for name, tensor in ours.state_dict().items()} == {
        name: tensor.shape for name, tensor in network.state_dict().items()
    }
    assert ours.config.grid == network.config.grid


def test_doctor_says_what_weights_are(home, kit_file, capsys):
    assert main(["import-weights", "theirs.pth", "ours.safetensors", "--settings", "mine.yaml"]) == 0
    torch.save({"conv1.weight": torch.zeros(3)}, "other.pt")
    Path("damaged.pth").write_bytes(b"PK")
    capsys.readouterr()
    for name, status, words in (
        (kit_file, 0, ["RTNH of K-Radar's kit", "114 tensors", "would use 99 tensors, leave out 15 and miss none"]),
        ("theirs.pth", 0, ["OpenPCDet's PointPillars", "would use 61 tensors, leave out 12 and miss none"]),
        ("ours.safetensors", 0, ["pointpillars of Farfield, for vehicle, pedestrian, bicycle", "nothing to import"]),
        ("other.pt", 1, ["unknown", "1 tensor with 3 numbers", "Weights that are read"]),
        ("damaged.pth", 1, ["an archive that cannot be opened"]),
    ):
        assert main(["doctor", name]) == status, name
        shown = " ".join(capsys.readouterr().out.replace("│", " ").split())
        assert all(part in shown for part in words), (name, shown)


def test_doctor_lists_what_a_checkpoint_lacks(home, capsys):
    state = KitRTNH("published", layers=20, widths=(6, 8, 10), neck=7).saved()
    del state["backbone.bn1a.weight"]
    torch.save(state, "cut.pt")
    assert main(["doctor", "cut.pt", "--json", "-"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert report["facts"]["what"] == "RTNH of K-Radar's kit"
    assert report["facts"]["parts"] == {"backbone": 106, "head": 4}
    assert "missing: backbone.bn1a.weight" in report["facts"]["fault"]
    assert "cut.pt" not in report["facts"]["fault"]
