"""Simulated camera images and the places on their vehicles where number plates belong."""

from collections.abc import Iterator
from dataclasses import dataclass, field
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
