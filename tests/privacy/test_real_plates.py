"""Photographs with number plates: few covers that cover nothing, and a share of missed plates that is the true one."""

import csv
from pathlib import Path

import numpy as np
import pytest
from face_model import has_face_model

pytest.importorskip("torch")
pytest.importorskip("safetensors")
pytest.importorskip("cv2")
if not has_face_model():
    pytest.skip("the model of faces is not installed", allow_module_level=True)

from PIL import Image

from farfield.privacy import AnonymizeOptions
from farfield.privacy.covering import box_mask
from farfield.privacy.detectors import PLATE_THRESHOLD, PLATES_MISSED, find_boxes
from farfield.privacy.image_boxes import ImageBoxes, covered_share

MOST_FALSE, LEAST_COVERED, COVERED_SHARE = 1, 11, 0.9


def annotated_plates(folder: Path) -> dict[tuple[str, int], tuple[np.ndarray, np.ndarray]]:
    """Plates and boxes that do not count (left, top, right, bottom) by file and frame; empty for other pictures."""
    with (folder / "boxes.csv").open() as file:
        rows = list(csv.DictReader(file))
    boxes = {}
    for place in sorted({(row["file"], int(row["frame"])) for row in rows}):
        plates, ignored = (
            np.array([box_px(row) for row in rows if place_of(row) == (*place, "plate", ignore)]).reshape(-1, 4)
            for ignore in ("0", "1")
        )
        boxes[place] = plates, ignored
    return boxes


def place_of(row: dict[str, str]) -> tuple[str, int, str, str]:
    return row["file"], int(row["frame"]), row["kind"], row["ignore"]


def box_px(row: dict[str, str]) -> list[float]:
    left, top, width, height = (float(row[name]) for name in "xywh")
    return [left, top, left + width, top + height]


def read_picture(path: Path, frame: int) -> np.ndarray:
    if path.suffix == ".mp4":
        pytest.importorskip("av")
        from farfield.files.videos import film_frames, read_film

        return next(iter(film_frames(read_film(path), frame, frame + 1)))
    with Image.open(path) as image:
        image.seek(frame)
        return np.array(image.convert("RGB"))


def count_false(covers: ImageBoxes, plates: np.ndarray, ignored: np.ndarray) -> int:
    """Covers whose centre lies on no plate and on no box that does not count, each grown by half to each side."""
    boxes = np.concatenate([plates, ignored])
    half = (boxes[:, 2:] - boxes[:, :2]) / 2
    centre = (covers.box_px[:, None, :2] + covers.box_px[:, None, 2:]) / 2
    upon = (centre >= boxes[:, :2] - half) & (centre <= boxes[:, 2:] + half)
    return int((~upon.all(axis=2).any(axis=1)).sum())


def test_few_covers_are_false_and_the_missed_share_is_the_one_that_is_printed(shared_real: Path) -> None:
    folder = shared_real / "faces_and_plates"
    covered, plates_in_all, false = 0, 0, {}
    for (name, frame), (plates, ignored) in annotated_plates(folder).items():
        picture = read_picture(folder / name, frame)
        boxes = find_boxes(picture, AnonymizeOptions().finders())
        covers = boxes[(boxes.kind == "plate") & (boxes.score >= PLATE_THRESHOLD)]
        mask = box_mask(covers, picture.shape[1], picture.shape[0])
        covered += sum(covered_share(mask, box) >= COVERED_SHARE for box in plates)
        plates_in_all += len(plates)
        false[f"{name} {frame}"] = count_false(covers, plates, ignored)
    assert {name: count for name, count in false.items() if count > MOST_FALSE} == {}
    assert covered >= LEAST_COVERED
    assert (plates_in_all - covered, plates_in_all) == PLATES_MISSED
