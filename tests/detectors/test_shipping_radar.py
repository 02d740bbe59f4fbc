"""What ships the radar experiments: files without folders of a machine, figures and rows from what was printed."""

import json
from pathlib import Path

import pytest
import shipped_figures

ROOT = Path(__file__).resolve().parents[2]
PRINTED = """command  python benchmarks/radar_detectors.py weathers --runs rtnh-kradar-sim pointpillars-kradar-sim
date     2026-11-23 18:00 UTC

kradar-sim-shipped: 348 frames of 116 drives, fingerprint 0123456789abcdef
rtnh-kradar-sim                        1500 steps of 2, seed 0, 928 frames, cloud radar, reader {}, {}, bf16
pointpillars-kradar-sim                1500 steps of 2, seed 0, 928 frames, cloud os2-64, reader {}, {}, bf16

kradar: AP of Sedan at IoU 0.3, per cent
                                                  total normal overc.    fog   rain  sleet l.snow h.snow
rtnh-kradar-sim                        AP_3d       54.9   51.4   74.8   80.9   63.2   39.1   59.1   69.1
pointpillars-kradar-sim                AP_3d       61.9   64.6   89.9      -   81.1   32.3   69.2   62.5
rtnh-kradar-sim                        AP_bev      58.2   54.4   76.3   80.9   68.0   43.9   62.8   70.5
pointpillars-kradar-sim                AP_bev      63.7   67.1   90.3      -   81.7   34.1   70.5   63.8
exact rotated IoU; label_version=not stated; region=narrow

kradar-compat:rtnh_narrow: AP of Sedan at IoU 0.3, per cent
rtnh-kradar-sim                        AP_3d       11.1   11.1   11.1   11.1   11.1   11.1   11.1   11.1

parameters (times: radar_detector_speed.py)
rtnh-kradar-sim                          4.31 M
pointpillars-kradar-sim                  0.92 M
"""


def test_figures_are_those_that_were_printed() -> None:
    known = shipped_figures.radar(PRINTED)
    assert known["data"] == "kradar-sim-shipped (0123456789abcdef): 348 frames of 116 drives"
    assert known["protocol"].startswith("exact rotated IoU")
    radar, lidar = (known["weights"][name] for name in shipped_figures.RADAR_WEIGHTS)
    assert (radar["detector"], radar["cloud"], radar["parameters_m"]) == ("rtnh", "radar", 4.31)
    assert (lidar["detector"], lidar["cloud"], lidar["parameters_m"]) == ("pointpillars", "os2-64", 0.92)
    assert radar["ap_3d"] == dict(
        zip(shipped_figures.WEATHERS, (54.9, 51.4, 74.8, 80.9, 63.2, 39.1, 59.1, 69.1), strict=True)
    )
    assert lidar["ap_3d"]["fog"] is None
    assert lidar["ap_bev"]["sleet"] == 34.1
    assert radar["schedule"] == "1500 steps of 2, seed 0, 928 frames, cloud radar"


def test_rows_of_the_page_follow_the_figures() -> None:
    text = "| a | b |\n| `pointpillars-kradar-sim` | old |\nand `pointpillars-kradar-sim` | stays\n"
    row = shipped_figures.in_page(text, shipped_figures.radar(PRINTED)).splitlines()
    assert row[1].startswith("| `pointpillars-kradar-sim` | 61.9 (63.7) | 64.6 (67.1) | 89.9 (90.3) | - |")
    assert row[2] == "and `pointpillars-kradar-sim` | stays"


def test_the_page_has_the_stored_figures() -> None:
    stored = json.loads(shipped_figures.FIGURES.read_text("utf-8"))["radar"]
    page = shipped_figures.PAGE.read_text("utf-8")
    for name in shipped_figures.RADAR_WEIGHTS:
        assert f"\n| `{name}` |" in page
    assert shipped_figures.in_page(page, stored) == page


def test_provenance_names_no_folder_of_a_machine() -> None:
    data = {"path": "/elsewhere/data/kradar-sim-train", "clouds": ["radar"]}
    given = {"experiment": {"data": data}, "frames": 928}
    kept = shipped_figures.without_machine(given)
    assert kept["experiment"]["data"]["path"] == "data/kradar-sim-train"
    assert kept["frames"] == 928
    assert data["path"].startswith("/elsewhere")
    streams = {"experiment": {"data": {"one": {"path": "/a/b"}, "two": {"path": "c"}}}}
    paths = shipped_figures.without_machine(streams)["experiment"]["data"]
    assert (paths["one"]["path"], paths["two"]["path"]) == ("data/b", "data/c")


def test_provenance_of_stages_names_no_folder_of_a_machine() -> None:
    start = {"weights": "/elsewhere/runs/roads/first/weights.safetensors"}
    streams = {"cirrus": {"path": "/elsewhere/data/cirrus"}, "donors": {"path": "open-sweeps", "donors": {"copies": 3}}}
    training = {"negatives": "/elsewhere/runs/roads/negatives.json", "start": dict(start)}
    portable = shipped_figures.without_machine({"experiment": {"data": streams, "training": training}, "start": start})
    assert "elsewhere" not in json.dumps(portable)
    assert portable["start"]["weights"] == "first/weights.safetensors"
    assert portable["experiment"]["training"]["negatives"] == "negatives.json"
    assert portable["experiment"]["data"]["donors"]["path"] == "open-sweeps"


def test_a_run_is_shipped_in_float16(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    from safetensors import safe_open

    from farfield.detectors import DETECTORS, build_detector
    from farfield.detectors.weights import load_weights, save_weights

    config = DETECTORS["pointpillars"].config_class.model_validate(
        {"grid": {"range_m": 16.0, "half_width_m": 8.0, "cell_m": 1.0}, "widths": [4, 4, 4], "depths": [0, 0, 0]}
    )
    torch.manual_seed(0)
    network = build_detector(config)
    provenance = {"experiment": {"detector": {"name": "pointpillars"}, "data": {"path": "/x/y"}}}
    save_weights(tmp_path / "weights.safetensors", network.state_dict(), config=config, provenance=provenance)
    written = shipped_figures.ship(tmp_path, "pointpillars-kradar-sim", tmp_path)
    assert written == tmp_path / "pointpillars-kradar-sim.safetensors"
    with safe_open(written, framework="pt") as file:
        kinds = {file.get_tensor(name).dtype for name in file.keys() if file.get_tensor(name).ndim > 1}  # noqa: SIM118
    assert kinds == {torch.float16}
    loaded, said = load_weights(written)
    assert said["experiment"]["data"]["path"] == "data/y"
    for name, tensor in network.state_dict().items():
        assert torch.allclose(loaded.state_dict()[name].float(), tensor.float(), rtol=1e-3, atol=1e-6), name
    with pytest.raises(SystemExit, match="expected a run of rtnh, got pointpillars"):
        shipped_figures.ship(tmp_path, "rtnh-kradar-sim", tmp_path)
