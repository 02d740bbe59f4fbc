"""Detectors trained on simulation only, on real Luminar, KITTI and View-of-Delft frames.

usage: python benchmarks/real_frames.py [REAL] [--detectors NAME_OR_RUN ...] [--pictures FOLDER]

REAL holds ``cirrus_layout/Cirrus_dataset1``, ``kitti``, ``kitti_more`` and ``view_of_delft/lidar``. The Luminar frames
see all round, so they are also turned by 180 degrees. Detections on the others are cut to the front camera's view,
where they are annotated. The intervals are those of DDS overall, over drawn frames and over drawn objects with all
their boxes; in sweeps of one drive a box is the same object as the nearest one of its class in the sweep before, where
each is nearest to the other and they are at most 3 m apart. Pictures go to a folder of your own: the frames' licences
do not let us ship them.
"""

import argparse
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from _report import SHARED_REAL, header
from PIL import Image

from farfield.api import load_detector, open_dataset
from farfield.datasets.base import Dataset
from farfield.figures.birds_eye import birdseye, fitting_window
from farfield.frame import Boxes, Frame
from farfield.geometry.boxes import count_points_in_boxes
from farfield.metrics import score
from farfield.metrics.centre import DdsSettings, ObjectIntervals, object_intervals

RANGES = ("0-70", "70-150", "150-250")
HEAD = (
    f"  {'':<32} AP within 70 m at         DDS                           wDDS .006                     DDS overall,\n"
    f"  {'detector':<32} 0.5   1     2     4       0-70   70-150 150-   overall  0-70   70-150 150-   overall  "
    "over frames     over objects"
)
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
    for frame in frames:
        boxes = annotations[frame.key]
        ids = np.full(len(boxes), -1)
        last = found.get(before) if before is not None and before[0] == frame.key[0] and frame.time_ns else None
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
    parts = [*(ranges[key] for key in RANGES), result]
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("real", type=Path, nargs="?", default=SHARED_REAL)
    parser.add_argument("--detectors", nargs="+", default=["pointpillars-cirrus-sim"])
    parser.add_argument("--pictures", type=Path)
    options = parser.parse_args()
    print(header(), "\n", sep="")
    print("trained on simulation only; z of a roof-mounted sensor 1.9 m above the road is assumed in all of them")
    detectors = {name: load_detector(name) for name in options.detectors}
    convention = ""
    for title, (data, cut, classes) in runs_of(options.real).items():
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


if __name__ == "__main__":
    main()
