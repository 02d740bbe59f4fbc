"""Draw one sheet a road: every weather as the front camera, the long-range LiDAR and the radar see it.

    python docs/make_weather_sheets.py [--roads urban highway] [--seed 5]

Each row is one weather, every third at night; world, traffic and moment are the same in all rows of a sheet.
"""

import argparse
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from farfield.frame import Frame
from farfield.radar.axes import KRADAR_AXES, POWER_UNIT
from farfield.simulation import simulate_frame
from farfield.simulation.world.scene import ROADS
from farfield.vocabulary.conditions import WEATHERS

IMAGES = Path(__file__).parent / "images" / "weather"
SENSORS = ("os2-64", "cam-front", "polar3d")
COLOURS = {"R": "tab:blue", "L": "tab:red"}


def moment(road: str, weather: str, time: str, seed: int) -> Frame:
    """The same moment of the same road in any weather."""
    options: dict[str, Any] = {"road": road, "weather": weather, "time": time, "duration_s": 40.0}
    return simulate_frame("kradar-sim", seed=seed, sequence=7, index=300, sensors=SENSORS, **options)


def draw_row(axes: Any, frame: Frame, title: str) -> None:
    """Camera, LiDAR from above, radar range-azimuth map."""
    camera, above, radar = axes
    camera.imshow(frame.images["cam-front"][::2, ::2])
    camera.set_title(title, fontsize=7, loc="left")
    camera.set_axis_off()
    cloud = frame.clouds["os2-64"]
    x, y, z = cloud.points_m.T
    shown = (x > -20) & (x < 100) & (np.abs(y) < 40)
    above.scatter(x[shown], y[shown], s=0.15, c=np.clip(z[shown], -2, 4), cmap="viridis", linewidths=0, rasterized=True)
    draw_boxes(above, frame)
    above.set(xlim=(-20, 100), ylim=(-40, 40), aspect="equal")
    above.set_title(f"os2-64: {len(cloud):,} returns", fontsize=7, loc="left")
    power = frame.radar["polar3d"][0].mean(axis=2) * POWER_UNIT
    azimuth, distance = np.meshgrid(np.radians(edges(KRADAR_AXES.azimuth_deg)), edges(KRADAR_AXES.range_m))
    level = 10 * np.log10(np.maximum(power, 1.0))
    x_m, y_m = distance * np.cos(azimuth), distance * np.sin(azimuth)
    radar.pcolormesh(x_m, y_m, level, vmin=108.5, vmax=116, cmap="magma")
    radar.set(xlim=(-20, 100), ylim=(-40, 40), aspect="equal", facecolor="black")
    radar.set_title("radar, mean over Doppler and elevation, 108.5 to 116 dB", fontsize=7, loc="left")
    for each in (above, radar):
        each.tick_params(labelsize=6)


def edges(centres: np.ndarray) -> np.ndarray:
    """Borders of evenly spaced cells."""
    half = (centres[1] - centres[0]) / 2
    return np.append(centres - half, centres[-1] + half)


def draw_boxes(axes: Any, frame: Frame) -> None:
    """Outlines: blue where the radar sees the object, red where only the LiDAR does."""
    boxes = frame.boxes
    if boxes is None:
        return
    for corners, seen in zip(boxes.bev_corners_m(), frame.annotation.visibility, strict=True):
        ring = np.vstack([corners, corners[:1]])
        axes.plot(ring[:, 0], ring[:, 1], color=COLOURS[seen], linewidth=0.6)


def sheet(road: str, seed: int) -> Path:
    """All weathers of one road."""
    figure = Figure(figsize=(13, 2.6 * len(WEATHERS)), layout="constrained")
    grid = figure.subplots(len(WEATHERS), 3, gridspec_kw={"width_ratios": [1.2, 1, 1]})
    for row, weather in enumerate(WEATHERS):
        time = "night" if (row + ROADS.index(road)) % 3 == 2 else "day"
        frame = moment(road, weather, time, seed)
        draw_row(grid[row], frame, "\n".join(wrap(f"{road}, {frame.metadata['weather'].describe()}", 84)))
    IMAGES.mkdir(parents=True, exist_ok=True)
    path = IMAGES / f"{road}.jpg"
    figure.savefig(path, dpi=80, pil_kwargs={"quality": 78, "optimize": True, "progressive": True})
    return path


def main() -> None:
    """Draw the sheets asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--roads", nargs="+", default=list(ROADS), choices=list(ROADS))
    parser.add_argument("--seed", type=int, default=5)
    options = parser.parse_args()
    for road in options.roads:
        path = sheet(road, options.seed)
        print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
