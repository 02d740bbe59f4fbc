"""The radar's tensor: seconds by number of scatterers, peak memory, and its map's statistics beside a real frame's.

    python benchmarks/radar_tensor.py [--repeats 5] [--output benchmarks/results/radar_tensor.txt]

Real figures: one range-azimuth map published with K-Radar (plot_tes_ra.png), digitised. Times are the best of some
repeats, on all cores. Exit status 1 where the full tensor of 10,000 scatterers takes more than 1.0 s or memory passes
2.5 GB.
"""

import argparse
import resource
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from _report import header

from farfield.files.atomic import write_text
from farfield.radar.products import polar3d_from_moments, zyx_cube
from farfield.simulation.radar.model import RadarModel
from farfield.simulation.radar.points import Scatterers, cell_snr
from farfield.simulation.radar.synthesis import draw_noise, form_moments, form_tensor, synthesise

COUNTS = (2_000, 10_000, 30_000)
QUANTILES = (5, 25, 50, 75, 95)
TIME_LIMIT_S, MEMORY_LIMIT_GB = 1.0, 2.5
STRONG_M = (25.0, 33.5, 42.1, 51.8, 60.2)
MODEL = RadarModel()


def peak_gb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def clutter(count: int, rng: np.random.Generator) -> Scatterers:
    """Scatterers all over the field of view, 10 dB a cell at 50 m with 6 dB of spread, one in a hundred 25 dB above."""
    range_m, azimuth = rng.uniform(3, 115, count), np.radians(rng.uniform(-53, 53, count))
    elevation, speed = np.radians(rng.uniform(-10, 10, count)), rng.uniform(-20, 0, count)
    level_db = 10 + rng.normal(0, 6, count) + 40 * np.log10(50 / range_m) + np.where(rng.random(count) < 0.01, 25, 0)
    x, y, z = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
    unit = Scatterers.of(range_m[:, None] * np.stack([x, y, z], axis=1), speed, np.ones(count))
    return replace(unit, rcs_m2=10 ** (level_db / 10) / cell_snr(unit, MODEL))


def best_times(count: int, output: str, repeats: int) -> dict[str, float]:
    """Seconds of each step of the fastest repeat."""
    rng = np.random.default_rng(count)
    seen, phase = clutter(count, rng), rng.uniform(0, 2 * np.pi, count)
    best: dict[str, float] = {}
    for _ in range(repeats):
        start = time.perf_counter()
        noise = draw_noise(MODEL, rng)
        drawn = time.perf_counter()
        channels = synthesise(seen, MODEL, phase, noise)
        added = time.perf_counter()
        form_tensor(channels, MODEL) if output == "tensor" else form_moments(channels, MODEL)
        end = time.perf_counter()
        steps = {"total": end - start, "noise": drawn - start, "echoes": added - drawn, "beams": end - added}
        best = steps if not best or steps["total"] < best["total"] else best
    return best


def strong_objects(rng: np.random.Generator) -> tuple[Scatterers, np.ndarray]:
    """Cars' worth of scatterers whose peaks stand 8.6 dB over the floor of the map, as the real frame's strongest."""
    quiet = replace(MODEL, leakage_db=(-40.0,) * len(MODEL.leakage_db))
    parts, phases = [], []
    for distance in STRONG_M:
        n = 30
        range_m, azimuth = distance + rng.uniform(-0.2, 0.3, n), np.radians(1 + rng.uniform(-1, 1, n))
        tilt = np.radians(rng.uniform(-1.5, 0.5, n))
        place = np.stack([np.cos(tilt) * np.cos(azimuth), np.cos(tilt) * np.sin(azimuth), np.sin(tilt)], axis=1)
        one = Scatterers.of(range_m[:, None] * place, np.full(n, 1.23), np.full(n, 1.0))
        phase = rng.uniform(0, 2 * np.pi, n)
        alone = form_moments(synthesise(one, quiet, phase), quiet).mean_power.mean(axis=1).max() / MODEL.noise_floor
        parts.append(replace(one, rcs_m2=one.rcs_m2 * (10**0.86 - 1) / alone))
        phases.append(phase)
    return Scatterers.join(parts), np.concatenate(phases)


def statistics() -> str:
    """The map of strong objects in noise beside the real frame's figures, and the control of independent noise."""
    rng = np.random.default_rng(7)
    seen, phase = strong_objects(rng)
    tensor = form_tensor(synthesise(seen, MODEL, phase, draw_noise(MODEL, rng)), MODEL)
    level = 10 * np.log10(tensor.mean(axis=(0, 2)))
    floor = level[150:220]
    above = level - np.median(floor)
    rows = [at - 2 + above[at - 2 : at + 3].max(axis=1).argmax() for at in np.int64(STRONG_M) * 256 // 118]
    quantiles = np.mean([np.percentile(above[row], QUANTILES) for row in rows], axis=0)
    widths = [np.sum(above[row] > above[row].max() - 3) for row in rows]
    beside = [above[row + step, above[row].argmax()] for row in rows for step in (-1, 1)]
    axis = MODEL.axes.range_m
    by_range = 10 * np.log10((10 ** (level / 10)).mean(axis=1)) - np.median(floor)
    zones = [
        by_range[(axis >= low) & (axis < high)].mean() for low, high in ((1, 5), (7, 11), (110, 113.5), (114.5, 119))
    ]
    control = 10 * np.log10(rng.exponential(1.0, (64, 20, 37, 107)).mean(axis=(0, 2)))
    cells = tensor[:, 150:200]
    peak = np.mean([above[row].max() for row in rows])
    table = [
        ("range-azimuth map, mean over Doppler and elevation", "simulated", "real"),
        ("floor, 15-107 m, dB", f"{np.median(floor):.1f}", "109.1"),
        ("its deviation between cells, dB", f"{floor.std():.2f}", "0.30"),
        ("  control: independent noise in each cell, dB", f"{control.std():.2f}", ""),
        ("strong rows, quantiles 5/25/50/75/95 %, dB", "/".join(f"{q:.1f}" for q in quantiles), "0.5/0.8/1.2/2.0/4.2"),
        ("  peak (set), dB", f"{peak:.1f}", "8.6"),
        ("  width at -3 dB, cells", f"{np.mean(widths):.1f}", "3-4"),
        ("  neighbours in range, dB", f"{np.mean(beside):.1f}", "2.7, 1.6"),
        ("bin 0, dB", f"{by_range[0]:.0f}", "42 to 50"),
        ("1-5 m, dB", f"{zones[0]:.1f}", "6 to 8"),
        ("7-11 m, dB", f"{zones[1]:.1f}", "-2"),
        ("110-113.5 m, dB", f"{zones[2]:.1f}", "-5"),
        ("last 4 m, dB", f"{zones[3]:.1f}", "2 to 6"),
        ("single cells, median over mean", f"{np.median(cells) / cells.mean():.3f}", "(exponential: 0.693)"),
    ]
    lines = [f"{what:<52}{simulated:<22}{real}".rstrip() for what, simulated, real in table]
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    lines = [header(), "", "seconds, best of repeats        total   noise  echoes   beams"]
    slowest = 0.0
    for output in ("mean", "tensor"):  # memory only grows: the smaller output first
        for count in COUNTS:
            steps = best_times(count, output, options.repeats)
            lines.append(
                f"  {output:<6} {count:6d} scatterers    " + "  ".join(f"{value:6.3f}" for value in steps.values())
            )
            slowest = steps["total"] if (output, count) == ("tensor", 10_000) else slowest
        lines.append(f"  peak memory of the process so far: {peak_gb():.2f} GB")
    rng = np.random.default_rng(0)
    reduced = form_moments(draw_noise(MODEL, rng), MODEL)
    for name, make in (
        ("polar map", lambda: polar3d_from_moments(reduced.mean_power_63, reduced.velocity_moment)),
        ("cube", lambda: zyx_cube(reduced.mean_power)),
    ):
        make()
        start = time.perf_counter()
        make()
        lines.append(f"  {name} from the moments: {time.perf_counter() - start:.3f} s")
    memory = peak_gb()
    lines += [f"  peak memory at the end: {memory:.2f} GB", "", statistics(), ""]
    text = "\n".join(lines)
    print(text)
    if options.output:
        write_text(options.output, text)
    return int(slowest > TIME_LIMIT_S or memory > MEMORY_LIMIT_GB)


if __name__ == "__main__":
    raise SystemExit(main())
