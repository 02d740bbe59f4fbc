"""Calibrations of whole data sets: choose frames, solve, and say it as JSON."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from farfield.calibration.edge_residuals import edge_residuals
from farfield.calibration.edges import (
    PARAMETERS,
    EdgeViews,
    align_edges,
    camera_difference,
    edge_score,
    edge_uncertainty,
    edge_views,
)
from farfield.calibration.information import LEAST_INFORMATION_FRAMES, information_distance
from farfield.calibration.moments import SensorPair, read_sensor_pairs
from farfield.calibration.radar_lidar import RadarCalibration, calibrate_radar
from farfield.calibration.radar_matching import RadarEvidence, RadarPose
from farfield.calibration.registration import Registration, register
from farfield.calibration.sweeps import deskew_to, pose_track, sweep_edges
from farfield.datasets.base import Dataset
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.ascii_table import parse_table
from farfield.files.atomic import read_bytes
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert

_MAX_PAIRS_BYTES = 1 << 20
_PAIRS_HEADER = "x_m,y_m,z_m,u_px,v_px"
KRADAR_NODE_M = 0.2  # its clouds stand half a cell below the nodes


def choose_frames(data: Dataset, sequence: str | None, frames: int, *, runs: bool) -> list[int]:
    """Numbers of the frames to use: spread over the sequence, alone or in runs of ten.

    Raises:
        DatasetError: If there is no such sequence.
    """
    names = list(dict.fromkeys(data.sequences))
    name = names[0] if sequence is None else sequence
    members = [index for index, each in enumerate(data.sequences) if each == name]
    if not members:
        raise DatasetError(f"sequence: expected one of {', '.join(names[:20])}; got {name!r}")
    length = 10 if runs else 1
    blocks = [members[at : at + length] for at in range(0, len(members), length)]
    most = max(frames // length, 1)
    picked = np.unique(np.linspace(0, len(blocks) - 1, min(most, len(blocks))).round().astype(int))
    return [index for block in picked for index in blocks[block]]


@dataclass(frozen=True, eq=False, kw_only=True)
class RadarJob:
    """A radar-LiDAR calibration with what it began from.

    Args:
        moments: The frames.
        before: The pose at the start.
        found: What was found.
    """

    moments: Sequence[SensorPair]
    before: RadarPose
    found: RadarCalibration

    def to_json(self) -> dict[str, Any]:
        """Everything that was found."""
        pose, found = self.found.pose, self.found
        return {
            "kind": "radar-lidar",
            "pose": vars(pose) | {"yaw_deg": float(np.degrees(pose.yaw_rad))},
            "before": vars(self.before),
            **found.solution.to_json(),
            "notes": list(found.notes),
            "residual": found.residual,
            "frame_offsets_worse_by_sigma": {str(k): round(v, 2) for k, v in sorted(found.rivals.items())},
            "frames": [each.number for each in self.moments],
        }


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
    known = invert(sensor.frame_T_sensor)
    x, y, z = (float(value) for value in known[:3, 3])
    return RadarPose(
        x_m=x if x_m is None else x_m,
        y_m=y if y_m is None else y_m,
        z_m=z,
        yaw_rad=float(np.arctan2(known[1, 0], known[0, 0])) if yaw_rad is None else yaw_rad,
    )


def radar_job(data: Dataset, indices: Sequence[int], guess: RadarPose) -> RadarJob:
    """Calibrate a K-Radar sequence's radar."""
    moments = read_sensor_pairs((data[index] for index in indices), node_m=KRADAR_NODE_M)
    return RadarJob(moments=moments, before=guess, found=calibrate_radar(RadarEvidence.of(moments), guess))


@dataclass(frozen=True, eq=False, kw_only=True)
class CameraJob:
    """A LiDAR-camera calibration with what it began from.

    Args:
        before: The camera at the start.
        after: The camera found.
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
        names = [f"{each.name}_{'deg' if each.unit == 'rad' else 'cm'}" for each in PARAMETERS]
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


def skew_note(skewed: int, frames: int) -> list[str]:
    """A sentence where frames hold the car's own motion; nothing otherwise."""
    if not skewed:
        return []
    what = "the car's own motion during the sweep is not taken out, for times of points or poses are not known"
    return [f"in {skewed} of {frames} frames {what}: take frames below 2 m/s"]


def distance_note(distances: tuple[float, ...] | None) -> list[str]:
    """A sentence where the information distance grew; nothing otherwise."""
    if distances is None or distances[1] <= distances[0]:
        return []
    grown = f"{distances[0]:.4f} to {distances[1]:.4f}"
    return [f"the normalised information distance of grey and intensity grew from {grown}: look at the picture"]


def _residual(camera: Camera, views: EdgeViews) -> dict[str, Any]:
    found = edge_residuals(camera, views)
    counts, limits = np.histogram(found.across_px, bins=np.arange(-6.25, 6.5, 0.5))
    return {
        "edges": len(found.across_px),
        "median_px": found.median_px,
        "score": float(edge_score(camera, views).mean()),
        "histogram": {"limits_px": limits.tolist(), "counts": counts.tolist()},
    }


def camera_job(
    data: Dataset, indices: Sequence[int], *, camera: str, lidar: str | None = None, start: Camera | None = None
) -> CameraJob:
    """Align a camera with a LiDAR over several frames.

    Raises:
        DatasetError: If no frame has the picture with a calibration.
    """
    found = {index: data[index] for index in indices}
    kept = [i for i, each in found.items() if camera in each.images and (start is not None or camera in each.cameras)]
    frames = [found[index] for index in kept]
    if not frames:
        raise DatasetError(f"{camera}: expected frames with this picture and a calibration to begin with, found none")
    pictures = [each.images[camera] for each in frames]
    before = frames[0].cameras[camera] if start is None else start
    before = replace(before, width_px=pictures[0].shape[1], height_px=pictures[0].shape[0])
    alike = [i for i, each in enumerate(pictures) if each.shape == pictures[0].shape]
    swept = [sweep_edges(data, kept[i], camera=camera, lidar=lidar) for i in alike]
    views = edge_views([pictures[i] for i in alike], [edges for edges, _ in swept], before)
    after = align_edges(before, views)
    return CameraJob(
        before=before,
        after=after,
        views=views,
        picture=pictures[0],
        keys=[frames[i].key for i in alike],
        skewed=sum(not still for _, still in swept),
        distances=information_distances((before, after), data, [kept[i] for i in alike], camera, lidar),
    )


def information_distances(
    cameras: Sequence[Camera], data: Dataset, indices: Sequence[int], camera: str, lidar: str | None
) -> tuple[float, ...] | None:
    """Normalised information distance of each calibration; None with too few frames, or where intensity lacks."""
    frames = [data[index] for index in indices]
    clouds = [each.cloud(lidar) for each in frames]
    if len(frames) < LEAST_INFORMATION_FRAMES or any(each.intensity is None for each in clouds):
        return None
    points = []
    for index, frame, cloud in zip(indices, frames, clouds, strict=True):
        still = deskew_to(cloud, pose_track(data, index), frame, frame.time_ns_of(camera))
        points.append(cloud.points_m.astype(np.float64) if still is None else still)
    pictures, strength = [each.images[camera] for each in frames], [each.intensity for each in clouds]
    known = [each for each in strength if each is not None]
    return tuple(information_distance(each, pictures, points, known) for each in cameras)


def lidars_job(data: Dataset, indices: Sequence[int], first: str, second: str) -> Registration:
    """Register two LiDARs' clouds over a few frames, from the pose that the data give, or none.

    Raises:
        DatasetError: If no frame has both.
    """
    frames = [each for each in (data[index] for index in indices) if {first, second} <= set(each.clouds)]
    if not frames:
        raise DatasetError(f"lidar-lidar: expected frames with the clouds {first} and {second}, found none")
    sensor = frames[0].sensors[second]
    start = None if sensor.in_frame else sensor.frame_T_sensor
    targets, sources = ([each.clouds[name].points_m.astype(np.float64) for each in frames] for name in (first, second))
    return register(targets, sources, start=start)


def read_pairs(path: Path) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 2"]]:
    """Read picked pairs: CSV with the header ``x_m,y_m,z_m,u_px,v_px``.

    Raises:
        FileFormatError: If the header is another or a line holds no five numbers.
    """
    head, _, rest = read_bytes(path, max_bytes=_MAX_PAIRS_BYTES).partition(b"\n")
    if head.decode("utf-8", errors="replace").strip() != _PAIRS_HEADER:
        raise FileFormatError(path, where="line 1", expected=_PAIRS_HEADER, found=repr(head[:80]))
    columns = parse_table(rest.rstrip(), dtypes=[np.dtype(np.float64)] * 5, separator=",", path=path, line=2)
    return np.column_stack(columns[:3]), np.column_stack(columns[3:])
