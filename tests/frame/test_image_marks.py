"""Boxes that were annotated in images: found, drawn, counted by the doctor, and written as COCO's JSON."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from farfield.datasets import InMemory
from farfield.datasets.convert import convert
from farfield.errors import ConfigError, DatasetError
from farfield.figures.camera import camera_picture
from farfield.frame import Annotation, Boxes, Camera, Constant, Frame
from farfield.frame.image_marks import image_marks, projected_overlap
from farfield.geometry.cameras import image_boxes
from farfield.inspection.doctor.image_marks import check_image_marks
from farfield.inspection.doctor.survey import Survey

CAMERA = Camera(matrix=np.array([[300.0, 0, 160], [0, 300, 80], [0, 0, 1]]), width_px=320, height_px=160)
ROWS = 6


def frame(number: int = 0, *, off_px: float = 0.0) -> Frame:
    """Six boxes ahead, their 2D boxes as they project or shifted, the last one without; a region to be ignored."""
    rng = np.random.default_rng(number)
    boxes = Boxes(
        centre_m=np.column_stack([rng.uniform(15, 40, ROWS), rng.uniform(-5, 5, ROWS), rng.uniform(-1, 0, ROWS)]),
        size_m=np.full((ROWS, 3), 2.0),
        yaw_rad=rng.uniform(-3, 3, ROWS),
        label=["vehicle", "pedestrian"] * 3,
    )
    box_px = image_boxes(boxes, CAMERA)[0] + off_px
    box_px[-1] = -1
    annotation = Annotation(
        boxes=boxes,
        details={"box_px": box_px, "occlusion": np.arange(ROWS)},
        unboxed={"dontcare_px": np.array([[10.0, 20, 30, 50], [0, 0, 0, 0]])},
    )
    image = np.full((160, 320, 3), 90, np.uint8)
    return Frame(
        sequence="a",
        frame_id=f"{number:06d}",
        cameras={"front": CAMERA},
        images={"front": image},
        load_annotation=Constant(annotation),
    )


def test_marks_are_the_rows_that_have_a_box_in_the_image() -> None:
    marks = image_marks(frame())
    assert marks is not None
    assert (marks.camera, marks.row.tolist(), len(marks.ignored_px)) == ("front", [0, 1, 2, 3, 4], 1)
    assert marks.label[1] == "pedestrian"
    np.testing.assert_allclose(projected_overlap(frame(), marks), 1.0)
    assert image_marks(replace(frame(), load_annotation=Constant(Annotation(boxes=Boxes.empty())))) is None
    behind = replace(frame(), cameras={"front": replace(CAMERA, camera_T_lidar=CAMERA.camera_T_lidar @ turned())})
    assert np.isnan(projected_overlap(behind, marks)).all()


def turned() -> np.ndarray:
    """Half a turn about z."""
    return np.diag([-1.0, -1.0, 1.0, 1.0])


@pytest.mark.parametrize(("off_px", "severity"), [(0.0, "ok"), (40.0, "warn")])
def test_the_doctor_counts_them_and_warns_where_they_do_not_fit(off_px: float, severity: str) -> None:
    data = InMemory([frame(number, off_px=off_px) for number in range(3)])
    facts: dict[str, dict[str, float]] = {}
    (finding,) = check_image_marks(Survey(dataset=data), facts)
    assert finding.severity == severity
    assert "15 boxes in the images of 3 frames, 3 regions to be ignored" in finding.what
    assert facts["image boxes"]["median_overlap"] == pytest.approx(1.0) if not off_px else True
    assert ("calibration" in finding.fix) == bool(off_px)


def test_sets_without_them_have_no_finding() -> None:
    bare = replace(frame(), load_annotation=Constant(Annotation(boxes=Boxes.empty())))
    assert not list(check_image_marks(Survey(dataset=InMemory([bare])), {}))


def test_they_are_drawn_dotted() -> None:
    marks = image_marks(frame())
    figure = camera_picture(frame().images["front"], CAMERA, annotated=frame().boxes, marks=marks)
    styles = [patch.get_linestyle() for patch in figure.axes[0].patches]
    assert len(styles) == 6
    assert set(styles) <= {"dotted", ":"}


def test_coco_holds_each_box_and_what_is_to_be_ignored(tmp_path: Path) -> None:
    data = InMemory([frame(0), frame(1)])
    convert(data, tmp_path / "boxes.json", to="coco")
    tree = json.loads((tmp_path / "boxes.json").read_text())
    assert [(image["id"], image["frame"], image["width"]) for image in tree["images"]] == [
        (1, "000000", 320),
        (2, "000001", 320),
    ]
    names = {category["id"]: category["name"] for category in tree["categories"]}
    marks = image_marks(frame(0))
    assert marks is not None
    first = [row for row in tree["annotations"] if row["image_id"] == 1]
    for row, box, label in zip(first, marks.box_px, marks.label, strict=False):
        np.testing.assert_allclose(row["bbox"], [box[0], box[1], box[2] - box[0], box[3] - box[1]])
        assert names[row["category_id"]] == label
    assert [row["occlusion"] for row in first[:5]] == [0, 1, 2, 3, 4]
    assert (names[first[5]["category_id"]], first[5]["iscrowd"], first[5]["bbox"]) == ("DontCare", 1, [10, 20, 20, 30])
    assert len({row["id"] for row in tree["annotations"]}) == 12
    with pytest.raises(ConfigError, match=r"\.json"):
        convert(data, tmp_path / "folder", to="coco")
    bare = InMemory([replace(frame(), load_annotation=Constant(Annotation(boxes=Boxes.empty())))])
    with pytest.raises(DatasetError, match="no frame has any"):
        convert(bare, tmp_path / "none.json", to="coco")


def test_kitti_s_own_boxes_lie_on_their_projections(shared_real: Path) -> None:
    from farfield.datasets import open_dataset

    data = open_dataset(shared_real / "kitti")
    overlaps = [projected_overlap(data[row], marks) for row in range(3) if (marks := image_marks(data[row]))]
    assert float(np.nanmedian(np.concatenate(overlaps))) > 0.9
