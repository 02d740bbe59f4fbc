"""``farfield calibrate``: solve where a sensor stands against the LiDAR, with residuals and what is not observed."""

import json
from pathlib import Path
from typing import Any, Literal

from tyro.conf import Positional


def run(
    kind: Positional[Literal["radar-lidar", "lidar-camera", "lidar-lidar"]],
    path: Positional[Path],
    /,
    *,
    sequence: str | None = None,
    frames: int = 40,
    camera: str | None = None,
    lidars: tuple[str, str] = ("os2-64", "os1-128"),
    pairs: Path | None = None,
    focal: bool = False,
    x: float | None = None,
    y: float | None = None,
    yaw: float = 0.0,
    frame_offset: int = 0,
    save: Path | None = None,
    out: Path | None = None,
) -> int:
    """Solve where a sensor stands against the LiDAR, with residuals and what the data cannot tell.

    examples:
      farfield calibrate radar-lidar K-Radar --sequence 3
      farfield calibrate radar-lidar K-Radar --x -2 --y 0 --save K-Radar/1/info_calib/calib_radar_lidar.txt
      farfield calibrate lidar-camera kitti --frames 20
      farfield calibrate lidar-camera K-Radar --camera cam-front --pairs picks.csv --save calibration.json
      farfield calibrate lidar-lidar K-Radar --lidars os2-64 os1-128 --frames 3

    Writes calibration.json and a picture before and after. Nothing of the data set is changed unless --save names a
    file; what was there is copied beside it first.

    Args:
        kind: What against what.
        path: Folder of a data set.
        sequence: Which one; the first unless given.
        frames: How many frames to use, spread over the sequence; for the radar in runs of ten.
        camera: Name of the image; the first with a calibration unless given.
        lidars: The clouds to register, the reference first.
        pairs: CSV of picked pairs (x_m,y_m,z_m,u_px,v_px): the camera begins from them.
        focal: With --pairs, solve for the focal length too (twelve pairs).
        x: Start of the radar's x, as K-Radar's file has it; the data set's own unless given.
        y: Start of its y.
        yaw: Start of its yaw in degrees.
        frame_offset: Start of the radar frames to add to those that are paired.
        save: File to write the result into: calib_radar_lidar.txt, cam_N.yml, KITTI's calibration, or JSON.
        out: Folder to write into; runs/calibrate-NAME unless given.
    """
    from farfield.calibration.jobs import chosen
    from farfield.datasets import open_dataset
    from farfield.errors import ConfigError
    from farfield.files.atomic import write_text

    if frames < 1:
        raise ConfigError(f"--frames: expected one or more, got {frames}")
    data = open_dataset(path)
    indices = chosen(data, sequence, frames, runs=kind == "radar-lidar")
    folder = out or Path("runs") / f"calibrate-{path.resolve().name}"
    folder.mkdir(parents=True, exist_ok=True)
    result: dict[str, Any]
    if kind == "radar-lidar":
        result = _radar(data, indices, (x, y, yaw, frame_offset), save, folder)
    elif kind == "lidar-camera":
        result = _camera(data, indices, camera, (pairs, focal), save, folder)
    else:
        result = _lidars(data, indices, lidars)
    write_text(folder / "calibration.json", json.dumps(result, indent=1) + "\n")
    print(json.dumps({name: result[name] for name in ("parameters", "change", "notes") if name in result}, indent=1))
    print(f"result: {(folder / 'calibration.json').resolve()}")
    return 0


def _radar(data: Any, indices: list[int], start: tuple[Any, ...], save: Path | None, folder: Path) -> dict[str, Any]:
    import numpy as np

    from farfield.calibration.jobs import radar_job
    from farfield.calibration.radar_lidar import RadarPose
    from farfield.calibration.saving import save_radar
    from farfield.errors import ConfigError
    from farfield.files.images import write_image
    from farfield.geometry.poses import invert
    from farfield.reports.calibration_pictures import radar_picture

    sensor = data[indices[0]].sensors.get("radar")
    if sensor is None or sensor.frame_T_sensor is None or not hasattr(data, "frame_difference"):
        raise ConfigError("calibrate radar-lidar: expected a K-Radar with a radar, LiDAR sweeps and their calibration")
    x, y, z = (float(value) for value in invert(sensor.frame_T_sensor)[:3, 3])
    x, y = (own if given is None else given for own, given in zip((x, y), start[:2], strict=True))
    guess = RadarPose(x_m=x, y_m=y, z_m=z, yaw_rad=float(np.radians(start[2])), frames=start[3])
    job = radar_job(data, indices, guess)
    write_image(folder / "before-after.png", radar_picture(job))
    if save is not None:
        difference = data.frame_difference(data.sequences[indices[0]])
        print("\n".join(f"wrote {each}" for each in save_radar(save, job.found, difference=difference)))
    return job.to_json()


def _camera(
    data: Any, indices: list[int], name: str | None, picks: tuple[Path | None, bool], save: Path | None, folder: Path
) -> dict[str, Any]:
    from farfield.calibration.jobs import camera_job, read_pairs
    from farfield.calibration.pairs import calibrate_pairs
    from farfield.calibration.saving import save_camera
    from farfield.errors import ConfigError
    from farfield.files.images import write_image
    from farfield.reports.calibration_pictures import camera_picture

    first = next((data[index] for index in indices if data[index].cameras), None)
    names = [] if first is None else [each for each in first.cameras if each in first.images]
    chosen = name or next(iter(names), None)
    if first is None or chosen is None or chosen not in names:
        raise ConfigError(f"--camera: expected one of {', '.join(names) or 'no camera at all'}; got {name}")
    start = None
    if picks[0] is not None:
        start = calibrate_pairs(*read_pairs(picks[0]), first.cameras[chosen], focal=picks[1]).camera
    job = camera_job(data, indices, camera=chosen, start=start)
    write_image(folder / "before-after.png", camera_picture(job))
    if save is not None:
        written = save_camera(save, chosen, first.cameras[chosen], job.after)
        print("\n".join(f"wrote {each}" for each in written))
    return job.to_json()


def _lidars(data: Any, indices: list[int], names: tuple[str, str]) -> dict[str, Any]:
    from farfield.calibration.jobs import lidars_job

    found = lidars_job(data, indices, *names)
    result = {"kind": "lidar-lidar", "target_T_source": found.target_T_source.tolist(), "rms_cm": 100 * found.rms_m}
    return result | {"pairs": found.pairs, "notes": list(found.solution.unobserved), **found.solution.to_json()}
