"""Correlation of bird's-eye maps: a start for radar-LiDAR calibration that needs no matches.

Both sensors' maps of 0.4 m cells are correlated over all shifts by FFT, summed over frames, for each yaw and each frame
offset. On a road at constant speed, frame offset and x explain the standing world equally well; what drives at another
speed decides, so the best of each frame offset is handed on for the objects to judge. :func:`correlate` is the
algorithm; :class:`OccupancyMaps` remembers what earlier starts correlated.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter

import numpy as np
from jaxtyping import Complex64, Float, Float32
from scipy import fft

from farfield.calibration.least_squares import Progress, no_progress
from farfield.calibration.radar_features import SensorPair
from farfield.errors import ConfigError

CELL_M = 0.4
_SHAPE = (192, 160)  # 76.8 m ahead, 32 m to each side
_SMOOTH = 0.7
_WIDE = 25
_LEAST_DB, _MOST_DB = 7.0, 40.0  # of an echo, over what is usual
_MOST = 40  # sweeps that are turned; more tell nothing new
_ORIGIN_M = 4.0  # the maps' origins lie on these steps, so that later starts find what earlier ones correlated
_REACH_M, _FARTHEST = 9.0, 30  # cells that are stored: reach, half a step of the origin, and a margin
_STEP_RAD = np.radians(0.5)


@dataclass(frozen=True, kw_only=True)
class PoseHypothesis:
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


_Spectra = Mapping[int, Complex64[np.ndarray, "h w"]]


@dataclass(frozen=True, eq=False)
class OccupancyMaps:
    """Maps of both sensors over a drive, and their correlations, stored for later starts.

    Args:
        sensor_pairs: Frames of one sequence.
        summed: Correlations over all shifts by yaw, origin and frame offset; none where no frames meet.
    """

    sensor_pairs: Sequence[SensorPair]
    summed: dict[tuple[int, float, float, int], Float[np.ndarray, "rows columns"] | None] = field(default_factory=dict)

    @cached_property
    def radar(self) -> _Spectra:
        """Spectra of the radar's maps, of the echoes that stand out, by number of the frame."""
        spectra = {}
        for pair in self.sensor_pairs:
            strong = pair.power_db > _LEAST_DB
            spectra[pair.number] = _spectrum(pair.echoes_m[strong], np.minimum(pair.power_db[strong], _MOST_DB))
        return spectra

    def correlated(
        self, turn: int, origin_m: tuple[float, float], offsets: Sequence[int]
    ) -> list[Float[np.ndarray, "rows columns"] | None]:
        """Correlations with the sweeps turned by so many steps and shifted to an origin, for each frame offset."""
        keys = [(turn, *origin_m, offset) for offset in offsets]
        new = [key for key in keys if key not in self.summed]
        if new:
            every = -(-len(self.sensor_pairs) // _MOST)
            lidar = {
                pair.number: _spectrum(_turn_and_shift(pair.points_m, turn * _STEP_RAD, origin_m), None)
                for pair in self.sensor_pairs[::every]
            }
            self.summed.update({key: _correlate_spectra(lidar, self.radar, key[3]) for key in new})
        return [self.summed[key] for key in keys]


def correlate(
    maps: OccupancyMaps,
    guess: PoseHypothesis,
    *,
    reach_m: float = 3.0,
    frames: int = 4,
    yaw_rad: float = np.radians(4.0),
    progress: Progress = no_progress,
) -> list[PoseHypothesis]:
    """Best explanation of each frame offset, best first.

    Args:
        maps: Of the frames of one sequence.
        guess: Where to look around.
        reach_m: How far x and y may be off, at most 9 m.
        frames: How many frames the offset may be off.
        yaw_rad: How far the yaw may be off.
        progress: Is called with the share that is finished; may raise to end it.

    Raises:
        ConfigError: If ``reach_m`` is more.
    """
    if reach_m > _REACH_M:
        raise ConfigError(f"radar-lidar: expected reach_m of at most {_REACH_M:g} m, got {reach_m:g}")

    # 1. The maps' origin near the guess, and the yaws and frame offsets around it.
    origin_m = round(guess.x_m / _ORIGIN_M) * _ORIGIN_M, round(guess.y_m / _ORIGIN_M) * _ORIGIN_M
    around_m = guess.x_m - origin_m[0], guess.y_m - origin_m[1]
    offsets = range(guess.frames - frames, guess.frames + frames + 1)
    middle, count = round(guess.yaw_rad / _STEP_RAD), round(yaw_rad / _STEP_RAD)

    # 2. The highest peak of all shifts and yaws for each frame offset.
    best: dict[int, PoseHypothesis] = {}
    for step in range(-count, count + 1):
        progress((step + count) / (2 * count + 1))
        for offset, correlation in zip(offsets, maps.correlated(middle + step, origin_m, offsets), strict=True):
            if correlation is None:
                continue
            score, dx_m, dy_m = _peak(correlation, around_m, reach_m)
            if offset not in best or score > best[offset].score:
                x, y = origin_m[0] + dx_m, origin_m[1] + dy_m
                yaw = float((middle + step) * _STEP_RAD)
                best[offset] = PoseHypothesis(frames=offset, yaw_rad=yaw, x_m=x, y_m=y, score=score)

    # 3. In the order of their scores.
    return sorted(best.values(), key=attrgetter("score"), reverse=True)


def _turn_and_shift(
    points_m: Float[np.ndarray, "n 3"], yaw_rad: float, shift_m: tuple[float, float]
) -> Float[np.ndarray, "n 2"]:
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    x, y = points_m[:, 0], points_m[:, 1]
    return np.column_stack([cos * x - sin * y + shift_m[0], sin * x + cos * y + shift_m[1]])


def birds_eye_map(
    points_m: Float[np.ndarray, "n d"], values: Float[np.ndarray, " n"] | None
) -> Float[np.ndarray, "192 160"]:
    """Largest value in each cell, or 1 where there is a point; x along the first axis."""
    cell = np.floor(points_m[:, :2] / CELL_M).astype(int) + np.array([0, _SHAPE[1] // 2])
    inside = ((cell >= 0) & (cell < _SHAPE)).all(axis=1)
    grid = np.zeros(_SHAPE, dtype=np.float32)
    weight = np.ones(len(points_m)) if values is None else values
    np.maximum.at(grid.ravel(), cell[inside] @ (_SHAPE[1], 1), weight[inside].astype(np.float32))
    return grid


def _spectrum(
    points_m: Float[np.ndarray, "n d"], values: Float[np.ndarray, " n"] | None
) -> Complex64[np.ndarray, "h w"]:
    """Spectrum of a map, filtered, of energy 1."""
    spectrum = fft.rfft2(birds_eye_map(points_m, values)) * _BAND_PASS
    energy = 2 * float(np.sum(np.abs(spectrum) ** 2)) - float(np.sum(np.abs(spectrum[:, [0, -1]]) ** 2))
    return spectrum / (float(np.sqrt(energy / np.prod(_SHAPE))) or 1.0)


def _band_pass() -> Float32[np.ndarray, "h w"]:
    """What is left of each frequency: a little smoothed, without what is slow across the map, which says little."""
    across, along = fft.fftfreq(_SHAPE[0])[:, None], fft.rfftfreq(_SHAPE[1])
    smooth = np.exp(-2 * (np.pi * _SMOOTH) ** 2 * (across**2 + along**2))
    mean = [np.sinc(_WIDE * frequency) / np.sinc(frequency) for frequency in (across, along)]
    return (smooth * (1 - mean[0] * mean[1])).astype(np.float32)


_BAND_PASS = _band_pass()


def _correlate_spectra(lidar: _Spectra, radar: _Spectra, offset: int) -> Float[np.ndarray, "rows columns"] | None:
    """Correlation over the shifts up to a dozen metres, the mean of the frames; None where no frames meet."""
    pairs = [(spectrum, radar[number + offset]) for number, spectrum in lidar.items() if number + offset in radar]
    if not pairs:
        return None
    cross = np.zeros_like(pairs[0][0])
    for one, other in pairs:
        cross += np.conj(one) * other
    values = fft.irfft2(cross, s=_SHAPE) / len(pairs)
    rolled = np.roll(values, (_FARTHEST, _FARTHEST), axis=(0, 1))
    return np.array(rolled[: 2 * _FARTHEST + 1, : 2 * _FARTHEST + 1])


def _peak(
    correlation: Float[np.ndarray, "rows columns"], around_m: tuple[float, float], reach_m: float
) -> tuple[float, float, float]:
    """The highest value within reach, and its shift in x and y, between cells by parabolas."""
    reach = int(np.ceil(reach_m / CELL_M))
    low = [round(shift_m / CELL_M) - reach for shift_m in around_m]
    top_row, left = (_FARTHEST + cell - 1 for cell in low)
    window = correlation[top_row : top_row + 2 * reach + 3, left : left + 2 * reach + 3]
    row, column = np.unravel_index(np.argmax(window[1:-1, 1:-1]), (2 * reach + 1, 2 * reach + 1))
    top = float(window[row + 1, column + 1])
    dx = _parabola(window[row : row + 3, column + 1])
    dy = _parabola(window[row + 1, column : column + 3])
    return top, CELL_M * (float(row) + low[0] + dx), CELL_M * (float(column) + low[1] + dy)


def _parabola(three: Float[np.ndarray, " 3"]) -> float:
    """Where between three values the highest lies, from the middle."""
    low, mid, high = (float(value) for value in three)
    bend = low - 2 * mid + high
    return float(np.clip(0.5 * (low - high) / bend, -0.5, 0.5)) if bend < 0 else 0.0
