"""Simulated camera images and the places on their vehicles where number plates belong."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from farfield.files.atomic import open_atomic
from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera
from farfield.simulation import simulate_frame

LIGHTS = {
    "day": {"time": "day", "weather": "normal"},
    "night": {"time": "night", "weather": "normal"},
    "rain": {"time": "day", "weather": "rain"},
}


@dataclass(frozen=True)
class Place:
    """Where a plate belongs: from metres in its plane (x right, y down, origin the centre) to pixels, shape (3, 3)."""

    pixel_H_metres: np.ndarray

    def quad(self, width_m: float, height_m: float) -> np.ndarray:
        """Corners in pixels, clockwise from the upper left, shape (4, 2)."""
        half = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [width_m / 2, height_m / 2]
        drawn = np.column_stack([half, np.ones(4)]) @ self.pixel_H_metres.T
        return drawn[:, :2] / drawn[:, 2:]

    def moved(self, scale: float, shift: np.ndarray) -> "Place":
        """In a picture of pixels ``scale * (pixel - shift)``."""
        return Place(
            np.array([[scale, 0, -scale * shift[0]], [0, scale, -scale * shift[1]], [0, 0, 1]]) @ self.pixel_H_metres
        )


@dataclass(frozen=True)
class Scene:
    """A simulated picture, where plates belong, and what must not count: plates half hidden."""

    image: np.ndarray
    places: tuple[Place, ...]
    hidden: tuple[Place, ...]
    light: str
    boxes: Boxes = field(default_factory=Boxes.empty)
    camera: Camera | None = None


def simulated_scene(preset: str, seed: int, sequence: int, light: str, sizes: tuple[str, ...]) -> Scene:
    """A scene of the simulator with the places of plates."""
    frame = simulate_frame(
        preset, seed=seed, sequence=sequence, index=0, sensors=("camera",), sizes=sizes, **LIGHTS[light]
    )
    camera, annotation = frame.cameras["camera"], frame.annotation
    boxes = annotation.full_boxes if annotation.full_boxes is not None else annotation.boxes
    places, hidden = _places(boxes, camera)
    return Scene(frame.images["camera"], tuple(places), tuple(hidden), light, boxes, camera)


def _places(boxes: Boxes, camera: Camera) -> tuple[list[Place], list[Place]]:
    """Plates of the vehicles that are seen, and those that others hide in part."""
    hulls = []
    for row in range(len(boxes)):
        pixels, depth, _ = camera.project(boxes[row : row + 1].corners_m()[0])
        hulls.append(cv2.convexHull(pixels.astype(np.float32)) if (depth > 0.5).all() else None)
    seen, hidden = [], []
    away = np.linalg.norm(boxes.centre_m, axis=1)
    for row in range(len(boxes)):
        if str(boxes.label[row]) in ("pedestrian", "cyclist", "bicyclist", "bicycle", "animal"):
            continue
        for end in (1, -1):
            place = _place(boxes, row, end, camera)
            if place is None:
                continue
            points = np.vstack([place.quad(0.5, 0.16), place.quad(0.01, 0.01)[:1]])
            blocked = any(
                hulls[other] is not None
                and away[other] < away[row]
                and any(cv2.pointPolygonTest(hulls[other], (float(x), float(y)), False) >= 0 for x, y in points)
                for other in range(len(boxes))
                if other != row
            )
            (hidden if blocked else seen).append(place)
    return seen, hidden


def _place(boxes: Boxes, row: int, end: int, camera: Camera) -> Place | None:
    """The plate at the front (1) or rear (-1) of a vehicle, as the simulator has it; none if it looks away."""
    length, _, height = boxes.size_m[row]
    yaw = float(boxes.yaw_rad[row])
    ahead, left = np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    rise = (0.24 if end > 0 else 0.34) * height if height < 2.2 else 0.6
    centre = boxes.centre_m[row] + end * ahead * (length / 2 + 0.01) + [0, 0, rise - height / 2]
    if (end * ahead) @ -(centre / np.linalg.norm(centre)) < 0.2:
        return None
    right = left * end  # seen from outside
    corners = np.array([centre + x * right * 0.25 + [0, 0, -y * 0.25] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    pixels, depth, visible = camera.project(corners)
    if not visible.all() or depth.min() < 2.5:
        return None
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float32) * 0.25
    return Place(cv2.getPerspectiveTransform(square, pixels.astype(np.float32)))


def upright(quad: np.ndarray) -> np.ndarray:
    """Left, top, right, bottom around corners given in pixels' centres; right and bottom are not inside."""
    return np.concatenate([quad.min(axis=0), quad.max(axis=0)]) + 0.5


def zoomed(scene: Scene, rng: np.random.Generator, size_px: tuple[int, int] = (960, 540)) -> Scene:
    """The scene as a longer lens sees it, with a plate 16 to 80 pixels high somewhere in the picture."""
    if not scene.places or scene.camera is None:
        return scene
    box = upright(scene.places[int(rng.integers(len(scene.places)))].quad(0.45, 0.13))
    scale = float(np.exp(rng.uniform(np.log(16), np.log(80)))) / (box[3] - box[1])
    height, width = scene.image.shape[:2]
    scale = float(np.clip(scale, max(size_px[0] / width, size_px[1] / height), 8.0))
    side = np.array(size_px) / scale
    low = (box[:2] + box[2:]) / 2 - side * rng.uniform(0.25, 0.75, 2)
    low = np.floor(low.clip(0, np.array([width, height]) - side)).astype(int)
    high = np.minimum(low + np.round(side).astype(int), [width, height])
    scale_x, scale_y = np.array(size_px) / (high - low)
    image = cv2.resize(scene.image[low[1] : high[1], low[0] : high[0]], size_px, interpolation=cv2.INTER_LINEAR)
    moved = np.array([[scale_x, 0, -scale_x * (low[0] - 0.5) - 0.5], [0, scale_y, -scale_y * (low[1] - 0.5) - 0.5]])
    moved = np.vstack([moved, [0, 0, 1]])
    places, hidden = (tuple(Place(moved @ each.pixel_H_metres) for each in old) for old in (scene.places, scene.hidden))
    camera = replace(scene.camera, matrix=moved @ scene.camera.matrix, width_px=size_px[0], height_px=size_px[1])
    return Scene(image, places, hidden, scene.light, scene.boxes, camera)


def scenes_of(
    numbers: range,
    seed: int,
    sizes: tuple[str, ...],
    folder: Path | None = None,
    lights: tuple[str, ...] = tuple(LIGHTS),
) -> Iterator[Scene]:
    """Simulated scenes of two rigs in all lights; kept in a folder if there is one, so that the next call is fast."""
    for number in numbers:
        preset, light = ("cirrus-sim", "kitti-sim")[number % 2], lights[number % len(lights)]
        path = folder / f"{seed}_{number:04d}.npz" if folder is not None else None
        if path is not None and path.is_file():
            yield kept_scene(path)
            continue
        scene = simulated_scene(preset, seed, number, light, sizes)
        if path is not None:
            keep_scene(path, scene)
        yield scene


def keep_scene(path: Path, scene: Scene) -> None:
    """Write a scene without pickle."""
    boxes, camera = scene.boxes, scene.camera
    kept = {
        name: np.array([each.pixel_H_metres for each in getattr(scene, name)]).reshape(-1, 3, 3)
        for name in ("places", "hidden")
    }
    kept |= {f"box_{name}": np.asarray(getattr(boxes, name)) for name in ("centre_m", "size_m", "yaw_rad")}
    kept |= {f"camera_{name}": getattr(camera, name) for name in ("matrix", "distortion", "camera_T_lidar")}
    path.parent.mkdir(parents=True, exist_ok=True)
    with open_atomic(path) as file:
        np.savez(file, image=scene.image, light=scene.light, box_label=np.asarray(boxes.label, dtype=str), **kept)


def kept_scene(path: Path) -> Scene:
    """Read what :func:`keep_scene` wrote."""
    with np.load(path, allow_pickle=False) as told:
        image = told["image"]
        places, hidden = (tuple(Place(each) for each in told[name]) for name in ("places", "hidden"))
        boxes = Boxes(**{name: told[f"box_{name}"] for name in ("centre_m", "size_m", "yaw_rad", "label")})
        calibration = {name: told[f"camera_{name}"] for name in ("matrix", "distortion", "camera_T_lidar")}
        camera = Camera(**calibration, width_px=image.shape[1], height_px=image.shape[0])
        return Scene(image, places, hidden, str(told["light"]), boxes, camera)
