"""Tracks of 60 frames from a keyframe every 10: how far interpolated boxes stand from the published ones of K-Radar.

    python benchmarks/studio_tracks.py [--output benchmarks/results/studio_tracks.txt]

Real labels v2.1 of sequences 1, 21 and 54 with the published odometry. Every track that is in 61 consecutive frames or
more, in stretches of 61: keyframes as they were published, every 10 (20, 30) frames; between them the studio's
interpolation, in the world by the odometry and, beside it, in the sensor's coordinates. Errors are distances of
centres in the plane over all frames between. Then one such track is made anew through the store, as a person does: its
edits are counted. Exit status 1 above 12 edits or, on sequence 21, above 0.35 m (p95).
"""

import argparse
import math
import os
import tarfile
import tempfile
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from _report import SHARED_REAL, header
from _studio_table import Table

from farfield.annotation.edits import add_box, boxes_of, interpolate_track, track_frames
from farfield.annotation.motion import TrackFrame, interpolate
from farfield.annotation.schema import schema_of
from farfield.annotation.store import Author, Store
from farfield.datasets.edits import journal_folder
from farfield.datasets.kradar.label_format import KRadarLabelFormat
from farfield.datasets.kradar.reader import KRadar
from farfield.datasets.labels import Numbers
from farfield.files.atomic import write_text
from farfield.frame import Key
from farfield.vocabulary.classes import SMALL_KINDS, VEHICLE_KINDS

SEQUENCES, LENGTH, STEPS = ("1", "21", "54"), 61, (10, 20, 30)
MOST_EDITS, FARTHEST_M = 12, 0.35
ANN = Author("ann", "w1")
Stretch = Sequence[tuple[TrackFrame, Numbers]]


def unpack(root: Path) -> None:
    """Labels and odometry of the sequences, where the reader looks for them."""
    with tarfile.open(SHARED_REAL / "kradar" / "labels_v2_1.tar.gz") as archive:
        for member in archive:
            parts = Path(member.name).parts
            file = archive.extractfile(member) if member.isfile() and parts[-2] in SEQUENCES else None
            if file is not None:
                path = root / "KRadar_revised_visibility" / parts[-2] / parts[-1]
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(file.read())
    for sequence in SEQUENCES:
        name = f"gt_{int(sequence):02d}.txt"
        target = root / "resources" / "odometry" / "gt" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes((SHARED_REAL / "kradar" / "odometry" / name).read_bytes())


def opened(root: Path) -> Store:
    data = KRadar(root)
    schema = schema_of(VEHICLE_KINDS | SMALL_KINDS, None, "full")
    return Store(data, KRadarLabelFormat(data), journal_folder(root), schema)


def stretches(store: Store, drive: str) -> Iterator[tuple[str, Stretch]]:
    """Parts of tracks in 61 consecutive frames each."""
    for track in store.tracks.names(drive):
        boxes = {row: (key, box.label.box) for row, key, box in boxes_of(store, drive, track)}
        rows = sorted(boxes)
        start = 0
        while start + LENGTH <= len(rows):
            part = rows[start : start + LENGTH]
            if part[-1] - part[0] == LENGTH - 1:
                found = track_frames(store, (boxes[row][0] for row in part))
                yield track, [(moment, boxes[row][1]) for moment, row in zip(found, part, strict=True)]
                start += LENGTH
            else:
                start += 1


def errors(stretch: Stretch, step: int, *, world: bool) -> list[float]:
    """Distances of interpolated boxes from the published ones, metres."""
    known = stretch if world else [(TrackFrame(moment.key, moment.time_s, None), box) for moment, box in stretch]
    found = interpolate(known[::step], [moment for moment, _ in known])
    truth = {moment.key: box for moment, box in known}
    return [math.dist(box[:2], truth[key][:2]) for key, box in found.items()]


def remade(store: Store, drive: str, track: str, stretch: Stretch) -> tuple[int, float]:
    """Edits by which a track is made anew, and the p95 of its error."""
    before = len(store.journal)
    number = store.tracks.new(drive)
    label = boxes_of(store, drive, track)[0][2].label.label
    for place, (moment, box) in enumerate(stretch[::10]):
        value = {"label": label, "box": list(box), "track": number}
        plan = partial(add_box, key=moment.key, name=f"k{place}", value=value)
        store.edit(ANN, f"k{place}", "box.add", plan)
    rows = [store.drives.locate(moment.key).row for moment, _ in stretch]
    plan = partial(interpolate_track, drive=drive, track=number, first=rows[0], last=rows[-1], prefix="i")
    store.edit(ANN, "i", "track.interpolate", plan)
    truth: dict[Key, Numbers] = {moment.key: box for moment, box in stretch}
    off = [math.dist(box.label.box[:2], truth[key][:2]) for _, key, box in boxes_of(store, drive, number)]
    assert len(off) == LENGTH
    return len(store.journal) - before, float(np.percentile(off, 95))


def report() -> tuple[str, bool]:
    load = f"load     {os.getloadavg()[0]:.1f} before (1 minute)"
    lines, far = (
        [header(), load, "", "sequence  step  frames    world: median   p95   sensor: median   p95 (m)"],
        np.inf,
    )
    with tempfile.TemporaryDirectory() as name:
        unpack(Path(name))
        with opened(Path(name)) as store:
            known = {drive: list(stretches(store, drive)) for drive in SEQUENCES}
            for drive, found in known.items():
                for step in STEPS:
                    world = np.concatenate([errors(each, step, world=True) for _, each in found])
                    sensor = np.concatenate([errors(each, step, world=False) for _, each in found])
                    figures = [f"{np.percentile(off, part):.2f}" for off in (world, sensor) for part in (50, 95)]
                    lines.append(
                        f"{drive:>8}  {step:>4}  {len(world):>6}  {figures[0]:>13} {figures[1]:>5}  {figures[2]:>14} "
                        f"{figures[3]:>5}"
                    )
                    if drive == "21" and step == STEPS[0]:
                        far = float(np.percentile(world, 95))
            track, stretch = known["21"][0]
            edits, p95 = remade(store, "21", track, stretch)
    sound = edits <= MOST_EDITS and far <= FARTHEST_M
    lines.append(f"\ntrack {track} of sequence 21, {LENGTH} frames, made anew: {edits} edits, p95 {p95:.2f} m")
    table = Table()
    figure = f"{edits} edits, p95 {p95:.2f} m; all stretches of sequence 21: {far:.2f} m"
    target = f"<= {MOST_EDITS} edits, <= {FARTHEST_M} m p95"
    table.add(f"track of {LENGTH} frames, every {STEPS[0]}th by hand", figure, target, sound)
    return "\n".join([*lines, "", table.text()]) + "\n", sound


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    text, sound = report()
    print(text, end="")
    if options.output is not None:
        write_text(options.output, text)
    raise SystemExit(0 if sound else 1)


if __name__ == "__main__":
    main()
