"""The custom sets of OpenPCDet and mmdetection3d: points, a text of boxes a frame, ImageSets.

Sources: CUSTOM_DATASET_TUTORIAL.md of OpenPCDet and customize_dataset.md of mmdetection3d (both Apache-2.0).
"""

from pathlib import Path

import numpy as np

from .dual_radar import moved
from .scene import Scene, strengths
from .truth import CloudTruth, FrameTruth, Truth, apply

NAMES = {
    "openpcdet": {
        "car": ("Vehicle", "vehicle"),
        "truck": ("Truck", "large_vehicle"),
        "bicycle": ("Cyclist", "bicycle"),
        "pedestrian": ("Pedestrian", "pedestrian"),
    },
    "mmdetection3d": {
        "car": ("Car", "vehicle"),
        "truck": ("Truck", "large_vehicle"),
        "bicycle": ("Cyclist", "bicycle"),
        "pedestrian": ("Pedestrian", "pedestrian"),
    },
}


def write_custom(root: Path, *, kind: str = "openpcdet", frames: int = 3) -> Truth:
    """Frames whose coordinates are the LiDAR's; ``kind`` is openpcdet (npy) or mmdetection3d (bin)."""
    scene = Scene(91, (0.0, 0.0, -1.6), 0.0, level=True)
    for sub in ("points", "labels", "ImageSets"):
        (root / sub).mkdir(parents=True, exist_ok=True)
    names = [f"{number:06d}" for number in range(frames)]
    (root / "ImageSets/train.txt").write_text("\n".join(names[:-1]) + "\n")
    (root / "ImageSets/val.txt").write_text(names[-1] + "\n")
    truths = []
    for number, name in enumerate(names):
        frame_T_world = np.linalg.inv(scene.world_T_ego(number * 0.1))
        points = apply(frame_T_world, scene.points(number, number * 0.1, 95, clutter=64)).astype("<f4")
        intensity = strengths(len(points), number)
        if kind == "openpcdet":
            strength = (intensity / 255).astype("<f4")
            np.save(root / f"points/{name}.npy", np.column_stack([points, strength]).astype("<f4"))
        else:
            np.column_stack([points, intensity]).astype("<f4").tofile(root / f"points/{name}.bin")
        boxes = [moved(box, frame_T_world) for box in scene.boxes(number, number * 0.1, NAMES[kind])]
        lines = []
        for box in boxes:
            yaw = float(np.arctan2(box.rotation[1, 0], box.rotation[0, 0]))
            numbers = " ".join(f"{value:.9f}" for value in [*box.centre_m, *box.size_m, yaw])
            lines.append(f"{numbers} {box.original}\n")
        (root / f"labels/{name}.txt").write_text("".join(lines))
        cloud = CloudTruth(world_m=points.astype(np.float64), intensity=intensity / 255)
        truths.append(FrameTruth(sequence=None, frame_id=name, time_ns=None, clouds={"lidar": cloud}, boxes=boxes))
    return Truth(frames=truths, tracked=False)
