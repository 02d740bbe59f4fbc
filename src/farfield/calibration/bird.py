"""Correlation of bird's-eye maps: a start for radar-LiDAR calibration that needs no matches.

Both sensors' maps of 0.4 m cells are correlated over all shifts by FFT, summed over frames, for each yaw and each frame
offset. On a road at constant speed, frame offset and x explain the standing world equally well; what drives at another
speed decides, so the best few of each frame offset are kept for the objects to judge.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex64, Float, Float32
from scipy import fft

from farfield.calibration.moments import Moment
from farfield.calibration.problems import Told, untold

CELL_M = 0.4
_SHAPE = (192, 160)  # 76.8 m ahead, 32 m to each side
_SMOOTH = 0.7
_WIDE = 25
_MOST = 40  # sweeps that are turned; more tell nothing new


@dataclass(frozen=True, kw_only=True)
class Start:
    """One explanation of the maps.

    Args:
        frames: Radar frames to add to those that the data set pairs.
        yaw_rad: Yaw of ``radar_T_lidar``.
        x_m: Its x.
        y_m: Its y.
        score: Correlation, normalised to 1 for equal maps.
    """

    frames: int
    yaw_rad: float
    x_m: float
    y_m: float
    score: float


def correlate(
    moments: Sequence[Moment],
    guess: Start,
    *,
    reach_m: float = 3.0,
    frames: int = 4,
    yaw_rad: float = np.radians(4.0),
    step_rad: float = np.radians(0.5),
    told: Told = untold,
) -> list[Start]:
    """Best explanation of each frame offset, best first.

    Args:
        moments: Frames of one sequence.
        guess: Where to look around.
        reach_m: How far x and y may be off.
        frames: How many frames the offset may be off.
        yaw_rad: How far the yaw may be off.
        step_rad: Step of the yaw.
        told: Is told the share that is done; may raise to end it.
    """
    radar = {each.number: _spectrum(each.echoes_m, each.power_db) for each in moments}
    best: dict[int, Start] = {}
    count, every = round(yaw_rad / step_rad), -(-len(moments) // _MOST)
    for step in range(-count, count + 1):
        told((step + count) / (2 * count + 1))
        yaw = guess.yaw_rad + step_rad * step
        lidar = {each.number: _spectrum(_moved(each.points_m, yaw, guess), None) for each in moments[::every]}
        for offset in range(guess.frames - frames, guess.frames + frames + 1):
            found = _peak(lidar, radar, offset, reach_m)
            if found and (offset not in best or found[0] > best[offset].score):
                x, y = guess.x_m + found[1], guess.y_m + found[2]
                best[offset] = Start(frames=offset, yaw_rad=float(yaw), x_m=x, y_m=y, score=found[0])
    return sorted(best.values(), key=_by_score, reverse=True)


def _by_score(start: Start) -> float:
    return start.score


def _moved(points_m: Float[np.ndarray, "n 3"], yaw_rad: float, guess: Start) -> Float[np.ndarray, "n 2"]:
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    x, y = points_m[:, 0], points_m[:, 1]
    return np.column_stack([cos * x - sin * y + guess.x_m, sin * x + cos * y + guess.y_m])


def bird_map(
    points_m: Float[np.ndarray, "n d"], values: Float[np.ndarray, " n"] | None
) -> Float[np.ndarray, "192 160"]:
    """Largest value in each cell, or 1 where there is a point; x along the first axis."""
    index = np.floor(points_m[:, :2] / CELL_M).astype(int) + np.array([0, _SHAPE[1] // 2])
    kept = ((index >= 0) & (index < _SHAPE)).all(axis=1)
    grid = np.zeros(_SHAPE, dtype=np.float32)
    weight = np.ones(len(points_m)) if values is None else values
    np.maximum.at(grid.ravel(), index[kept] @ (_SHAPE[1], 1), weight[kept].astype(np.float32))
    return grid


def _spectrum(
    points_m: Float[np.ndarray, "n d"], values: Float[np.ndarray, " n"] | None
) -> Complex64[np.ndarray, "h w"]:
    found = fft.rfft2(bird_map(points_m, values)) * _PASSED
    energy = 2 * float(np.sum(np.abs(found) ** 2)) - float(np.sum(np.abs(found[:, [0, -1]]) ** 2))
    return found / (float(np.sqrt(energy / np.prod(_SHAPE))) or 1.0)


def _passed() -> Float32[np.ndarray, "h w"]:
    """What is left of each frequency: a little smoothed, without what is slow across the map, which says little."""
    across, along = fft.fftfreq(_SHAPE[0])[:, None], fft.rfftfreq(_SHAPE[1])
    smooth = np.exp(-2 * (np.pi * _SMOOTH) ** 2 * (across**2 + along**2))
    mean = [np.sinc(_WIDE * each) / np.sinc(each) for each in (across, along)]
    return (smooth * (1 - mean[0] * mean[1])).astype(np.float32)


_PASSED = _passed()


def _peak(
    lidar: Mapping[int, Complex64[np.ndarray, "h w"]],
    radar: Mapping[int, Complex64[np.ndarray, "h w"]],
    offset: int,
    reach_m: float,
) -> tuple[float, float, float] | None:
    pairs = [(each, radar[number + offset]) for number, each in lidar.items() if number + offset in radar]
    if not pairs:
        return None
    cross = sum(np.conj(one) * other for one, other in pairs)
    values = fft.irfft2(cross, s=_SHAPE) / len(pairs)
    reach = int(np.ceil(reach_m / CELL_M))
    window = np.roll(values, (reach + 1, reach + 1), axis=(0, 1))[: 2 * reach + 3, : 2 * reach + 3]
    row, column = np.unravel_index(np.argmax(window[1:-1, 1:-1]), (2 * reach + 1, 2 * reach + 1))
    top = float(window[row + 1, column + 1])
    dx = _parabola(window[row : row + 3, column + 1])
    dy = _parabola(window[row + 1, column : column + 3])
    return top, CELL_M * (float(row) - reach + dx), CELL_M * (float(column) - reach + dy)


def _parabola(three: Float[np.ndarray, " 3"]) -> float:
    low, mid, high = (float(value) for value in three)
    bend = low - 2 * mid + high
    return float(np.clip(0.5 * (low - high) / bend, -0.5, 0.5)) if bend < 0 else 0.0
