"""The tracker on annotated drives: K-Radar, Argoverse 2's long log, Boreas, RADIATE's fog, and simulated roads.

    python benchmarks/tracking_real.py [--only NAME ...]

Annotated boxes lose their identities and are tracked back to them, as they are, and degraded with a stated noise. All
classes count as one; two boxes are alike if their centres lie near each other from above. What is not on this machine
is left out. The simulated roads are tracked with and without radial velocities from the same detections.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _annotated_drives import (
    Noise,
    argoverse2,
    boreas,
    class_identities,
    detected,
    identities,
    kradar,
    kradar_labels,
    radiate,
    simulated,
    split_identities,
)
from _report import SHARED_REAL, header

from farfield.metrics.detections import Detections
from farfield.tracking import JoinSettings, join_tracks, track

BINS_M = (0.0, 50.0, 100.0, 150.0, 250.0)
LIDAR = Noise(range_sigma_m=0.1, azimuth_sigma_deg=0.1)
RADAR = Noise(range_sigma_m=0.3, azimuth_sigma_deg=0.5)
KRADAR_SPAN_M_S = 3.865
ROADS = ("highway", "urban")
ACROSS_M_S = 3.0
COUNTS = (1, 2, 3, 5, 10)
NO_POSES: dict[str, Any] = {"gate_speed_m_s": 50.0, "gate_sigmas": None, "initial_speed_variance": 600.0}
"""For drives without poses, in whose coordinates others come at up to 60 m/s."""
JOINING = JoinSettings(size=0.03)
"""Annotators keep an object's size."""
_RADAR_OPTIONS = {"range_sigma_m": 0.3, "azimuth_sigma_rad": float(np.deg2rad(0.5)), "min_hits": 2, "unsure_hits": 3}


def scored(truth: Detections, tracks: Detections, distance_m: float) -> dict[str, dict[str, float | None]]:
    """Figures of the whole and of the range bins, without the prefix; all tracks."""
    names = {str(name) for a in truth.annotations.values() for name in np.unique(a.boxes.label)}
    names |= {str(name) for boxes in tracks.boxes.values() for name in np.unique(boxes.label)}
    result = tracks.score(
        "tracking",
        label="object",
        relabel=dict.fromkeys(names, "object"),
        ignore=(),
        similarity="centre",
        distance_m=2 * distance_m,
        iou=0.5,
        range_bins_m=BINS_M,
    )
    parts = {"all": result.figures, **result.ranges}
    return {part: dict(figures) for part, figures in parts.items()}


def line(part: str, figures: dict[str, float | None]) -> str:
    """One row of the table."""
    annotated = (figures["all_tracks/TP"] or 0) + (figures["all_tracks/FN"] or 0)
    if not annotated:
        return ""
    shown = [f"{part:>8}", f"{annotated:7.0f}"]
    for name in ("all_tracks/MOTA", "tracking/HOTA", "tracking/DetA", "tracking/AssA", "tracking/IDF1"):
        value = figures.get(name)
        shown.append(f"{'-':>6}" if value is None else f"{100 * value:6.2f}")
    shown += [f"{figures[f'all_tracks/{name}'] or 0:6.0f}" for name in ("IDS", "FRAG", "FP", "FN")]
    return " ".join(shown)


def show(title: str, truth: Detections, tracks: Detections, distance_m: float = 2.0) -> None:
    """Print a block of the table: the whole and the range bins."""
    parts = scored(truth, tracks, distance_m)
    print(f"\n{title}\n  {'range':>8} {'boxes':>7} {'MOTA':>6} {'HOTA':>6} {'DetA':>6} {'AssA':>6} {'IDF1':>6}", end="")
    print(f" {'IDS':>6} {'FRAG':>6} {'FP':>6} {'FN':>6}")
    rows = [line(part, figures) for part, figures in parts.items()]
    print("".join(f"  {row}\n" for row in rows if row), end="", flush=True)


def real(name: str, of: Callable[[Path], Detections], noise: Noise, options: dict[str, Any]) -> None:
    """Print a real log's blocks: as annotated, and degraded."""
    truth = of(SHARED_REAL)
    boxes = sum(len(a.boxes) for a in truth.annotations.values())
    print(f"\n== {name}: {boxes} boxes, {len(truth.annotations)} frames, {len(truth.drives)} drives")
    found = detected(truth, None)
    show("as annotated, default, min_hits=1", truth, track(found, min_hits=1))
    if options:
        said = "as annotated, default, min_hits=1, " + ", ".join(f"{key}={value}" for key, value in options.items())
        tracks = track(found, min_hits=1, **options)
        title = said
        show(said, truth, tracks)
        again = split_identities(truth)
        if identities(again) > identities(truth):
            said += f"; {identities(truth)} annotated identities, {identities(again)} as those begin anew that are away"
            again_tracks = replace(tracks, annotations=again.annotations)
            show(f"{said} for 1 s or jump by more than 70 m/s", again, again_tracks)
        by_class = class_identities(truth)
        if identities(by_class) > identities(truth):
            words = f"{title}; {identities(by_class)} identities: an annotated number and a class"
            show(words, by_class, replace(tracks, annotations=by_class.annotations))
            whole = replace(join_tracks(tracks, JOINING), annotations=by_class.annotations)
            show(f"{words}; offline, joined: {JOINING}", by_class, whole)
    show(f"degraded ({described(noise)}), default", truth, track(detected(truth, noise)))


def described(noise: Noise) -> str:
    """The noise in a few words."""
    return (
        f"{noise.range_sigma_m:g} m and {noise.azimuth_sigma_deg:g} degrees; missed {100 * noise.missed[0]:g} % to "
        f"{100 * noise.missed[1]:g} % at 250 m; {noise.false_alarms:g} false a frame; seed {noise.seed}"
    )


def radial_errors(truth: Detections, tracks: Detections) -> Iterator[tuple[int, float]]:
    """Error of the radial velocity over ground of each track's n-th box, of boxes within 3 m of an annotated one."""
    seen: dict[tuple[str, int], int] = {}
    for drive in truth.drives:
        for key in drive.keys:
            given, found = truth.annotations[key].boxes, tracks.boxes[key]
            assert found.track_id is None or found.velocity_m_s is not None
            for row, name in enumerate([] if found.track_id is None else found.track_id.tolist()):
                count = seen[key[0], name] = seen.get((key[0], name), 0) + 1
                gap_m = np.hypot(*(given.centre_m - found.centre_m[row])[:, :2].T)
                if not len(gap_m) or gap_m.min() > 3 or given.velocity_m_s is None or found.velocity_m_s is None:
                    continue
                unit = found.centre_m[row] / np.linalg.norm(found.centre_m[row])
                off = found.velocity_m_s[row] - given.velocity_m_s[int(gap_m.argmin())]
                yield count, float(off[:2] @ unit[:2])


def simulated_rows(road: str, frames: int) -> None:
    """Print a simulated road's blocks: the same detections without and with radial velocities."""
    truth = simulated(road, sequence=0, frames=frames)
    boxes = sum(len(a.boxes) for a in truth.annotations.values())
    print(f"\n== simulated {road}, to 250 m: {boxes} boxes, {frames} frames at 10 Hz; {described(RADAR)}")
    kinds = {
        "without radial velocities": (None, None),
        "with (0.1 m/s)": (0.1, None),
        f"with (0.1 m/s, modulo {KRADAR_SPAN_M_S:g} m/s)": (0.1, KRADAR_SPAN_M_S),
    }
    for name, (sigma, span) in kinds.items():
        noise = Noise(doppler_sigma_m_s=sigma, doppler_span_m_s=span)
        across = None if sigma is None else ACROSS_M_S
        tracks = track(detected(truth, noise), **_RADAR_OPTIONS, doppler_span_m_s=span, across_speed_m_s=across)
        by_count: dict[int, list[float]] = {}
        for count, error in radial_errors(truth, tracks):
            by_count.setdefault(count, []).append(abs(error))
        errors = ", ".join(f"{np.percentile(by_count[n], 68):.2f}" for n in COUNTS if n in by_count)
        show(name, truth, tracks, distance_m=4.0)
        print(
            f"  error of the radial velocity (68 % are smaller) in a track's written box 1, 2, 3, 5, 10: {errors} m/s"
        )


def main() -> None:
    """Print all blocks whose data are here."""
    rows: dict[str, tuple[str, Callable[[], None]]] = {
        "kradar": ("kradar/labels_v2_1.tar.gz", partial(real, "K-Radar v2.1", kradar, RADAR, NO_POSES)),
        "argoverse2": ("argoverse2_tracks", partial(real, "Argoverse 2, log 3b3570b4", argoverse2, LIDAR, {})),
        "boreas": ("boreas_objects", partial(real, "Boreas", boreas, LIDAR, {"max_age": 10, "gate_sigmas": None})),
        "radiate": ("radiate", partial(real, "RADIATE, tiny_foggy", radiate, RADAR, {})),
        **{road: ("", partial(simulated_rows, road, 300)) for road in ROADS},
    }
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--only", nargs="*", choices=[*rows], default=[*rows])
    parser.add_argument("--kradar", type=Path, help="a folder of K-Radar's labels of another version, as v2.0")
    options = parser.parse_args()
    chosen = options.only
    if options.kradar is not None:
        version = next(options.kradar.glob("kradar_revised_label_*"), options.kradar).name
        rows["kradar"] = ("", partial(real, version, lambda _: kradar_labels(options.kradar), RADAR, NO_POSES))
    print(header())
    print(
        "all classes as one, all tracks; a match lies within 2 m, in the simulated roads within 4 m; per cent, counts"
    )
    for name in chosen:
        place, run = rows[name]
        if (SHARED_REAL / place).exists():
            run()
        else:
            print(f"\n== {name}: not on this machine")


if __name__ == "__main__":
    main()
