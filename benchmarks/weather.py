"""What each weather costs the sensors: the same moments of the same worlds in all seven conditions.

    python benchmarks/weather.py [--moments 24] [--output benchmarks/results/weather.txt]

LiDAR: hits of the os2-64 on cars between 10 and 60 m, summed over all moments. Radar: median change of the cars' signal
over noise. How much of the sensors' windows ice covers is an input (simulation.json says how much); only the order is a
result. Exit status 1 if hits do not fall in the order normal > rain, light snow > fog > heavy snow, sleet, or the radar
changes by 3 dB or more.
"""

import argparse
import itertools
from pathlib import Path

import numpy as np
from _report import header

from farfield.files.atomic import write_text
from farfield.simulation import find_preset
from farfield.simulation.rigs.drive import drive_of
from farfield.simulation.rigs.kradar import KRadarFrame
from farfield.simulation.world.scene import ROADS
from farfield.vocabulary.conditions import WEATHERS


def look(weather: str, number: int) -> tuple[dict[int, int], dict[int, float]]:
    """Hits and signal over noise of the cars near by, by track."""
    road = ROADS[number % len(ROADS)]
    preset = find_preset("kradar-sim", weather=weather, time="day", road=road, duration_s=60.0, radar_offset_ms=(0, 0))
    moment = KRadarFrame(drive_of(preset, 77, number), 500)
    offset = moment.window.bottom_m - moment.world_T_lidar[:3, 3]
    distance = np.hypot(offset[:, 0], offset[:, 1])
    ahead = offset @ moment.world_T_lidar[:3, 0] > 0.5 * distance
    owner = moment.sweep("os2-64").actor
    hits = np.bincount(owner[owner >= 0], minlength=len(distance))
    snr_db = moment.measured(()).snr_db
    radar = {actor.track_id: float(snr) for actor, snr in zip(moment.radar_window.actors, snr_db, strict=True)}
    rows = [
        row
        for row, actor in enumerate(moment.window.actors)
        if actor.label == "vehicle" and 10 < distance[row] < 60 and ahead[row]
    ]
    tracks = [moment.window.actors[row].track_id for row in rows]
    return (
        {track: int(hits[row]) for track, row in zip(tracks, rows, strict=True)},
        {track: radar.get(track, -np.inf) for track in tracks},
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--moments", type=int, default=24)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    hits: dict[str, int] = {}
    change: dict[str, float] = {}
    clear = [look("normal", number) for number in range(options.moments)]
    for weather in WEATHERS:
        seen = [look(weather, number) for number in range(options.moments)]
        hits[weather] = sum(sum(found.values()) for found, _ in seen)
        differences = [
            snr - clear[number][1][track]
            for number, (_, found) in enumerate(seen)
            for track, snr in found.items()
            if np.isfinite(snr) and clear[number][1].get(track, -np.inf) > 5
        ]
        change[weather] = float(np.median(differences))
    cars = sum(len(found) for found, _ in clear)
    lines = [header(), "", f"{options.moments} moments on {len(ROADS)} roads, {cars} cars ahead between 10 and 60 m"]
    lines += ["weather      os2-64 hits on cars   of normal   radar signal over noise, median change"]
    lines += [
        f"{weather:<12} {hits[weather]:19,}  {hits[weather] / hits['normal']:9.2f}  {change[weather]:+8.2f} dB"
        for weather in WEATHERS
    ]
    groups = [("normal",), ("rain", "light_snow"), ("fog",), ("heavy_snow", "sleet")]
    ordered = all(
        min(hits[name] for name in before) > max(hits[name] for name in after)
        for before, after in itertools.pairwise(groups)
    )
    lines += [f"order normal > rain, light snow > fog > heavy snow, sleet: {'holds' if ordered else 'BROKEN'}", ""]
    text = "\n".join(lines)
    print(text)
    if options.output:
        write_text(options.output, text)
    return int(not ordered or max(abs(value) for value in change.values()) >= 3)


if __name__ == "__main__":
    raise SystemExit(main())
