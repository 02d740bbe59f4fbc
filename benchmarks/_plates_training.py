"""The crops that the network of number plates learns from, and its training."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import torch
from _plates_clutter import draw_clutter
from _plates_scenes import (
    FONTS,
    Place,
    Scene,
    cover,
    degraded,
    draw_plate,
    light_of,
    paste,
    random_string,
    text_on,
    upright,
)
from PIL import Image, ImageDraw

from farfield.privacy.plate_network import STRIDE

# Crops with and without number plates, as the network that finds them learns from.


SIDE = 128
LEAST_PX, MOST_PX, WIDEST_PX = 5.0, 42.0, 92.0
_SHIPPED_PICTURES = {
    "skimage": tuple(
        f"data/{name}"
        for name in (
            *("brick.png", "camera.png", "cat.png", "chelsea.png", "coffee.png", "coins.png", "clock_motion.png"),
            *("grass.png", "gravel.png", "hubble_deep_field.jpg", "page.png", "rocket.jpg", "text.png", "retina.jpg"),
        )
    ),
    "sklearn": ("datasets/images/china.jpg", "datasets/images/flower.jpg"),
}


@dataclass
class Crop:
    """A picture of 128 pixels a side, its plates, and boxes in which nothing counts."""

    image: np.ndarray
    boxes: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    ignored: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))


def free_pictures() -> list[np.ndarray]:
    """Pictures without plates that matplotlib, scikit-image and scikit-learn ship, where these are installed.

    The astronaut is not among them, for the pictures that the result is measured on have her too.
    """
    import matplotlib

    folder = Path(matplotlib.get_data_path()) / "sample_data"
    paths = [folder / name for name in ("grace_hopper.jpg", "Minduka_Present_Blue_Pack.png", "logo2.png")]
    for package, names in _SHIPPED_PICTURES.items():
        spec = find_spec(package)
        if spec is not None and spec.origin is not None:
            paths += [Path(spec.origin).parent / name for name in names]
    return [np.asarray(Image.open(path).convert("RGB")) for path in paths if path.is_file()]


def cut(image: np.ndarray, centre: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """A square around a point, drawn at ``scale`` in 128 pixels, and its upper left corner in the picture."""
    side = max(4, round(SIDE / scale))
    low = np.round(centre - side / 2).astype(int)
    height, width = image.shape[:2]
    inner = image[max(low[1], 0) : max(low[1] + side, 1), max(low[0], 0) : max(low[0] + side, 1)]
    if not inner.size:
        return np.full((SIDE, SIDE, 3), 90, np.uint8), low
    if inner.shape[:2] != (side, side):
        top, left = max(-low[1], 0), max(-low[0], 0)
        bottom, right = max(low[1] + side - height, 0), max(low[0] + side - width, 0)
        inner = cv2.copyMakeBorder(
            inner,
            top,
            bottom,
            left,
            right,
            cv2.BORDER_REFLECT_101
            if min(inner.shape[:2]) > max(top, bottom, left, right) + 1
            else cv2.BORDER_REPLICATE,
        )
    return cv2.resize(inner, (SIDE, SIDE), interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR), low


def tilted(rng: np.random.Generator, width_m: float, height_m: float, high_px: float) -> Place:
    """A plate seen from anywhere, at times by a camera that is rolled."""
    yaw, pitch = rng.uniform(-1.3, 1.3) * rng.random() ** 0.4, rng.normal(0, 0.2)
    roll = rng.uniform(-0.9, 0.9) if rng.random() < 0.3 else rng.normal(0, 0.08)
    turn = _rotation(2, roll) @ _rotation(0, pitch) @ _rotation(1, yaw)
    away = rng.uniform(2.0, 10.0) * width_m
    flat = np.column_stack([turn[:, 0], turn[:, 1], [0, 0, away]])
    flat[:2] *= away
    quad = Place(flat).quad(width_m, height_m)
    extent = np.ptp(quad, axis=0)
    scale = min(high_px / extent[1], WIDEST_PX / extent[0])
    centre = rng.uniform(0.2, 0.8, 2) * SIDE
    return Place(np.array([[scale, 0, centre[0]], [0, scale, centre[1]], [0, 0, 1]]) @ flat)


def _rotation(axis: int, angle: float) -> np.ndarray:
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.eye(3)
    one, two = [row for row in range(3) if row != axis]
    turn[one, one], turn[one, two], turn[two, one], turn[two, two] = cos, -sin, sin, cos
    return turn


def draw_board(rng: np.random.Generator) -> tuple[np.ndarray, float, float]:
    """Something that is no plate: a sign, a text board, a window, lane paint, a blank rectangle; its size in metres."""
    kind = int(rng.integers(7))
    wide, high = rng.uniform(0.3, 2.0), rng.uniform(0.15, 1.2)
    width, height = max(8, round(160 * min(1, wide / high))), max(8, round(160 * min(1, high / wide)))
    ground = tuple(
        int(value) for value in (rng.uniform(0, 255, 3) if rng.random() < 0.6 else [rng.uniform(150, 255)] * 3)
    )
    ink = tuple(int(value) for value in (rng.uniform(0, 255, 3) if rng.random() < 0.4 else [rng.choice([10, 245])] * 3))
    image = Image.new("RGB", (width, height), ground)
    pen = ImageDraw.Draw(image)
    if kind in (0, 1):  # lines of text
        lines = int(rng.integers(2, 6))
        for line in range(lines):
            top, left = height * (line + 0.15) / lines, width * rng.uniform(0.02, 0.3)
            words = random_string(rng, int(rng.integers(3, 18)))
            text_on(
                image,
                words.lower() if rng.random() < 0.6 else words,
                (left, top, width * rng.uniform(0.6, 0.98), top + height * 0.6 / lines),
                str(rng.choice(FONTS)),
                ink,
            )
    elif kind == 2:  # a round sign
        pen.ellipse((0, 0, width - 1, height - 1), fill=ink, outline=(200, 20, 20), width=max(2, width // 8))
        text_on(
            image,
            random_string(rng, 2),
            (width * 0.3, height * 0.3, width * 0.7, height * 0.7),
            FONTS[0],
            (10, 10, 10),
        )
    elif kind == 3:  # windows, a grille
        rows, columns = int(rng.integers(1, 7)), int(rng.integers(1, 9))
        for row in range(rows):
            for column in range(columns):
                at = (width * (column + 0.1) / columns, height * (row + 0.1) / rows)
                pen.rectangle((*at, at[0] + width * 0.75 / columns, at[1] + height * 0.75 / rows), fill=ink)
    elif kind == 4:  # an arrow or stripes
        for stripe in range(int(rng.integers(1, 5))):
            left = width * (0.05 + 0.25 * stripe)
            pen.polygon(
                [(left, 0), (left + width * 0.1, 0), (left + width * 0.2, height), (left + width * 0.08, height)],
                fill=ink,
            )
    elif kind == 5:  # a lamp or a badge
        pen.ellipse(
            (width * 0.1, height * 0.1, width * 0.9, height * 0.9), fill=tuple(int(v) for v in rng.uniform(120, 255, 3))
        )
    return np.asarray(image), wide, high


def vehicle_end(image: np.ndarray, place: Place, rng: np.random.Generator) -> None:
    """Body, lamps and a dark strip around a plate, in its plane, in place."""
    if rng.random() < 0.25:
        return
    wide, tall, down = rng.uniform(0.7, 2.2), rng.uniform(0.35, 1.2), rng.uniform(-0.4, 0.3)
    colour = rng.uniform(10, 240, 3) if rng.random() < 0.4 else np.full(3, rng.uniform(10, 235))
    patch = np.linspace(colour * rng.uniform(0.5, 1), colour, 48)[:, None] * np.ones((1, 96, 1))
    patch = patch.clip(0, 255).astype(np.uint8)
    if rng.random() < 0.6:
        low, thick = int(rng.integers(8, 40)), int(rng.integers(3, 14))
        patch[low : low + thick] = rng.uniform(5, 60)
        if rng.random() < 0.4:
            patch[low : low + thick : 3] = rng.uniform(40, 160)
    if rng.random() < 0.7:
        lamp = [200, 30, 30] if rng.random() < 0.5 else [235, 235, 225]
        top, high, across = int(rng.integers(2, 24)), int(rng.integers(5, 14)), int(rng.integers(8, 22))
        patch[top : top + high, :across] = patch[top : top + high, -across:] = lamp
    if rng.random() < 0.5:
        patch = cv2.GaussianBlur(patch, (0, 0), 1.5)
    shifted = Place(place.pixel_H_metres @ np.array([[1, 0, rng.normal(0, 0.1)], [0, 1, down], [0, 0, 1.0]]))
    flat = shifted.quad(wide, tall)
    if np.isfinite(flat).all() and np.abs(flat).max() < 2000:
        paste(image, patch, flat, float(rng.uniform(0.6, 1.1)), rng)


def faded(plate: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """At times a plate whose writing hardly shows: bleached, dirty, in the dark, shining back, or out of focus."""
    image = plate.astype(np.float32)
    draw = rng.random()
    if draw < 0.35:
        ground = np.median(image.reshape(-1, 3), axis=0)
        image = ground + (image - ground) * rng.uniform(0.12, 0.7)
    elif draw < 0.45:
        image = 255 - image * rng.uniform(0.5, 1.0)
    elif draw < 0.55:
        image = image + rng.uniform(20, 120)
    if rng.random() < 0.25:
        image = cv2.GaussianBlur(image, (0, 0), float(rng.uniform(1.0, 7.0)))
    if rng.random() < 0.3:  # half in the shadow
        rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
        edge = columns * rng.normal() + rows * rng.normal() > rng.normal(0, 60)
        image = image * np.where(edge, rng.uniform(0.3, 0.7), 1.0)[..., None].astype(np.float32)
    return image.clip(0, 255).astype(np.uint8)


class Sampler:
    """Draws crops; the same number gives the same crop.

    Plates are no crisper than what is around them, pictures are sharpened at times, and many plates are away from the
    simulated vehicles: against what drawn crops have and photographs have not.

    Args:
        scenes: Where plates belong.
        seed: Of all crops.
    """

    def __init__(self, scenes: Sequence[Scene], seed: int) -> None:
        self.scenes, self.seed, self.pictures = scenes, seed, free_pictures()
        self.spots = [(scene, place) for scene in scenes for place in scene.places]

    def __call__(self, number: int) -> Crop:
        """The crop of that number."""
        rng = np.random.default_rng([self.seed, number])
        draw = rng.random()
        crop = self._on_vehicle(rng) if draw < 0.3 else self._free(rng) if draw < 0.58 else self._without(rng)
        return self._finished(crop, rng)

    def _finished(self, crop: Crop, rng: np.random.Generator) -> Crop:
        if rng.random() < 0.3:
            low = cv2.GaussianBlur(crop.image, (0, 0), float(rng.uniform(0.7, 2.0)))
            crop.image = cv2.addWeighted(crop.image, 1.7, low, -0.7, 0)
        crop.image = degraded(crop.image, rng, strong=True)
        if rng.random() < 0.5:
            crop.image = np.ascontiguousarray(crop.image[:, ::-1])
            flip = [2, 1, 0, 3]
            crop.boxes, crop.ignored = (
                np.where([True, False, True, False], SIDE - boxes, boxes)[:, flip] if len(boxes) else boxes
                for boxes in (crop.boxes, crop.ignored)
            )
        return crop

    def _on_vehicle(self, rng: np.random.Generator) -> Crop:
        scene, place = self.spots[int(rng.integers(len(self.spots)))]
        plate, form = draw_plate(rng)
        box = upright(place.quad(form.width_m, form.height_m))
        wanted = np.exp(rng.uniform(np.log(LEAST_PX), np.log(MOST_PX)))
        scale = min(wanted / (box[3] - box[1]), WIDEST_PX / (box[2] - box[0]), 4.0)
        centre = (box[:2] + box[2:]) / 2 + rng.uniform(-0.33, 0.33, 2) * SIDE / scale
        return self._around(scene, centre, scale, rng, (place, plate, form))

    def _around(
        self, scene: Scene, centre: np.ndarray, scale: float, rng: np.random.Generator, first: tuple | None
    ) -> Crop:
        """A piece of a scene with plates on all vehicles, or, without a first one, on none."""
        image, low = cut(scene.image, centre, scale)
        boxes, ignored = [], []
        for place in scene.places:
            here = place.moved(scale, low + 0.5 - 0.5 / scale)
            quad = here.quad(0.52, 0.2)
            if (quad.max(axis=0) < -2).any() or (quad.min(axis=0) > SIDE + 2).any():
                continue
            cover(image, here, rng)
            if first is None:
                continue
            plate, form = first[1:] if place is first[0] else draw_plate(rng)
            plate = faded(plate, rng) if rng.random() < 0.5 else plate
            quad = here.quad(form.width_m, form.height_m)
            paste(image, plate, quad, light_of(scene.light, scene.image, rng), rng)
            box = upright(quad)
            right_size = LEAST_PX * 0.8 <= box[3] - box[1] <= MOST_PX * 1.2 and box[2] - box[0] < WIDEST_PX * 1.2
            centre_in = ((box[:2] + box[2:]) / 2 >= 0).all() and ((box[:2] + box[2:]) / 2 < SIDE).all()
            (boxes if right_size and centre_in else ignored).append(box)
        if scale > 1.3 and rng.random() < 0.7:
            image = cv2.GaussianBlur(image, (0, 0), 0.35 * scale)
        ignored += [upright(place.moved(scale, low + 0.5 - 0.5 / scale).quad(0.6, 0.25)) for place in scene.hidden]
        return Crop(image, np.array(boxes).reshape(-1, 4), np.array(ignored).reshape(-1, 4))

    def _background(self, rng: np.random.Generator) -> Crop:
        draw = rng.random()
        if draw < 0.35:
            return Crop(draw_clutter(rng, SIDE))
        if draw < 0.50:
            picture = self.pictures[int(rng.integers(len(self.pictures)))]
            height, width = picture.shape[:2]
            scale = float(np.exp(rng.uniform(np.log(0.25), np.log(1.5))))
            return Crop(cut(picture, rng.uniform(0, 1, 2) * [width, height], scale)[0])
        if draw < 0.55:
            low = rng.uniform(0, 255, (int(rng.integers(2, 30)), int(rng.integers(2, 30)), 3)).astype(np.uint8)
            return Crop(cv2.resize(low, (SIDE, SIDE), interpolation=int(rng.choice([0, 1, 2]))))
        scene = self.scenes[int(rng.integers(len(self.scenes)))]
        height, width = scene.image.shape[:2]
        scale = float(np.exp(rng.uniform(np.log(0.25), np.log(1.0))))
        return self._around(scene, rng.uniform(0, 1, 2) * [width, height], scale, rng, None)

    def _free(self, rng: np.random.Generator) -> Crop:
        crop = self._without(rng)
        plate, form = draw_plate(rng)
        high = float(np.exp(rng.uniform(np.log(LEAST_PX + 1), np.log(MOST_PX))))
        place = tilted(rng, form.width_m, form.height_m, high)
        quad = place.quad(form.width_m, form.height_m)
        box = upright(quad)
        if not np.isfinite(quad).all() or box[3] - box[1] < LEAST_PX * 0.8:
            return crop
        vehicle_end(crop.image, place, rng)
        paste(crop.image, faded(plate, rng), quad, float(rng.uniform(0.3, 1.4)), rng)
        inside = np.concatenate([crop.ignored, np.zeros((0, 4))])
        return Crop(crop.image, box[None], inside)

    def _without(self, rng: np.random.Generator) -> Crop:
        crop = self._background(rng)
        if rng.random() < 0.3:
            place = tilted(rng, 0.5, 0.2, float(rng.uniform(8, 40)))
            vehicle_end(crop.image, place, rng)
        for _ in range(int(rng.integers(0, 4))):
            board, wide, high = draw_board(rng)
            place = tilted(rng, wide, high, float(np.exp(rng.uniform(np.log(6), np.log(80)))))
            flat = place.quad(wide, high)
            if np.isfinite(flat).all():
                paste(crop.image, board, flat, float(rng.uniform(0.4, 1.2)), rng)
        return crop


# Loss of the network that finds number plates.


def targets(crop: Crop) -> tuple[np.ndarray, np.ndarray]:
    """Heat, logarithms of size, offset, shape (5, 32, 32); and what counts: heat everywhere else, size at centres."""
    cells = SIDE // STRIDE
    maps, counts = np.zeros((5, cells, cells), np.float32), np.ones((2, cells, cells), np.float32)
    counts[1] = 0
    axis = np.arange(cells) + 0.5
    for left, top, right, bottom in crop.ignored / STRIDE:
        counts[0, max(0, int(top - 1)) : int(max(0, bottom + 2)), max(0, int(left - 1)) : int(max(0, right + 2))] = 0
    for left, top, right, bottom in crop.boxes / STRIDE:
        x, y, wide, high = (left + right) / 2, (top + bottom) / 2, right - left, bottom - top
        column, row = int(x), int(y)
        spread = np.maximum(np.array([wide, high]) / 6, 0.5)
        heat = np.exp(
            -(((axis - column - 0.5) / spread[0]) ** 2)[None] / 2 - (((axis - row - 0.5) / spread[1]) ** 2)[:, None] / 2
        )
        maps[0] = np.maximum(maps[0], heat)
        for there_y in range(max(row - 1, 0), min(row + 2, cells)):
            for there_x in range(max(column - 1, 0), min(column + 2, cells)):
                if (there_y, there_x) == (row, column) or not counts[1, there_y, there_x]:
                    maps[1:, there_y, there_x] = [np.log(wide), np.log(high), x - there_x, y - there_y]
                    counts[1, there_y, there_x] = 1.0 if (there_y, there_x) == (row, column) else 0.3
        maps[0, row, column], counts[0, row, column] = 1.0, 1.0
    return maps, counts


def loss_of(told: torch.Tensor, maps: torch.Tensor, counts: torch.Tensor) -> torch.Tensor:
    """Focal loss of the heat (alpha 2, beta 4) and L1 of size and offset."""
    heat, logit = maps[:, 0], told[:, 0]
    score = logit.sigmoid()
    hit, plates = (heat == 1).float(), (heat == 1).sum().clamp(min=4)
    good = hit * (1 - score) ** 2 * torch.nn.functional.softplus(-logit)
    bad = (1 - hit) * (1 - heat) ** 4 * score**2 * torch.nn.functional.softplus(logit)
    size = ((told[:, 1:] - maps[:, 1:]).abs() * counts[:, 1:]).sum() / counts[:, 1].sum().clamp(min=1)
    return ((good + bad) * counts[:, 0]).sum() / plates + 0.5 * size
