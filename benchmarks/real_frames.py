"""The shipped detector, trained on simulation only, on real Luminar and KITTI frames.

usage: python benchmarks/real_frames.py [REAL] [--pictures FOLDER]

REAL holds ``cirrus_layout/Cirrus_dataset1`` and ``kitti``. The Luminar frames see all round, so they are also turned by
180 degrees. KITTI's detections are cut to the front camera's view, where it is annotated.
"""

import argparse
from pathlib import Path

import numpy as np
from _report import SHARED_REAL, header
from simulated_detection import rows_of

from farfield.api import load_detector, open_dataset, show
from farfield.frame import Boxes, Frame
from farfield.geometry.points import count_points_in_boxes
from farfield.metrics import score


def in_camera(boxes: Boxes, frame: Frame) -> Boxes:
    """The boxes whose centre falls into the frame's image."""
    camera = next(iter(frame.cameras.values()), None)
    return boxes if camera is None or len(boxes) == 0 else boxes[camera.project(boxes.centre_m)[2]]


def counted(frame: Frame) -> Boxes:
    """A frame's boxes with the number of points inside each."""
    assert frame.boxes is not None
    return frame.boxes.replace(point_count=count_points_in_boxes(frame.cloud().points_m, frame.boxes))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("real", type=Path, nargs="?", default=SHARED_REAL)
    parser.add_argument("--detector", default="pointpillars-cirrus-sim")
    parser.add_argument("--pictures", type=Path)
    options = parser.parse_args()
    print(header(), "\n", sep="")
    luminar = options.real / "cirrus_layout" / "Cirrus_dataset1"
    runs = {
        "Luminar, as they are": (open_dataset(luminar), "window", False),
        "Luminar, turned by 180 degrees": (open_dataset(luminar, rotate_deg=180), "window", False),
        "KITTI, front camera's view": (open_dataset(options.real / "kitti"), "window", True),
    }
    detector = load_detector(options.detector)
    print("trained on simulation only; z of a roof-mounted sensor 1.9 m above the road is assumed in all of them\n")
    for name, (data, region, cut) in runs.items():
        predictions, annotations = {}, {}
        for frame in data:
            boxes = detector(frame)
            predictions[frame.key] = in_camera(boxes, frame) if cut else boxes
            annotations[frame.key] = counted(frame)
            if options.pictures:
                options.pictures.mkdir(parents=True, exist_ok=True)
                stem = f"{name.split(',')[0]}_{frame.frame_id}_{'turned' if 'turned' in name else 'plain'}"
                sure = predictions[frame.key][predictions[frame.key].score > 0.3]
                show(frame, sure).savefig(options.pictures / f"{stem}.png", dpi=90)
        annotated = {key: int(np.isin(b.label, ["vehicle", "large_vehicle"]).sum()) for key, b in annotations.items()}
        print(f"{name}: {len(data)} frames, {sum(annotated.values())} annotated vehicles, any distance")
        for least in (0, 5):
            result = score(predictions, annotations, protocol="dds", region=region, min_points=least)
            print(f" vehicles with {least} points or more" if least else " all vehicles, hidden ones too")
            print("  range     AP 0.5   1     2     4      aIoU    DDS    wDDS .003 .006  .009   DDS 95 %")
            print("\n".join(rows_of(result.to_json())))
        print()
    print(result.convention)


if __name__ == "__main__":
    main()
