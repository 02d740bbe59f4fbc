"""The tracker: on annotated and simulated drives, K-Radar's identities, its speed, its tuning on KITTI."""

import itertools
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

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
from _report import SHARED_REAL, MissingError, Part, part_parser, run_parts
from jaxtyping import Float

from farfield.frame.drive import Key
from farfield.metrics.box_files import read
from farfield.metrics.detections import Detections
from farfield.tracking import ANNOTATED, PRESETS, JoinSettings, join_tracks, preset, track
from farfield.tracking.offline import smooth_tracks, with_track_score
from farfield.tracking.tracker import DetectionBatch, TrackEngine

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


def run_drives(arguments: Sequence[str]) -> None:
    """The tracker on annotated drives: K-Radar, Argoverse 2's long log, Boreas, RADIATE's fog, and simulated roads.

        python benchmarks/tracking.py drives [--only NAME ...]

    Annotated boxes lose their identities and are tracked back to them, as they are, and degraded with a stated noise.
    All classes count as one; two boxes are alike if their centres lie near each other from above. What is not on this
    machine is left out. The simulated roads are tracked with and without radial velocities from the same detections.
    """
    rows: dict[str, tuple[str, Callable[..., None]]] = {
        "kradar": ("kradar/labels_v2_1.tar.gz", partial(real, "K-Radar v2.1", kradar, RADAR, NO_POSES)),
        "argoverse2": ("argoverse2_tracks", partial(real, "Argoverse 2, log 3b3570b4", argoverse2, LIDAR, {})),
        "boreas": ("boreas_objects", partial(real, "Boreas", boreas, LIDAR, {"max_age": 10, "gate_sigmas": None})),
        "radiate": ("radiate", partial(real, "RADIATE, tiny_foggy", radiate, RADAR, {})),
        **{road: ("", partial(simulated_rows, road)) for road in ROADS},
    }
    parser = part_parser(run_drives.__doc__)
    parser.add_argument("--only", nargs="*", choices=[*rows], default=[*rows])
    parser.add_argument("--frames", type=int, default=300, help="of a simulated road")
    parser.add_argument("--kradar", type=Path, help="a folder of K-Radar's labels of another version, as v2.0")
    options = parser.parse_args(arguments)
    chosen = options.only
    if options.kradar is not None:
        version = next(options.kradar.glob("kradar_revised_label_*"), options.kradar).name
        rows["kradar"] = ("", partial(real, version, lambda _: kradar_labels(options.kradar), RADAR, NO_POSES))
    print(
        "all classes as one, all tracks; a match lies within 2 m, in the simulated roads within 4 m; per cent, counts"
    )
    for name in chosen:
        place, run = rows[name]
        if name in ROADS or (SHARED_REAL / place).exists():
            run(*[options.frames] * (name in ROADS))
        else:
            print(f"\n== {name}: not on this machine")


PARTS: dict[str, tuple[int, ...]] = {"all": (0, 1), "odd": (1,), "even": (0,)}
ABSENCES_S = (0.35, 1.0, 3.0, 10.0, 30.0)


def part_of(found: Detections, rests: tuple[int, ...]) -> Detections:
    """The drives of the sequences that are odd, even, or both."""
    drives = tuple(each for each in found.drives if int(each.name.split(".")[0]) % 2 in rests)
    keys = {key for each in drives for key in each.keys}
    return replace(
        found,
        drives=drives,
        boxes={key: boxes for key, boxes in found.boxes.items() if key in keys},
        annotations={key: each for key, each in found.annotations.items() if key in keys},
    )


def of_sequences(found: Detections, sequences: Collection[str]) -> Detections:
    """The drives of some sequences."""
    drives = tuple(drive for drive in found.drives if drive.name.split(".")[0] in sequences)
    return replace(part(found, [drive.name for drive in drives]), drives=drives)


def bound(truth: Detections, longest_gap_s: float) -> float:
    """Share of boxes in the longest unbroken parts of their identities."""
    again = split_identities(truth, longest_gap_s=longest_gap_s)
    counts: Counter[tuple[str, int, int]] = Counter()
    for key, each in truth.annotations.items():
        old, new = each.boxes.track_id, again.annotations[key].boxes.track_id
        if old is not None and new is not None:
            counts.update(zip([key[0]] * len(old), old.tolist(), new.tolist(), strict=True))
    longest: Counter[tuple[str, int]] = Counter()
    for (drive, old_name, _), count in counts.items():
        longest[drive, old_name] = max(longest[drive, old_name], count)
    return sum(longest.values()) / max(sum(counts.values()), 1)


def rows(truth: Detections, tracked: dict[str, Detections]) -> None:
    """Print the scores of each part, and its bounds."""
    for part, rests in PARTS.items():
        wanted = part_of(truth, rests)
        boxes = sum(len(each.boxes) for each in wanted.annotations.values())
        for name, tracks in tracked.items():
            found = part_of(replace(tracks, annotations=truth.annotations), rests)
            figures = scored(wanted, found, 2.0)["all"]
            shown = [100 * (figures[f"tracking/{each}"] or 0.0) for each in ("IDF1", "HOTA", "AssA")]
            print(f"  {part:>5} {boxes:7} {name:22}", *(f"{value:6.2f}" for value in shown), end="")
            print(f" {figures['all_tracks/IDS'] or 0:6.0f}", flush=True)
        bounds = ", ".join(f"{gap_s:g} s {100 * bound(wanted, gap_s):.2f}" for gap_s in ABSENCES_S)
        print(f"  {part:>5} identity F1 without any mistake up to absences of: {bounds}", flush=True)


def block(name: str, truth: Detections) -> None:
    """Print a version's figures."""
    boxes = sum(len(each.boxes) for each in truth.annotations.values())
    print(f"\n== {name}: {boxes} boxes, {len(truth.annotations)} frames; `annotated`, then {ANNOTATED}")
    online = track(detected(truth, None), preset("annotated"))
    tracked = {"annotated, online": online, "annotated, joined": join_tracks(online, ANNOTATED)}
    for words, wanted in {"numbers": truth, "a number and a class each": class_identities(truth)}.items():
        print(f"identities: {words}\n  {'':5} {'boxes':>7} {'':22} {'IDF1':>6} {'HOTA':>6} {'AssA':>6} {'IDS':>6}")
        rows(wanted, tracked)


def run_identities(arguments: Sequence[str]) -> None:
    """K-Radar's annotated boxes tracked back to their identities by the preset for boxes that people drew.

        python benchmarks/tracking.py identities [FOLDER ...]

    The settings were chosen on the odd sequences; the even ones tell what they are worth on others. Identities are the
    annotated numbers, or a number and a class each. FOLDER holds labels of another version than v2.1. The bounds are
    what a tracker without any mistake reaches that gives up an object at an absence of so long, or at a jump faster
    than 70 m/s.
    """
    parser = part_parser(run_identities.__doc__)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--sequences", nargs="+", help="of v2.1, in place of all")
    options = parser.parse_args(arguments)
    folders = options.folders
    if not folders and not (SHARED_REAL / "kradar" / "labels_v2_1.tar.gz").exists():
        raise MissingError("no K-Radar labels beside the project")
    print("sequences: all, odd (on which the settings were chosen), even; a match lies within 2 m; per cent, counts")
    if (SHARED_REAL / "kradar" / "labels_v2_1.tar.gz").exists():
        truth = kradar(SHARED_REAL)
        block("K-Radar v2.1", truth if options.sequences is None else of_sequences(truth, options.sequences))
    for folder in folders:
        block(next(folder.glob("kradar_revised_label_*"), folder).name, kradar_labels(folder))


TRACKS, STEPS = 30, 200


def frames(drives: int, rng: np.random.Generator) -> list[DetectionBatch]:
    """Detections of cars that drive side by side, 5 % missed."""
    n = drives * TRACKS
    place: Float[np.ndarray, "n 2"] = rng.uniform([0, -50], [200, 50], (n, 2))
    speed = rng.uniform(-1, 1, (n, 2)) * [1.5, 0.1]
    drive = np.repeat(np.arange(drives), TRACKS)
    steps = []
    for number in range(STEPS):
        kept = rng.random(n) > 0.05
        here = place + number * speed + rng.normal(0, 0.1, (n, 2))
        rows = np.column_stack([here, np.zeros(n), np.tile([4.2, 1.8, 1.5, 0.0], (n, 1))])
        m = int(kept.sum())
        seen = DetectionBatch(
            drive=drive[kept],
            boxes=rows[kept],
            velocity_m_s=np.zeros((m, 2)),
            ray_m=here[kept],
            score=np.ones(m),
            label=np.zeros(m, dtype=np.int64),
            source=np.arange(m),
        )
        steps.append(seen)
    return steps


def run_speed(arguments: Sequence[str]) -> None:
    """How many frames a CPU second the tracker takes: filter, association, births and deaths, 30 tracks a frame.

    Several drives run as one batch, one frame of each a step. Reading and writing are not in it.

        python benchmarks/tracking.py speed [--drives 1 10 50]
    """
    parser = part_parser(run_speed.__doc__)
    parser.add_argument("--drives", type=int, nargs="+", default=[1, 10, 50])
    options = parser.parse_args(arguments)
    print(f"one thread; {TRACKS} cars a frame")
    for name in ("ab3dmot-paper", "default", "centerpoint", "ab3dmot"):
        for drives in options.drives:
            steps = frames(drives, np.random.default_rng(0))
            engine = TrackEngine(PRESETS[name], drives=drives, labels=("car",))
            dt, running = np.full(drives, 0.1), np.ones(drives, dtype=bool)
            steps = steps if name != "ab3dmot" or drives < 50 else steps[:40]
            start = time.process_time()
            for seen in steps:
                engine.step(seen, dt, running)
            rate = len(steps) * drives / (time.process_time() - start)
            print(f"{name:14} {drives:3} drives: {rate:8,.0f} frames a CPU second, {len(engine.tracks)} tracks")


TUNED = ("0000", "0002", "0003", "0004", "0005")
GRID: dict[str, tuple[Any, ...]] = {
    "gate_sigmas": (None, 4.0, 6.0),
    "acceleration": (3.0, 10.0, 30.0),
    "sure_score": (None, 0.8, 0.9),
    "unsure_hits": (5, 8),
    "min_hits": (2, 3),
    "max_age": (2, 3),
}
OFFLINE: dict[str, tuple[Any, ...]] = {"max_age": (2, 3, 5, 8), "min_hits": (1, 2, 3), "gate_sigmas": (None, 4.0, 6.0)}
CUTS = (0.0, 1.0, 2.0, 2.5, 3.0, 3.5, 4.0)
_Value = TypeVar("_Value")


def part(found: Detections, sequences: Collection[str]) -> Detections:
    """Detections and annotations of some sequences."""
    return replace(
        found,
        boxes=_of(found.boxes, sequences),
        annotations=_of(found.annotations, sequences),
        prediction_details=_of(found.prediction_details, sequences),
    )


def _of(values: Mapping[Key, _Value], sequences: Collection[str]) -> dict[Key, _Value]:
    return {key: value for key, value in values.items() if key[0] in sequences}


def hota(tracks: Detections, cut: float | None = None) -> float:
    """HOTA of all tracks, or of those of at least a score."""
    kept = tracks if cut is None else with_track_score(tracks, cut)
    return 100 * float(kept.score("tracking", label="Car", iou=0.25).figures["tracking/HOTA"] or 0.0)


def offline(found: Detections, **changes: Any) -> Detections:
    """Tracks of the offline preset, smoothed."""
    return smooth_tracks(track(found, "offline", **changes))


def search(tune: Detections, cut: float) -> None:
    """Print the best of both grids on the tuned half."""
    online = [dict(zip(GRID, each, strict=True)) for each in itertools.product(*GRID.values())]
    online = [
        each for each in online if each["sure_score"] is not None or each["unsure_hits"] == GRID["unsure_hits"][0]
    ]
    scored = sorted(((hota(track(tune, **each, warm_up=each["min_hits"])), str(each)) for each in online), reverse=True)
    print(f"online, {len(online)} settings, the best on the tuned half:")
    print("".join(f"  {value:.2f} {each}\n" for value, each in scored[:8]), end="")
    later = [dict(zip(OFFLINE, each, strict=True)) for each in itertools.product(*OFFLINE.values())]
    scored = sorted(
        ((hota(offline(tune, **each, warm_up=each["min_hits"]), cut), str(each)) for each in later), reverse=True
    )
    print(f"offline at the cut {cut:g}, {len(later)} settings, the best on the tuned half:")
    print("".join(f"  {value:.2f} {each}\n" for value, each in scored[:8]), end="")


def run_tuning(arguments: Sequence[str]) -> None:
    """The tracker's defaults tuned on five sequences of KITTI and reported on five others, beside AB3DMOT.

    Figures are HOTA in 3D, label Car, in per cent. Online takes all tracks that are written. Offline is smoothed and
    cut at one score of tracks, the one at which the preset is best on the tuned half; the preset is cut at the same
    one.

        python benchmarks/tracking.py tuning [DETECTIONS LABELS] [--search]

    ``--search`` tries the grid below on the tuned half; without it only the presets are scored.
    """
    parser = part_parser(run_tuning.__doc__)
    folder = SHARED_REAL / "kitti_tracking"
    parser.add_argument("detections", type=Path, nargs="?", default=folder / "detections_pointrcnn_car")
    parser.add_argument("labels", type=Path, nargs="?", default=folder / "label")
    parser.add_argument("--sequences", nargs="+", help="in place of all")
    parser.add_argument("--search", action="store_true")
    options = parser.parse_args(arguments)
    if not options.labels.is_dir():
        raise MissingError("no KITTI tracking labels beside the project")
    found = read(options.detections, options.labels, format="kitti-tracking")
    found = part(found, options.sequences) if options.sequences else found
    others = sorted({key[0] for key in found.annotations} - set(TUNED))
    halves = {"tuned": part(found, TUNED), "others": part(found, others)}
    print(f"tuned on {', '.join(TUNED)}; others: {', '.join(others)}; HOTA in 3D, per cent")
    reference = {name: track(half, "ab3dmot") for name, half in halves.items()}
    cut = max(CUTS, key=lambda each: hota(reference["tuned"], each))
    if options.search:
        search(halves["tuned"], cut)
    print(f"cut of tracks for the offline figures, best for ab3dmot on the tuned half of {CUTS}: {cut:g}")
    for name, half in halves.items():
        rows = {
            "ab3dmot, online, all tracks": hota(reference[name]),
            "default, online, all tracks": hota(track(half)),
            f"ab3dmot, online, tracks of {cut:g} or more": hota(reference[name], cut),
            f"default, online, tracks of {cut:g} or more": hota(track(half), cut),
            f"offline (smoothed), tracks of {cut:g} or more": hota(offline(half), cut),
            "offline (smoothed), all tracks": hota(offline(half)),
        }
        print("".join(f"{name:7} {row:45} {value:.2f}\n" for row, value in rows.items()), end="")


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "drives": Part(run_drives, "--only highway --frames 20"),
                "identities": Part(run_identities, "--sequences 1"),
                "speed": Part(run_speed, "--drives 1"),
                "tuning": Part(run_tuning, "--sequences 0000 0020"),
            },
        )
    )
