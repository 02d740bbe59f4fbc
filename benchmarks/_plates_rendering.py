"""Number plates of many countries drawn with random strings, and put into pictures."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from _plates_scenes import Place, Scene, upright
from PIL import Image, ImageDraw, ImageFont

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
