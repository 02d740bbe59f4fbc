"""Simulated camera images, the places where number plates belong, and plates drawn onto them."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from farfield.files.atomic import open_atomic
from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera
from farfield.simulation import simulate_frame

# Simulated camera images and the places on their vehicles where number plates belong.


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


# Number plates of many countries drawn with random strings, and put into pictures.


LETTERS, DIGITS = "ABCDEFGHJKLMNPRSTUVWXYZ", "0123456789"
FONTS = ("DejaVuSans-Bold", "DejaVuSansMono-Bold", "DejaVuSans", "DejaVuSansMono", "STIXGeneralBol")
_WHITE, _BLACK, _YELLOW, _BLUE = (236, 236, 230), (20, 20, 24), (242, 190, 20), (20, 50, 150)
_HEIGHT_PX = 72  # of a drawn plate


@dataclass(frozen=True)
class Format:
    """A kind of plate: size in metres, lines, grounds and inks that go together, and how it is decorated."""

    width_m: float
    height_m: float
    lines: int = 1
    colours: tuple[tuple[tuple[int, int, int], tuple[int, int, int]], ...] = ((_WHITE, _BLACK),)
    band: float = 0.0  # how often a blue band stands at the left
    picture: float = 0.0  # how often the ground is a picture or has a line of small print


FORMATS = (
    Format(0.52, 0.11, colours=((_WHITE, _BLACK), (_WHITE, _BLACK), (_WHITE, (170, 20, 30))), band=0.8),
    Format(0.52, 0.111, colours=((_WHITE, _BLACK), (_YELLOW, _BLACK)), band=0.5),
    Format(0.36, 0.11, band=0.7),
    Format(0.30, 0.16, lines=2),
    Format(0.28, 0.20, lines=2, band=0.5),
    Format(0.34, 0.24, lines=2, colours=((_WHITE, _BLACK), (_YELLOW, _BLACK))),
    Format(0.20, 0.20, lines=2, colours=((_WHITE, _BLACK), (_YELLOW, _BLACK))),
    Format(0.305, 0.152, colours=((_WHITE, _BLUE), (_WHITE, _BLACK), (_YELLOW, _BLUE), (_BLACK, _YELLOW)), picture=0.7),
    Format(0.335, 0.17, lines=2, colours=(((30, 105, 60), _WHITE), (_YELLOW, _BLACK))),
    Format(0.335, 0.155, colours=((_WHITE, _BLACK), ((110, 180, 220), _BLACK))),
    Format(0.44, 0.14, colours=((_BLUE, _WHITE), (_YELLOW, _BLACK), ((120, 200, 140), _BLACK))),
    Format(0.33, 0.165, lines=2, colours=((_WHITE, (20, 90, 50)), (_YELLOW, _BLACK))),
    Format(0.372, 0.134, colours=((_WHITE, _BLUE), (_YELLOW, _BLACK), ((60, 20, 60), _WHITE)), picture=0.3),
    Format(0.40, 0.13, colours=(((215, 215, 215), _BLACK), (_WHITE, _BLACK)), band=0.2, picture=0.4),
)


@lru_cache(maxsize=256)
def _font(name: str, size: int) -> ImageFont.FreeTypeFont:
    import matplotlib

    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / f"{name}.ttf"), size)


def random_string(rng: np.random.Generator, length: int) -> str:
    """Letters, digits and at times a gap; no plate's grammar, so that none is a real one but by chance."""
    told = [str(rng.choice(list(LETTERS if rng.random() < 0.45 else DIGITS))) for _ in range(length)]
    if length > 4 and rng.random() < 0.6:
        told.insert(int(rng.integers(2, length - 1)), str(rng.choice([" ", "-", "·"])))
    return "".join(told)


def text_on(image: Image.Image, words: str, box: tuple[float, float, float, float], font: str, ink: tuple) -> None:
    """Words stretched into a box: left, top, right, bottom."""
    used = _font(font, 64)
    left, top, right, bottom = used.getbbox(words)
    drawn = Image.new("L", (max(1, int(right - left)), max(1, int(bottom - top))), 0)
    ImageDraw.Draw(drawn).text((-left, -top), words, fill=255, font=used)
    width, height = max(1, round(box[2] - box[0])), max(1, round(box[3] - box[1]))
    image.paste(ink, (round(box[0]), round(box[1])), drawn.resize((width, height), Image.Resampling.BILINEAR))


def draw_plate(rng: np.random.Generator, form: Format | None = None) -> tuple[np.ndarray, Format]:
    """A plate by day, RGB, and its format."""
    form = form or FORMATS[int(rng.integers(len(FORMATS)))]
    height = _HEIGHT_PX * (1 if form.lines == 1 else 2)
    width = round(height * form.width_m / form.height_m)
    ground, ink = form.colours[int(rng.integers(len(form.colours)))]
    image = Image.new("RGB", (width, height), ground)
    pen = ImageDraw.Draw(image)
    if form.picture and rng.random() < form.picture:
        _decorate(image, rng, ink)
    left = width * 0.03
    if rng.random() < form.band:
        left = height / form.lines * 0.42
        pen.rectangle((0, 0, left, height), fill=(25, 50, 160))
        text_on(
            image,
            str(rng.choice(list(LETTERS))),
            (left * 0.25, height * 0.62, left * 0.75, height * 0.85),
            FONTS[0],
            _WHITE,
        )
        left *= 1.15
    font = str(rng.choice(FONTS, p=[0.4, 0.25, 0.15, 0.1, 0.1]))
    for line in range(form.lines):
        length = int(rng.integers(5, 9)) if form.lines == 1 else int(rng.integers(2, 6))
        high = height / form.lines
        share = rng.uniform(0.62, 0.8)
        if form.picture and rng.random() < 0.7:
            share = rng.uniform(0.5, 0.6)
        top = line * high + (1 - share) / 2 * high
        inset = rng.uniform(0.01, 0.06) * width
        text_on(
            image,
            random_string(rng, length),
            (left + inset, top, width - 0.03 * width - inset, top + share * high),
            font,
            ink,
        )
    if rng.random() < 0.7:
        pen.rectangle((1, 1, width - 2, height - 2), outline=ink, width=max(2, height // 36))
    for side in (0.12, 0.88) if rng.random() < 0.3 else ():
        pen.ellipse((side * width - 3, height * 0.1 - 3, side * width + 3, height * 0.1 + 3), fill=(90, 90, 90))
    return _worn(np.asarray(image), rng), form


def _decorate(image: Image.Image, rng: np.random.Generator, ink: tuple) -> None:
    """A ground of two colours, and small print above or below."""
    width, height = image.size
    low, high = rng.uniform(120, 255, 3), rng.uniform(170, 255, 3)
    ramp = np.linspace(low, high, height)[:, None] * np.ones((1, width, 1))
    if rng.random() < 0.5:
        image.paste(Image.fromarray(ramp.astype(np.uint8)))
    for top in (0.05, 0.83) if rng.random() < 0.6 else (0.83,):
        words = random_string(rng, int(rng.integers(6, 12)))
        text_on(image, words, (width * 0.25, height * top, width * 0.75, height * (top + 0.12)), FONTS[2], ink)


def _worn(plate: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Emboss, dirt and the dealer's frame."""
    image = plate.astype(np.float32)
    if rng.random() < 0.4:
        grey = image.mean(axis=2)
        image += (0.15 * (np.roll(grey, 2, (0, 1)) - np.roll(grey, -2, (0, 1))))[..., None]
    if rng.random() < 0.35:
        height, width = image.shape[:2]
        dirt = cv2.resize(rng.random((4, 9), dtype=np.float32), (width, height), interpolation=cv2.INTER_CUBIC)
        weight = np.clip(dirt * rng.uniform(0.3, 1.0), 0, 0.8)[..., None]
        image = image * (1 - weight) + weight * np.array([105, 95, 80])
    if rng.random() < 0.3:
        edge, colour = int(rng.integers(3, 9)), rng.uniform(0, 60, 3) if rng.random() < 0.7 else rng.uniform(0, 255, 3)
        low = edge * (2 if rng.random() < 0.5 else 1)
        image = cv2.copyMakeBorder(image, edge, low, edge, edge, cv2.BORDER_CONSTANT, value=colour.tolist())
        image = cv2.resize(image, plate.shape[1::-1], interpolation=cv2.INTER_AREA)
    return image.clip(0, 255).astype(np.uint8)


def paste(image: np.ndarray, plate: np.ndarray, quad: np.ndarray, lit: float, rng: np.random.Generator) -> None:
    """Put a plate into a picture, in place; ``lit`` times as bright as it is drawn."""
    height, width = image.shape[:2]
    low = np.floor(quad.min(axis=0)).astype(int) - 2
    high = np.ceil(quad.max(axis=0)).astype(int) + 3
    low, high = np.maximum(low, 0), np.minimum(high, [width, height])
    if (high <= low).any():
        return
    across = max(np.linalg.norm(quad[1] - quad[0]), np.linalg.norm(quad[2] - quad[3]), 1.0)
    down = max(np.linalg.norm(quad[3] - quad[0]), np.linalg.norm(quad[2] - quad[1]), 1.0)
    wanted = (max(2, round(across * 2)), max(2, round(down * 2)))
    small = plate if wanted[0] >= plate.shape[1] else cv2.resize(plate, wanted, interpolation=cv2.INTER_AREA)
    rows, columns = small.shape[:2]
    corners = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], np.float32) - 0.5
    part = 2  # samples a side of a pixel
    target = ((quad - low + 0.5) * part - 0.5).astype(np.float32)
    size = tuple(int(side) * part for side in high - low)
    matrix = cv2.getPerspectiveTransform(corners, target)
    warped = cv2.warpPerspective(small, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    share = cv2.warpPerspective(np.full((rows, columns), 255, np.uint8), matrix, size, flags=cv2.INTER_LINEAR)
    final = (int(high[0] - low[0]), int(high[1] - low[1]))
    warped = cv2.resize(warped, final, interpolation=cv2.INTER_AREA).astype(np.float32)
    weight = cv2.resize(share, final, interpolation=cv2.INTER_AREA).astype(np.float32)[..., None] / 255
    tint = rng.normal(1.0, 0.03, 3)
    region = image[low[1] : high[1], low[0] : high[0]]
    mixed = region * (1 - weight) + (warped * lit * tint).clip(0, 255) * weight
    region[:] = mixed.clip(0, 255).astype(np.uint8)


def light_of(light: str, image: np.ndarray, rng: np.random.Generator) -> float:
    """How bright a plate is: by day as its surroundings, at night dark or shining back into the headlamps."""
    if light == "night":
        return float(rng.uniform(1.0, 1.9) if rng.random() < 0.5 else rng.uniform(0.2, 0.9))
    return float(rng.uniform(0.45, 1.1)) * float(np.clip(image.mean() / 115, 0.5, 1.1))


def degraded(image: np.ndarray, rng: np.random.Generator, strong: bool = False) -> np.ndarray:
    """Motion and focus blur, tone, noise and JPEG; ``strong`` as for training."""
    drawn = image
    if rng.random() < 0.35:
        length = int(rng.integers(2, 5))
        kernel = np.zeros((length, length), np.float32)
        kernel[length // 2] = 1 / length
        drawn = cv2.filter2D(drawn, -1, kernel if rng.random() < 0.8 else kernel.T)
    if rng.random() < 0.5:
        drawn = cv2.GaussianBlur(drawn, (0, 0), float(rng.uniform(0.3, 1.0)))
    if strong:
        drawn = _toned(drawn, rng)
    if rng.random() < 0.7:
        noise = cv2.resize(rng.normal(0, 1, drawn.shape).astype(np.float32), drawn.shape[1::-1])
        drawn = (drawn + rng.uniform(0, 9) * noise).clip(0, 255).astype(np.uint8)
    if rng.random() < 0.8:
        kept = cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(30, 95))])[1]
        drawn = cv2.imdecode(kept, cv2.IMREAD_COLOR)
    return drawn


def _toned(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    tones = np.arange(256, dtype=np.float32) / 255
    curve = (tones ** rng.uniform(0.6, 1.6) * rng.uniform(0.5, 1.3) + rng.uniform(-0.08, 0.08)) * 255
    drawn = cv2.LUT(image, curve.clip(0, 255).astype(np.uint8))
    if rng.random() < 0.2:
        return np.repeat(drawn.mean(axis=2, keepdims=True), 3, axis=2).astype(np.uint8)
    if rng.random() < 0.3:
        return (drawn * rng.uniform(0.75, 1.2, 3)).clip(0, 255).astype(np.uint8)
    return drawn


def with_plates(scene: Scene, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A picture with a plate at every place, its plates' upright boxes, and the boxes that do not count."""
    image, boxes = scene.image.copy(), []
    ignored = [upright(place.quad(0.6, 0.25)) for place in scene.hidden]
    size = np.array(scene.image.shape[1::-1])
    for place in scene.places:
        plate, form = draw_plate(rng)
        quad = place.quad(form.width_m, form.height_m)
        box = upright(quad)
        if (box[2:] < 0).any() or (box[:2] > size).any():
            continue
        cover(image, place, rng)
        paste(image, plate, quad, light_of(scene.light, scene.image, rng), rng)
        (boxes if (box[:2] >= 0).all() and (box[2:] <= size).all() else ignored).append(box)
    return degraded(image, rng), np.array(boxes).reshape(-1, 4), np.array(ignored).reshape(-1, 4)


def cover(image: np.ndarray, place: Place, rng: np.random.Generator) -> None:
    """Paint over the simulator's own blank plate with what stands around it, or something dark."""
    quad = place.quad(0.54, 0.2)
    low, high = np.maximum(quad.min(axis=0).astype(int), 0), np.ceil(quad.max(axis=0)).astype(int)
    region = image[low[1] : high[1], low[0] : high[0]]
    if not region.size:
        return
    colour = np.median(np.concatenate([region[0], region[-1]]), axis=0) if rng.random() < 0.6 else rng.uniform(5, 70, 3)
    cv2.fillConvexPoly(image, np.round(quad).astype(np.int32), [float(value) for value in colour])
