"""Detectors on the real road: false vehicles over the recall of pasted cars, far cars, and what is found near by."""

import json
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from _report import ROOT, SHARED_REAL, MissingError, Part, part_parser, run_parts
from detectors import KITTI_DRIVES, counted, identified, learnt_from

from farfield.api import load_detector, open_dataset
from farfield.datasets.base import Dataset
from farfield.datasets.memory import InMemory
from farfield.detectors import Detector
from farfield.evaluation.donor_trial import (
    KINDS,
    LEAST_POINTS,
    RECALL,
    RECALLS,
    DonorTrial,
    PastedCar,
    Shares,
    interval_over_sweeps,
    paired_difference,
    recall_by_points,
    recall_by_range,
)
from farfield.evaluation.pasted_cars import (
    FAR_POINTS,
    FAR_RANGES_M,
    InField,
    all_around,
    annotated_cars,
    far_pasted_cars,
    in_camera,
    try_on_donors,
)
from farfield.files.atomic import write_text
from farfield.frame import Boxes, Frame, transform_frame
from farfield.geometry.poses import invert
from farfield.metrics.centre import DdsSettings, object_differences, object_intervals
from farfield.metrics.frames import BoxesByFrame
from farfield.pages.false_vehicles_page import render_false_vehicles
from farfield.simulation import simulate_frame
from farfield.simulation.lidar.model import HDL_64E, LUMINAR_H2, LidarModel
from farfield.vocabulary.conditions import WORLDS

DETECTORS = (
    "pointpillars-cirrus-sim",
    "pointpillars-roads",
    "voxelnet-cirrus-sim",
    "second-cirrus-sim",
    "sparsecentre-cirrus-sim",
    "pointrcnn-cirrus-sim",
)
VLP_32C = replace(HDL_64E, name="vlp-32c", reference_range_m=100.0, max_range_m=200.0)
"""Argoverse 2 has two of them, one above the other: its points' rays begin in two places 0.2 m apart."""
VLP_16 = replace(HDL_64E, name="vlp-16", reference_range_m=60.0, max_range_m=100.0, min_range_m=1.0)
PANDAR_40 = replace(HDL_64E, name="pandar-40", reference_range_m=100.0, max_range_m=200.0, min_range_m=0.5)


@dataclass(frozen=True, kw_only=True)
class Donors:
    """Real annotated sweeps: the data, how their sensor measures, where they are annotated, which cloud is meant."""

    data: Dataset
    model: LidarModel
    in_field: InField
    scene: str = ""
    drives: Mapping[str, str] = field(default_factory=dict)
    cloud: str = "lidar"

    def frames(self) -> list[Frame]:
        """The frames in the sensor's axes, with its cloud alone and the scene's name as their sequence."""
        frames = []
        for frame in self.data:
            cloud = self.cloud if self.cloud in frame.clouds else next(iter(frame.clouds))
            sensor = frame.sensors.get(cloud)
            frame = replace(frame, clouds={cloud: frame.cloud(cloud)}, sequence=self.scene_of(frame))
            pose = None if sensor is None else sensor.frame_T_sensor
            frames.append(frame if pose is None else transform_frame(frame, invert(pose)))
        return frames

    def scene_of(self, frame: Frame) -> str:
        """The scene that a frame shows."""
        return self.scene or self.drives.get(frame.frame_id, f"{frame.sequence} {frame.frame_id}")


def donors(real: Path, only: str | None = None) -> dict[str, Donors]:
    """Sets by name; of all the one whose name has a word."""
    luminar = partial(open_dataset, real / "cirrus_layout" / "Cirrus_dataset1")
    sets: dict[str, tuple[Callable[[], Dataset], LidarModel, InField, str]] = {
        "KITTI": (partial(open_dataset, real / "kitti"), HDL_64E, in_camera, ""),
        "KITTI, further": (partial(open_dataset, real / "kitti_more"), HDL_64E, in_camera, ""),
        "View-of-Delft": (partial(open_dataset, real / "view_of_delft" / "lidar"), HDL_64E, in_camera, ""),
        "Luminar ahead": (luminar, LUMINAR_H2, all_around, "Luminar"),
        "Luminar behind": (partial(luminar, rotate_deg=180), LUMINAR_H2, all_around, "Luminar"),
        "Argoverse 2": (partial(open_dataset, real / "argoverse2"), VLP_32C, all_around, "Argoverse 2"),
        "Astyx": (partial(open_dataset, real / "astyx"), VLP_16, in_camera, ""),
        "SUSTechPOINTS": (partial(open_dataset, real / "sustechpoints"), PANDAR_40, all_around, "SUSTechPOINTS"),
    }
    if not real.is_dir():
        raise MissingError(f"no real frames in {real.name}")
    return {
        title: Donors(
            data=opened(),
            model=model,
            in_field=in_field,
            scene=scene,
            drives=KITTI_DRIVES if "KITTI" in title else {},
        )
        for title, (opened, model, in_field, scene) in sets.items()
        if not only or only in title
    }


def named(name: str) -> str:
    """A detector as the tables call it."""
    return Path(name).name


@dataclass(frozen=True, kw_only=True)
class Store:
    """Trials by detector and set in a folder, so that an interrupted table goes on; what is out of time is not run."""

    folder: Path
    minutes: float
    began_s: float

    def trial(self, name: str, title: str, one: Donors) -> DonorTrial | None:
        """A trial from the folder, if it is of these weights and frames, or run now; None where time is up."""
        path = self.folder / f"{named(name)} {title}.json".replace(",", "").replace(" ", "-")
        detector = load_detector(name)
        key = {"detector": detector.digest(), "frames": one.data.fingerprint(), "model": one.model.name}
        if path.is_file() and (tree := json.loads(path.read_text(encoding="utf-8")))["key"] == key:
            return replace(DonorTrial.from_json(tree["trial"]), scenes=[one.scene_of(frame) for frame in one.data])
        if time.monotonic() - self.began_s > 60 * self.minutes:
            return None
        trial = try_on_donors(detector, one.frames(), one.model, in_field=one.in_field)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps({"key": key, "trial": trial.to_json()}))
        return trial


def at_recall(trial: DonorTrial, sweeps: np.ndarray) -> float | None:
    """False vehicles a sweep at the recall that all tables are at."""
    return trial.at_recall(RECALL, sweeps)


def row(name: str, trial: DonorTrial, before: DonorTrial | None) -> str:
    """One detector on one set: the curve at a few recalls, false vehicles at 0.3, and what they are."""
    cars = [car for car in trial.cars if car.points >= LEAST_POINTS]
    values = [trial.at_recall(recall) for recall in RECALLS]
    curve = "".join(f"{'-' if value is None else format(value, '.2f'):>7}" for value in values)
    interval = interval_over_sweeps(trial, at_recall)
    spans = "" if interval is None else f"[{interval[0]:.1f}, {interval[1]:.1f}]"
    at_03 = sum(one.score >= 0.3 for one in trial.false) / max(trial.sweeps, 1)
    threshold = trial.threshold_at()
    kinds = Counter(one.kind for one in trial.false if threshold is not None and one.score >= threshold)
    change = ""
    if before is not None:
        result = paired_difference(before, trial, at_recall)
        change = "  change not known" if result is None else f"  change {result[0]:+.2f}"
        change += "" if result is None or result[1] is None else f" [{result[1][0]:+.1f}, {result[1][1]:+.1f}]"
    counts = " ".join(f"{kinds[kind]:4d}" for kind in KINDS)
    return f"  {name:<26}{len(cars):6d}{curve}  {spans:<14}{at_03:7.2f}   {counts}{change}"


def spread(trial: DonorTrial) -> str:
    """Recall and false vehicles a sweep by range and points."""
    threshold = trial.threshold_at() or 0.3
    by_range, by_points = trial.recall_by_range(threshold), trial.recall_by_points(threshold)
    false = [
        ", ".join(f"{key} {value:.2f}" for key, value in counts.items())
        for counts in (trial.false_by_range(threshold), trial.false_by_points(threshold))
    ]
    return (
        f"      recall at {threshold:.2f}: {shares(by_range)}; points {shares(by_points)}\n"
        f"      false a sweep: {'; points '.join(false)}"
    )


def shares(recall: Shares) -> str:
    """Recall by what the cars are sorted by."""
    return ", ".join(f"{key} {value:.2f} of {count}" for key, (value, count) in recall.items() if value is not None)


def run_false(arguments: Sequence[str]) -> None:
    """False vehicles a sweep over the recall of simulated cars pasted into the same real sweeps.

        python benchmarks/real_road.py false [REAL] [--detectors BEFORE AFTER ...] [--minutes M] [--pages FOLDER]

    Annotated objects are taken out; what is still detected within 70 m, in the annotated field, is false. Cars stand in
    the sweeps at 6 to 70 m; those of five points and more count. Beside each detector stands its change from the first
    one named, paired over drawn scenes. Trials are kept in a folder: the same command goes on where it stopped, and
    after --minutes begins no further one. Pages go to a folder of your own: the frames' licences do not let us ship
    them.
    """
    parser = part_parser(run_false.__doc__)
    parser.add_argument("real", type=Path, nargs="?", default=SHARED_REAL)
    parser.add_argument("--detectors", nargs="+", default=list(DETECTORS))
    parser.add_argument("--only", help="of the sets, those whose name has this word")
    parser.add_argument("--trials", type=Path, default=ROOT / "data" / "real_road")
    parser.add_argument("--minutes", type=float, default=1e6)
    parser.add_argument("--pages", type=Path)
    options = parser.parse_args(arguments)
    sets = donors(options.real, options.only)
    store = Store(folder=options.trials, minutes=options.minutes, began_s=time.monotonic())
    pooled: dict[str, DonorTrial | None] = {named(name): DonorTrial() for name in options.detectors}
    print(f"false vehicles a sweep where so many of the pasted cars of {LEAST_POINTS} points and more are found")
    recalls = "".join(f"{recall:>7.0%}" for recall in RECALLS)
    print(f"  {'':<26}{'cars':>6}{recalls}  {f'{RECALL:.0%}, 95 %':<14}{'at 0.3':>7}   {', '.join(KINDS)}")
    trial_of = {
        (title, named(name)): store.trial(name, title, one) for name in options.detectors for title, one in sets.items()
    }
    for title, one in sets.items():
        trials = {name: trial_of[title, name] for name in pooled}
        print_set(f"{title}: {len(one.data)} sweeps", trials)
        for name, trial in trials.items():
            whole = pooled[name]
            if trial is None or whole is None:
                pooled[name] = None
                continue
            whole.add(trial, "")
            if options.pages:
                options.pages.mkdir(parents=True, exist_ok=True)
                page = render_false_vehicles(trial, InMemory(one.frames()), detector=name, name=title)
                write_text(options.pages / f"{title} {name}.html".replace(",", "").replace(" ", "-"), page)
    if len(sets) > 1:
        sweeps = sum(len(one.data) for one in sets.values())
        scenes = len({one.scene_of(frame) for one in sets.values() for frame in one.data})
        print_set(f"all: {sweeps} sweeps of {scenes} scenes", pooled)


def print_set(title: str, trials: Mapping[str, DonorTrial | None]) -> None:
    """All detectors on one set."""
    print(title)
    first = next(iter(trials.values()))
    for name, trial in trials.items():
        if trial is None:
            print(f"  {name:<26}not run", flush=True)
            continue
        print(row(name, trial, None if trial is first else first))
        print(spread(trial), flush=True)


def simulated(world: str, roads: int, frames: int) -> Iterable[Frame]:
    """Gaussian sweeps of the Cirrus car on some roads."""
    for sequence, index in np.ndindex(roads, frames):
        yield simulate_frame(
            "cirrus-sim", seed=901, sequence=sequence, index=20 * index, sensors=("gaussian",), world=world
        )


def run_far(arguments: Sequence[str]) -> None:
    """Cars at 70 to 250 m: found in simulated sweeps, pasted into real ones, and real ones, by points and range.

        python benchmarks/real_road.py far [REAL] [--detectors NAME_OR_RUN ...] [--roads 8] [--frames 3]

    All at a score of 0.3, cars of a point and more, a match within 2 m. Simulated cars have the detector's own world
    about them, pasted ones a real one; at equal numbers of points the difference is the background's.
    """
    parser = part_parser(run_far.__doc__)
    parser.add_argument("real", type=Path, nargs="?", default=SHARED_REAL)
    parser.add_argument("--detectors", nargs="+", default=["pointpillars-cirrus-sim"])
    parser.add_argument("--only", default="Luminar", help="of the sets, those whose name has this word")
    parser.add_argument("--roads", type=int, default=8)
    parser.add_argument("--frames", type=int, default=3, help="of each road")
    parser.add_argument("--worlds", nargs="+", choices=WORLDS, default=["v2"])
    options = parser.parse_args(arguments)
    sets = donors(options.real, options.only)
    span = float(FAR_RANGES_M[0][0]), float(FAR_RANGES_M[-1][1])
    print(f"recall at {span[0]:g} to {span[1]:g} m at a score of 0.3 by points and range")
    for name in options.detectors:
        detector = load_detector(name)
        print(named(name))
        cars: dict[str, list[PastedCar]] = {}
        for world in options.worlds:
            frames = simulated(world, options.roads, options.frames)
            cars[f"simulated, {world}"] = annotated_cars(detector, frames, span, in_field=in_window)
        for title, one in sets.items():
            frames = one.frames()
            cars[f"pasted, {title}"] = far_pasted_cars(detector, frames, one.model, in_field=in_window)
            cars[f"real, {title}"] = annotated_cars(detector, frames, span, in_field=in_window)
        cars = {what: [car for car in own if car.points] for what, own in cars.items()}
        for what, own in cars.items():
            by_points, by_range = recall_by_points(own, 0.3, FAR_POINTS), recall_by_range(own, 0.3, FAR_RANGES_M)
            print(f"  {what:<24} points {shares(by_points)}; {shares(by_range)}", flush=True)
        reference = recall_by_points(next(iter(cars.values())), 0.3, FAR_POINTS)
        for what in (what for what in cars if what.startswith("pasted")):
            pairs = [
                (key, value, reference[key][0])
                for key, (value, _) in recall_by_points(cars[what], 0.3, FAR_POINTS).items()
            ]
            apart = ", ".join(
                f"{key} {value - other:+.2f}" for key, value, other in pairs if None not in (value, other)
            )
            print(f"  {what} less simulated: {apart or 'no car of equal points'}", flush=True)


def in_window(frame: Frame, boxes: Boxes) -> np.ndarray:
    """Boxes ahead, where the detectors look."""
    del frame
    return (boxes.centre_m[:, 0] > 0) & (np.abs(boxes.centre_m[:, 1]) < 50.0)


NEAR = DdsSettings(min_points=LEAST_POINTS, range_bins_m=(0.0, 70.0), epsilons=(0.0,))
AP_2M = "ap/2.0"


def run_near(arguments: Sequence[str]) -> None:
    """AP at 2 m of visible real vehicles within 70 m, by set and pooled, with intervals over scenes and objects.

        python benchmarks/real_road.py near [REAL] [--detectors BEFORE AFTER ...]

    Vehicles of five points and more, ahead, in the annotated field. Beside each detector stands its change from the
    first one named: the same scenes and objects are drawn for both. What a detector saw in training stands beside.
    """
    parser = part_parser(run_near.__doc__)
    parser.add_argument("real", type=Path, nargs="?", default=SHARED_REAL)
    parser.add_argument("--detectors", nargs="+", default=["pointpillars-cirrus-sim"])
    parser.add_argument("--only", help="of the sets, those whose name has this word")
    options = parser.parse_args(arguments)
    sets = donors(options.real, options.only)
    frames = {title: one.frames() for title, one in sets.items()}
    detectors = {named(name): load_detector(name) for name in options.detectors}
    truth: dict[str, dict] = {}
    for title, own in frames.items():
        boxes = identified(own, {frame.key: in_annotated(sets[title], frame, counted(frame)) for frame in own})
        truth[title] = {(f"{title}: {key[0]}", key[1]): value for key, value in boxes.items()}
    detections = {
        name: {title: detected(detector, sets[title], title, own) for title, own in frames.items()}
        for name, detector in detectors.items()
    }
    print(f"AP at 2 m, vehicles of {LEAST_POINTS} points and more within 70 m")
    for title in [*sets, "all"] if len(sets) > 1 else [*sets]:
        chosen = [*sets] if title == "all" else [title]
        annotations = {key: value for part in chosen for key, value in truth[part].items()}
        scenes = {key: key[0].partition(": ")[2] for key in annotations}
        runs = {name: {k: v for part in chosen for k, v in by[part].items()} for name, by in detections.items()}
        print(f"{title}: {len(annotations)} frames of {len(set(scenes.values()))} scenes")
        for name, run in runs.items():
            data = [] if title == "all" else [sets[title].data]
            print(near_row(name, next(iter(runs.values())), run, annotations, scenes), end="")
            words = [learnt_from(own, detectors[name].info.provenance) for own in data]
            print("".join(f"  seen in training: {text}" for text in words), flush=True)


def in_annotated(one: Donors, frame: Frame, boxes: Boxes) -> Boxes:
    """The boxes in the annotated field."""
    return boxes[one.in_field(frame, boxes)] if len(boxes) else boxes


def detected(detector: Detector, one: Donors, title: str, frames: Sequence[Frame]) -> dict:
    """Detections in the annotated field by set, scene and frame."""
    return {(f"{title}: {f.sequence}", f.frame_id): in_annotated(one, f, detector(f)) for f in frames}


def near_row(
    name: str, first: BoxesByFrame, run: BoxesByFrame, annotations: BoxesByFrame, scenes: Mapping[tuple[str, str], str]
) -> str:
    """One detector: AP at 2 m with its interval, and the change from the first."""
    own = object_intervals(run, annotations, NEAR, scenes=scenes)
    change = object_differences(first, run, annotations, NEAR, scenes=scenes)
    value, interval = change.after[AP_2M], own.intervals[AP_2M]
    text = f"  {name:<26}{own.objects:5d} objects  {'-' if value is None else format(value, '.3f')}"
    text += "" if interval is None else f" [{interval[0]:.3f}, {interval[1]:.3f}]"
    old, span = change.before[AP_2M], change.intervals[AP_2M]
    if run is not first and value is not None and old is not None:
        text += f"  change {value - old:+.3f}" + ("" if span is None else f" [{span[0]:+.3f}, {span[1]:+.3f}]")
    return text


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "false": Part(
                    run_false, "--only View-of-Delft --detectors pointpillars-cirrus-sim --trials TMP/trials"
                ),
                "far": Part(run_far, "--only 'Luminar ahead' --roads 1 --frames 1"),
                "near": Part(run_near, "--only View-of-Delft"),
            },
        )
    )
