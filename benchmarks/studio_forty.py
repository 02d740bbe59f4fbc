"""Objects annotated through the page by a hand with errors, and what then stands in the label files.

usage: python benchmarks/studio_forty.py [REAL] [--only simulated radar real] [--sets NAME ...]
       [--first N] [--work DIR] [--output FILE]

A Chromium clicks, drags and presses keys at the pixels of ``farfield annotate``, which runs as a process of its own;
the label files that it writes are compared with the truth. The button goes down 0.35 m (standard deviation) beside one
of the object's points, the drag is 4 degrees off. Simulated: forty objects within 40 m in the second frames of six
drives, first as new objects with their class's usual size, the first ten once more with one drag more in the
close-up from above, at last as the next box of a track whose size is locked in the first frame. Of the radar alone:
every vehicle that no LiDAR point shows, by a double click on the map. REAL holds ``cirrus_layout`` and
``view_of_delft``; usual sizes are the medians of the set's classes, and the hand presses at a point of the object, as
in studio_fitting.py. Missed is an object without a box or whose box overlaps by less than 0.1.
"""

import argparse
import itertools
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _gestures import Subject, seen_whole, subjects
from _report import SHARED_REAL, header, progress
from _studio_copies import Emptied, annotated, emptied, errors_of, written
from _studio_hand import Hand, kind_of, usual_length_m, word_of
from _studio_screen import chromium_path
from scipy.ndimage import maximum_filter

from farfield.annotation.fitting import prior_of
from farfield.datasets import open_dataset
from farfield.files.atomic import write_text
from farfield.frame import Frame
from farfield.geometry.boxes import count_points_in_boxes
from farfield.radar.axes import KRADAR_AXES
from farfield.vocabulary.classes import VEHICLE_KINDS

REAL = {"View-of-Delft": "view_of_delft/lidar", "Luminar": "cirrus_layout/Cirrus_dataset1"}
BINS_M = ((0, 30), (30, 60), (60, 100), (100, 300))
TARGETS = {(0, 30): 0.76, (30, 60): 0.65, (60, 100): 0.55}
PARTS = ("simulated", "radar", "real")
FORTY, NEAR_M, MISSED = 40, 40.0, 0.1
CELL_DEG = 1.0
TEN, UNAIDED, CORRECTED = 10, (0.10, 2.0), (0.05, 1.0)  # objects; metres and degrees that are asked
RADAR = ("--frames", "4", "--sequences", "4", "--sensors", "os2-64,polar3d", "--weather", "fog")
SEED = 1


def simulated(folder: Path, *arguments: str) -> Path:
    """Frames of kradar-sim as ``farfield simulate`` writes them; what is there already stays."""
    command = [sys.executable, "-m", "farfield.cli", "simulate", "kradar-sim", str(folder), "--workers", "1"]
    subprocess.run([*command, "--seed", str(SEED), *arguments], check=True, stdout=subprocess.DEVNULL)
    return folder


def near_objects(source: Path, most: int = FORTY) -> list[tuple[int, Subject]]:
    """Objects within 40 m of the second frame of each drive that the first one has too: frame and object."""
    data = open_dataset(source)
    found: list[tuple[int, Subject]] = []
    for index in range(1, len(data)):
        if data.keys[index][0] == data.keys[index - 1][0]:
            tracks = _tracks(data[index - 1])
            seen = (one for one in subjects([("simulated", data[index])]) if one.range_m < NEAR_M)
            found += [(index, one) for one in seen if _tracks(one.box)[0] in tracks]
    return found[:most]


def _tracks(of: Any) -> list[int]:
    boxes = of.boxes if isinstance(of, Frame) else of
    assert boxes is not None
    assert boxes.track_id is not None
    return [int(track) for track in boxes.track_id]


def draw_new(hand: Hand, chosen: Sequence[tuple[int, Subject]]) -> list[dict[str, Any] | None]:
    """Each object with its class, a bus told from a van, and one drag."""
    return [drawn_new(hand, number, *each) for number, each in progress(list(enumerate(chosen)), "drawing")]


def drawn_new(hand: Hand, number: int, frame: int, one: Subject) -> dict[str, Any] | None:
    """One of them."""
    classes = hand.page.tell("state.welcome.classes")
    name = word_of(classes, str(one.box.label[0]))
    hand.page.go(frame)
    hand.choose(name, kind_of(classes, name, float(one.box.size_m[0, 0])))
    return hand.drawn(one, np.random.default_rng([SEED, number]))


def draw_corrected(hand: Hand, chosen: Sequence[tuple[int, Subject]]) -> list[dict[str, Any] | None]:
    """Each object as a new one, then fixed by one drag in the close-up from above."""
    made = []
    for number, (frame, one) in progress(list(enumerate(chosen)), "drawing"):
        row = drawn_new(hand, number, frame, one)
        made.append(row and hand.corrected(row, one, np.random.default_rng([SEED, number, 1])))
    return made


def draw_next(hand: Hand, source: Path, chosen: Sequence[tuple[int, Subject]]) -> list[dict[str, Any] | None]:
    """Each object selected in the frame before, its size locked, then drawn with one drag."""
    data, made = open_dataset(source), []
    for number, (frame, one) in progress(list(enumerate(chosen)), "drawing"):
        track, before = _tracks(one.box)[0], data[frame - 1].boxes
        assert before is not None
        place = _tracks(before).index(track)
        hand.page.go(frame - 1)
        hand.locked(before.centre_m[place].tolist(), track)
        hand.page.press("ArrowRight")
        hand.page.settled()
        made.append(hand.drawn(one, np.random.default_rng([SEED, number])))
        assert made[-1] is None or made[-1]["track"] == track, f"drawn as track {made[-1]['track']}, not {track}"
    return made


def scored(
    title: str,
    copy: Emptied,
    chosen: Sequence[tuple[int, Subject]],
    made: Sequence[Any],
    targets: tuple[float, float] = UNAIDED,
) -> Iterator[str]:
    """Medians over all objects, and whether they hold; then what the centre's error is made of.

    An object without a box is infinitely far.
    """
    found, there = errors_of(copy, chosen, made)
    missed = int((~there).sum() + (found.iou < MISSED).sum())
    centre = float(np.median(np.append(found.centre_m, np.full(int((~there).sum()), np.inf))))
    yaw = float(np.median(found.yaw_deg))
    held = centre <= targets[0] and yaw <= targets[1]
    line = f"  {title:<32} centre {centre:.3f} m, yaw {yaw:.2f} degrees, overlap {np.median(found.iou):.2f} (medians); "
    yield f"{line}missed {missed} of {len(chosen)}  {'held' if held else 'MISSED'}"
    whole = np.array([seen_whole(one) for (_, one), given in zip(chosen, there, strict=True) if given])
    yield f"   along the heading {np.median(found.along_m):.3f} m, across {np.median(found.across_m):.3f} m"
    for words, which in (("points at both ends", whole), ("an end that no point shows", ~whole)):
        if which.any():
            yield f"   {words:<27} {which.sum():>2} objects, centre {np.median(found.centre_m[which]):.3f} m"


def simulated_part(work: Path, chromium: Any) -> Iterator[str]:
    drives = ("--frames", "12", "--sequences", "6", "--sensors", "os2-64", "--stride-s", "0.1")
    source = simulated(work / "drives", *drives)
    chosen = near_objects(source)
    yield f"\n{len(chosen)} simulated objects within {NEAR_M:g} m, pressed 0.35 m and dragged 4 degrees off"
    new = emptied(source, work / "new")
    with annotated(new, chromium) as page:
        made = draw_new(Hand(page), chosen)
        classes = page.tell("state.welcome.classes")
    yield from scored("new objects, size of the class", new, chosen, made)
    lengths = [(float(one.box.size_m[0, 0]), word_of(classes, str(one.box.label[0]))) for _, one in chosen]
    off = np.median([abs(length - usual_length_m(classes, name, length)) / 2 for length, name in lengths])
    yield f"   (half of what the usual length is off: {off:.3f} m in the median; so far off is the middle of a box"
    yield "   whose seen end is right)"
    mended = emptied(source, work / "fixed")
    with annotated(mended, chromium) as page:
        made = draw_corrected(Hand(page), chosen[:TEN])
    yield from scored("new, one drag in the close-up", mended, chosen[:TEN], made, CORRECTED)
    later = emptied(source, work / "next", sorted({frame for frame, _ in chosen}))
    with annotated(later, chromium) as page:
        made = draw_next(Hand(page), source, chosen)
    yield from scored("the next box of a track", later, chosen, made)
    yield f"   targets: centre {UNAIDED[0]:.2f} m, yaw {UNAIDED[1]:g} degrees"
    yield f"   with one drag in the close-up, a pixel beside its place: {CORRECTED[0]:.2f} m, {CORRECTED[1]:g} degree"


def unseen(frame: Frame) -> Iterator[tuple[Subject, np.ndarray]]:
    """Vehicles in the radar's field without a LiDAR point, each with its brightest peak on the map."""
    pose, boxes, cloud = frame.sensors["radar"].frame_T_sensor, frame.boxes, frame.cloud().points_m
    assert pose is not None
    assert boxes is not None
    bird = np.asarray(frame.radar["polar3d"])[0].max(axis=2)
    peak = bird == maximum_filter(bird, 3)
    ranges, angles = np.meshgrid(KRADAR_AXES.range_m, np.deg2rad(KRADAR_AXES.azimuth_deg), indexing="ij")
    places = np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=-1) + pose[:2, 3]
    for number, points in enumerate(count_points_in_boxes(cloud, boxes)):
        box = boxes[number]
        away = box.centre_m[0, :2] - pose[:2, 3]
        if points or str(box.label[0]) not in VEHICLE_KINDS or not 8 < np.hypot(*away) < 80:
            continue
        cos, sin = np.cos(box.yaw_rad[0]), np.sin(box.yaw_rad[0])
        local = (places - box.centre_m[0, :2]) @ np.array([[cos, -sin], [sin, cos]])
        on_it = peak & (np.abs(local) <= box.size_m[0, :2] / 2 + 0.7).all(axis=-1)
        if on_it.any():
            brightest = places.reshape(-1, 2)[int(np.argmax(np.where(on_it, bird, -1)))]
            prior = prior_of(str(box.label[0]))
            yield Subject(source="radar", points_m=cloud, box=box, own_m=cloud[:0], prior=prior), brightest


def radar_part(work: Path, chromium: Any) -> Iterator[str]:
    """Double clicks on the map beside the peak of each vehicle that no LiDAR point shows."""
    source = simulated(work / "radar", *RADAR)
    data = open_dataset(source)
    found = [(index, *each) for index in range(len(data)) for each in unseen(data[index])]
    copy, made = emptied(source, work / "radar-new"), []
    with annotated(copy, chromium) as page:
        hand, classes = Hand(page), page.tell("state.welcome.classes")
        for number, (index, one, place) in progress(list(enumerate(found)), "drawing"):
            name = word_of(classes, str(one.box.label[0]))
            page.go(index)
            hand.choose(name, kind_of(classes, name, float(one.box.size_m[0, 0])))
            made.append(hand.peak(place + np.random.default_rng([SEED, number]).normal(0, hand.error_m, 2)))
    pose = data[0].sensors["radar"].frame_T_sensor
    assert pose is not None
    rows = list(polar_errors(copy, [(index, one) for index, one, _ in found], made, pose[:2, 3]))
    yield f"\n{len(rows)} vehicles without a LiDAR point, a double click 0.35 m beside their peak on the radar's map"
    for (index, one, _), (range_m, turn) in zip(found, rows, strict=True):
        held = abs(range_m) <= KRADAR_AXES.range_step_m and abs(turn) <= CELL_DEG
        name = f"{'/'.join(data.keys[index])}, {one.range_m:.0f} m"
        yield f"  {name:<32} range {range_m:+.2f} m, azimuth {turn:+.2f} degrees  {'held' if held else 'beyond a cell'}"
    yield f"   target: one cell, {KRADAR_AXES.range_step_m:.2f} m and {CELL_DEG:g} degree"


def polar_errors(
    copy: Emptied, chosen: Sequence[tuple[int, Subject]], made: Sequence[Any], ego_m: np.ndarray
) -> Iterator[tuple[float, float]]:
    """By how much the middle of each box in the files is too far from the radar (metres) and beside it (degrees)."""
    files = copy.boxes()
    for (frame, one), row in zip(chosen, made, strict=True):
        if row is None:
            yield np.inf, np.inf
            continue
        label = written(files[frame], row["box"])
        here, truth = np.array(label.box[:2]) - ego_m, one.box.centre_m[0, :2] - ego_m
        turn = np.rad2deg(np.arctan2(here[1], here[0]) - np.arctan2(truth[1], truth[0]))
        yield float(np.hypot(*here) - np.hypot(*truth)), float(turn)


def real_part(real: Path, sets: Sequence[str], first: int | None, work: Path, chromium: Any) -> Iterator[str]:
    """Click and drag at the annotated objects of real frames, of all or of the first ones of each set."""
    for title, name in ((title, REAL[title]) for title in sets):
        data = open_dataset(real / name)
        chosen = [(index, one) for index in range(len(data))[:first] for one in subjects([(name, data[index])])]
        sizes = _medians(data)
        chosen = [(index, one) for index, one in chosen if str(one.box.label[0]) in sizes]
        copy = emptied(real / name, work / title)
        given = [f"{label}:{','.join(f'{value:.2f}' for value in size)}" for label, size in sizes.items()]
        with annotated(copy, chromium, "--classes", *given) as page:
            made = draw_new(Hand(page, error_m=0.0), chosen)
        found, there = errors_of(copy, chosen, made)
        kept = [one for (_, one), held in zip(chosen, there, strict=True) if held]
        for kind in (True, False):
            yield from _by_range(title, kind, chosen, kept, found.iou, found.centre_m)
    yield "   targets for vehicles: " + ", ".join(
        f"{least:.2f} ({low}-{high} m)" for (low, high), least in TARGETS.items()
    )


def _medians(data: Any) -> dict[str, tuple[float, ...]]:
    """Median size of each class with five boxes or more, the usual size of others."""
    seen: dict[str, list[np.ndarray]] = {}
    for frame in data:
        for label, size in zip(frame.boxes.label, frame.boxes.size_m, strict=True):
            seen.setdefault(str(label), []).append(size)
    found = {}
    for label, sizes in seen.items():
        if label != "unknown":
            found[label] = tuple(np.median(sizes, axis=0).tolist()) if len(sizes) >= 5 else prior_of(label).size_m
    return found


def _by_range(
    title: str, vehicles: bool, chosen: Sequence[tuple[int, Subject]], kept: Sequence[Subject], iou: Any, centre_m: Any
) -> Iterator[str]:
    wanted = [one for _, one in chosen if one.vehicle == vehicles]
    if not wanted:
        return
    mine = np.array([one.vehicle == vehicles for one in kept])
    ranges = np.array([one.range_m for one in kept])
    lost = len(wanted) - int(mine.sum()) + int((iou[mine] < MISSED).sum())
    name = "vehicles" if vehicles else "people and two-wheelers"
    yield f"\n{title}, {name}: {len(wanted)} objects, click and drag, no correction; missed {lost}"
    for low, high in BINS_M:
        held = mine & (ranges >= low) & (ranges < high)
        if held.any():
            far = f"{np.median(iou[held]):.2f} / {np.median(centre_m[held]):.2f} m"
            yield f"  {low:>3}-{high:<3} m ({int(held.sum()):>3})  overlap from above / centre {far}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("real", type=Path, nargs="?", default=SHARED_REAL)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--sets", nargs="+", choices=tuple(REAL), default=tuple(REAL), help="of the real ones")
    parser.add_argument("--first", type=int, help="only so many frames of each real set")
    parser.add_argument("--work", type=Path, help="where frames are simulated and copied to")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    from playwright.sync_api import sync_playwright

    lines: list[str] = []
    with tempfile.TemporaryDirectory() as place, sync_playwright() as playwright:
        work = options.work or Path(place)
        chromium = playwright.chromium.launch(executable_path=chromium_path())
        parts: dict[str, Callable[..., Iterator[str]]] = {"simulated": simulated_part, "radar": radar_part}
        if options.real.is_dir():
            parts["real"] = partial(real_part, options.real, options.sets, options.first)
        elif "real" in options.only:
            print(f"{options.real}: no real frames, that part is left out", file=sys.stderr)
        chosen = (part(work, chromium) for name, part in parts.items() if name in options.only)
        first = [header(), f"load     {os.getloadavg()[0]:.1f}"]
        for line in itertools.chain(first, itertools.chain.from_iterable(chosen)):
            print(line, flush=True)
            lines.append(line)
        chromium.close()
    if options.output is not None:
        write_text(options.output, "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
