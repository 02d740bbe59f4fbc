"""Ray casting side by side: a frame's rays cast by the simulator, and the same rays by Embree's own call.

    python benchmarks/ray_casting.py [--repeat 9] [--output benchmarks/results/ray_casting.txt]

Both cast the same arrays of origins and directions at the same mesh, in turns, one thread; the simulator's call also
gives the cosine of incidence. Making the rays is not part of it. It is part of the seconds of whole frames beside them
(five rays a beam, motion, pruning, echoes, detection).
Exit status 1 where the simulator casts less than 0.8 of Embree's rays a second.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from _report import header

from farfield.files.atomic import write_text
from farfield.geometry.poses import pose_from_yaw
from farfield.simulation.lidar.model import LUMINAR_H2, OS1_128, OS2_64, LidarModel
from farfield.simulation.lidar.rays import Scan, turned
from farfield.simulation.lidar.rays import SensorPath as SensorPath
from farfield.simulation.lidar.sweep import sweep
from farfield.simulation.world.scene import SceneWindow, WorldScene

LEAST_RATIO = 0.8
EGO_T_SENSOR = pose_from_yaw(0.0, (0.0, 0.0, 1.9))


def seconds(action: Callable[[], object]) -> float:
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def world_rays(scan: Scan, window: SceneWindow) -> tuple[np.ndarray, np.ndarray]:
    """Every ray of a rolling frame in the frame of the fixed surroundings."""
    path = SensorPath.towards(window.bodies[0], window.world_T_ego @ EGO_T_SENSOR, window.knots_s)
    pose = path.at(scan.times_s)
    directions = np.ascontiguousarray(turned(pose, scan.rays).reshape(-1, 3))
    origins = np.broadcast_to(pose[..., 3], (*scan.rays.shape[1:], 3))
    return np.ascontiguousarray(origins).reshape(-1, 3), directions


def compare(model: LidarModel, window: SceneWindow, repeat: int) -> tuple[float, float, float]:
    """Best rays a second of both, in alternating repetitions, and the median of their ratio."""
    scan = Scan.draw(model, np.random.default_rng(0))
    origins, directions = world_rays(scan, window)
    tracer = window.bodies[0].tracer
    ours, embrees = [], []
    for _ in range(repeat):
        embrees.append(seconds(lambda: tracer.scene.run(origins, directions, output=1)))
        ours.append(seconds(lambda: tracer.cast_anchored(origins, directions)))
    ratio = float(np.median(np.array(embrees) / np.array(ours)))
    return len(directions) / min(ours), len(directions) / min(embrees), ratio


def frame_seconds(model: LidarModel, window: SceneWindow, repeat: int) -> float:
    def measure() -> object:
        rng = np.random.default_rng(1)
        return sweep(Scan.draw(model, rng), model, window, EGO_T_SENSOR, rng)

    measure()
    return min(seconds(measure) for _ in range(repeat))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=9)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    lines, worst = [header(), ""], np.inf
    for road in ("highway", "urban"):
        scene = WorldScene(road, np.random.SeedSequence(5), duration_s=10.0)
        window = scene.window(2.0, half_span_s=0.06, reach_m=360.0, behind_m=150.0)
        lines.append(
            f"{road}: {len(window.bodies[0].tracer.mesh.faces)} triangles stand, {len(window.bodies) - 1} bodies move"
        )
        for model in (LUMINAR_H2, OS2_64, OS1_128):
            ours, embrees, ratio = compare(model, window, options.repeat)
            worst = min(worst, ratio)
            frame = frame_seconds(model, window, options.repeat)
            lines.append(
                f"  {model.name:<11} simulator {ours / 1e6:5.2f}, Embree {embrees / 1e6:5.2f} million rays a second, "
                f"ratio {ratio:.2f}; whole frame {frame:.3f} s"
            )
    text = "\n".join([*lines, f"lowest ratio {worst:.2f} (wanted: at least {LEAST_RATIO})", ""])
    print(text)
    if options.output:
        write_text(options.output, text)
    return int(worst < LEAST_RATIO)


if __name__ == "__main__":
    raise SystemExit(main())
