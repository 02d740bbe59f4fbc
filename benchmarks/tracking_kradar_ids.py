"""K-Radar's annotated boxes tracked back to their identities by the preset for boxes that people drew.

    python benchmarks/tracking_kradar_ids.py [FOLDER ...]

The settings were chosen on the odd sequences; the even ones tell what they are worth on others. Identities are the
annotated numbers, or a number and a class each. FOLDER holds labels of another version than v2.1. The bounds are what a
tracker without any mistake reaches that gives up an object at an absence of so long, or at a jump faster than 70 m/s.
"""

import argparse
from collections import Counter
from dataclasses import replace
from pathlib import Path

from _annotated_drives import class_identities, detected, kradar, kradar_labels, split_identities
from _report import SHARED_REAL, header
from tracking_real import scored

from farfield.metrics.detections import Detections
from farfield.tracking import ANNOTATED, join_tracks, preset, track

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


def main() -> None:
    """Print the figures of v2.1, and of the versions in other folders."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folders", nargs="*", type=Path)
    folders = parser.parse_args().folders
    print(header())
    print("sequences: all, odd (on which the settings were chosen), even; a match lies within 2 m; per cent, counts")
    if (SHARED_REAL / "kradar" / "labels_v2_1.tar.gz").exists():
        block("K-Radar v2.1", kradar(SHARED_REAL))
    for folder in folders:
        block(next(folder.glob("kradar_revised_label_*"), folder).name, kradar_labels(folder))


if __name__ == "__main__":
    main()
