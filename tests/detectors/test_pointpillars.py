import copy
import json

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from small import batch_of, cloud_of

from farfield.detectors.config import GridConfig
from farfield.detectors.pointpillars.network import PointPillars, PointPillarsConfig
from farfield.detectors.runtime import Detector
from farfield.detectors.weights import load_weights, save_weights
from farfield.errors import FarfieldError, FileFormatError
from farfield.vocabulary.classes import CIRRUS_SIZES_M

SMALL = PointPillarsConfig(
    grid=GridConfig(range_m=64.0, half_width_m=20.0, cell_m=0.5), widths=(16, 32, 32), neck_width=32, out_stride=2
)


@pytest.fixture
def network():
    torch.manual_seed(3)
    return PointPillars(SMALL)


def test_default_covers_the_range_asked_for_and_knows_all_eight_classes():
    config = PointPillarsConfig()
    assert list(config.anchors) == list(CIRRUS_SIZES_M)
    assert len(config.anchors) == 8
    network = PointPillars(config)
    assert (network.encoder.nx * 0.25, network.encoder.ny * 0.25) == (250.0, 100.0)
    assert len(network.head.anchors) == 250 * 100 * 16


@pytest.mark.parametrize("range_m", [60.0, 69.12, 120.3, 250.0])
def test_any_range_gives_a_grid_that_the_strides_divide(range_m):
    grid = GridConfig(range_m=range_m, half_width_m=39.68, cell_m=0.16)
    nx, ny = grid.shape(8)
    assert nx % 8 == ny % 8 == 0
    assert nx * 0.16 >= range_m - 1e-9
    assert nx * 0.16 < range_m + 8 * 0.16
    assert ny * 0.16 >= 2 * 39.68 - 1e-9


def test_same_input_same_output_whatever_the_order_of_points(network, scene, rng):
    network.eval()
    cloud = cloud_of(network, scene.cloud())
    shuffled = cloud[torch.from_numpy(rng.permutation(len(cloud)))]
    with torch.no_grad():
        one, again, other = (network(batch_of(c))[0] for c in (cloud, cloud, shuffled))
    assert torch.equal(one, again)
    torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-4)


def test_pillar_image_equals_a_loop_over_pillars(network, scene):
    encoder = copy.deepcopy(network.encoder).eval()
    cloud = cloud_of(network, scene.cloud())[::7]
    with torch.no_grad():
        image = encoder(cloud, torch.zeros(len(cloud), dtype=torch.long), 1)[0]
    cells = {}
    for point in cloud.double().numpy():
        cells.setdefault((int(point[0] // 0.5), int((point[1] + encoder.ny * 0.25) // 0.5)), []).append(point[:3])
    assert (image.abs().sum(0) > 0).sum() <= len(cells)
    for (ix, iy), inside in list(cells.items())[::25]:
        points = np.array(inside)
        centre = np.array([(ix + 0.5) * 0.5, (iy + 0.5) * 0.5 - encoder.ny * 0.25])
        count = np.full((len(points), 1), np.log1p(len(points)))
        rows = [points / [64.0, 20.0, 6.0], (points - points.mean(0)) / 0.5, (points[:, :2] - centre) / 0.5, count]
        features = torch.from_numpy(np.concatenate(rows, 1)).float()
        with torch.no_grad():
            expected = torch.relu(encoder.norm(encoder.linear(features))).max(0).values
        torch.testing.assert_close(image[:, ix, iy], expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("content", [b"", b"\x00" * 100, b"\x80\x04pickle", (2**40).to_bytes(8, "little") + b"{}"])
def test_damaged_weights_are_refused_clearly(tmp_path, content):
    (tmp_path / "w.safetensors").write_bytes(content)
    with pytest.raises(FileFormatError, match="safetensors"):
        load_weights(tmp_path / "w.safetensors")


@pytest.mark.parametrize(
    "change",
    [
        {"widths": [16, 64, 32]},
        {"widths": [10**9, 32, 32]},
        {"depths": [10**9, 0, 0]},
        {"grid": {"range_m": 1e9}},
        {"name": "second"},
        {"more": 1},
    ],
)
def test_weights_that_lie_about_their_network_are_refused_before_anything_is_allocated(network, tmp_path, change):
    config = SMALL.model_dump(mode="json") | change

    class Lying:
        def model_dump_json(self):
            return json.dumps(config)

    save_weights(tmp_path / "w.safetensors", network.state_dict(), config=Lying(), provenance={})
    with pytest.raises(FileFormatError, match=r"configuration and tensors|expected float32 of shape"):
        load_weights(tmp_path / "w.safetensors")


def test_weights_of_a_detector_that_is_not_installed_name_the_package(network, tmp_path):
    class Foreign:
        def model_dump_json(self):
            return json.dumps(SMALL.model_dump(mode="json") | {"name": "my-detector"})

    save_weights(tmp_path / "w.safetensors", network.state_dict(), config=Foreign(), provenance={})
    with pytest.raises(FileFormatError, match="Install the package that has the detector my-detector"):
        load_weights(tmp_path / "w.safetensors")


def test_unknown_detector_lists_what_there_is():
    with pytest.raises(FarfieldError, match="bundled"):
        Detector.load("no-such-detector")


@pytest.mark.parametrize("precision", [torch.float32, torch.bfloat16])
def test_the_order_of_a_clouds_points_changes_nothing(network, precision):
    """In bfloat16 scores moved by 1.6e-3 with it: a mean that rounds otherwise in its last digit crosses a step."""
    points = torch.from_numpy(np.random.default_rng(0).uniform([2, -4, -2, 0], [20, 4, 2, 1], (20_000, 4))).float()
    points = points[:, : len(network.config.columns)]
    batch = torch.zeros(len(points), dtype=torch.int64)
    order = torch.from_numpy(np.random.default_rng(1).permutation(len(points)))
    with torch.no_grad(), torch.autocast("cpu", precision, enabled=precision != torch.float32):
        as_read, shuffled = (network.eval().encoder(rows, batch, 1) for rows in (points, points[order]))
    assert torch.equal(as_read, shuffled)
