"""No frame is built twice: who detects in it gives the annotation and the conditions too."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from farfield.datasets.base import Dataset
from farfield.evaluation import detect, plan_detection
from farfield.evaluation.evaluating import EvaluationOptions, evaluate_clouds
from farfield.frame import Annotation, Boxes, Cloud, Constant, Frame
from farfield.jobs import JobOptions

BOXES = Boxes(centre_m=np.array([[10.0, 0, 0]]), size_m=np.full((1, 3), 2.0), yaw_rad=np.zeros(1), label=["vehicle"])


class CountedFrames(Dataset):
    """Five annotated frames of files; counts how often each is built."""

    name = "counted"

    def __init__(self, root: Path) -> None:
        self.root, self.builds = root, Counter[int]()
        self.sequences, self.frame_ids = ("s",) * 5, tuple("01234")
        for frame_id in self.frame_ids:
            (root / f"{frame_id}.bin").write_bytes(b"x")

    def frame(self, index: int) -> Frame:
        self.builds[index] += 1
        return Frame(
            sequence="s",
            frame_id=str(index),
            clouds={"lidar": Cloud(np.array([[10.0, 0, 0], [10.5, 0, 0]], dtype=np.float32))},
            conditions={"weather": "fog"},
            load_annotation=Constant(Annotation(boxes=BOXES)),
        )

    def files(self, index: int) -> Sequence[Path]:
        return [self.root / f"{self.frame_ids[index]}.bin"]


class Perfect:
    """Finds what is annotated; has a digest, so that a journal can keep its boxes."""

    name, class_names = "perfect", ("vehicle",)

    def digest(self) -> str:
        return "perfect"

    def __call__(self, frame: Frame | Cloud) -> Boxes:
        assert isinstance(frame, Frame)
        return BOXES.replace(score=np.ones(1))


@pytest.fixture
def data(tmp_path: Path) -> CountedFrames:
    (tmp_path / "data").mkdir()
    return CountedFrames(tmp_path / "data")


@pytest.mark.parametrize("journalled", [False, True])
@pytest.mark.parametrize("bulk", [None, JobOptions()])
def test_each_frame_is_built_once_and_the_first_also_to_plan(
    data: CountedFrames, tmp_path: Path, bulk: JobOptions | None, journalled: bool
) -> None:
    journal = tmp_path / ".found.jsonl" if journalled else None
    detections = detect(Perfect(), data, bulk=bulk, journal=journal)
    assert data.builds == {0: 2, 1: 1, 2: 1, 3: 1, 4: 1}
    assert len(detections.ms) == 5
    assert {annotation.boxes.point_count.tolist()[0] for annotation in detections.annotations.values()} == {2}
    assert {conditions["weather"] for conditions in detections.conditions.values()} == {"fog"}
    assert detections.score("dds", region="none").figures["dds/0/map"] == 1.0


def test_boxes_of_a_journal_give_the_same_detections_and_build_each_frame_once(
    data: CountedFrames, tmp_path: Path
) -> None:
    journal = tmp_path / ".found.jsonl"
    first = detect(Perfect(), data, journal=journal)
    data.builds.clear()
    second = detect(Perfect(), data, journal=journal)
    assert data.builds == {0: 2, 1: 1, 2: 1, 3: 1, 4: 1}
    assert second.ms == ()
    assert first.score("dds").to_json() == second.score("dds").to_json()


def test_a_plan_detects_nothing_before_it_is_iterated_over(data: CountedFrames) -> None:
    plan = plan_detection(Perfect(), data)
    assert data.builds == {0: 1}
    assert [detections.boxes.score.tolist() for detections in plan.detections() if detections] == [[1.0]] * 5


def test_an_evaluation_holds_its_tables_and_clocks(data: CountedFrames) -> None:
    evaluation = evaluate_clouds(Perfect(), data, EvaluationOptions(shown_frames=2, settings={"region": "none"}))
    assert set(evaluation.results) == set(evaluation.tables) == set(evaluation.timing) == {"lidar"}
    assert evaluation.timing["lidar"]["frames"] == 5
    assert "0-70" in evaluation.tables["lidar"]
    assert [view.frame.frame_id for view in evaluation.frames] == ["0", "4"]
    assert data.builds[2] == 1
