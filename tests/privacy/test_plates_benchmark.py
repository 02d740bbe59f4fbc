"""The benchmark that trains the plate network: plates stand where the homography says, and the loss is learnt."""

import sys
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("cv2")
sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks"))

import _plates_pool
from _plates_clutter import draw_clutter
from _plates_pool import filled_pool, train_networks
from _plates_scenes import FORMATS, Place, Scene, draw_plate, keep_scene, kept_scene, paste, upright
from _plates_training import SIDE, Crop, Sampler, loss_of, targets, tilted

from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera
from farfield.privacy.detectors import decode_plates, picture_sizes, predict_plate_maps
from farfield.privacy.image_boxes import pairwise_iou
from farfield.privacy.plate_network import PlateNetwork


def test_a_homography_draws_metres_as_pixels() -> None:
    """100 pixels a metre, origin at (50, 40); then at half the size from (10, 20) on."""
    place = Place(np.array([[100.0, 0, 50], [0, 100, 40], [0, 0, 1]]))
    np.testing.assert_allclose(place.quad(0.4, 0.2), [[30, 30], [70, 30], [70, 50], [30, 50]])
    np.testing.assert_allclose(place.moved(0.5, np.array([10, 20])).quad(0.4, 0.2)[[0, 2]], [[10, 5], [30, 15]])
    np.testing.assert_allclose(upright(place.quad(0.4, 0.2)), [30.5, 30.5, 70.5, 50.5])


def test_a_plate_changes_its_quad_and_nothing_else(rng) -> None:
    for form in FORMATS:
        place = tilted(rng, form.width_m, form.height_m, 24.0)
        image = np.full((SIDE, SIDE, 3), 7, dtype=np.uint8)
        plate, used = draw_plate(rng, form)
        assert used is form
        quad = place.quad(form.width_m, form.height_m)
        paste(image, np.full_like(plate, 200), quad, 1.0, rng)
        changed = np.argwhere((image != 7).any(axis=2))[:, ::-1]
        box = upright(quad)
        inner = box.clip(0, SIDE)
        assert (changed.min(axis=0) >= box[:2] - 2).all()
        assert (changed.max(axis=0) <= box[2:] + 1).all()
        np.testing.assert_allclose([*changed.min(axis=0), *(changed.max(axis=0) + 1)], inner, atol=2.5)


def test_a_kept_scene_comes_back(tmp_path: Path) -> None:
    place = Place(np.array([[100.0, 0, 50], [0, 100, 40], [0, 0, 1]]))
    boxes = Boxes(centre_m=np.ones((1, 3)), size_m=np.ones((1, 3)), yaw_rad=np.zeros(1), label="vehicle")
    camera = Camera(matrix=np.eye(3), width_px=9, height_px=8)
    scene = Scene(np.zeros((8, 9, 3), np.uint8), (place,), (), "night", boxes, camera)
    keep_scene(tmp_path / "a.npz", scene)
    again = kept_scene(tmp_path / "a.npz")
    assert (again.light, len(again.places), len(again.hidden), again.camera.width_px) == ("night", 1, 0, 9)
    np.testing.assert_array_equal(again.places[0].pixel_H_metres, place.pixel_H_metres)
    assert str(again.boxes.label[0]) == "vehicle"


def test_the_network_learns_two_crops_by_heart(rng) -> None:
    crops = []
    for high in (12.0, 30.0):
        place = Place(np.array([[high / 0.11, 0, 60], [0, high / 0.11, 70], [0, 0, 1]]) * 1.0)
        image = rng.integers(60, 90, (SIDE, SIDE, 3)).astype(np.uint8)
        quad = place.quad(0.22, 0.11)
        paste(image, draw_plate(rng, FORMATS[0])[0], quad, 1.0, rng)
        crops.append(Crop(image, upright(quad)[None]))
    made = [targets(crop) for crop in crops]
    maps, counts = (torch.from_numpy(np.stack([each[part] for each in made])) for part in (0, 1))
    images = torch.from_numpy(np.stack([crop.image for crop in crops])).permute(0, 3, 1, 2).float() / 255
    torch.manual_seed(0)
    network = PlateNetwork().train()
    optimiser = torch.optim.AdamW(network.parameters(), lr=3e-3)
    for _ in range(60):
        loss = loss_of(network(images), maps, counts)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    network.train()  # statistics of two crops: those of the batch itself
    with torch.no_grad():
        told = network(images)
        told[:, 0] = told[:, 0].sigmoid()
    for crop, each in zip(crops, told.numpy().astype(float), strict=True):
        best = decode_plates(each, 0.3)[:1]
        assert pairwise_iou(best.box_px, crop.boxes)[0, 0] > 0.6
    assert len(predict_plate_maps(network.eval(), picture_sizes(crops[0].image))) == 3


def test_a_pool_teaches_both_networks(monkeypatch) -> None:
    """Four crops and no time: one step each, and networks that can be saved."""
    monkeypatch.setattr(_plates_pool, "PROPOSED", 0.0)
    place = Place(np.array([[100.0, 0, 60], [0, 100, 60], [0, 0, 1]]))
    scene = Scene(np.full((300, 400, 3), 90, np.uint8), (place,), (), "day")
    pool = filled_pool(Sampler([scene], 1), 4, 1)
    assert (pool.image.reshape(4, -1).std(axis=1) > 0).all()
    finder, judge = train_networks(pool, 1, seconds=1.0, device="cpu")
    assert not finder.training
    assert all(bool(torch.isfinite(value).all()) for value in judge.state_dict().values())


def test_clutter_is_drawn_again_from_the_same_seed() -> None:
    for seed in range(20):
        one, other = (draw_clutter(np.random.default_rng(seed), 64) for _ in range(2))
        assert one.shape == (64, 64, 3)
        assert one.dtype == np.uint8
        np.testing.assert_array_equal(one, other)
