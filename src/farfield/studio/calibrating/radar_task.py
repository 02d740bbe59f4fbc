"""Radar to LiDAR, on the calibration page."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from farfield.calibration.jobs import KRADAR_NODE_M, choose_frames, radar_start
from farfield.calibration.least_squares import Progress, Solution
from farfield.calibration.radar_features import SensorPair, read_sensor_pairs
from farfield.calibration.radar_lidar import RadarCalibration, appraise_radar, calibrate_radar, frame_matches
from farfield.calibration.radar_matching import PARAMETERS, MatchedObjects, RadarEvidence, RadarPose, polar_residuals
from farfield.calibration.saving import save_radar, save_radar_where_read
from farfield.datasets.base import Dataset
from farfield.datasets.kradar.radar_pose import RADAR_FILE, SIDE_FILE
from farfield.errors import ConfigError, DatasetError
from farfield.geometry.cameras import Camera
from farfield.studio.calibrating.task import (
    CalibrationSolution,
    Pick,
    Snapshot,
    Values,
    bars,
    observability,
    pose_of,
    radar_values,
)
from farfield.studio.messages.calibration import (
    CalibFrame,
    CalibrationKind,
    Figure,
    MatchedPair,
    OffsetScore,
    RadarValues,
    ResidualPoint,
    Residuals,
)
from farfield.studio.options import CalibrationSettings
from farfield.vocabulary.counts import count_of

_LIMITS_CM = np.arange(-160.0, 161.0, 10.0)
_MOST_POINTS = 2000
_READ = 0.8  # of the time of preparing


class RadarTask:
    """K-Radar's radar against its os2-64.

    Args:
        data: The data set.
        settings: Which frames, and the start.

    Raises:
        FarfieldError: If it is no K-Radar, or there is no such sequence.
    """

    kind: CalibrationKind = "radar-lidar"

    def __init__(self, data: Dataset, settings: CalibrationSettings) -> None:
        self.data = data
        self.indices = choose_frames(data, settings.sequence, settings.frames, runs=True)
        x_m, y_m, yaw_rad, frames = settings.radar
        self.stored = radar_start(data, self.indices[0])
        start = radar_start(data, self.indices[0], x_m=x_m, y_m=y_m, yaw_rad=yaw_rad)
        self._begin = replace(start, frames=frames)
        self.sensor, self.lidar = "radar", "os2-64"
        self.frames = tuple(
            CalibFrame(index=index, name="/".join(data.keys[index]), number=number)
            for number, index in enumerate(self.indices)
        )
        self.numbers: dict[str, int] = {}
        self.evidence: RadarEvidence | None = None

    @property
    def before(self) -> RadarValues:
        """The values at the start."""
        return radar_values(self._begin)

    @property
    def start(self) -> Camera | None:
        """No camera."""
        return None

    def prepare(self, progress: Progress) -> None:
        """Read the frames and find the objects that both sensors see."""
        sensor_pairs: list[SensorPair] = []
        for number, index in enumerate(self.indices):
            progress(_READ * number / len(self.indices))
            pair = read_sensor_pairs([self.data[index]], lidar=self.lidar, node_m=KRADAR_NODE_M)[0]
            numbered = self.lidar in self.data[index].indices
            sensor_pairs.append(pair if numbered else replace(pair, number=number))
        progress(_READ)
        self.evidence = RadarEvidence.of(sensor_pairs)
        rows = zip(self.frames, sensor_pairs, strict=True)
        self.frames = tuple(replace(frame, number=pair.number) for frame, pair in rows)
        members = [i for i, name in enumerate(self.data.sequences) if name == self.data.sequences[self.indices[0]]]
        index_of = {self.data[index].indices.get(self.lidar): index for index in members}
        index_of |= {frame.number: frame.index for frame in self.frames}
        self.numbers = {str(number): index for number, index in index_of.items() if number is not None}

    def picks(self) -> tuple[Pick, ...]:
        """None are picked here."""
        return ()

    def residuals(self, now: Snapshot, frame: int, *, full: bool) -> Residuals:
        """Matched objects in range and azimuth; ``full`` makes no difference."""
        del full
        pose, evidence = _pose(now.values), self._require_evidence()
        number = next((served.number for served in self.frames if served.index == frame), -1)
        lidar, radar = frame_matches(evidence, pose, number)
        frame_pairs = tuple(
            MatchedPair(lidar_m=(a, b), radar_m=(c, d))
            for (a, b), (c, d) in zip(lidar.tolist(), radar.tolist(), strict=True)
        )
        try:
            calibration, pairs = appraise_radar(evidence, pose)
        except DatasetError as error:
            return Residuals(pairs=frame_pairs, lacking=str(error))
        shown: RadarCalibration = calibration if now.solved is None else now.solved.detail  # what a save writes
        return Residuals(
            figures=_figures(calibration, len(frame_pairs)),
            histogram=bars(100 * calibration.range_m, _LIMITS_CM, "cm"),
            known=observability(PARAMETERS, shown.solution.sigma),
            notes=shown.notes,
            objects=_points(pose, pairs),
            pairs=frame_pairs,
        )

    def off_px(self, now: Snapshot) -> list[float | None]:
        """None are picked here."""
        return [None for _ in now.picks]

    def solve(self, now: Snapshot, how: str, progress: Progress, *, focal: bool) -> CalibrationSolution:
        """Solve from matched objects and maps, from the present values."""
        del focal
        if how != "objects":
            raise ConfigError(f"calib.solve: a radar is solved by objects, got {how}")
        calibration = calibrate_radar(self._require_evidence(), _pose(now.values), progress=progress)
        offsets = {calibration.pose.frames: 0.0} | calibration.rivals
        matches = int(calibration.residual["matches"])
        return CalibrationSolution(
            values=radar_values(calibration.pose),
            summary=f"solved from {matches} matched objects in {count_of(len(self.indices), 'frame')}",
            notes=calibration.notes,
            offsets=tuple(OffsetScore(frames=k, worse=float(v)) for k, v in sorted(offsets.items())),
            detail=calibration,
        )

    def save(self, now: Snapshot, folder: Path | None) -> list[Path]:
        """Write K-Radar's text file, its side file and, into the data set, ``info_matching``."""
        solved = now.solved.detail if now.solved is not None else None
        calibration = solved if solved is not None else self._by_hand(_pose(now.values))
        index = self.indices[0]
        if folder is None:
            return save_radar_where_read(self.data, index, calibration)
        difference: int = getattr(self.data, "frame_difference")(self.data.sequences[index])  # noqa: B009
        folder.mkdir(parents=True, exist_ok=True)
        return save_radar(folder / RADAR_FILE, calibration, difference=difference)

    def saves_to(self) -> tuple[list[Path], str]:
        """The text file and its side file; ``info_matching`` comes with them."""
        folder = self.data.root / self.data.sequences[self.indices[0]] / "info_calib"
        return [folder / RADAR_FILE, folder / SIDE_FILE], ""

    def lost(self, values: Values) -> str:
        """Z has no place in K-Radar's files."""
        if abs(_pose(values).z_m - self.stored.z_m) < 1e-6:
            return ""
        return f"z is not saved: K-Radar's files have no place for it, and its reader takes {self.stored.z_m:g} m"

    def _require_evidence(self) -> RadarEvidence:
        if self.evidence is None:
            raise ConfigError("the frames are still being read")
        return self.evidence

    def _by_hand(self, pose: RadarPose) -> RadarCalibration:
        """Values set by hand, with the sigma that matched objects give, or else the one assumed before."""
        try:
            calibration, _ = appraise_radar(self._require_evidence(), pose)
        except DatasetError as error:
            return _unsupported(pose, str(error))
        return replace(calibration, notes=("set by hand", *calibration.notes))


def _pose(values: Values) -> RadarPose:
    if not isinstance(values, RadarValues):
        raise ConfigError("radar: expected values of a radar")
    return pose_of(values)


def _figures(calibration: RadarCalibration, pairs: int) -> tuple[Figure, ...]:
    rows = calibration.residual
    return (
        Figure(name="matched", value=rows["matches"], unit=""),
        Figure(name="this frame", value=float(pairs), unit=""),
        Figure(name="range", value=rows["range_cm"], unit="cm"),
        Figure(name="range", value=rows["range_cells"], unit="cells"),
        Figure(name="azimuth", value=rows["azimuth_deg"], unit="deg"),
        Figure(name="azimuth", value=rows["azimuth_cells"], unit="cells"),
        Figure(name="echoes above", value=calibration.echoes_above_m, unit="m"),
    )


def _points(pose: RadarPose, pairs: MatchedObjects) -> tuple[ResidualPoint, ...]:
    off = polar_residuals(pose.vector, pairs)
    x, y = pairs.radar_m[:, 0], pairs.radar_m[:, 1]
    table = np.column_stack([np.hypot(x, y), np.arctan2(y, x), pairs.velocity_m_s[:, 0], off])
    step = max(1, len(table) // _MOST_POINTS)
    return tuple(
        ResidualPoint(range_m=a, azimuth_rad=b, speed_m_s=c, off_m=d, off_rad=e)
        for a, b, c, d, e in table[::step].round(4).tolist()
    )


def _unsupported(pose: RadarPose, reason: str) -> RadarCalibration:
    prior = np.array([parameter.prior_sigma for parameter in PARAMETERS])
    nothing = np.zeros(0)
    solution = Solution(
        parameters=PARAMETERS,
        value=pose.vector,
        covariance=np.diag(prior**2),
        unobserved=tuple(f"{parameter.name} is not observed" for parameter in PARAMETERS),
        before=nothing,
        after=nothing,
        converged=False,
        information=np.zeros(len(PARAMETERS)),
    )
    notes = ("set by hand", reason, *solution.unobserved)
    return RadarCalibration(
        pose=pose, solution=solution, echoes_above_m=0.0, notes=notes, range_m=nothing, azimuth_rad=nothing, rivals={}
    )
