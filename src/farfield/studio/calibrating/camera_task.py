"""LiDAR to camera, on the calibration page."""

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from jaxtyping import Float

from farfield.calibration.camera_edges import (
    PARAMETERS,
    EdgeViews,
    align_edges,
    camera_difference,
    edge_residuals,
    edge_score,
    edge_uncertainty,
    edge_views,
    select_edges,
)
from farfield.calibration.camera_pairs import calibrate_pairs, read_pairs, spread_notes
from farfield.calibration.depth_edges import LidarEdges, sweep_edges
from farfield.calibration.jobs import choose_frames, distance_note, information_distances, skew_note
from farfield.calibration.least_squares import Progress, Solution
from farfield.calibration.saving import camera_files, holds_intrinsics, save_camera, save_camera_where_read
from farfield.datasets.base import Dataset
from farfield.errors import ConfigError, FarfieldError
from farfield.geometry.cameras import Camera
from farfield.studio.calibrating.task import (
    CalibrationSolution,
    Pick,
    Snapshot,
    Values,
    bars,
    camera_of,
    camera_values,
    observability,
    same_lens,
)
from farfield.studio.messages.calibration import CalibFrame, CalibrationKind, CameraValues, Figure, Residuals
from farfield.studio.options import CalibrationSettings
from farfield.vocabulary.counts import count_of

_LIMITS_PX = np.arange(-6.25, 6.5, 0.5)
_READ = 0.7  # of the time of preparing
_TURNED_RAD, _SHIFTED_M, _FOCAL = np.radians(3.0), 0.5, 0.05  # from where the edges in view are others
_LENS = "its files hold the pose alone: focal length, centre and distortion stay as they are"


class CameraTask:
    """A camera against a LiDAR.

    Args:
        data: The data set.
        settings: Which frames and camera, and the start.

    Raises:
        FarfieldError: If there is no such sequence or camera, or it has no calibration and none was given.
    """

    kind: CalibrationKind = "lidar-camera"

    def __init__(self, data: Dataset, settings: CalibrationSettings) -> None:
        self.data, self._pairs = data, settings.pairs
        indices = choose_frames(data, settings.sequence, settings.frames, runs=False)
        beginning = settings.beginning
        self.sensor = _named(data, indices, settings.camera, guessed=beginning is not None and not beginning.empty)
        self.indices = [index for index in indices if self.sensor in data[index].images]
        first = data[self.indices[0]]
        self.stored = first.cameras.get(self.sensor)
        shape = first.images[self.sensor].shape
        begin = self.stored
        if beginning is not None and not beginning.empty:
            begin = beginning.camera(self.sensor, shape, self.stored)
        if begin is None:
            raise ConfigError(f"{self.sensor} has no calibration: give --guess-focal PIXELS, or --intrinsics FILE")
        self._begin = replace(begin, width_px=shape[1], height_px=shape[0])
        self._shape = shape
        self.lidar = next(iter(first.clouds))
        self.frames = tuple(
            CalibFrame(index=index, name="/".join(data.keys[index]), number=number)
            for number, index in enumerate(self.indices)
        )
        self.numbers: dict[str, int] = {}
        self._edges: list[LidarEdges] = []
        self._views: tuple[Camera, EdgeViews] | None = None
        self._skewed = 0

    @property
    def before(self) -> CameraValues:
        """The values at the start."""
        return camera_values(self._begin, self._begin)

    @property
    def start(self) -> Camera | None:
        """The camera from which moves are counted."""
        return self._begin

    def prepare(self, progress: Progress) -> None:
        """Find the edges of sweeps and pictures."""
        alike = [i for i in self.indices if self.data[i].images[self.sensor].shape == self._shape]
        swept = []
        for number, index in enumerate(alike):
            progress(_READ * number / len(alike))
            swept.append(sweep_edges(self.data, index, camera=self.sensor, lidar=self.lidar))
        self._skewed = sum(not still for _, still in swept)
        progress(_READ)
        self._edges = [edges for edges, _ in swept]
        self.indices = alike
        self.frames = tuple(frame for frame in self.frames if frame.index in alike)
        pictures = [self.data[index].images[self.sensor] for index in alike]
        self._views = (self._begin, edge_views(pictures, self._edges, self._begin))

    def picks(self) -> tuple[Pick, ...]:
        """Those of the file that was given."""
        if self._pairs is None:
            return ()
        points, pixels = read_pairs(self._pairs)
        rows = zip(points.tolist(), pixels.tolist(), strict=True)
        frame = self.indices[0]
        return tuple(Pick(i + 1, frame, (x, y, z), (u, v)) for i, ((x, y, z), (u, v)) in enumerate(rows))

    def residuals(self, now: Snapshot, frame: int, *, full: bool) -> Residuals:
        """Edges in pixels across them, and picks; ``full`` adds what the edges cannot tell."""
        del frame
        camera = self._camera(now.values)
        views = self._seen(camera)
        away = edge_residuals(camera, views)
        off = np.array(
            [distance for distance, pick in zip(self.off_px(now), now.picks, strict=True) if distance and pick.used]
        )
        figures = (
            Figure(name="edges", value=float(len(away.across_px)), unit=""),
            Figure(name="off, median", value=away.median_px, unit="px"),
            Figure(name="strength", value=float(edge_score(camera, views).mean()), unit="x"),
            Figure(name="pairs", value=float(len(off)), unit=""),
            Figure(name="pairs, rms", value=float(np.sqrt((off**2).mean())) if len(off) else None, unit="px"),
        )
        sigma: Float[np.ndarray, " 6"] | None
        notes: tuple[str, ...]
        if now.solved is not None and isinstance(now.solved.detail, Solution):  # by pairs: their sigma, not the edges'
            sigma, notes = now.solved.detail.sigma[: len(PARAMETERS)], now.solved.detail.unobserved
        else:
            sigma, notes = edge_uncertainty(camera, views) if full else (None, ())
        return Residuals(
            figures=figures,
            histogram=bars(away.across_px, _LIMITS_PX, "px"),
            known=() if sigma is None else observability(PARAMETERS, sigma),
            notes=(*notes, *self._hints(now, camera)),
        )

    def off_px(self, now: Snapshot) -> list[float | None]:
        """How far each pick's point falls from its pixel; None behind the camera."""
        if not now.picks:
            return []
        points, pixels = _columns(now.picks)
        projected, depth, _ = self._camera(now.values).project(points)
        off = np.linalg.norm(projected - pixels, axis=1)
        return [
            float(distance) if z > 0 and np.isfinite(distance) else None for distance, z in zip(off, depth, strict=True)
        ]

    def solve(self, now: Snapshot, how: str, progress: Progress, *, focal: bool) -> CalibrationSolution:
        """Solve by picked pairs or by edges, from the present values."""
        if how == "pairs":
            return self._by_pairs(now, focal=focal)
        if how != "edges":
            raise ConfigError(f"calib.solve: a camera is solved by pairs or edges, got {how}")
        before = self._camera(now.values)
        views = self._seen(before)
        after = align_edges(before, views, progress=progress)
        _, notes = edge_uncertainty(after, views)
        distances = information_distances((before, after), self.data, self.indices, self.sensor, self.lidar)
        all_notes = (*notes, *skew_note(self._skewed, len(self.indices)), *distance_note(distances))
        summary = f"aligned {len(views.points_m)} edges of {count_of(len(self.indices), 'frame')}"
        return CalibrationSolution(values=camera_values(after, self._begin), summary=summary, notes=all_notes)

    def save(self, now: Snapshot, folder: Path | None) -> list[Path]:
        """Write where the reader finds it, or our own file into a folder."""
        camera = self._camera(now.values)
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            return save_camera(folder / "calibration.json", self.sensor, camera, camera)
        if lost := self.lost(now.values):
            raise ConfigError(f"{lost}; save into the folder of results instead")
        written = save_camera_where_read(self.data, self.indices[0], self.sensor, self.stored, camera)
        self.stored = camera
        return written

    def saves_to(self) -> tuple[list[Path], str]:
        """The files that a save writes, or why there are none."""
        try:
            return camera_files(self.data, self.indices[0], self.sensor, self.stored), ""
        except FarfieldError as error:
            return [], str(error)

    def lost(self, values: Values) -> str:
        """A changed lens, where the files hold poses alone."""
        if self.stored is None or holds_intrinsics(self.data) or same_lens(self._camera(values), self.stored):
            return ""
        return f"the changed lens is not saved into {self.data.name}: {_LENS}"

    def _camera(self, values: Values) -> Camera:
        if not isinstance(values, CameraValues):
            raise ConfigError("camera: expected values of a camera")
        return camera_of(values, self._begin)

    def _seen(self, camera: Camera) -> EdgeViews:
        """The edges in view; others where the camera stands elsewhere."""
        if self._views is None:
            raise ConfigError("the frames are still being read")
        viewed_by, views = self._views
        away = camera_difference(camera, viewed_by)
        focal = abs(np.log(camera.matrix[0, 0] / viewed_by.matrix[0, 0]))
        if np.abs(away[:3]).max() > _TURNED_RAD or np.abs(away[3:]).max() > _SHIFTED_M or focal > _FOCAL:
            views = select_edges(views, self._edges, camera)
            self._views = (camera, views)
        return views

    def _by_pairs(self, now: Snapshot, *, focal: bool) -> CalibrationSolution:
        used = [pick for pick in now.picks if pick.used]
        points, pixels = _columns(used)
        robust = find_spec("cv2") is not None
        calibration = calibrate_pairs(points, pixels, self._camera(now.values), focal=focal, from_nothing=robust)
        far = [pick.number for pick, near in zip(used, calibration.inlier, strict=True) if not near]
        notes = [*calibration.solution.unobserved, *spread_notes(points, pixels, calibration.camera)]
        if far:
            notes.insert(0, f"pair {', '.join(map(str, far))}: too far off for a slip of the hand; look at it again")
        summary = f"solved from {len(used)} picked pairs{' with the focal length' if focal else ''}"
        return CalibrationSolution(
            values=camera_values(calibration.camera, self._begin),
            summary=summary,
            notes=tuple(notes),
            detail=calibration.solution,
        )

    def _hints(self, now: Snapshot, camera: Camera) -> tuple[str, ...]:
        used = [pick for pick in now.picks if pick.used]
        return spread_notes(*_columns(used), camera) if used else ()


def _named(data: Dataset, indices: list[int], name: str | None, *, guessed: bool) -> str:
    """The camera's name: the one asked for, or the first with a calibration."""
    cameras: dict[str, None] = {}
    for index in indices:
        frame = data[index]
        cameras |= {image: None for image in frame.images if guessed or image in frame.cameras}
        if frame.clouds and (name in cameras if name is not None else cameras):
            return name or next(iter(cameras))
    raise ConfigError(f"--camera: expected one of {', '.join(cameras) or 'no camera at all'}; got {name}")


def _columns(picks: "tuple[Pick, ...] | list[Pick]") -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 2"]]:
    points = np.array([pick.point_m for pick in picks], dtype=np.float64).reshape(-1, 3)
    return points, np.array([pick.pixel for pick in picks], dtype=np.float64).reshape(-1, 2)
