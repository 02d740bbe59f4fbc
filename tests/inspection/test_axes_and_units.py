"""Clouds and boxes in other axes or units: doctor, predict, evaluate and train say the same of them."""

from pathlib import Path

import numpy as np
import pytest

import farfield as ff
from farfield import cli
from farfield.datasets import in_memory, open_dataset
from farfield.files.atomic import write_text
from farfield.frame import Boxes, Cloud, Frame, Sensor
from farfield.inspection.axes_and_units import doubts_of, first_doubts
from farfield.metrics import Bootstrap

Change = tuple[np.ndarray, float]
EYE = np.eye(3)
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # x forward to y forward


def road(rng: np.random.Generator, *, all_round: bool = False) -> tuple[np.ndarray, Boxes]:
    """A straight road: ground, walls beside it, and cars that stand on it; x forward, the sensor 1.7 m high."""
    near = -80.0 if all_round else 2.0
    ground = np.column_stack([rng.uniform(near, 120, 4000), rng.normal(0, 4, 4000), rng.normal(-1.7, 0.02, 4000)])
    walls = np.column_stack([rng.uniform(near, 120, 1500), rng.choice([-12.0, 12.0], 1500), rng.uniform(-1.7, 4, 1500)])
    ahead = np.linspace(near if all_round else 15, 90, 12)
    centre = np.column_stack([ahead, rng.uniform(-5, 5, 12), np.full(12, -0.9)])
    yaw = rng.choice([0.0, np.pi], 12) + rng.normal(0, 0.03, 12)
    body = [centre[row] + rng.uniform(-0.5, 0.5, (40, 3)) * [4.4, 1.8, 1.5] for row in range(12)]
    boxes = Boxes(centre_m=centre, size_m=np.tile([4.4, 1.8, 1.5], (12, 1)), yaw_rad=yaw, label=["vehicle"] * 12)
    points = np.concatenate([ground, walls, *body])
    return points[np.hypot(*points[:, :2].T) > 1.5], boxes


def changed(points: np.ndarray, boxes: Boxes, matrix: np.ndarray, turn_rad: float) -> tuple[np.ndarray, Boxes]:
    scale = abs(np.linalg.det(matrix)) ** (1 / 3)
    size = boxes.size_m * scale
    return points @ matrix.T, boxes.replace(
        centre_m=boxes.centre_m @ matrix.T, size_m=size, yaw_rad=boxes.yaw_rad + turn_rad
    )


CASES: dict[str, tuple[Change, bool, str]] = {
    "x right, y forward": ((TURN, np.pi / 2), False, "+y seems to point forward (x right"),
    "y forward, all round": ((TURN, np.pi / 2), True, "+y seems to point forward (x right"),
    "y backward": ((TURN.T, -np.pi / 2), False, "-y seems to point forward"),
    "x backward": ((np.diag([-1.0, -1.0, 1.0]), np.pi), False, "-x seems to point forward"),
    "z down": ((np.diag([1.0, -1.0, -1.0]), 0.0), False, "z seems to point down"),
    "north east down": ((np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]), 0.0), True, "z seems to point down"),
    "a camera's axes": ((np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), 0.0), False, "a camera's axes"),
    "y up": ((np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), 0.0), True, "y seems to be the vertical axis"),
    "x up": ((np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), 0.0), True, "x seems to be the vertical axis"),
    "centimetres": ((100 * EYE, 0.0), False, "centimetres"),
    "millimetres": ((1000 * EYE, 0.0), False, "millimetres"),
    "kilometres": ((EYE / 1000, 0.0), False, "kilometres"),
    "feet": ((EYE / 0.3048, 0.0), False, "feet"),
}


@pytest.mark.parametrize("case", CASES)
def test_each_is_named(case: str, rng: np.random.Generator) -> None:
    (matrix, turn), all_round, words = CASES[case]
    points, boxes = changed(*road(rng, all_round=all_round), matrix, turn)
    texts = [str(doubt) for doubt in doubts_of([points], [boxes])]
    assert any(words in text for text in texts), texts


@pytest.mark.parametrize("case", ["x right, y forward", "y backward", "x backward", "z down", "centimetres"])
def test_clouds_alone_tell_as_well(case: str, rng: np.random.Generator) -> None:
    (matrix, turn), all_round, words = CASES[case]
    points, _ = changed(*road(rng, all_round=all_round), matrix, turn)
    assert any(words in str(doubt) for doubt in doubts_of([points]))


@pytest.mark.parametrize("all_round", [False, True])
def test_what_is_right_raises_no_doubt(all_round: bool, rng: np.random.Generator) -> None:
    points, boxes = road(rng, all_round=all_round)
    assert doubts_of([points], [boxes]) == []
    assert doubts_of([points]) == []
    assert doubts_of([]) == []
    crossing = boxes.replace(yaw_rad=boxes.yaw_rad + np.pi / 2)  # cars of the road that crosses
    assert doubts_of([points], [crossing]) == []


def test_regions_that_are_unsure_are_no_objects_in_feet(rng: np.random.Generator) -> None:
    points, boxes = road(rng)
    regions = Boxes(
        centre_m=np.tile([60.0, 20.0, 0.0], (40, 1)), size_m=np.tile([11.0, 6.0, 3.0], (40, 1)),
        yaw_rad=np.zeros(40), label=["unsure"] * 40,
    )  # fmt: skip
    cloud = Cloud(points.astype(np.float32), np.zeros(len(points), np.float32))
    assert first_doubts(in_memory([Frame.of(cloud, Boxes.concatenate([boxes, regions]))])) == []
    wide = Frame.of(cloud, regions.relabel({"unsure": "vehicle"}))
    assert "feet" in str(first_doubts(in_memory([wide]))[0])


@pytest.mark.parametrize("name", ["kitti", "view_of_delft", "cirrus_layout", "kradar", "argoverse2", "astyx"])
def test_published_data_raise_no_doubt(name: str, shared_real: Path) -> None:
    folder = shared_real / name
    if not folder.is_dir():
        pytest.skip("not there")
    try:
        data = open_dataset(folder)
    except Exception as error:
        pytest.skip(str(error)[:80])
    assert first_doubts(data) == []


def own_folder(folder: Path, rng: np.random.Generator, matrix: np.ndarray, turn: float, frames: int = 3) -> Path:
    folder.mkdir()
    rows = ["frame,label,x,y,z,l,w,h,yaw_rad"]
    for frame in range(frames):
        points, boxes = changed(*road(rng), matrix, turn)
        np.save(folder / f"{frame:03d}.npy", np.column_stack([points, np.full(len(points), 0.5)]).astype(np.float32))
        for centre, size, yaw in zip(boxes.centre_m, boxes.size_m, boxes.yaw_rad, strict=True):
            rows.append(",".join([f"{frame:03d}", "vehicle", *(f"{value:.4f}" for value in (*centre, *size, yaw))]))
    write_text(folder / "labels.csv", "\n".join(rows) + "\n")
    return folder


@pytest.mark.parametrize("case", ["x right, y forward", "centimetres"])
def test_every_verb_says_it(
    case: str, tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("torch")
    (matrix, turn), _, words = CASES[case]
    folder = own_folder(tmp_path / "own", rng, matrix, turn)
    cli.main(["doctor", str(folder), "--json", "-"])
    assert words in capsys.readouterr().out
    detector = "pointpillars-cirrus-sim"
    for arguments in (
        ["predict", detector, str(folder), "--out", str(tmp_path / "found.csv"), "--dry-run"],
        ["predict", detector, str(folder / "000.npy"), "--dry-run"],
        ["evaluate", detector, str(folder), "--dry-run"],
        [
            "train",
            detector,
            "--dry-run",
            *("-o", f"data.path={folder}", "-o", "data.clouds=[lidar]", "-o", "data.simulate=null"),
        ],
    ):
        cli.main(arguments)
        captured = capsys.readouterr()
        assert words in " ".join((captured.out + captured.err).split()), arguments[0]


def test_the_advised_turn_mends_it(tmp_path: Path, rng: np.random.Generator) -> None:
    folder = own_folder(tmp_path / "own", rng, *CASES["x right, y forward"][0])
    assert "--rotate-deg -90" in str(first_doubts(open_dataset(folder))[0])
    assert first_doubts(open_dataset(folder, rotate_deg=-90.0)) == []


@pytest.mark.parametrize("stored_boxes", [False, True], ids=["a detector", "boxes"])
def test_evaluate_and_detect_say_what_the_verbs_warn_of(rng: np.random.Generator, stored_boxes: bool) -> None:
    points, boxes = changed(*road(rng), 100 * EYE, 0.0)
    frame = Frame.of(Cloud(points.astype(np.float32)), boxes)
    predicted = boxes.replace(score=np.ones(len(boxes)))
    detector = {frame.key: predicted} if stored_boxes else (lambda frame: predicted)
    result = ff.evaluate(detector, [frame], bootstrap=Bootstrap(replicates=0), region="none")
    assert [note for note in result.notes if "centimetres" in note], result.notes
    if not stored_boxes:
        assert [note for note in ff.detect(detector, [frame]).notes if "centimetres" in note]


def test_a_radars_cloud_is_not_judged_as_a_lidars(rng: np.random.Generator) -> None:
    points = road(rng)[0]
    tall = (points * [1.0, 1.0, 30.0]).astype(np.float32)
    sensors = {"radar": Sensor(kind="radar")}
    frame = Frame(sequence="s", frame_id="0", clouds={"radar": Cloud(tall)}, sensors=sensors)
    assert first_doubts(in_memory([frame]), cloud="radar") == []
