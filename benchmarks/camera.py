"""Camera pictures: seconds a picture by camera, road, weather and time, in one thread, and the memory they take.

    python benchmarks/camera.py [--repeats 6] [--output benchmarks/results/camera.txt]

Exit status 1 where the best of the repeats exceeds 0.30 s for 1280 x 720 or 0.40 s for 1920 x 650 pixels, or the
process 500 MB. The first picture of each case (kernels loaded or compiled, ray grid inverted) is given by itself.
"""

import argparse
import os
import resource
import time
from pathlib import Path

import numpy as np
from _report import header

from farfield.files.atomic import write_text
from farfield.geometry.poses import pose
from farfield.simulation.camera.mounts import rig_cameras
from farfield.simulation.camera.render import render
from farfield.simulation.weather.conditions import draw_weather
from farfield.simulation.world.scene import WorldScene

LIMIT_S = {"kradar": 0.30, "cirrus": 0.40}
NAMES = {"kradar": "front_left", "cirrus": "front"}
CASES = (("normal", "day"), ("fog", "day"), ("heavy_snow", "day"), ("rain", "day"), ("rain", "night"))


def time_case(rig: str, road: str, repeats: int) -> tuple[list[str], float]:
    """Lines of figures for one camera on one road, and the slowest of the best times."""
    window = WorldScene(road, np.random.SeedSequence(3), duration_s=20.0).window(5.0)
    ego_T_lidar = pose(np.eye(3), np.array([0.0, 0.0, 1.6]))
    camera = rig_cameras(rig, ego_T_lidar)[NAMES[rig]]
    lines, worst = [], 0.0
    for condition, moment in CASES:
        weather = draw_weather(condition, moment, np.random.default_rng(7))
        seconds = []
        for _ in range(repeats + 1):
            start = time.perf_counter()
            render(window, camera, window.world_T_ego_now @ ego_T_lidar, weather, np.random.default_rng(1))
            seconds.append(time.perf_counter() - start)
        best = min(seconds[1:])
        worst = max(worst, best)
        size = f"{camera.width_px} x {camera.height_px}"
        middle = np.median(seconds[1:])
        lines.append(
            f"  {size:11s} {road:8s} {condition:10s} {moment:5s}"
            f"  best {best:.3f} s  median {middle:.3f} s  first {seconds[0]:.2f} s"
        )
    return lines, worst


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=6)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    lines, slow = [], False
    for rig in LIMIT_S:
        for road in ("highway", "urban"):
            more, worst = time_case(rig, road, options.repeats)
            lines += more
            slow = slow or worst > LIMIT_S[rig]
    memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    load = f"load average before: {os.getloadavg()[2]:.2f} (15 min)"
    text = "\n".join([header(), load, "", *lines, f"peak memory of the process: {memory_mb:.0f} MB", ""])
    print(text)
    if options.output:
        write_text(options.output, text)
    return int(slow or memory_mb > 500)


if __name__ == "__main__":
    raise SystemExit(main())
