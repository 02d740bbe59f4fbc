"""What every detector must do, whatever its paper."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from small import SMALL, small_detector

from farfield.detectors import DETECTORS
from farfield.detectors.folding import fold_batch_norm
from farfield.detectors.runtime import Detector, cloud_tensor
from farfield.detectors.weights import load_weights, save_weights
from farfield.frame import Boxes, Cloud
from farfield.metrics import score

every_detector = pytest.mark.parametrize("name", list(DETECTORS))


def tensors_of(outputs):
    """All tensors in whatever a network returns, in a fixed order."""
    if torch.is_tensor(outputs):
        return [outputs]
    if isinstance(outputs, dict):
        return [t for key in sorted(outputs) for t in tensors_of(outputs[key])]
    if isinstance(outputs, tuple | list):
        return [t for part in outputs for t in tensors_of(part)]
    return [t for part in vars(outputs).values() for t in tensors_of(part)] if hasattr(outputs, "__dict__") else []


def one_loss(network, clouds, boxes):
    targets = [network.targets(b, c.numpy()) for b, c in zip(boxes, clouds, strict=True)]
    return network.loss(network(clouds, targets), targets)


def same(one: Boxes, other: Boxes, *, tolerance: float = 1e-3) -> None:
    """Equal boxes within a tolerance; weak ones may come in another order."""
    assert len(one) == len(other)
    for name in ("centre_m", "size_m", "score"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=tolerance, rtol=tolerance)
    assert one.label.tolist() == other.label.tolist()


def test_every_registered_detector_is_tested():
    assert list(SMALL) == list(DETECTORS)


@every_detector
def test_forward_has_no_nan_and_every_parameter_gets_a_gradient(name, scene):
    network = small_detector(name)
    cloud = cloud_tensor(scene.cloud())
    outputs = tensors_of(network([cloud]))
    assert outputs
    assert all(torch.isfinite(part).all() for part in outputs)
    sum(one_loss(network, [cloud], [scene.boxes])).backward()
    without = [key for key, p in network.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
    assert without == []


@every_detector
def test_overfits_one_frame(name, scene):
    network = small_detector(name)
    cloud, boxes = cloud_tensor(scene.cloud()), scene.boxes
    optimizer = torch.optim.AdamW(network.parameters(), SMALL[name].learning_rate)
    for _ in range(SMALL[name].steps):
        optimizer.zero_grad()
        sum(one_loss(network, [cloud], [boxes])).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 10.0)
        optimizer.step()
    predicted = Detector(network, precision="fp32", device="cpu")(scene)
    result = score({scene.key: predicted}, {scene.key: boxes}, protocol="dds").to_json()
    assert result["dds"]["0"]["dds"] > 0.9
    gap = np.hypot(*(predicted.centre_m[:, None, :2] - boxes.centre_m[None, :, :2]).transpose(2, 0, 1))
    best = gap.argmin(axis=0)  # the prediction nearest to each box
    assert np.cos(predicted.yaw_rad[best] - boxes.yaw_rad).min() > 0.9  # the whole heading, not only its axis


@every_detector
def test_same_seed_same_network_same_input_same_boxes(name, scene):
    one, other = (small_detector(name, score_threshold=0.0, max_boxes=50) for _ in range(2))
    first, again = (Detector(n, precision="fp32", device="cpu") for n in (one, other))
    a, b, c = first(scene), first(scene), again(scene)
    for x in (b, c):
        np.testing.assert_array_equal(a.centre_m, x.centre_m)
        np.testing.assert_array_equal(a.score, x.score)


@every_detector
def test_a_step_of_training_is_deterministic(name, scene):
    gradients = []
    for _ in range(2):
        network = small_detector(name)
        sum(one_loss(network, [cloud_tensor(scene.cloud())], [scene.boxes])).backward()
        gradients.append([p.grad for p in network.parameters()])
    assert all(torch.equal(a, b) for a, b in zip(*gradients, strict=True))


@every_detector
def test_batch_of_many_equals_many_of_one(name, scene):
    network = small_detector(name, score_threshold=0.0, max_boxes=30).eval()
    first = cloud_tensor(scene.cloud())
    second = first[::3] * torch.tensor([1.0, -1.0, 1.0, 1.0, 1.0])
    clouds = [first, torch.zeros(0, 5), second]
    found = network.predict(clouds)
    assert len(found) == len(clouds)
    for together, cloud in zip(found, clouds, strict=True):
        same(together, network.predict([cloud])[0])


@every_detector
@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((7, 3), 500.0), np.full((3, 3), np.nan), np.ones((1, 3))])
def test_clouds_without_usable_points_give_no_error(name, points):
    cloud = Cloud(points.astype(np.float32), np.zeros(len(points), np.float32))
    network = small_detector(name)
    assert len(Detector(network, precision="fp32", device="cpu")(cloud)) >= 0
    losses = one_loss(network.train(), [cloud_tensor(cloud)], [Boxes.empty()])
    assert all(torch.isfinite(loss) for loss in losses)
    sum(losses).backward()


@every_detector
def test_a_cloud_with_no_box_teaches_its_background(name, scene):
    network = small_detector(name)
    losses = one_loss(network, [cloud_tensor(scene.cloud())], [Boxes.empty()])
    assert all(torch.isfinite(loss) for loss in losses)
    sum(losses).backward()
    assert any(p.grad is not None and p.grad.abs().sum() > 0 for p in network.parameters())


@every_detector
def test_boxes_without_a_point_do_no_harm(name, scene):
    network = small_detector(name)
    losses = one_loss(network, [torch.zeros(0, 5), cloud_tensor(scene.cloud())], [scene.boxes, scene.boxes])
    assert all(torch.isfinite(loss) for loss in losses)


@every_detector
def test_folding_changes_nothing_but_speed(name, scene):
    network = small_detector(name, score_threshold=0.0, max_boxes=30)
    cloud = cloud_tensor(scene.cloud())
    with torch.no_grad():
        for _ in range(5):
            network([cloud])  # statistics of the normalisation
    network.eval()
    folded = fold_batch_norm(network)
    assert not any(isinstance(m, torch.nn.modules.batchnorm._BatchNorm) for m in folded.modules())
    one, other = network.predict([cloud])[0], folded.predict([cloud])[0]
    np.testing.assert_allclose(np.sort(one.score), np.sort(other.score), atol=2e-3)


@every_detector
def test_bf16_finds_nearly_the_same(name, scene):
    network = small_detector(name, score_threshold=0.0, max_boxes=30)
    exact, coarse = (Detector(network, precision=precision, device="cpu")(scene) for precision in ("fp32", "bf16"))
    assert np.isfinite(coarse.score).all()
    np.testing.assert_allclose(np.sort(exact.score)[-10:], np.sort(coarse.score)[-10:], atol=0.05)


def test_dense_middle_layers_of_voxelnet_run_in_bf16_too(scene):
    network = small_detector("voxelnet", middle="dense", score_threshold=0.0, max_boxes=30)
    exact, coarse = (Detector(network, precision=precision, device="cpu")(scene) for precision in ("fp32", "bf16"))
    np.testing.assert_allclose(np.sort(exact.score)[-10:], np.sort(coarse.score)[-10:], atol=0.05)


@every_detector
def test_far_boxes_weigh_more_where_asked(name, scene):
    plain, weighted = small_detector(name), small_detector(name, far_weight=4.0)
    assert plain.config.box_weights(scene.boxes).tolist() == [1.0] * len(scene.boxes)
    reach_m = np.hypot(scene.boxes.centre_m[:, 0], scene.boxes.centre_m[:, 1])
    np.testing.assert_allclose(weighted.config.box_weights(scene.boxes), 1 + 0.04 * reach_m)
    cloud = cloud_tensor(scene.cloud())
    a, b = (sum(one_loss(network, [cloud], [scene.boxes])).detach() for network in (plain, weighted))
    assert abs(float(a) - float(b)) > 1e-6


@every_detector
def test_weights_travel_with_their_configuration(name, scene, tmp_path):
    network = small_detector(name)
    save_weights(tmp_path / "w.safetensors", network.state_dict(), config=network.config, provenance={"seed": 3})
    loaded, provenance = load_weights(tmp_path / "w.safetensors")
    assert provenance == {"seed": 3}
    assert loaded.config == network.config
    cloud = cloud_tensor(scene.cloud())
    same(loaded.predict([cloud])[0], network.eval().predict([cloud])[0], tolerance=1e-6)
    save_weights(tmp_path / "h.safetensors", network.state_dict(), config=network.config, provenance={}, half=True)
    halved = load_weights(tmp_path / "h.safetensors")[0].state_dict()
    assert (tmp_path / "h.safetensors").stat().st_size < 0.75 * (tmp_path / "w.safetensors").stat().st_size
    for key, value in network.state_dict().items():
        assert halved[key].dtype == value.dtype
        torch.testing.assert_close(halved[key], value, rtol=1e-3, atol=1e-6)
