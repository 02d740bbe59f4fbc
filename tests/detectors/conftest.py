"""A small scene, cars as L-shaped walls of points on a flat road, and each small detector trained on it once."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from small import SMALL, cloud_of, losses_of, small_detector

from farfield.detectors.network import Network
from farfield.detectors.runtime import Detector
from farfield.frame import Boxes, Cloud, Frame
from farfield.metrics import score


def wall_car(rng: np.random.Generator, x: float, y: float, yaw: float) -> np.ndarray:
    """Points on the rear and one side of a car."""
    along, up = rng.uniform(-2.2, 2.2, 60), rng.uniform(-0.7, 0.7, 120)
    across = rng.uniform(-0.9, 0.9, 60)
    local = np.concatenate([np.column_stack([along, np.full(60, 0.9)]), np.column_stack([np.full(60, -2.2), across])])
    turned = local @ np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    return np.column_stack([turned[:, 0] + x, turned[:, 1] + y, up - 1.2])


def made_scene(rng: np.random.Generator) -> Frame:
    """Five cars within 60 m, at headings all round."""
    places = [(10.0, 3.0, 0.1), (22.0, -8.0, 3.0), (35.0, 6.0, 1.5), (48.0, -3.0, -1.6), (57.0, 12.0, -2.4)]
    ground = np.column_stack([rng.uniform(2, 63, 1500), rng.uniform(-19, 19, 1500), rng.normal(-2, 0.02, 1500)])
    points = np.concatenate([ground, *[wall_car(rng, *place) for place in places]]).astype(np.float32)
    boxes = Boxes(
        centre_m=np.array([[x, y, -1.2] for x, y, _ in places]),
        size_m=np.tile([4.4, 1.8, 1.4], (5, 1)),
        yaw_rad=np.array([yaw for *_, yaw in places]),
        label="vehicle",
    )
    strength = np.full(len(points), 0.3, np.float32)
    return Frame.of(Cloud(points, strength, {"power": strength}), boxes)


@pytest.fixture
def scene(rng: np.random.Generator) -> Frame:
    """The small scene."""
    return made_scene(rng)


def quality(detector: Detector, scene: Frame) -> tuple[float, float]:
    """The detection score of a scene, and the cosine of the worst heading among the boxes nearest to those annotated.

    It is that of the whole heading, not only of its axis.
    """
    predicted, boxes = detector(scene.cloud()), scene.boxes
    if not len(predicted):
        return 0.0, -1.0
    result = score({scene.key: predicted}, {scene.key: boxes}, protocol="dds").to_json()
    gap = np.hypot(*(predicted.centre_m[:, None, :2] - boxes.centre_m[None, :, :2]).transpose(2, 0, 1))
    nearest = predicted.yaw_rad[gap.argmin(axis=0)]
    return float(result["dds"]["0"]["dds"]), float(np.cos(nearest - boxes.yaw_rad).min())


def _learnt(network: Network, scene: Frame) -> bool:
    known, heading = quality(Detector(network.eval(), precision="fp32", device="cpu"), scene)
    network.train()
    return known > 0.94 and heading > 0.97


def _train(name: str, folder: Path) -> None:
    scene, network = made_scene(np.random.default_rng(20260101)), small_detector(name)  # as the fixture rng
    cloud, boxes = cloud_of(network, scene.cloud()), scene.boxes
    optimizer = torch.optim.AdamW(network.parameters(), SMALL[name].learning_rate)
    for step in range(SMALL[name].steps):
        if step >= 35 and step % 5 == 0 and _learnt(network, scene):
            break
        for group in optimizer.param_groups:
            group["lr"] = SMALL[name].learning_rate * min(1.0, 1.5 - step / 80)  # falls once most have learnt
        optimizer.zero_grad()
        sum(losses_of(network, [cloud], [boxes]).values()).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 10.0)
        optimizer.step()
    folder.mkdir()
    torch.save(network.state_dict(), folder / "state.pt")


def _trained(made_once: Callable[[str, Callable[[Path], object]], Path], name: str) -> Network:
    folder = made_once(f"trained-{name}", partial(_train, name))
    network = small_detector(name)
    network.load_state_dict(torch.load(folder / "state.pt", weights_only=True))
    return network.eval()


@pytest.fixture(scope="session")
def trained(made_once: Callable[[str, Callable[[Path], object]], Path]) -> Callable[[str], Network]:
    """Gives a small detector that knows the scene by heart, trained by whichever worker asks first."""
    return partial(_trained, made_once)
