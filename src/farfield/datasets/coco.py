"""The 2D boxes of a data set as COCO's JSON (https://cocodataset.org/#format-data): images, annotations, categories."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from farfield.datasets.base import Dataset
from farfield.datasets.losses import Capacity
from farfield.errors import DatasetError
from farfield.files.atomic import write_text
from farfield.frame.image_marks import image_marks

COCO_HOLDS = Capacity(
    title="COCO's JSON of image boxes",
    holds=frozenset({"names", "empty frames", "region", "unboxed"}),
    one_cloud=False,
    attributes=frozenset({"box_px", "truncation", "occlusion"}),
    file_names=str,
    reasons={
        **dict.fromkeys(("clouds", "cameras", "radar"), "boxes in the image alone are written"),
        "images": "named by their files, not copied",
    },
)
IGNORED = "DontCare"
_PICTURES = (".png", ".jpg", ".jpeg")


def write_coco(dataset: Dataset, path: Path) -> int:
    """Write the boxes in the image of every annotated frame; regions without annotation are crowds to be ignored.

    Coordinates are those of the labels: x, y of the left upper corner, width, height, in pixels from 0.

    Args:
        dataset: The data set.
        path: The JSON file.

    Returns:
        How many boxes were written.

    Raises:
        DatasetError: If no frame has boxes in an image.
    """
    images: list[dict[str, Any]] = []
    rows: list[dict[str, Any]] = []
    categories: dict[str, int] = {}
    for index in range(len(dataset)):
        if not dataset.has_annotation(index):
            continue
        frame = dataset[index]
        marks = image_marks(frame)
        if marks is None:
            continue
        number, camera = len(images) + 1, frame.cameras.get(marks.camera)
        size = (camera.width_px, camera.height_px) if camera is not None else (0, 0)
        if not all(size) and marks.camera in frame.images:
            size = frame.images[marks.camera].shape[1::-1]
        image = {"id": number, "file_name": _picture(dataset, index, marks.camera), "sequence": frame.sequence}
        images.append(image | {"frame": frame.frame_id, "width": int(size[0]), "height": int(size[1])})
        details = {} if frame.annotation is None else frame.annotation.details
        for mark, box in enumerate((*marks.box_px.tolist(), *marks.ignored_px.tolist())):
            of_object = mark < len(marks)
            label = marks.label[mark] if of_object else IGNORED
            left, top, right, bottom = box
            row = {
                "id": len(rows) + 1,
                "image_id": number,
                "category_id": categories.setdefault(label, len(categories) + 1),
                "bbox": [left, top, right - left, bottom - top],
                "area": (right - left) * (bottom - top),
                "iscrowd": 0 if of_object else 1,
            }
            if of_object:
                columns = {name: details[name] for name in ("truncation", "occlusion") if name in details}
                row |= {name: np.asarray(values)[marks.row[mark]].item() for name, values in columns.items()}
            rows.append(row)
    if not images:
        raise DatasetError(f"{dataset.root}: expected boxes in an image, as KITTI's labels have them; no frame has any")
    tree = {
        "info": {"description": f"image boxes of {dataset.name}"},
        "images": images,
        "annotations": rows,
        "categories": [{"id": number, "name": name} for name, number in categories.items()],
    }
    write_text(path, json.dumps(tree) + "\n")
    return len(rows)


def _picture(dataset: Dataset, index: int, camera: str) -> str:
    """The image's file below the data set, else a name by frame."""
    pictures = [Path(file) for file in dataset.files(index) if Path(file).suffix.lower() in _PICTURES]
    chosen = next((file for file in pictures if camera in file.parts), pictures[0] if pictures else None)
    if chosen is None:
        return f"{dataset.frame_ids[index]}.png"
    return chosen.relative_to(dataset.root).as_posix() if chosen.is_relative_to(dataset.root) else chosen.name
