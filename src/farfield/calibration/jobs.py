"""Calibrations of whole data sets, and of folders of pictures: choose frames, solve, and say it as JSON."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from farfield.calibration.birds_eye_correlation import birds_eye_map
from farfield.calibration.boards import Board, BoardCalibration, calibrate_board, find_board
from farfield.calibration.camera_edges import (
    PARAMETERS,
    EdgeViews,
    align_edges,
    camera_difference,
    edge_residuals,
    edge_score,
    edge_uncertainty,
    edge_views,
)
from farfield.calibration.camera_pairs import PairCalibration, calibrate_pairs, spread_notes
from farfield.calibration.checking import LEAST_INFORMATION_FRAMES, information_distance
from farfield.calibration.depth_edges import deskew_to, pose_track, sweep_edges
from farfield.calibration.lidar_lidar import Registration, register
from farfield.calibration.radar_features import SensorPair, read_sensor_pairs
from farfield.calibration.radar_lidar import RadarCalibration, calibrate_radar
from farfield.calibration.radar_matching import RadarEvidence, RadarPose
from farfield.datasets.base import Dataset
from farfield.errors import ConfigError, DatasetError
from farfield.files.images import read_image
from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert
from farfield.vocabulary.counts import count_of

KRADAR_NODE_M = 0.2  # its clouds stand half a cell below the nodes
_RUN = 10  # frames of a run
_SUFFIXES = (".png", ".jpg", ".jpeg")


def choose_frames(data: Dataset, sequence: str | None, frames: int, *, runs: bool) -> list[int]:
    """Numbers of the frames to use: spread over the sequence, alone or in runs of ten.

    Raises:
        DatasetError: If there is no such sequence.
    """
    names = list(dict.fromkeys(data.sequences))
    name = names[0] if sequence is None else sequence
    members = [index for index, other in enumerate(data.sequences) if other == name]
    if not members:
        raise DatasetError(f"sequence: expected one of {', '.join(names[:20])}; got {name!r}")
    length = _RUN if runs else 1
    blocks = [members[at : at + length] for at in range(0, len(members), length)]
    most = max(frames // length, 1)
    picked = np.unique(np.linspace(0, len(blocks) - 1, min(most, len(blocks))).round().astype(int))
    return [index for block in picked for index in blocks[block]]


# Radar to LiDAR


@dataclass(frozen=True, eq=False, kw_only=True)
class RadarJob:
    """A radar-LiDAR calibration with what it began from.

    Args:
        sensor_pairs: The frames.
        before: The pose at the start.
        calibration: The result.
    """

    sensor_pairs: Sequence[SensorPair]
    before: RadarPose
    calibration: RadarCalibration

    def to_json(self) -> dict[str, Any]:
        """Pose, sigma, notes, residuals and frame offsets."""
        pose, result = self.calibration.pose, self.calibration
        return {
            "kind": "radar-lidar",
            "pose": vars(pose) | {"yaw_deg": float(np.degrees(pose.yaw_rad))},
            "before": vars(self.before),
            **result.solution.to_json(),
            "notes": list(result.notes),
            "residual": result.residual,
            "frame_offsets_worse_by_sigma": {str(k): round(v, 2) for k, v in sorted(result.rivals.items())},
            "frames": [pair.number for pair in self.sensor_pairs],
        }

    def from_above(self, pose: RadarPose) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "h w"]]:
        """The middle frame at a pose, as a figure shows it.

        Returns:
            The LiDAR's points in the radar's frame, shape (n, 2), and the largest power over what is usual, in dB, of
            the radar frame that belongs to them, in cells of 0.4 m, x along the first axis.
        """
        lidar = self.sensor_pairs[len(self.sensor_pairs) // 2]
        radar = next((pair for pair in self.sensor_pairs if pair.number == lidar.number + pose.frames), lidar)
        cos, sin = np.cos(pose.yaw_rad), np.sin(pose.yaw_rad)
        x, y = lidar.points_m[:, 0], lidar.points_m[:, 1]
        points_m = np.column_stack([cos * x - sin * y + pose.x_m, sin * x + cos * y + pose.y_m])
        return points_m, birds_eye_map(radar.echoes_m, radar.power_db)


def radar_start(
    data: Dataset, index: int, *, x_m: float | None = None, y_m: float | None = None, yaw_rad: float | None = None
) -> RadarPose:
    """The radar's pose as the data set has it, with what is given instead.

    Raises:
        ConfigError: If the data set is no K-Radar with a radar's calibration.
    """
    sensor = data[index].sensors.get("radar")
    if sensor is None or sensor.frame_T_sensor is None or not hasattr(data, "frame_difference"):
        raise ConfigError("calibrate radar-lidar: expected a K-Radar with a radar, LiDAR sweeps and their calibration")
    stored = RadarPose.from_matrix(invert(sensor.frame_T_sensor))
    return replace(
        stored,
        x_m=stored.x_m if x_m is None else x_m,
        y_m=stored.y_m if y_m is None else y_m,
        yaw_rad=stored.yaw_rad if yaw_rad is None else yaw_rad,
    )


def radar_job(data: Dataset, indices: Sequence[int], guess: RadarPose) -> RadarJob:
    """Calibrate a K-Radar sequence's radar."""
    sensor_pairs = read_sensor_pairs((data[index] for index in indices), node_m=KRADAR_NODE_M)
    calibration = calibrate_radar(RadarEvidence.of(sensor_pairs), guess)
    return RadarJob(sensor_pairs=sensor_pairs, before=guess, calibration=calibration)


# LiDAR to camera, by edges


@dataclass(frozen=True, eq=False, kw_only=True)
class CameraJob:
    """A LiDAR-camera calibration with what it began from.

    Args:
        before: The camera at the start.
        after: The camera that edges gave.
        views: The frames' edges.
        picture: The first frame's picture.
        keys: The frames.
        skewed: Of how many frames the car's own motion could not be taken out: no times of points, or no poses.
        distances: Normalised information distance before and after; a check only.
    """

    before: Camera
    after: Camera
    views: EdgeViews
    picture: UInt8[np.ndarray, "height width 3"]
    keys: Sequence[tuple[str, str]]
    skewed: int = 0
    distances: tuple[float, ...] | None = None

    def to_json(self) -> dict[str, Any]:
        """Change, sigma, residuals in pixels with their histogram, and what is not observed."""
        sigma, sentences = edge_uncertainty(self.after, self.views)
        change, units = camera_difference(self.after, self.before), np.array([180 / np.pi] * 3 + [100.0] * 3)
        names = [f"{parameter.name}_{'deg' if parameter.unit == 'rad' else 'cm'}" for parameter in PARAMETERS]
        return {
            "kind": "lidar-camera",
            "camera_T_lidar": self.after.camera_T_lidar.tolist(),
            "matrix": self.after.matrix.tolist(),
            "distortion": self.after.distortion.tolist(),
            "change": dict(zip(names, (change * units).tolist(), strict=True)),
            "sigma": {
                name: float(value) if np.isfinite(value) else None
                for name, value in zip(names, sigma * units, strict=True)
            },
            "notes": [*sentences, *skew_note(self.skewed, len(self.keys)), *distance_note(self.distances)],
            "information_distance": None if self.distances is None else list(self.distances),
            "residual_before": _residual(self.before, self.views),
            "residual_after": _residual(self.after, self.views),
            "frames": ["/".join(key) for key in self.keys],
        }


def _residual(camera: Camera, views: EdgeViews) -> dict[str, Any]:
    residuals = edge_residuals(camera, views)
    counts, limits = np.histogram(residuals.across_px, bins=np.arange(-6.25, 6.5, 0.5))
    return {
        "edges": len(residuals.across_px),
        "median_px": residuals.median_px,
        "score": float(edge_score(camera, views).mean()),
        "histogram": {"limits_px": limits.tolist(), "counts": counts.tolist()},
    }


def skew_note(skewed: int, frames: int) -> list[str]:
    """A sentence where frames hold the car's own motion; nothing otherwise."""
    if not skewed:
        return []
    what = "the car's own motion during the sweep is not taken out, for times of points or poses are not known"
    return [f"in {skewed} of {count_of(frames, 'frame')} {what}: take frames below 2 m/s"]


def distance_note(distances: tuple[float, ...] | None) -> list[str]:
    """A sentence where the information distance grew; nothing otherwise."""
    if distances is None or distances[1] <= distances[0]:
        return []
    grown = f"{distances[0]:.4f} to {distances[1]:.4f}"
    return [f"the normalised information distance of grey and intensity grew from {grown}: look at the picture"]


def camera_job(
    data: Dataset, indices: Sequence[int], *, camera: str, lidar: str | None = None, start: Camera | None = None
) -> CameraJob:
    """Align a camera with a LiDAR over several frames.

    Raises:
        DatasetError: If no frame has the picture with a calibration.
    """
    # 1. Frames with the picture, all of one size, and the camera to begin with.
    all_frames = {index: data[index] for index in indices}
    frames = {
        index: frame
        for index, frame in all_frames.items()
        if camera in frame.images and (start is not None or camera in frame.cameras)
    }
    if not frames:
        raise DatasetError(f"{camera}: expected frames with this picture and a calibration to begin with, found none")
    first = next(iter(frames.values()))
    picture = first.images[camera]
    before = first.cameras[camera] if start is None else start
    before = replace(before, width_px=picture.shape[1], height_px=picture.shape[0])
    frames = {index: frame for index, frame in frames.items() if frame.images[camera].shape == picture.shape}

    # 2. Edges of the sweeps and of the pictures.
    swept = [sweep_edges(data, index, camera=camera, lidar=lidar) for index in frames]
    pictures = [frame.images[camera] for frame in frames.values()]
    views = edge_views(pictures, [edges for edges, _ in swept], before)

    # 3. Align, and check.
    after = align_edges(before, views)
    return CameraJob(
        before=before,
        after=after,
        views=views,
        picture=picture,
        keys=[frame.key for frame in frames.values()],
        skewed=sum(not deskewed for _, deskewed in swept),
        distances=information_distances((before, after), data, list(frames), camera, lidar),
    )


def information_distances(
    cameras: Sequence[Camera], data: Dataset, indices: Sequence[int], camera: str, lidar: str | None
) -> tuple[float, ...] | None:
    """Normalised information distance of each calibration; None with too few frames, or where intensity lacks."""
    frames = [data[index] for index in indices]
    clouds = [frame.cloud(lidar) for frame in frames]
    intensity = [cloud.intensity for cloud in clouds if cloud.intensity is not None]
    if len(frames) < LEAST_INFORMATION_FRAMES or len(intensity) < len(frames):
        return None
    points = []
    for index, frame, cloud in zip(indices, frames, clouds, strict=True):
        deskewed_m = deskew_to(cloud, pose_track(data, index), frame, frame.time_ns_of(camera))
        points.append(cloud.points_m.astype(np.float64) if deskewed_m is None else deskewed_m)
    pictures = [frame.images[camera] for frame in frames]
    return tuple(information_distance(candidate, pictures, points, intensity) for candidate in cameras)


# LiDAR to camera, by picked pairs


@dataclass(frozen=True, eq=False, kw_only=True)
class PairsJob:
    """A camera from picked pairs.

    Args:
        before: The camera at the start.
        calibration: The result.
        picture: The picture in which pairs were picked.
        points_m: The frame's cloud.
        boxes: The frame's boxes.
        notes: What the picks do not tell.
    """

    before: Camera
    calibration: PairCalibration
    picture: UInt8[np.ndarray, "height width 3"]
    points_m: Float[np.ndarray, "n 3"]
    boxes: Boxes
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Camera, sigma, and the residual of every pick in pixels."""
        result, camera = self.calibration, self.calibration.camera
        return {
            "kind": "lidar-camera",
            "from": "pairs",
            "camera_T_lidar": camera.camera_T_lidar.tolist(),
            "matrix": camera.matrix.tolist(),
            "distortion": camera.distortion.tolist(),
            **result.solution.to_json(),
            "residual_px": result.residual_px.round(2).tolist(),
            "left_out": np.flatnonzero(~result.inlier).tolist(),
            "notes": [*self.notes, *result.solution.unobserved],
        }


def pairs_job(
    data: Dataset,
    index: int,
    name: str,
    pairs: tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 2"]],
    start: Camera,
    *,
    focal: bool,
) -> PairsJob:
    """Solve a camera from pairs picked in one frame.

    Args:
        data: The data set.
        index: The frame.
        name: Name of the image.
        pairs: Points and pixels.
        start: Intrinsics to begin with.
        focal: Solve for the focal length too.
    """
    frame = data[index]
    calibration = calibrate_pairs(*pairs, start, focal=focal)
    return PairsJob(
        before=start,
        calibration=calibration,
        picture=frame.images[name],
        points_m=frame.cloud().points_m.astype(np.float64),
        boxes=Boxes.empty() if frame.boxes is None else frame.boxes,
        notes=spread_notes(*pairs, calibration.camera),
    )


# LiDAR to LiDAR, and intrinsics


def lidars_job(data: Dataset, indices: Sequence[int], first: str, second: str) -> Registration:
    """Register two LiDARs' clouds over a few frames, from the pose that the data give, or none.

    Raises:
        DatasetError: If no frame has both.
    """
    frames = [frame for frame in (data[index] for index in indices) if {first, second} <= set(frame.clouds)]
    if not frames:
        raise DatasetError(f"lidar-lidar: expected frames with the clouds {first} and {second}, found none")
    sensor = frames[0].sensors[second]
    start = None if sensor.in_frame else sensor.frame_T_sensor
    targets, sources = (
        [frame.clouds[name].points_m.astype(np.float64) for frame in frames] for name in (first, second)
    )
    return register(targets, sources, start=start)


def board_job(
    folder: Path, board: Board, progress: Callable[[Iterable[Path]], Iterable[Path]] = iter
) -> BoardCalibration:
    """Calibrate from all pictures of a folder; those without the board are named in ``left_out``.

    Raises:
        ConfigError: If there are too few.
    """
    paths = sorted(path for path in folder.glob("*") if path.suffix.lower() in _SUFFIXES)
    if not paths:
        raise ConfigError(f"{folder}: expected pictures of the board ({', '.join(_SUFFIXES)}), found none")
    sightings = {path.name: find_board(read_image(path), board, path.name) for path in progress(paths)}
    calibration = calibrate_board([sighting for sighting in sightings.values() if sighting is not None], board)
    missing = {name: "no board seen" for name, sighting in sightings.items() if sighting is None}
    return replace(calibration, left_out=missing | calibration.left_out)
