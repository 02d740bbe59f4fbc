"""Real View-of-Delft frames: do the radar, the lidar, the boxes and the camera picture fit together?

    python benchmarks/radar_projection.py [REAL] [--pictures FOLDER] [--output benchmarks/results/radar_projection.txt]

REAL is the data set's root. A picture a frame goes to a folder of your own, as the data's licence does not let us ship
it: boxes, lidar and radar points projected into the camera's image, and the same seen from above. Points of the radar
are coloured by their radial velocity over ground; boxes of objects marked as moving are blue, others grey.
"""

import argparse
from pathlib import Path

import numpy as np
from _report import SHARED_REAL, header
from matplotlib.collections import LineCollection

from farfield.api import open_dataset
from farfield.datasets.view_of_delft.reader import radar_velocity_m_s, read_radar
from farfield.figures.birds_eye import draw_birdseye, draw_boxes
from farfield.figures.camera import box_lines
from farfield.figures.style import ANNOTATED, INK, MUTED, figure_bytes, house_style, new_figure
from farfield.files.atomic import write_text
from farfield.frame import Boxes, Cloud, Frame
from farfield.geometry.boxes import count_points_in_boxes
from farfield.geometry.poses import pose_from_yaw

MARGIN_M = 0.5  # the radar measures a direction to about a degree: half a metre at 30 m
STILL_M_S = 0.5
COLOURS_TO_M_S = 3.0
WINDOW_M = (0.0, 60.0, -25.0, 25.0)
VELOCITY = "v_r_compensated_m_s"


def outside_m(points_m: np.ndarray, box: Boxes) -> np.ndarray:
    """Distance of points from the surface of one box in three dimensions, 0 inside, shape (n,)."""
    turn = pose_from_yaw(float(-box.yaw_rad[0]))[:3, :3]
    local_m = np.abs((points_m - box.centre_m[0]) @ turn.T)
    return np.linalg.norm(np.maximum(local_m - box.size_m[0] / 2, 0.0), axis=1)


def near_any(points_m: np.ndarray, boxes: Boxes, margin_m: float) -> np.ndarray:
    """Which points are inside or within a margin of any box, shape (n,)."""
    near = np.zeros(len(points_m), dtype=bool)
    for index in range(len(boxes)):
        near |= outside_m(points_m, boxes[index : index + 1]) <= margin_m
    return near


def annotated_area(frame: Frame, cloud: Cloud) -> Cloud:
    """The points where objects are annotated: in the camera's picture and within 50 m."""
    seen = frame.cameras["camera"].project(cloud.points_m)[2]
    return cloud[seen & (np.linalg.norm(cloud.points_m, axis=1) < 50.0)]


def box_table(frame: Frame, boxes: Boxes, moving: np.ndarray) -> list[str]:
    """One line a box: range, points of both sensors, distance to the nearest radar point, velocities."""
    lidar, radar = frame.clouds["lidar"], frame.clouds["radar"]
    lines = [f"  {'label':<14} moving range_m  lidar radar nearest_m  median v_r over ground, m/s"]
    counts = count_points_in_boxes(lidar.points_m, boxes, margin_m=0.05)
    names = frame.annotation.original_label
    for index in np.argsort(np.linalg.norm(boxes.centre_m[:, :2], axis=1)):
        gap_m = outside_m(radar.points_m, boxes[index : index + 1])
        inside = gap_m <= MARGIN_M
        speed = f"{np.median(radar.extra[VELOCITY][inside]):+.2f}" if inside.any() else "-"
        range_m = np.linalg.norm(boxes.centre_m[index, :2])
        lines.append(
            f"  {names[index]:<14} {'yes' if moving[index] else 'no':<6} {range_m:7.1f} {counts[index]:6d}"
            f" {inside.sum():5d} {gap_m.min():9.2f}  {speed}"
        )
    return lines


def alternatives(frame: Frame, boxes: Boxes) -> list[str]:
    """How many radar points lie in boxes as read, and with the calibration or the axes wrong on purpose."""
    path = next(name for name in frame.metadata["files"] if "radar" in name and name.endswith(".bin"))
    own, lidar_T_radar = read_radar(Path(path)), frame.sensors["radar"].frame_T_sensor
    mirrored = np.diag([1.0, -1.0, 1.0, 1.0])
    cases = {
        "as read": lidar_T_radar,
        "left and right mirrored": lidar_T_radar @ mirrored,
        "radar taken for lidar coordinates": np.eye(4),
        "turned by +5 degrees": lidar_T_radar @ pose_from_yaw(float(np.radians(5))),
        "turned by -5 degrees": lidar_T_radar @ pose_from_yaw(float(np.radians(-5))),
    }
    moving = boxes[frame.annotation.moving]
    lines = [f"  {'':<34} points in boxes, of them faster than {STILL_M_S} m/s in moving boxes"]
    for name, motion in cases.items():
        cloud = own.transform(motion)
        fast = cloud[np.abs(cloud.extra[VELOCITY]) > STILL_M_S]
        inside = near_any(cloud.points_m, boxes, MARGIN_M).sum()
        lines.append(f"  {name:<34} {inside:6d} {near_any(fast.points_m, moving, MARGIN_M).sum():6d}")
    return lines


def summary(frame: Frame, boxes: Boxes, moving: np.ndarray) -> list[str]:
    """Shares and residuals of a frame's radar points."""
    radar = annotated_area(frame, frame.clouds["radar"])
    speed = np.abs(radar.extra[VELOCITY])
    near_moving = near_any(radar.points_m, boxes[moving], MARGIN_M)
    near_still = near_any(radar.points_m, boxes[~moving], MARGIN_M) & ~near_moving
    background = ~near_any(radar.points_m, boxes, 1.0)
    fast = speed > STILL_M_S

    def share(part: np.ndarray, of: np.ndarray) -> str:
        return f"{(part & of).sum()} of {of.sum()} ({(part & of).sum() / max(of.sum(), 1):.0%})"

    path = next(name for name in frame.metadata["files"] if "radar" in name and name.endswith(".bin"))
    own = read_radar(Path(path))
    velocity = radar_velocity_m_s(own)
    rays = own.points_m / np.linalg.norm(own.points_m, axis=1, keepdims=True)
    residual = np.abs(rays @ velocity - (own.extra[VELOCITY] - own.extra["v_r_m_s"]))
    quantiles = np.percentile(speed[background], [50, 75, 90])
    return [
        f"  clouds: {len(frame.clouds['lidar'])} lidar, {len(frame.clouds['radar'])} radar points; {len(radar)} of"
        f" the radar's in the picture within 50 m; {len(boxes)} boxes, {moving.sum()} moving",
        f"  radar points in or within {MARGIN_M} m of a moving box, faster than {STILL_M_S} m/s:"
        f" {share(fast, near_moving)}",
        f"  of those near a still box: {share(fast, near_still)}; of those more than 1 m from every box:"
        f" {share(fast, background)}",
        f"  points faster than {STILL_M_S} m/s that are near a moving box: {share(near_moving, fast)}",
        f"  |v_r over ground| more than 1 m from every box: median {quantiles[0]:.3f}, 75 % {quantiles[1]:.3f}, 90 %"
        f" {quantiles[2]:.3f} m/s",
        f"  the radar's velocity from its two velocity columns: {np.round(velocity, 3).tolist()} m/s, residual median"
        f" {np.median(residual):.4f}, largest {residual.max():.4f} m/s",
    ]


def picture(frame: Frame, boxes: Boxes, moving: np.ndarray, path: Path) -> None:
    """Draw the camera's image with everything projected, beside the same from above."""
    lidar, radar, camera = frame.clouds["lidar"], frame.clouds["radar"], frame.cameras["camera"]
    image = frame.images["camera"]
    look = {"cmap": "coolwarm", "vmin": -COLOURS_TO_M_S, "vmax": COLOURS_TO_M_S, "edgecolors": INK, "linewidths": 0.5}
    with house_style():
        figure = new_figure(20.0, 7.6)
        left, right = figure.subplots(1, 2, width_ratios=[1.35, 1.0])
        left.imshow(image)
        pixels, _, seen = camera.project(lidar.points_m)
        left.scatter(*pixels[seen][::4].T, s=2.0, c="#ffe066", linewidths=0, alpha=0.8)
        for part, colour in ((boxes[~moving], "#ced4da"), (boxes[moving], "#4dabf7")):
            left.add_collection(LineCollection(box_lines(part, camera), colors=colour, linewidths=1.3))
        pixels, _, seen = camera.project(radar.points_m)
        dots = left.scatter(*pixels[seen].T, s=34, c=radar.extra[VELOCITY][seen], **look)
        left.set(xlim=(0, image.shape[1]), ylim=(image.shape[0], 0), title=f"frame {frame.frame_id}: camera")
        left.set_axis_off()
        draw_birdseye(right, lidar, window_m=WINDOW_M, rings_m=(25.0, 50.0), point_size=0.3)
        draw_boxes(right, boxes[~moving], MUTED, line_width=1.3, order=4)
        draw_boxes(right, boxes[moving], ANNOTATED, line_width=1.6, order=5)
        right.scatter(*radar.points_m[:, :2].T, s=26, c=radar.extra[VELOCITY], zorder=6, **look)
        right.set_title("from above: lidar grey, radar coloured")
        figure.colorbar(dots, ax=right, label="radial velocity over ground (m/s), positive away", shrink=0.8)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(figure_bytes(figure, "png", dpi=110))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("real", type=Path, nargs="?", default=SHARED_REAL / "view_of_delft")
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    lines = [header()]
    for frame in open_dataset(options.real):
        assert frame.boxes is not None
        boxes, moving = frame.boxes, frame.annotation.moving
        lines += [f"\nView-of-Delft, frame {frame.frame_id}", *summary(frame, boxes, moving)]
        lines += ["", *alternatives(frame, boxes), "", *box_table(frame, boxes, moving)]
        if options.pictures:
            picture(frame, boxes, moving, options.pictures / f"view_of_delft_{frame.frame_id}.png")
    text = "\n".join([*lines, ""])
    print(text)
    if options.output:
        write_text(options.output, text)


if __name__ == "__main__":
    main()
