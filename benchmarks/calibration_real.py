"""Calibration on real frames: published calibrations perturbed and brought back, boxes and points drawn.

KITTI and View-of-Delft frames, a LiDAR-camera pair, K-Radar's example picture, View-of-Delft's radar against its LiDAR;
each is skipped where it is absent.

    python benchmarks/calibration_real.py --output benchmarks/results/calibration_real.txt --pictures runs/pictures
"""

import argparse
import json
import tempfile
import time
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from _report import SHARED_REAL, header

from farfield.calibration.camera_edges import align_edges, camera_difference, edge_uncertainty, edge_views, move_camera
from farfield.calibration.checking import check_camera
from farfield.calibration.depth_edges import lidar_edges
from farfield.calibration.radar_features import read_sensor_pairs
from farfield.calibration.radar_lidar import calibrate_radar
from farfield.calibration.radar_matching import RadarEvidence, RadarPose
from farfield.datasets import open_dataset
from farfield.datasets.kradar.labels import annotation_of, read_labels
from farfield.datasets.kradar.texts import read_camera
from farfield.errors import DatasetError
from farfield.figures.camera import boxes_picture
from farfield.files.images import read_image, write_image
from farfield.frame import Boxes, Frame
from farfield.frame.cloud import read_cloud
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert

ERRORS = ((0.5, 0.05), (1.0, 0.10), (2.0, 0.10))  # degrees about, and metres along, each axis, at most
KRADAR_SEQUENCE = 11  # of the example picture: the time stamp of its label says so
HEAD = (
    "set                    frames from              deg before  after  worst | cm before  after  worst |"
    " px before  after  worst  CPU s"
)


_YAW, _ASIDE = np.array([0, np.radians(1.0), 0, 0, 0, 0]), np.array([0, 0, 0, 0.2, 0, 0])


def aligned(
    name: str, camera: Camera, pictures: Sequence[np.ndarray], clouds: Sequence[np.ndarray], starts: int
) -> Iterator[tuple[str, Camera, Camera]]:
    """Rows of one set: largest angle, largest shift and median pixel error over random starts; a start and its end."""
    edges = [lidar_edges(points) for points in clouds]
    near = np.concatenate([points[::20] for points in clouds]).astype(np.float64)
    near = near[camera.project(near)[2] & (np.linalg.norm(near, axis=1) < 50)]
    there = camera.project(near)[0]
    for degrees, metres in ERRORS:
        rng, rows, began = np.random.default_rng(0), [], time.process_time()
        for _ in range(starts):
            delta = np.concatenate([np.radians(rng.uniform(-degrees, degrees, 3)), rng.uniform(-metres, metres, 3)])
            start = move_camera(camera, delta)
            views = edge_views(pictures, edges, start, margin_px=100)
            sigma = (*(np.radians(degrees),) * 3, *(metres,) * 3)
            found = align_edges(start, views, sigma=sigma)
            rows.append([_off(each, camera, near, there) for each in (start, found)])
        before, after = np.array(rows).transpose(1, 0, 2)
        cells = [
            f"{np.median(b):9.2f} {np.median(a):6.2f} {a.max():6.2f}" for b, a in zip(before.T, after.T, strict=True)
        ]
        text = f"{name:<22} {len(clouds):6d} {degrees:.1f} deg {100 * metres:3.0f} cm  " + " |  ".join(cells)
        yield f"{text} {(time.process_time() - began) / starts:6.1f}", start, found
    views = edge_views(pictures, edges, camera, margin_px=100)
    if len(clouds) < 2:
        yield "  one frame alone: no sigma", camera, camera
        return
    sigma, notes = edge_uncertainty(align_edges(camera, views), views)
    told = ", ".join(f"{s:.2f}" for s in np.degrees(sigma[:3])), ", ".join(f"{100 * s:.0f}" for s in sigma[3:])
    yield f"  sigma (pitch, yaw, roll) {told[0]} deg, (x, y, z) {told[1]} cm", camera, camera
    for note in notes or ("all six are observed",):
        yield f"  {note}", camera, camera
    own = _off(align_edges(camera, views), camera, near, there)
    yield f"  begun at the published one: {own[0]:.2f} deg, {own[1]:.1f} cm, {own[2]:.1f} px away", camera, camera
    for what, delta in (("published", np.zeros(6)), ("turned by 1 deg", _YAW), ("shifted by 20 cm", _ASIDE)):
        check = check_camera(move_camera(camera, delta), views)
        yield (
            f"  the doctor on the {what}: {check.verdict} ({check.px:.1f} px, {check.evidence:.1f} errors)",
            camera,
            camera,
        )


def _off(found: Camera, truth: Camera, points_m: np.ndarray, pixels: np.ndarray) -> tuple[float, float, float]:
    error = np.abs(camera_difference(found, truth))
    away = np.linalg.norm(replace(found, width_px=0, height_px=0).project(points_m)[0] - pixels, axis=1)
    return float(np.degrees(error[:3].max())), 100 * float(error[3:].max()), float(np.nanmedian(away))


def alike(folders: Sequence[Path], form: str) -> list[Frame]:
    """Frames with the picture and calibration that most of the folders' frames share."""
    frames = [frame for folder in folders for frame in open_dataset(folder, format=form)]
    frames = [each for each in frames if "camera" in each.images and "camera" in each.cameras]
    marks = [np.round(each.cameras["camera"].camera_T_lidar, 6).tobytes() for each in frames]
    usual = max(marks, key=marks.count)
    found = [each for each, mark in zip(frames, marks, strict=True) if mark == usual]
    sizes = [each.images["camera"].shape for each in found]
    size = max(sizes, key=sizes.count)
    return [each for each, own in zip(found, sizes, strict=True) if own == size]


def of_frames(name: str, frames: Sequence[Frame], starts: int, folder: Path | None) -> Iterator[str]:
    """Rows of a data set's frames, and the first frame before and after from the second kind of start."""
    camera, clouds = frames[0].cameras["camera"], [each.clouds["lidar"].points_m for each in frames]
    pictures = [each.images["camera"] for each in frames]
    yield f"  frames {', '.join(each.frame_id for each in frames)}"
    for number, (text, start, found) in enumerate(aligned(name, camera, pictures, clouds, starts)):
        yield text
        if number == 1 and folder is not None:
            boxes = frames[0].boxes
            pair = [boxes_picture(pictures[0], each, boxes, clouds[0].astype(float)) for each in (start, found)]
            write_image(folder / f"{name.split()[0].lower()}.png", np.concatenate(pair))


def pair(starts: int, folder: Path | None) -> Iterator[str]:
    """The pair of PJLab's SensorsCalibration."""
    place = SHARED_REAL / "pcd" / "lidar2camera"
    inner = json.loads((place / "center_camera-intrinsic.json").read_text())["center_camera-intrinsic"]["param"]
    outer = json.loads((place / "top_center_lidar-to-center_camera-extrinsic.json").read_text())
    pose = np.array(outer["top_center_lidar-to-center_camera-extrinsic"]["param"]["sensor_calib"]["data"])
    bent = np.ravel(inner["cam_dist"]["data"])[:5]
    picture, cloud = read_image(place / "0.png"), read_cloud(place / "0.pcd")
    camera = Camera(
        matrix=np.array(inner["cam_K"]["data"], dtype=float),
        distortion=np.pad(bent, (0, 5 - len(bent))).astype(float),
        camera_T_lidar=pose,
        width_px=picture.shape[1],
        height_px=picture.shape[0],
    )
    points = cloud.points_m.astype(np.float64)
    for number, (text, start, found) in enumerate(aligned("lidar2camera pair", camera, [picture], [points], starts)):
        yield text
        if number == 1 and folder is not None:
            drawn = [boxes_picture(picture, each, Boxes.empty(), points) for each in (start, found)]
            write_image(folder / "pair.png", np.concatenate(drawn))


def kradar_example(folder: Path | None) -> Iterator[str]:
    """Boxes of the example label on the example picture, by both releases of its sequence's calibration."""
    place = SHARED_REAL / "kradar"
    picture = read_image(place / "example" / "img_example.png")
    boxes = annotation_of(read_labels(place / "example" / "label_example.txt"), "v1.0").boxes
    drawn, picture = [], picture[:, : picture.shape[1] // 2]  # both eyes side by side: the left one
    for release in ("calib_seq", "calib_seq_v2"):
        with tempfile.TemporaryDirectory() as scratch, zipfile.ZipFile(place / f"{release}.zip") as archive:
            name = next(n for n in archive.namelist() if n.endswith(f"seq_{KRADAR_SEQUENCE:02d}/cam_1.yml"))
            (Path(scratch) / "cam_1.yml").write_bytes(archive.read(name))
            camera = read_camera(Path(scratch) / "cam_1.yml")
        height, width = picture.shape[:2]
        seen = camera.project(boxes.centre_m)
        yield f"  {release}: {int(seen[2].sum())} of {len(boxes)} centres in the picture of {width} x {height}: " + (
            ", ".join(f"({u:.0f}, {v:.0f})" for u, v in seen[0][seen[2]])
        )
        drawn.append(boxes_picture(picture, camera, boxes))
    if folder is not None:
        write_image(folder / "kradar.png", np.concatenate(drawn))


def radar(frames: Sequence[Frame], starts: int) -> Iterator[str]:
    """View-of-Delft's radar against its LiDAR: x, y and yaw from +-0.5 m and +-1 degree."""
    sensor = frames[0].sensors["radar"].frame_T_sensor
    sensor_pairs = [replace(each, number=100 * i) for i, each in enumerate(read_sensor_pairs(frames, lidar="lidar"))]
    evidence, truth = RadarEvidence.of(sensor_pairs), invert(sensor)
    yaw = float(np.arctan2(truth[1, 0], truth[0, 0]))
    tilt = np.degrees(np.arccos(np.clip(truth[2, 2], -1, 1)))
    yield f"  published: x {truth[0, 3]:.2f}, y {truth[1, 3]:.2f}, z {truth[2, 3]:.2f} m,"
    counts = ", ".join(str(len(each.echoes_m)) for each in sensor_pairs)
    yield f"  yaw {np.degrees(yaw):.2f}, tilt {tilt:.2f} deg; {counts} strong echoes a frame"
    rng, notes = np.random.default_rng(0), ("two frames do not tell x, y, yaw or the time offset; z is not solved",)
    for number in range(starts):
        x, y = truth[:2, 3] + (rng.uniform(-0.5, 0.5, 2) if number else 0.0)
        turn = yaw + (float(np.radians(rng.uniform(-1, 1))) if number else 0.0)
        guess = RadarPose(x_m=float(x), y_m=float(y), z_m=float(truth[2, 3]), yaw_rad=turn)
        try:
            found = calibrate_radar(evidence, guess, reach_m=1.0, frames=0)
        except DatasetError as error:
            yield f"  from ({x - truth[0, 3]:+.2f}, {y - truth[1, 3]:+.2f}) m: {error}"
            continue
        notes = found.notes
        away = 100 * (found.pose.x_m - truth[0, 3]), 100 * (found.pose.y_m - truth[1, 3])
        angle, sigma = np.degrees(found.pose.yaw_rad - yaw), found.solution.sigma
        yield (
            f"  from ({100 * (x - truth[0, 3]):+4.0f}, {100 * (y - truth[1, 3]):+4.0f}) cm, "
            f"{np.degrees(turn - yaw):+.2f} deg to x {away[0]:+.0f} +- {100 * sigma[0]:.0f} cm, y {away[1]:+.0f} +- "
            f"{100 * sigma[1]:.0f} cm, yaw {angle:+.2f} +- {np.degrees(sigma[2]):.2f} deg; "
            f"{found.residual['matches']:.0f} matches"
        )
    yield from (f"  {note}" for note in notes)


def lines(starts: int, folder: Path | None) -> Iterator[str]:
    """All tables, as they become known."""
    kitti = [each for name in ("kitti", "kitti_more") if (each := SHARED_REAL / name).is_dir()]
    delft = SHARED_REAL / "view_of_delft"
    yield f"\nLiDAR-camera by edges, {starts} starts; medians, worst of the starts; largest of three angles and shifts"
    yield HEAD
    if kitti:
        yield from of_frames("KITTI (09_26)", alike(kitti, "kitti"), starts, folder)
    if delft.is_dir():
        frames = list(open_dataset(delft))
        yield from of_frames("View-of-Delft", frames, starts, folder)
    if (SHARED_REAL / "pcd" / "lidar2camera").is_dir():
        yield from pair(starts, folder)
    if (SHARED_REAL / "kradar" / "example").is_dir():
        yield f"\nK-Radar's example picture with its label's boxes, sequence {KRADAR_SEQUENCE}"
        yield from kradar_example(folder)
    if delft.is_dir():
        yield "\nView-of-Delft's radar against its LiDAR, two frames of two drives"
        yield from radar(frames, min(starts, 5))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--starts", type=int, default=10)
    options = parser.parse_args()
    if options.pictures is not None:
        options.pictures.mkdir(parents=True, exist_ok=True)
    said = [header()]
    print(said[0], flush=True)
    for line in lines(options.starts, options.pictures):
        print(line, flush=True)
        said.append(line)
        if options.output:
            options.output.write_text("\n".join(said) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
