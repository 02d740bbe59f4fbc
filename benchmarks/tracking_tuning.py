"""The tracker's defaults tuned on five sequences of KITTI and reported on five others, beside AB3DMOT.

Figures are HOTA in 3D, label Car, in per cent. Online takes all tracks that are written. Offline is smoothed and cut at
one score of tracks, the one at which the preset is best on the tuned half; the preset is cut at the same one.

    python benchmarks/tracking_tuning.py DETECTIONS LABELS [--search]

``--search`` tries the grid below on the tuned half; without it only the presets are scored.
"""

import argparse
import itertools
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from farfield.frame.drive import Key
from farfield.metrics.box_files import read
from farfield.metrics.detections import Detections
from farfield.tracking import track
from farfield.tracking.offline import smooth_tracks, with_track_score

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


def main() -> None:
    """Print both halves' figures of the preset and of ours."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("detections", type=Path)
    parser.add_argument("labels", type=Path)
    parser.add_argument("--search", action="store_true")
    options = parser.parse_args()
    found = read(options.detections, options.labels, format="kitti-tracking")
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
    main()
