"""What every detector must do, whatever its paper."""

import hashlib

import numpy as np
import pytest

torch = pytest.importorskip("torch")


from small import SMALL, batch_of, cloud_of, losses_of, small_detector

from farfield.detectors import DETECTORS, build_detector
from farfield.detectors.layers import fold_batch_norm
from farfield.detectors.runtime import Detector
from farfield.detectors.weights import load_weights, save_weights
from farfield.frame import Boxes, Cloud
from farfield.metrics import score
from farfield.testing import detectors as checks

every_detector = pytest.mark.parametrize("name", list(DETECTORS))

PARAMETERS = {  # digests of the names and shapes in the state dict: weights files hang on them
    "pointpillars": "f53950d04c95de6c",
    "pointrcnn": "6a22d98bc7742766",
    "rtn": "ad0d0d5b83cd269c",
    "rtnh": "733782d591e7c4f3",
    "second": "e6eef3a43b3af6c0",
    "sparsecentre": "528681b455c0732d",
    "voxelnet": "d73f05a9c4ad1231",
}


def same(one: Boxes, other: Boxes, *, tolerance: float = 1e-3) -> None:
    """Equal boxes within a tolerance; weak ones may come in another order."""
    assert len(one) == len(other)
    for name in ("centre_m", "size_m", "score"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=tolerance, rtol=tolerance)
    assert one.label.tolist() == other.label.tolist()


def test_every_registered_detector_is_tested():
    assert list(SMALL) == list(DETECTORS) == list(PARAMETERS)


@every_detector
@pytest.mark.parametrize("check", checks.CHECKS, ids=lambda check: check.__name__)
def test_contract(name, check):
    check(checks.built(name, SMALL[name].settings))


@every_detector
def test_no_parameter_moved(name):
    state = small_detector(name).state_dict()
    text = "\n".join(f"{key} {tuple(value.shape)}" for key, value in state.items())
    assert hashlib.sha256(text.encode()).hexdigest()[:16] == PARAMETERS[name]


@every_detector
def test_assigner_of_the_published_network_is_small_too(name):
    with torch.device("meta"):
        network = build_detector(DETECTORS[name].config_class.model_validate({"name": name}))
    checks.check_assigner_is_small(network)


@every_detector
def test_forward_has_no_nan_and_every_parameter_gets_a_gradient(name, scene):
    network = small_detector(name)
    cloud = cloud_of(network, scene.cloud())
    outputs = checks.tensors_of(network(batch_of(cloud)))
    assert outputs
    assert all(torch.isfinite(part).all() for part in outputs)
    sum(losses_of(network, [cloud], [scene.boxes]).values()).backward()
    without = [key for key, p in network.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
    assert without == []


@every_detector
def test_overfits_one_frame(name, scene, trained):
    predicted, boxes = Detector(trained(name), precision="fp32", device="cpu")(scene.cloud()), scene.boxes
    result = score({scene.key: predicted}, {scene.key: boxes}, protocol="dds").to_json()
    assert result["dds"]["0"]["dds"] > 0.9
    gap = np.hypot(*(predicted.centre_m[:, None, :2] - boxes.centre_m[None, :, :2]).transpose(2, 0, 1))
    best = gap.argmin(axis=0)  # the prediction nearest to each box
    assert np.cos(predicted.yaw_rad[best] - boxes.yaw_rad).min() > 0.9  # the whole heading, not only its axis


@every_detector
def test_same_seed_same_network_same_input_same_boxes(name, scene):
    one, other = (small_detector(name, score_threshold=0.0, max_boxes=50) for _ in range(2))
    first, again = (Detector(n, precision="fp32", device="cpu") for n in (one, other))
    a, b, c = (detector(scene.cloud()) for detector in (first, first, again))
    for x in (b, c):
        np.testing.assert_array_equal(a.centre_m, x.centre_m)
        np.testing.assert_array_equal(a.score, x.score)


@every_detector
def test_a_step_of_training_is_deterministic(name, scene):
    gradients = []
    for _ in range(2):
        network = small_detector(name)
        sum(losses_of(network, [cloud_of(network, scene.cloud())], [scene.boxes]).values()).backward()
        gradients.append([p.grad for p in network.parameters()])
    assert all(torch.equal(a, b) for a, b in zip(*gradients, strict=True))


@every_detector
def test_batch_of_many_equals_many_of_one(name, scene):
    network = small_detector(name, score_threshold=0.0, max_boxes=30).eval()
    first = cloud_of(network, scene.cloud())
    second = first[::3].clone()
    second[:, 1] *= -1
    clouds = [first, first[:0], second]
    found = network.predict(batch_of(*clouds))
    assert len(found) == len(clouds)
    for together, cloud in zip(found, clouds, strict=True):
        same(together, network.predict(batch_of(cloud))[0])


@every_detector
@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((7, 3), 500.0), np.full((3, 3), np.nan), np.ones((1, 3))])
def test_clouds_without_usable_points_give_no_error(name, points):
    strength = np.zeros(len(points), np.float32)
    cloud = Cloud(points.astype(np.float32), strength, {"power": strength})
    network = small_detector(name)
    assert len(Detector(network, precision="fp32", device="cpu")(cloud)) >= 0
    losses = losses_of(network.train(), [cloud_of(network, cloud)], [Boxes.empty()])
    assert all(torch.isfinite(loss) for loss in losses.values())
    sum(losses.values()).backward()


@every_detector
def test_a_cloud_with_no_box_teaches_its_background(name, scene):
    network = small_detector(name)
    losses = losses_of(network, [cloud_of(network, scene.cloud())], [Boxes.empty()])
    assert all(torch.isfinite(loss) for loss in losses.values())
    sum(losses.values()).backward()
    assert any(p.grad is not None and p.grad.abs().sum() > 0 for p in network.parameters())


@every_detector
def test_boxes_without_a_point_do_no_harm(name, scene):
    network = small_detector(name)
    cloud = cloud_of(network, scene.cloud())
    losses = losses_of(network, [cloud[:0], cloud], [scene.boxes, scene.boxes])
    assert all(torch.isfinite(loss) for loss in losses.values())


@every_detector
def test_folding_changes_nothing_but_speed(name, scene, trained):
    network = trained(name)
    folded = fold_batch_norm(network)
    assert not any(isinstance(m, torch.nn.modules.batchnorm._BatchNorm) for m in folded.modules())
    batch = batch_of(cloud_of(network, scene.cloud()))
    one, other = network.predict(batch)[0], folded.predict(batch)[0]
    same(one[one.score > 0.5], other[other.score > 0.5], tolerance=2e-3)


@every_detector
def test_folding_an_untrained_network_changes_nothing_but_speed(name, scene):
    network = small_detector(name, score_threshold=0.0, max_boxes=30)
    batch = batch_of(cloud_of(network, scene.cloud()))
    with torch.no_grad():
        for _ in range(2):
            network(batch)  # statistics of the normalisation
    network.eval()
    one, other = network.predict(batch)[0], fold_batch_norm(network).predict(batch)[0]
    np.testing.assert_allclose(np.sort(one.score), np.sort(other.score), atol=2e-3)


@every_detector
def test_bf16_finds_nearly_the_same(name, scene):
    network = small_detector(name, score_threshold=0.0, max_boxes=30)
    exact, coarse = (
        Detector(network, precision=precision, device="cpu")(scene.cloud()) for precision in ("fp32", "bf16")
    )
    assert np.isfinite(coarse.score).all()
    np.testing.assert_allclose(np.sort(exact.score)[-10:], np.sort(coarse.score)[-10:], atol=0.05)


@every_detector
def test_bf16_finds_the_same_objects(name, scene, trained):
    exact, coarse = (Detector(trained(name), precision=p, device="cpu")(scene.cloud()) for p in ("fp32", "bf16"))
    for boxes in (exact, coarse):
        gap = np.hypot(*(boxes[:5].centre_m[:, None, :2] - scene.boxes.centre_m[None, :, :2]).transpose(2, 0, 1))
        assert sorted(gap.argmin(axis=1)) == [0, 1, 2, 3, 4]


def test_dense_middle_layers_of_voxelnet_run_in_bf16_too(scene):
    network = small_detector("voxelnet", middle="dense", score_threshold=0.0, max_boxes=30)
    exact, coarse = (
        Detector(network, precision=precision, device="cpu")(scene.cloud()) for precision in ("fp32", "bf16")
    )
    np.testing.assert_allclose(np.sort(exact.score)[-10:], np.sort(coarse.score)[-10:], atol=0.05)


@every_detector
def test_far_boxes_weigh_more_where_asked(name, scene):
    plain, weighted = small_detector(name), small_detector(name, far_weight=4.0)
    assert plain.config.box_weights(scene.boxes).tolist() == [1.0] * len(scene.boxes)
    reach_m = np.hypot(scene.boxes.centre_m[:, 0], scene.boxes.centre_m[:, 1])
    np.testing.assert_allclose(weighted.config.box_weights(scene.boxes), 1 + 0.04 * reach_m)
    cloud = cloud_of(plain, scene.cloud())
    losses = (losses_of(network, [cloud], [scene.boxes]) for network in (plain, weighted))
    a, b = (sum(parts.values()).detach() for parts in losses)
    assert abs(float(a) - float(b)) > 1e-6


@every_detector
def test_weights_travel_with_their_configuration(name, scene, trained, tmp_path):
    network = trained(name)
    save_weights(tmp_path / "w.safetensors", network.state_dict(), config=network.config, provenance={"seed": 3})
    loaded, provenance = load_weights(tmp_path / "w.safetensors")
    assert provenance == {"seed": 3}
    assert loaded.config == network.config
    batch = batch_of(cloud_of(network, scene.cloud()))
    same(loaded.predict(batch)[0], network.predict(batch)[0], tolerance=1e-6)
    save_weights(tmp_path / "h.safetensors", network.state_dict(), config=network.config, provenance={}, half=True)
    halved = load_weights(tmp_path / "h.safetensors")[0].state_dict()
    assert (tmp_path / "h.safetensors").stat().st_size < 0.75 * (tmp_path / "w.safetensors").stat().st_size
    for key, value in network.state_dict().items():
        assert halved[key].dtype == value.dtype
        torch.testing.assert_close(halved[key], value, rtol=1e-3, atol=1e-4)
