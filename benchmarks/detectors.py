"""Scores of LiDAR detectors: the same budget for all, the shipped ones, on real frames, options for far objects."""

import hashlib
import json
import platform
import sys
import time
from collections.abc import Mapping, Sequence
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
from _report import ROOT, SHARED_REAL, MissingError, Part, git, part_parser, progress, run_parts
from detector_speed import busy_cloud, milliseconds
from PIL import Image

from farfield.api import load_detector, open_dataset
from farfield.datasets.base import Dataset
from farfield.datasets.open_sweeps import package_places
from farfield.detectors.info import SIMULATED_FAMILIES, family_with_start, open_places
from farfield.detectors.weights import bundled_weights, resolve_weights
from farfield.evaluation import detect, median_ms
from farfield.evaluation.leakage import seen_in_training
from farfield.figures.birds_eye import birdseye, fitting_window
from farfield.files.atomic import write_text
from farfield.frame import Boxes, Frame
from farfield.frame.provenance import processor
from farfield.geometry.boxes import count_points_in_boxes
from farfield.metrics import score
from farfield.metrics.bootstrap import percentile_interval
from farfield.metrics.centre import DdsSettings, ObjectIntervals, object_intervals
from farfield.metrics.deciding import ScoreSample, figure, samples
from farfield.simulation.recording import record

SPLIT = "cirrus-sim-val-v2"
EPSILONS = (0.0, 0.003, 0.006, 0.009)
CLOUDS = ("gaussian", "uniform")
BUDGET_RANGES = ("0-70", "70-150", "150-250", "overall")
FIGURES = ROOT / "src" / "farfield" / "detectors" / "weights_data" / "figures.json"
DEFAULT_RUNS = [
    f"runs/{name}-cirrus-sim-table" for name in ("pointpillars", "voxelnet", "second", "pointrcnn", "sparsecentre")
]


def frozen_split(folder: Path, frames: int | None = None, name: str = SPLIT) -> Dataset:
    """A validation split, or its first frames, simulated where its folder is absent."""
    if not folder.exists():
        bar = partial(progress, what="simulating")
        some = {} if frames is None else {"frames": frames, "sequences": 1}
        record(name, folder, cache=frames is None, progress=bar, report=partial(print, file=sys.stderr), **some)
    data = open_dataset(folder)
    return data if frames is None else data.select(range(frames))


def evaluated(run: str, data: Any, kept_in: Path | None) -> dict[str, Any]:
    """Results of a run by cloud, from its folder if these weights were scored on this split before."""
    weights = resolve_weights(run)
    digest = hashlib.sha256(weights.read_bytes()).hexdigest()
    kept = (kept_in or weights.parent) / f"{weights.stem}-{SPLIT}.json"
    if kept.is_file() and (known := json.loads(kept.read_text()))["weights_sha256"] == digest:
        return dict(known)
    detector = load_detector(run)
    results: dict[str, Any] = {"weights_sha256": digest, "precision": detector.precision, "clouds": {}}
    for cloud in CLOUDS:
        seen = detect(detector, data, cloud=cloud, annotated_only=True, progress=partial(progress, what=cloud))
        found = seen.score("dds", epsilons=EPSILONS)
        results["clouds"][cloud] = {**found.to_json(), "convention": str(found.convention), "frame_ms": median_ms(seen)}
    write_text(kept, json.dumps(results))
    return results


def part_of(result: dict[str, Any], name: str) -> dict[str, Any] | None:
    """One range of a result, or the whole."""
    return result if name == "overall" else result["ranges"][name]


def dds_of(result: dict[str, Any], name: str) -> dict[str, float | None]:
    """DDS by epsilon of one range."""
    part = part_of(result, name)
    return {key: None if part is None else value["dds"] for key, value in (part or {"dds": {}})["dds"].items()}


def table(results: dict[str, dict[str, Any]], cloud: str) -> str:
    """One line a detector and range: AP by threshold, aIoU, DDS and wDDS, and the interval of DDS."""
    lines = [f"{'detector':<14} {'range':<8} AP 0.5   1     2     4     aIoU   DDS    .003   .006   .009   DDS 95 %"]
    for name, result in results.items():
        for where in BUDGET_RANGES:
            part = part_of(result["clouds"][cloud], where)
            if part is None:
                continue
            low_high = (result["clouds"][cloud]["intervals"].get(where) or {}).get("dds", {}).get("0", {}).get("dds")
            aps = " ".join(f"{value:.3f}" for value in part["ap"].values())
            scores = " ".join(f"{part['dds'][key]['dds']:.4f}" for key in part["dds"])
            interval = f"[{low_high[0]:.3f}, {low_high[1]:.3f}]" if low_high else ""
            lines.append(f"{name:<14} {where:<8} {aps}  {part['dds']['0']['aiou']:.3f}  {scores} {interval}")
    return "\n".join(lines)


def schedule(provenance: dict[str, Any]) -> str:
    """What a run was trained with, in one line."""
    experiment = provenance["experiment"]
    training, data = experiment["training"], experiment["data"]
    made = data["simulate"] or {}
    seen = training["steps"] * training["batch_size"]
    return (
        f"{training['steps']} steps of {training['batch_size']} ({seen} samples), peak {training['learning_rate']}, "
        f"seed {training['seed']}, {provenance['frames']} frames of {made.get('preset')} (seed {made.get('seed')}), "
        f"clouds {' and '.join(data['clouds'])}, {provenance.get('precision')}, {provenance.get('threads')} threads, "
        f"commit {provenance['environment']['commit']}"
    )


def figures_of(run: str, result: dict[str, Any], points: int) -> dict[str, Any]:
    """The record of one detector for ``farfield detectors``."""
    cloud, speeds, parameters = busy_cloud(points, seed=1), {}, 0
    for precision in ("bf16", "fp32"):
        detector = load_detector(run, precision=precision, device="cpu")
        parameters = sum(p.numel() for p in detector.network.parameters())
        speeds[precision] = float(np.median(milliseconds(detector, cloud, 12)))
    name = detector.config.name
    shipped = [key for key in bundled_weights() if key == f"{name}-cirrus-sim"]
    return {
        "weights": shipped[0] if shipped else "",
        "parameters": parameters,
        "frame_ms": {key: round(value, 1) for key, value in speeds.items()},
        "scores": {c: {r: dds_of(result["clouds"][c], r) for r in BUDGET_RANGES} for c in CLOUDS},
        "setting": {"schedule": schedule(detector.provenance)},
    }


def run_budget(arguments: Sequence[str]) -> None:
    """The seed's Tables I and II on the frozen validation split: every detector, the same data and budget for all.

        python benchmarks/detectors.py budget [--runs RUN ...] [--data DATA] [--figures]

    A RUN is the folder of a finished training. Results are kept beside the weights, so that a cut run goes on where it
    stopped. ``--figures`` also measures speed and writes src/farfield/detectors/weights_data/figures.json, which
    ``farfield detectors`` shows. Trained and scored on simulation only.
    """
    parser = part_parser(run_budget.__doc__)
    parser.add_argument("--data", type=Path, default=ROOT / "data" / SPLIT)
    parser.add_argument("--runs", nargs="+", default=DEFAULT_RUNS)
    parser.add_argument("--points", type=int, default=60_000, help="points of the frame that is timed")
    parser.add_argument("--kept", type=Path, help="where scores are kept, in place of beside the weights")
    parser.add_argument("--figures", action="store_true", help="also time the detectors and write figures.json")
    parser.add_argument("--frames", type=int, help="of the split, in place of all")
    options = parser.parse_args(arguments)
    data = frozen_split(options.data, options.frames)
    frozen = json.loads((ROOT / "src" / "farfield" / "simulation" / f"{SPLIT}.json").read_text())
    print(f"{SPLIT}: {len(data)} frames, sha256 {frozen['sha256']}, fingerprint {data.fingerprint()[:16]}\n")
    results = {}
    for run in options.runs:
        detector = load_detector(run)
        label = detector.config.name if detector.config.name not in results else run
        print(f"{label:<14} {schedule(detector.provenance)}", flush=True)
        results[label] = evaluated(run, data, options.kept)
    for cloud in CLOUDS:
        print(f"\n{cloud.capitalize()}\n{table(results, cloud)}")
    print(f"\n{next(iter(results.values()))['clouds']['gaussian']['convention']}")
    if not options.figures:
        return
    budget = schedule(load_detector(options.runs[-1]).provenance).split(", peak")[0]
    records = {
        load_detector(run).config.name: figures_of(run, result, options.points)
        for run, result in zip(options.runs, results.values(), strict=True)
    }
    stored = {
        "split": SPLIT,
        "sha256": frozen["sha256"],
        "budget": budget,
        "points": f"{options.points} points in 250 m x 100 m, points to boxes, median",
        "precision": "bf16 and fp32",
        "machine": f"{processor()}, {torch.get_num_threads()} threads, {platform.system()}",
        "date": time.strftime("%Y-%m-%d", time.gmtime()),
        "commit": git(ROOT, "rev-parse", "--short", "HEAD"),
        "detectors": records,
    }
    write_text(FIGURES, json.dumps(stored, indent=1) + "\n")
    print("\nspeed, points to boxes:")
    for name, kept in records.items():
        times = ", ".join(f"{key} {value:.0f} ms" for key, value in kept["frame_ms"].items())
        print(f"{name:<14} {kept['parameters'] / 1e6:6.2f} M parameters   {times}")


def rows_of(result: dict) -> list[str]:
    """One line a range: counts, AP by threshold, aIoU, DDS and the weighted ones, with the interval of DDS."""
    lines = []
    for name, part in [*result["ranges"].items(), ("overall", result)]:
        if part is None:
            lines.append(f"  {name:<9} -")
            continue
        low_high = (result["intervals"].get(name) or {}).get("dds", {}).get("0", {}).get("dds")
        interval = f"[{low_high[0]:.3f}, {low_high[1]:.3f}]" if low_high else ""
        aps = " ".join(f"{value:.3f}" for value in part["ap"].values())
        scores = " ".join(f"{part['dds'][key]['dds']:.4f}" for key in part["dds"])
        lines.append(f"  {name:<9} {aps}   {part['dds']['0']['aiou']:.3f}   {scores}   {interval}")
    return lines


def run_simulated(arguments: Sequence[str]) -> None:
    """DDS and wDDS by range of detectors on the frozen validation split, both scan patterns; one model against two.

        python benchmarks/detectors.py simulated [DATA] [--models NAME_OR_RUN ...] [--json OUT]

    DATA is what ``farfield simulate cirrus-sim-val-v2 DATA --cache`` wrote; it is made where it is absent. Trained and
    scored on simulation only.
    """
    parser = part_parser(run_simulated.__doc__)
    parser.add_argument("data", type=Path, nargs="?", default=ROOT / "data" / SPLIT)
    parser.add_argument("--models", nargs="+", default=["pointpillars-cirrus-sim"])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--frames", type=int, help="of the split, in place of all")
    options = parser.parse_args(arguments)
    data = frozen_split(options.data, options.frames)
    print(f"{options.data.name}: {len(data)} frames, fingerprint {data.fingerprint()[:16]}")
    found = {}
    for model in options.models:
        detector = load_detector(model)
        trained = detector.provenance.get("experiment", {})
        clouds, steps = (trained.get(group, {}).get(key) for group, key in (("data", "clouds"), ("training", "steps")))
        print(f"\n{model}: trained on {clouds}, {steps} steps")
        for cloud in ("gaussian", "uniform"):
            seen = detect(detector, data, cloud=cloud, annotated_only=True, progress=partial(progress, what=cloud))
            result, taken = seen.score("dds", epsilons=EPSILONS), median_ms(seen)
            found[f"{model}/{cloud}"] = result.to_json()
            print(f" {cloud}: {taken:.0f} ms a frame ({detector.precision})")
            print("  range     AP 0.5   1     2     4      aIoU    DDS    wDDS .003 .006  .009   DDS 95 %")
            print("\n".join(rows_of(found[f"{model}/{cloud}"])), flush=True)
    print(f"\n{result.convention}")
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


def run_splits(arguments: Sequence[str]) -> None:
    """Detectors on the validation splits of both worlds, each with the difference from the first detector named.

        python benchmarks/detectors.py splits [--models BEFORE AFTER] [--splits NAME ...] [--frames N]

    The difference is paired: both detectors see the same frames, and its 95 % interval draws whole sequences. The near
    score is that of 0-70 m. Splits are simulated into ``data/NAME`` where they are absent.
    """
    parser = part_parser(run_splits.__doc__)
    parser.add_argument("--models", nargs="+", default=["pointpillars-cirrus-sim"])
    parser.add_argument("--splits", nargs="+", default=[SPLIT, "cirrus-sim-val-v3"])
    parser.add_argument("--folder", type=Path, default=ROOT / "data", help="where the splits lie")
    parser.add_argument("--frames", type=int, help="of each split, in place of all")
    options = parser.parse_args(arguments)
    for split in options.splits:
        data = frozen_split(options.folder / split, options.frames, split)
        print(f"\n{split}: {len(data)} frames, fingerprint {data.fingerprint()[:16]}, DDS by range, difference [95 %]")
        print(f"  {'':<32} {'cloud':<10}" + "".join(f"{part:<32}" for part in BUDGET_RANGES))
        for cloud in CLOUDS:
            before: dict[str, ScoreSample] = {}
            for model in options.models:
                detections = detect(load_detector(model), data, cloud=cloud, annotated_only=True)
                parts = {part: figure("dds/0/dds", part) for part in BUDGET_RANGES}
                by_part = samples(detections, parts, replicates=200, epsilons=(0.0,))
                before = before or by_part
                cells = "".join(f"{score_cell(one, before[part]):<32}" for part, one in by_part.items())
                print(f"  {Path(model).name:<32} {cloud:<10}{cells}", flush=True)


def score_cell(after: ScoreSample, before: ScoreSample) -> str:
    """A score, and its difference from another one of the same frames."""
    if after.value is None or before.value is None:
        return "-"
    if after is before:
        return f"{after.value:.3f}"
    span = percentile_interval(after.draws - before.draws, 0.95)
    shown = "" if span is None else f" [{span[0]:+.3f}, {span[1]:+.3f}]"
    return f"{after.value:.3f} {after.value - before.value:+.3f}{shown}"


REAL_RANGES = ("0-70", "70-150", "150-250")
HEAD = (
    f"  {'':<32} AP within 70 m at         DDS                           wDDS .006                     DDS overall,\n"
    f"  {'detector':<32} 0.5   1     2     4       0-70   70-150 150-   overall  0-70   70-150 150-   overall  "
    "over frames     over objects"
)
KITTI_RUN = ("002364", "003638", "002352", "002335")
"""Four sweeps of KITTI's object set that follow each other in one drive, a tenth of a second apart."""
KITTI_DRIVES = {
    **dict.fromkeys(("000000", "000011"), "0106"),
    **dict.fromkeys(("000001", "000004"), "0101"),
    **dict.fromkeys(KITTI_RUN, "0001"),
}
"""Drives of several of KITTI's frames, whose set shuffles them; each other frame is of a drive of its own."""
SAME_M = 3.0  # a tenth of a second at 30 m/s


def in_camera(boxes: Boxes, frame: Frame) -> Boxes:
    """The boxes whose centre falls into the frame's image."""
    camera = next(iter(frame.cameras.values()), None)
    return boxes if camera is None or len(boxes) == 0 else boxes[camera.project(boxes.centre_m)[2]]


def counted(frame: Frame) -> Boxes:
    """A frame's boxes with the number of points inside each."""
    assert frame.boxes is not None
    return frame.boxes.replace(point_count=count_points_in_boxes(frame.cloud().points_m, frame.boxes))


def identified(frames: list[Frame], annotations: dict[Any, Boxes]) -> dict[Any, Boxes]:
    """The annotated boxes with identities: those of boxes that are nearest to each other from sweep to sweep."""
    found: dict[Any, Boxes] = {}
    following, before = 0, None
    in_a_row = {name: place for place, name in enumerate(KITTI_RUN)}
    for frame in sorted(frames, key=lambda frame: in_a_row.get(frame.frame_id, -1)):
        boxes = annotations[frame.key]
        ids = np.full(len(boxes), -1)
        follows = bool(frame.time_ns) or in_a_row.get(frame.frame_id, 0) > 0
        last = found.get(before) if follows and before is not None and before[0] == frame.key[0] else None
        if last is not None and len(last) and len(boxes):
            apart_m = np.linalg.norm(boxes.centre_m[:, None] - last.centre_m[None], axis=2)
            apart_m[np.asarray(boxes.label)[:, None] != np.asarray(last.label)[None]] = np.inf
            nearest, back = apart_m.argmin(1), apart_m.argmin(0)
            rows = np.arange(len(boxes))
            same = (back[nearest] == rows) & (apart_m[rows, nearest] <= SAME_M)
            assert last.track_id is not None
            ids[same] = last.track_id[nearest[same]]
        new = ids < 0
        ids[new] = following + np.arange(new.sum())
        following += int(new.sum())
        found[frame.key], before = boxes.replace(track_id=ids), frame.key
    return found


def scene_of(frame: Frame) -> str:
    """The scene that a frame shows: its drive where sweeps have times, else the frame itself."""
    return frame.sequence if frame.time_ns else KITTI_DRIVES.get(frame.frame_id, f"{frame.sequence} {frame.frame_id}")


def learnt_from(data: Dataset, provenance: Mapping[str, Any]) -> str:
    """What a detector saw of some frames in training: nothing where it learnt from simulation and Open Sweeps alone."""
    simulate = provenance.get("experiment", {}).get("data", {}).get("simulate")
    if simulate and not provenance.get("start") and not provenance.get("adapted"):
        return f"nothing: simulated frames only ({simulate['preset']})"
    places = open_places(provenance)
    if family_with_start(provenance) in SIMULATED_FAMILIES and places is not None and not package_places(data):
        return f"nothing: simulated frames, Open Sweeps ({', '.join(places)})"
    return seen_in_training(data, provenance, set(data.keys))[0]


def runs_of(real: Path) -> dict[str, tuple[Dataset, bool, tuple[str, ...]]]:
    """Data sets by name: the frames, whether to cut to the camera's view, the classes that are scored."""
    luminar = real / "cirrus_layout" / "Cirrus_dataset1"
    return {
        "Luminar, as they are": (open_dataset(luminar), False, ("vehicle",)),
        "Luminar, turned by 180 degrees": (open_dataset(luminar, rotate_deg=180), False, ("vehicle",)),
        "KITTI, front camera's view": (open_dataset(real / "kitti"), True, ("vehicle",)),
        "KITTI, further frames, front camera's view": (open_dataset(real / "kitti_more"), True, ("vehicle",)),
        "View-of-Delft, front camera's view": (
            open_dataset(real / "view_of_delft" / "lidar"),
            True,
            ("vehicle", "pedestrian", "bicycle"),
        ),
    }


def row_of(name: str, result: dict[str, Any], objects: ObjectIntervals) -> str:
    """One detector: AP within 70 m, DDS and wDDS at epsilon 0.006 by range and overall, and the interval of DDS."""
    ranges = result["ranges"]
    near = ranges["0-70"]
    aps = " ".join("   - " if near is None else f"{value:.3f}" for value in (near or result)["ap"].values())
    parts = [*(ranges[key] for key in REAL_RANGES), result]
    scores, weighted = (
        " ".join("   -  " if part is None else f"{part['dds'][key]['dds']:.4f}" for part in parts)
        for key in ("0", "0.006")
    )
    drawn = result["intervals"]["overall"]["dds"]["0"]["dds"]
    interval = "" if drawn is None else f"  [{drawn[0]:.3f}, {drawn[1]:.3f}]"
    over = objects.intervals["dds/0/dds"]
    interval += "" if over is None else f"  [{over[0]:.3f}, {over[1]:.3f}] of {objects.objects}"
    return f"  {Path(name).name:<32} {aps}   {scores}   {weighted}{interval}"


def picture(frame: Frame, found: dict[str, Boxes], path: Path) -> None:
    """Draw the frame once for each detector, one above the other, with the boxes that score above 0.3."""
    window_m = fitting_window(frame.cloud(), *found.values())
    drawn = []
    for name, boxes in found.items():
        assert boxes.score is not None
        figure = birdseye(frame, boxes[boxes.score > 0.3], window_m=window_m)
        figure.suptitle(Path(name).name, x=0.99, ha="right", fontsize=9)
        buffer = BytesIO()
        figure.savefig(buffer, dpi=80)
        drawn.append(Image.open(buffer).convert("RGB"))
    sheet = Image.new("RGB", (max(p.width for p in drawn), sum(p.height for p in drawn)), "white")
    for index, part in enumerate(drawn):
        sheet.paste(part, (0, sum(p.height for p in drawn[:index])))
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path)


def run_real(arguments: Sequence[str]) -> None:
    """Detectors trained on simulation only, on real Luminar, KITTI and View-of-Delft frames.

        python benchmarks/detectors.py real [REAL] [--detectors NAME_OR_RUN ...] [--pictures FOLDER]

    REAL holds ``cirrus_layout/Cirrus_dataset1``, ``kitti``, ``kitti_more`` and ``view_of_delft/lidar``. The Luminar
    frames see all round, so they are also turned by 180 degrees. Detections on the others are cut to the front camera's
    view, where they are annotated. The intervals are those of DDS overall, over drawn frames and over drawn objects
    with all their boxes; in sweeps of one drive a box is the same object as the nearest one of its class in the sweep
    before, where each is nearest to the other and they are at most 3 m apart. Pictures go to a folder of your own: the
    frames' licences do not let us ship them.
    """
    parser = part_parser(run_real.__doc__)
    parser.add_argument("real", type=Path, nargs="?", default=SHARED_REAL)
    parser.add_argument("--detectors", nargs="+", default=["pointpillars-cirrus-sim", "pointpillars-roads"])
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--only", help="of the data sets, those whose title has this word")
    options = parser.parse_args(arguments)
    if not options.real.is_dir():
        raise MissingError(f"no real frames in {options.real.name}")
    print("trained on simulation only; z of a roof-mounted sensor 1.9 m above the road is assumed in all of them")
    detectors = {name: load_detector(name) for name in options.detectors}
    convention = ""
    for title, (data, cut, classes) in runs_of(options.real).items():
        if options.only and options.only not in title:
            continue
        frames = list(data)
        annotations = identified(frames, {frame.key: counted(frame) for frame in frames})
        predictions: dict[str, dict] = {}
        for name, detector in detectors.items():
            found = {frame.key: detector(frame) for frame in frames}
            predictions[name] = {f.key: in_camera(found[f.key], f) if cut else found[f.key] for f in frames}
        for frame in frames if options.pictures else ():
            stem = f"{title.split(',')[0]}_{frame.frame_id}_{'turned' if 'turned' in title else 'plain'}.png"
            picture(frame, {n: found[frame.key] for n, found in predictions.items()}, options.pictures / stem)
        for label in classes:
            names = ["vehicle", "large_vehicle"] if label == "vehicle" else [label]
            annotated = sum(int(np.isin(boxes.label, names).sum()) for boxes in annotations.values())
            print(f"\n{title}: {len(frames)} frames, {annotated} annotated of class {label}, any distance")
            print(f" scenes: {len({scene_of(frame) for frame in frames})}")
            for name, detector in detectors.items():
                print(f" seen in training, {Path(name).name}: {learnt_from(data, detector.info.provenance)}")
            for least in (0, 5):
                print(f" with {least} points or more" if least else " all, hidden ones too")
                print(HEAD)
                for name in detectors:
                    result = score(predictions[name], annotations, protocol="dds", label=label, min_points=least)
                    convention = str(result.convention)
                    settings = DdsSettings(label=label, min_points=least)
                    objects = object_intervals(predictions[name], annotations, settings)
                    print(row_of(name, result.to_json(), objects), flush=True)
    print(f"\n{convention}")


ON_SPLIT = {
    "plain": "runs/sparsecentre-cirrus-sim-table",
    "far_weight 2": "runs/sparsecentre-far-weight",
    "pasted_bands_m 0, 70, 150, 250; far_sampling 1": "runs/sparsecentre-far-sampling",
}
ON_SWEEPS = {"one sweep": "runs/sparsecentre-sweeps-1", "three sweeps": "runs/sparsecentre-sweeps-3"}


def report(title: str, run: str, data: Any) -> None:
    """Score one run on the Gaussian clouds of some frames."""
    if run not in bundled_weights() and not (ROOT / run / "weights.safetensors").is_file():
        print(f" {title}: {run} is not trained here")
        return
    detector = load_detector(run if run in bundled_weights() else ROOT / run)
    found = detect(detector, data, cloud="gaussian", annotated_only=True, progress=partial(progress, what="gaussian"))
    result = found.score("dds", epsilons=EPSILONS)
    training = detector.provenance["experiment"]["training"]
    print(f" {title}: {training['steps']} steps of {training['batch_size']}, seed {training['seed']}")
    print("  range     AP 0.5   1     2     4      aIoU    DDS    wDDS .003 .006  .009   DDS 95 %")
    print("\n".join(rows_of(result.to_json())), flush=True)


def run_far(arguments: Sequence[str]) -> None:
    """What the options for far objects give: the sparse detector with each of them beside the one without.

        python benchmarks/detectors.py far [--stride 2]

    Loss by range and balanced ranges are scored on every ``stride``-th frame of the frozen validation split; several
    sweeps on frames 0.1 s apart of another simulated set, beside a network that learnt from the same frames one by one.
    The runs are trained as docs/detectors.md tells; those that are absent are left out.
    """
    parser = part_parser(run_far.__doc__)
    parser.add_argument("--stride", type=int, default=2)
    parser.add_argument("--data", type=Path, default=ROOT / "data" / SPLIT)
    parser.add_argument("--trained", nargs="+", default=[f"{title}={run}" for title, run in ON_SPLIT.items()])
    options = parser.parse_args(arguments)
    split = frozen_split(options.data)
    chosen = range(0, len(split), options.stride)
    print(f"{SPLIT}, {len(chosen)} frames, Gaussian")
    for title, _, run in (text.rpartition("=") for text in options.trained):
        report(title, run, split.select(chosen))
    folder = ROOT / "data" / "sim-sweeps-val"
    if folder.exists():
        sweeps = open_dataset(folder)
        print(f"\n{folder.name}: {len(sweeps)} frames 0.1 s apart, Gaussian, fingerprint {sweeps.fingerprint()[:16]}")
        for title, run in ON_SWEEPS.items():
            report(title, run, sweeps)


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "budget": Part(run_budget, "--runs pointpillars-cirrus-sim --data TMP/val --frames 2 --kept TMP"),
                "simulated": Part(run_simulated, "TMP/val --frames 2"),
                "splits": Part(
                    run_splits,
                    "--folder TMP/splits --frames 2 --models pointpillars-cirrus-sim sparsecentre-cirrus-sim",
                ),
                "real": Part(run_real, "--only 'View-of-Delft'"),
                "far": Part(run_far, "--data TMP/val --trained plain=pointpillars-cirrus-sim"),
            },
        )
    )
