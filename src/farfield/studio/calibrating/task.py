"""What both calibrations share: a task reads frames, gives residuals of any values, solves and saves."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float

from farfield.calibration.camera_edges import camera_difference, move_camera
from farfield.calibration.least_squares import Parameter, Progress
from farfield.calibration.radar_matching import RadarPose
from farfield.datasets.base import Dataset
from farfield.geometry.cameras import Camera
from farfield.studio.messages.calibration import (
    Bars,
    CalibFrame,
    CalibrationKind,
    CameraValues,
    Known,
    OffsetScore,
    RadarValues,
    Residuals,
)

_UNITS = {"rad": ("deg", 180 / np.pi), "m": ("cm", 100.0), "s": ("ms", 1000.0)}


# Values between messages and the types of farfield.calibration

Values = RadarValues | CameraValues


def pose_of(values: RadarValues) -> RadarPose:
    """A radar's pose from a message."""
    return RadarPose(**vars(values))


def radar_values(pose: RadarPose) -> RadarValues:
    """A radar's pose as a message."""
    return RadarValues(**vars(pose))


def camera_of(values: CameraValues, start: Camera) -> Camera:
    """A camera from a message.

    Args:
        values: Intrinsics, and moves from the start.
        start: The camera from which moves are counted.
    """
    matrix = np.array([[values.fx, 0.0, values.cx], [0.0, values.fy, values.cy], [0.0, 0.0, 1.0]])
    moved_camera = move_camera(start, np.array(values.moved, dtype=np.float64))
    return replace(moved_camera, matrix=matrix, distortion=np.array(values.distortion, dtype=np.float64))


def camera_values(camera: Camera, start: Camera) -> CameraValues:
    """A camera as a message; arguments as of :func:`camera_of`."""
    (fx, _, cx), (_, fy, cy), _ = camera.matrix.tolist()
    k1, k2, p1, p2, k3 = camera.distortion.tolist()
    a, b, c, x, y, z = camera_difference(camera, start).tolist()
    return CameraValues(fx=fx, fy=fy, cx=cx, cy=cy, distortion=(k1, k2, p1, p2, k3), moved=(a, b, c, x, y, z))


def same_lens(one: Camera, other: Camera) -> bool:
    """Whether two cameras have the same focal lengths, centre and distortion."""
    return bool(np.allclose(one.matrix, other.matrix, atol=1e-6) and np.allclose(one.distortion, other.distortion))


@dataclass(frozen=True)
class Pick:
    """A picked pair.

    Args:
        number: Its name among the picks.
        frame: In which frame it was picked.
        point_m: The point in the LiDAR's coordinates.
        pixel: The pixel.
        used: Whether it counts.
    """

    number: int
    frame: int
    point_m: tuple[float, float, float]
    pixel: tuple[float, float]
    used: bool = True


@dataclass(frozen=True, eq=False)
class CalibrationSolution:
    """What a solver found.

    Args:
        values: The values.
        summary: What was solved and from what.
        notes: What the data cannot tell, a sentence each.
        offsets: How much worse other frame offsets are.
        detail: The room's own result, for saving.
    """

    values: Values
    summary: str
    notes: tuple[str, ...]
    offsets: tuple[OffsetScore, ...] = ()
    detail: Any = None


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The calibration at one moment: what undo goes back to.

    Args:
        values: The values.
        picks: The picked pairs.
        solved: What was solved last, where the values are still its.
    """

    values: Values
    picks: tuple[Pick, ...] = ()
    solved: CalibrationSolution | None = None


class CalibrationTask(Protocol):
    """One kind of calibration of one data set."""

    kind: CalibrationKind
    data: Dataset
    sensor: str
    lidar: str
    stored: Any  # the calibration that the files hold
    frames: tuple[CalibFrame, ...]
    numbers: dict[str, int]

    @property
    def before(self) -> Values:
        """The values at the start."""

    @property
    def start(self) -> Camera | None:
        """The camera from which moves are counted."""

    def prepare(self, progress: Progress) -> None:
        """Read the frames; takes seconds."""

    def picks(self) -> tuple[Pick, ...]:
        """Pairs to begin with."""

    def residuals(self, now: Snapshot, frame: int, *, full: bool) -> Residuals:
        """What the data say of some values."""

    def off_px(self, now: Snapshot) -> list[float | None]:
        """How far each pick falls from its pixel."""

    def solve(self, now: Snapshot, how: str, progress: Progress, *, focal: bool) -> CalibrationSolution:
        """Solve from the present values."""

    def save(self, now: Snapshot, folder: Path | None) -> list[Path]:
        """Write where the reader finds it, or into a folder; the files written and copies of what was there."""

    def saves_to(self) -> tuple[list[Path], str]:
        """The files that a save writes, and what they have no place for."""

    def lost(self, values: Values) -> str:
        """What of these values the files have no place for."""


def observability(
    parameters: Sequence[Parameter], sigma: Float[np.ndarray, " k"], prior: Float[np.ndarray, " k"] | None = None
) -> tuple[Known, ...]:
    """How well each parameter is known against what was assumed before: 1 - (sigma / prior sigma)^2 is observed."""
    assumed = np.array([parameter.prior_sigma for parameter in parameters]) if prior is None else prior
    rows = []
    for parameter, own, before in zip(parameters, sigma.tolist(), assumed.tolist(), strict=True):
        unit, factor = _UNITS.get(parameter.unit, (parameter.unit, 1.0))
        share = 0.0 if not np.isfinite(own) else max(0.0, 1.0 - (own / before) ** 2)
        shown_sigma = float(own * factor) if np.isfinite(own) else None
        rows.append(
            Known(name=parameter.name, unit=unit, sigma=shown_sigma, prior=float(before * factor), observed=share)
        )
    return tuple(rows)


def bars(values: Float[np.ndarray, " n"], limits: Float[np.ndarray, " m"], unit: str) -> Bars:
    """A histogram; what lies outside counts in the outermost bars."""
    counts, _ = np.histogram(np.clip(values, limits[0], limits[-1]), bins=limits)
    return Bars(limits=tuple(map(float, limits)), counts=tuple(map(int, counts)), unit=unit)
