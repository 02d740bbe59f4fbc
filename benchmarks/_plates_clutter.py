"""Drawn surroundings that are no plates: what a detector of plates takes for one in photographs.

Asphalt, gravel and hedges are noise of several grains; then branches, leaves against the sky, glints on paint, wheels,
grilles, fences, fronts of houses, lane paint. All is drawn at random, none of it is copied from a photograph.
"""

import cv2
import numpy as np


def draw_clutter(rng: np.random.Generator, side_px: int) -> np.ndarray:
    """A square picture without a plate, RGB: one kind of surroundings, or two that meet at a line."""
    image = _one_kind(rng, side_px)
    if rng.random() < 0.5:
        other = _one_kind(rng, side_px)
        angle, offset = rng.uniform(0, 2 * np.pi), rng.normal(0, side_px * 0.2)
        rows, columns = np.mgrid[:side_px, :side_px] - side_px / 2
        mask = rows * np.sin(angle) + columns * np.cos(angle) > offset
        image = np.where(mask[..., None], image, other)
    if rng.random() < 0.4:
        _glints(image := image.copy(), rng)
    if rng.random() < 0.5:
        image = cv2.GaussianBlur(image, (0, 0), float(rng.uniform(0.4, 2.0)))
    return np.ascontiguousarray(image)


def _one_kind(rng: np.random.Generator, side_px: int) -> np.ndarray:
    kinds = (_ground, _ground, _leaves, _leaves, _branches, _paintwork, _wheel, _grille, _front, _lanes)
    return kinds[int(rng.integers(len(kinds)))](rng, side_px)


def _colour(rng: np.random.Generator, low: float = 0, high: float = 255, tint: float = 14) -> np.ndarray:
    return (rng.uniform(low, high) + rng.normal(0, tint, 3)).clip(0, 255)


def _ground(rng: np.random.Generator, side_px: int) -> np.ndarray:
    """Asphalt, gravel, plaster: noise of several grains, at times seen at a low angle."""
    grey = np.zeros((side_px, side_px), np.float32)
    slope = rng.uniform(0.3, 1.6)
    for cells in (4, 8, 16, 32, 64, 128):
        across = max(2, int(cells * (rng.uniform(0.3, 1.0) if rng.random() < 0.4 else 1.0)))
        part = rng.normal(0, 1, (cells, across)).astype(np.float32)
        grey += cv2.resize(part, (side_px, side_px), interpolation=cv2.INTER_CUBIC) * (cells / 4.0) ** -slope
    grey *= rng.uniform(3, 45) / max(float(grey.std()), 1e-3)
    if rng.random() < 0.3:
        grey = np.abs(grey) * rng.choice([-1.0, 1.0])
    image = (_colour(rng, 20, 230) + grey[..., None]).clip(0, 255).astype(np.uint8)
    for _ in range(int(rng.integers(0, 25)) if rng.random() < 0.5 else 0):
        centre = tuple(int(value) for value in rng.uniform(0, side_px, 2))
        axes = tuple(int(value) for value in rng.uniform(1, 6, 2))
        cv2.ellipse(image, centre, axes, float(rng.uniform(0, 180)), 0, 360, _colour(rng).tolist(), -1)
    return image


def _leaves(rng: np.random.Generator, side_px: int) -> np.ndarray:
    """Leaves, needles, hedges: many small spots of like colours before a dark ground or the sky."""
    image = np.empty((side_px, side_px, 3), np.uint8)
    image[:] = _colour(rng, 0, 60, 8) if rng.random() < 0.6 else _colour(rng, 150, 255, 12)
    colours = [_colour(rng, 10, 220, 35) for _ in range(5)]
    size = float(np.exp(rng.uniform(0, 2.0)))
    for _ in range(int(rng.integers(60, 420))):
        centre = tuple(int(value) for value in rng.uniform(0, side_px, 2))
        axes = (max(1, int(rng.gamma(2, size / 2))), max(1, int(rng.gamma(2, size / 4))))
        colour = (colours[int(rng.integers(5))] * rng.uniform(0.5, 1.3)).clip(0, 255)
        cv2.ellipse(image, centre, axes, float(rng.uniform(0, 180)), 0, 360, colour.tolist(), -1)
    return image


def _branches(rng: np.random.Generator, side_px: int) -> np.ndarray:
    """Lines of every thickness before a gradient: twigs, wires, posts, cracks."""
    ramp = np.linspace(_colour(rng, 60, 255), _colour(rng, 60, 255), side_px)[:, None] * np.ones((1, side_px, 1))
    image = ramp.clip(0, 255).astype(np.uint8)
    mean = rng.uniform(0, np.pi)
    for _ in range(int(rng.integers(3, 60))):
        start, angle, length = rng.uniform(0, side_px, 2), mean + rng.normal(0, 0.7), rng.uniform(8, side_px)
        end = start + length * np.array([np.cos(angle), np.sin(angle)])
        points = [tuple(int(value) for value in point) for point in (start, end)]
        cv2.line(image, *points, _colour(rng, 0, 200, 15).tolist(), max(1, int(rng.gamma(1.5, 1.5))), cv2.LINE_AA)
    return image


def _paintwork(rng: np.random.Generator, side_px: int) -> np.ndarray:
    """A vehicle's panels: large smooth faces, seams, lamps, glass, badges."""
    image = np.empty((side_px, side_px, 3), np.uint8)
    image[:] = _colour(rng, 5, 240)
    for _ in range(int(rng.integers(2, 9))):
        points = rng.uniform(-20, side_px + 20, (int(rng.integers(3, 6)), 2)).astype(np.int32)
        cv2.fillConvexPoly(image, cv2.convexHull(points), _colour(rng, 0, 250).tolist(), cv2.LINE_AA)
    image = cv2.GaussianBlur(image, (0, 0), float(rng.uniform(0.5, 6.0)))
    for _ in range(int(rng.integers(0, 5))):  # lamps and badges: bright shapes with a dark rim
        centre = tuple(int(value) for value in rng.uniform(0, side_px, 2))
        axes = tuple(int(value) for value in np.exp(rng.uniform(1.0, 3.4, 2)))
        angle = float(rng.normal(0, 25))
        cv2.ellipse(image, centre, axes, angle, 0, 360, _colour(rng, 0, 90).tolist(), -1, cv2.LINE_AA)
        inner = tuple(max(1, int(axis * rng.uniform(0.5, 0.9))) for axis in axes)
        cv2.ellipse(image, centre, inner, angle, 0, 360, _colour(rng, 100, 255, 40).tolist(), -1, cv2.LINE_AA)
        for _ in range(int(rng.integers(0, 4))):
            spot = tuple(int(value) for value in np.array(centre) + rng.normal(0, axes[1] / 2, 2))
            cv2.circle(image, spot, max(1, axes[1] // 3), _colour(rng, 0, 255).tolist(), -1, cv2.LINE_AA)
    for _ in range(int(rng.integers(0, 6))):
        ends = [tuple(int(value) for value in rng.uniform(0, side_px, 2)) for _ in range(2)]
        cv2.line(image, *ends, _colour(rng, 0, 255).tolist(), int(rng.integers(1, 4)), cv2.LINE_AA)
    return image


def _wheel(rng: np.random.Generator, side_px: int) -> np.ndarray:
    image = _ground(rng, side_px)
    centre, radius = rng.uniform(0.2, 0.8, 2) * side_px, rng.uniform(12, side_px * 0.6)
    squeeze, spokes, turn = rng.uniform(0.35, 1.0), int(rng.integers(5, 16)), rng.uniform(0, np.pi)
    middle = tuple(int(value) for value in centre)
    rim, dark = _colour(rng, 90, 250, 8).tolist(), _colour(rng, 5, 45, 4).tolist()
    for share, colour in ((1.0, dark), (0.7, rim), (0.62, dark)):
        axes = (max(1, int(radius * squeeze * share)), max(1, int(radius * share)))
        cv2.ellipse(image, middle, axes, 0, 0, 360, colour, -1, cv2.LINE_AA)
    for spoke in range(spokes):
        angle = turn + 2 * np.pi * spoke / spokes
        end = centre + 0.66 * radius * np.array([squeeze * np.cos(angle), np.sin(angle)])
        points = middle, tuple(int(value) for value in end)
        cv2.line(image, *points, rim, max(1, int(radius * rng.uniform(0.04, 0.12))), cv2.LINE_AA)
    return image


def _grille(rng: np.random.Generator, side_px: int) -> np.ndarray:
    """Bars or a mesh, seen at an angle: grilles, fences, shutters, stairs."""
    rows, columns = np.mgrid[:side_px, :side_px].astype(np.float32)
    bars = np.zeros((side_px, side_px), np.float32)
    for turn in range(int(rng.integers(1, 3))):
        angle = rng.normal(0, 0.3) + (np.pi / 2) * (turn + int(rng.integers(2)))
        period, fall = rng.uniform(3, 24), rng.uniform(-0.004, 0.004)
        along = rows * np.cos(angle) + columns * np.sin(angle)
        wave = np.sin(2 * np.pi * along / (period * (1 + fall * columns).clip(0.4, 2)))
        bars = np.maximum(bars, (wave > rng.uniform(-0.6, 0.8)).astype(np.float32))
    one, other = _colour(rng, 0, 255), _colour(rng, 0, 255)
    return (one + (other - one) * bars[..., None]).clip(0, 255).astype(np.uint8)


def _front(rng: np.random.Generator, side_px: int) -> np.ndarray:
    """A house's front with windows in rows, in perspective."""
    wall, glass = _colour(rng, 60, 240), _colour(rng, 0, 200)
    flat = np.empty((side_px, side_px, 3), np.uint8)
    flat[:] = wall
    rows, columns = int(rng.integers(1, 7)), int(rng.integers(1, 9))
    high, wide = side_px / rows, side_px / columns
    share = rng.uniform(0.3, 0.85, 2)
    for row in range(rows):
        for column in range(columns):
            low = np.array([column * wide + wide * 0.1, row * high + high * 0.1])
            ends = low, low + share * [wide, high]
            points = [tuple(int(value) for value in end) for end in ends]
            tone = (glass * rng.uniform(0.6, 1.4)).clip(0, 255).tolist()
            cv2.rectangle(flat, *points, tone, -1)
            cv2.rectangle(flat, *points, _colour(rng, 0, 255).tolist(), 1)
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32) * side_px
    moved = (square + rng.normal(0, side_px * 0.25, (4, 2))).astype(np.float32)
    matrix = cv2.getPerspectiveTransform(square, moved)
    return cv2.warpPerspective(flat, matrix, (side_px, side_px), borderMode=cv2.BORDER_REPLICATE)


def _lanes(rng: np.random.Generator, side_px: int) -> np.ndarray:
    """Paint, kerbs, shadows and puddles on a road."""
    image = _ground(rng, side_px)
    for _ in range(int(rng.integers(1, 6))):
        start, angle = rng.uniform(-20, side_px + 20, 2), rng.normal(0, 0.8)
        along = np.array([np.cos(angle), np.sin(angle)]) * rng.uniform(6, side_px)
        across = np.array([-np.sin(angle), np.cos(angle)]) * rng.uniform(1.5, 16)
        quad = np.array([start, start + along, start + along + across * rng.uniform(0.5, 1.5), start + across])
        layer = image.copy()
        colour = _colour(rng, 150, 255, 20) if rng.random() < 0.6 else _colour(rng, 0, 70, 8)
        cv2.fillConvexPoly(layer, quad.astype(np.int32), colour.tolist(), cv2.LINE_AA)
        share = float(rng.uniform(0.4, 1.0))
        image = cv2.addWeighted(layer, share, image, 1 - share, 0)
    return image


def _glints(image: np.ndarray, rng: np.random.Generator) -> None:
    """Small bright spots and streaks, in place: the sun on paint, glass and chrome."""
    side_px = image.shape[0]
    for _ in range(int(rng.integers(1, 10))):
        centre = tuple(int(value) for value in rng.uniform(0, side_px, 2))
        axes = tuple(max(1, int(value)) for value in rng.gamma(1.5, 2.0, 2))
        colour = _colour(rng, 170, 255, 10).tolist()
        cv2.ellipse(image, centre, axes, float(rng.uniform(0, 180)), 0, 360, colour, -1, cv2.LINE_AA)
