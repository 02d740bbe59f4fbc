"""Whether the calibrations that a data set gives fit its data, and whether a sensor moved during a drive."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from farfield.calibration.camera_edges import EdgeViews, edge_views
from farfield.calibration.checking import ASKED_M, ASKED_RAD, CalibrationCheck, check_camera, check_radar
from farfield.calibration.depth_edges import sweep_edges
from farfield.calibration.jobs import KRADAR_NODE_M, choose_frames
from farfield.calibration.radar_features import read_sensor_pairs
from farfield.calibration.radar_matching import RadarEvidence, RadarPose
from farfield.datasets.base import Dataset
from farfield.datasets.kradar import KRadar
from farfield.errors import DatasetError, FarfieldError
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert
from farfield.inspection.doctor.survey import Finding, Severity
from farfield.vocabulary.counts import count_of

_EDGES = 600  # a frame
_MARGIN_PX = 120.0


def check_calibration(data: Dataset, frames: int, facts: dict[str, Any]) -> Iterator[Finding]:
    """Check the cameras, and K-Radar's radar, of the first sequence.

    Args:
        data: The data set.
        frames: How many frames to read.
        facts: What was measured is noted here.
    """
    checked = facts.setdefault("calibration", {})
    indices = choose_frames(data, None, frames, runs=True)
    names = dict.fromkeys(name for index in indices for name in _pictured(data, index))
    for name in names:
        try:
            check = check_camera(*camera_views(data, choose_frames(data, None, frames, runs=False), name))
        except (FarfieldError, OSError, ValueError) as error:
            yield Finding(severity="warn", topic=f"calibration of {name}", what=f"could not be checked: {error}")
            continue
        checked[name] = vars(check)
        yield _finding(name, check, f"farfield calibrate lidar-camera {data.root} --camera {name}")
    if isinstance(data.unwrapped, KRadar) and "radar" in data[indices[0]].clouds:
        try:
            check = check_radar(*radar_evidence(data, indices))
        except (FarfieldError, OSError, ValueError) as error:
            yield Finding(severity="warn", topic="calibration of radar", what=f"could not be checked: {error}")
            return
        checked["radar"] = vars(check)
        yield _finding("radar", check, f"farfield calibrate radar-lidar {data.root}")


def _pictured(data: Dataset, index: int) -> list[str]:
    try:
        frame = data[index]
    except (FarfieldError, OSError, ValueError):
        return []
    return [name for name in frame.cameras if name in frame.images]


def _finding(name: str, check: CalibrationCheck, fix: str) -> Finding:
    size = f"{check.degrees:.2f} degrees, {check.cm:.0f} cm" + (f", {check.px:.1f} px" if check.px else "")
    drift = f"{check.drift_degrees:.2f} degrees, {check.drift_cm:.0f} cm"
    what = {
        "fits": f"fits {count_of(check.frames, 'frame')} (aligning moves it by {size})",
        "off": f"does not fit: {size} away from where {count_of(check.frames, 'frame')} put it",
        "moved": f"the sensor moved during the drive: {drift} between its first and second half",
        "not told": f"{count_of(check.frames, 'frame does', 'frames do')} not tell: {_lacking(check)}",
    }[check.verdict]
    severity: Severity = "warn" if check.claimed else "ok"
    return Finding(severity=severity, topic=f"calibration of {name}", what=what, fix=fix if check.claimed else "")


def _lacking(check: CalibrationCheck) -> str:
    if not check.needed:
        return "too few, or nothing that both sensors see"
    limits = f"{100 * ASKED_M:.0f} cm and {np.degrees(ASKED_RAD):.0f} degree"
    return f"about {count_of(check.needed, 'frame')} needed to find errors of {limits}"


def camera_views(data: Dataset, indices: Iterable[int], name: str) -> tuple[Camera, EdgeViews]:
    """A camera as the data set gives it, and the edges of its frames in time.

    Raises:
        DatasetError: If no frame has the picture with a calibration.
    """
    pictures, edges, camera = [], [], None
    for index in indices:
        frame = data[index]
        if name not in frame.images or name not in frame.cameras:
            continue
        picture = frame.images[name]
        own = replace(frame.cameras[name], width_px=picture.shape[1], height_px=picture.shape[0])
        camera = own if camera is None else camera
        same = np.allclose(own.camera_T_lidar, camera.camera_T_lidar) and np.allclose(own.matrix, camera.matrix)
        if same and (own.width_px, own.height_px) == (camera.width_px, camera.height_px):
            pictures.append(picture)
            lidar = next((cloud for cloud in frame.clouds if not cloud.startswith("radar")), None)
            edges.append(sweep_edges(data, index, camera=name, lidar=lidar)[0])
    if camera is None:
        raise DatasetError(f"{name}: expected frames with this picture and its calibration, found none")
    return camera, edge_views(pictures, edges, camera, margin_px=_MARGIN_PX, most=_EDGES)


def radar_evidence(data: Dataset, indices: Iterable[int]) -> tuple[RadarPose, RadarEvidence]:
    """A K-Radar radar as the data set gives it, and the objects of its frames.

    Raises:
        DatasetError: If a frame lacks the radar or the LiDAR.
    """
    numbers = list(indices)
    sensor = data[numbers[0]].sensors.get("radar")
    if sensor is None or sensor.frame_T_sensor is None:
        raise DatasetError("radar: expected its pose, found none")
    pose = RadarPose.from_matrix(invert(sensor.frame_T_sensor))
    return pose, RadarEvidence.of(read_sensor_pairs((data[index] for index in numbers), node_m=KRADAR_NODE_M))
