"""Called on what people have: paths, arrays, lists and tables come in at one door; what they cannot be is refused."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import farfield as ff
from farfield.datasets.door import dataset_of
from farfield.errors import ConfigError, DatasetError
from farfield.files.tables import columns_in
from farfield.frame.door import frame_of

CAR = np.array([[20.0, 1.0, -1.0, 4.4, 1.9, 1.6, 0.0]])


@pytest.fixture
def points(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform([2, -30, -2, 0], [60, 30, 1, 1], (400, 4)).astype(np.float32)


def one_car(frame: ff.Frame) -> ff.Boxes:
    assert len(frame.cloud()) > 0
    return ff.Boxes.from_numpy(CAR, label="vehicle", score=np.array([0.5]))


class Table:
    """Columns by name without being a mapping, as polars and pyarrow have them."""

    def __init__(self, columns: dict[str, Any]) -> None:
        self.columns, self.data = list(columns), columns

    def __getitem__(self, name: str) -> Any:
        return self.data[name]


def test_everything_that_is_a_sweep_is_detected_in(points: np.ndarray, tmp_path: Path) -> None:
    paths = [tmp_path / f"{name}.npy" for name in "ab"]
    for path in paths:
        np.save(path, points)
    columns = {**dict(zip("xyz", points.T, strict=False)), "intensity": points[:, 3], "ring": np.arange(400)}
    one: list[Any] = [
        paths[0],
        str(paths[0]),
        points,
        ff.Cloud.of(points),
        ff.Frame.of(points),
        columns,
        Table(columns),
    ]
    for data in one:
        assert len(ff.detect(one_car, data).boxes) == 1, type(data)
        np.testing.assert_allclose(dataset_of(data)[0].cloud().points_m, points[:, :3])
    assert frame_of(columns).cloud().extra["ring"].tolist() == list(range(400))
    assert list(ff.detect(one_car, paths).boxes) == [("files", "a"), ("files", "b")]
    assert list(ff.detect(one_car, [points, points]).boxes) == [("memory", "0"), ("memory", "1")]
    assert frame_of(paths[1]).key == ("memory", "b")


def test_a_loaded_detector_takes_a_path_and_an_array(points: np.ndarray, tmp_path: Path) -> None:
    pytest.importorskip("torch")
    from farfield.detectors.runtime import Detector
    from tests.detectors.small import small_detector

    detector = Detector(small_detector("pointpillars"), precision="fp32", device="cpu")
    np.save(tmp_path / "sweep.npy", points)
    boxes = [detector(given) for given in (points, tmp_path / "sweep.npy", str(tmp_path / "sweep.npy"))]
    assert [len(b) for b in boxes] == [len(boxes[0])] * 3
    np.testing.assert_allclose(boxes[1].to_numpy(), boxes[0].to_numpy(), atol=1e-5)
    with pytest.raises(ConfigError, match="got int"):
        detector(3)


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda p: p * [1000, 1000, 1000, 1], "millimetres"),
        (lambda p: p * [1e-3, 1e-3, 1e-3, 1], "kilometres"),
        (lambda p: p.T.copy(), r"give array.T"),
        (lambda p: p[:, :2], r"shape \(n, 3\) or wider"),
        (lambda p: p.reshape(20, 20, 4), "organised cloud"),
        (lambda p: p.astype(str), "of <U"),
        (lambda p: np.column_stack([p[:, 0], p[:, 1] / 30, p[:, 2] / 2, p[:, 3]]), "range, azimuth and elevation"),
        (lambda p: {"a": p[:, 0]}, "the columns x, y, z"),
    ],
)
def test_what_an_array_cannot_be_is_refused_by_name(points: np.ndarray, made: Any, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        ff.detect(one_car, [made(points)])


def test_wrong_types_say_what_to_give(points: np.ndarray, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="expected a data set, the path"):
        ff.detect(one_car, 3)
    with pytest.raises(ConfigError, match="expected a detector, a bundled one's name"):
        ff.detect(3, points)  # type: ignore[arg-type]
    with pytest.raises(DatasetError, match=r"nowhere\.pcd"):
        ff.detect(one_car, [tmp_path / "nowhere.pcd"])
    with pytest.raises(ConfigError, match="expected a Frame, a Cloud"):
        frame_of(SimpleNamespace())


def test_boxes_are_arrays_sums_and_tables() -> None:
    boxes = ff.Boxes.from_numpy(CAR, label="vehicle", score=np.array([0.5]))
    np.testing.assert_array_equal(np.asarray(boxes), CAR)
    assert np.asarray(boxes, dtype=np.float32).dtype == np.float32
    assert len(boxes + boxes) == len(sum([boxes, boxes])) == 2
    with pytest.raises(TypeError):
        boxes + 3
    table = Table(boxes.columns())
    np.testing.assert_array_equal(ff.Boxes.from_pandas(table).to_numpy(), CAR)
    assert columns_in([1, 2]) is None


@pytest.mark.parametrize("library", ["pandas", "polars"])
def test_tables_of_libraries_go_in_and_out(library: str, points: np.ndarray) -> None:
    frames = pytest.importorskip(library)
    boxes = ff.Boxes.from_numpy(CAR, label="vehicle", score=np.array([0.5]))
    table = getattr(boxes, f"to_{library}")()
    np.testing.assert_array_equal(ff.Boxes.from_pandas(table).to_numpy(), CAR)
    sweep = frames.DataFrame({name: points[:, number] for number, name in enumerate(["x", "y", "z", "intensity"])})
    assert len(ff.detect(one_car, sweep).boxes) == 1
    annotated = ff.Frame.of(points, boxes.plain())
    result = ff.evaluate(one_car, [annotated], replicates=0, region="none")
    rows = getattr(result, f"to_{library}")()
    assert {"figure", "part", "value", "low", "high"} == set(rows.columns)


def test_a_result_is_columns() -> None:
    boxes = ff.Boxes.from_numpy(CAR, label="vehicle", score=np.array([0.5]))
    points = np.random.default_rng(0).uniform(2, 60, (30, 3))
    result = ff.evaluate(one_car, [ff.Frame.of(points, boxes.plain())], replicates=0, region="none")
    columns = result.columns()
    row = [(f, p) for f, p in zip(columns["figure"], columns["part"], strict=True)].index(("dds/0/dds", "overall"))
    assert columns["value"][row] == result.figures["dds/0/dds"]
    assert result.settings["bootstrap"]["replicates"] == 0, "replicates=0 is the flag's keyword"


def test_a_loader_of_torch_takes_a_data_set(points: np.ndarray) -> None:
    torch = pytest.importorskip("torch")
    frames = [ff.Frame.of(points, ff.Boxes.from_numpy(CAR, label="vehicle"), frame_id=str(n)) for n in range(3)]
    loader = torch.utils.data.DataLoader(dataset_of(frames), batch_size=2, collate_fn=ff.collate)
    batches = list(loader)
    assert [len(batch["frame"]) for batch in batches] == [2, 1]
    np.testing.assert_array_equal(batches[0]["points"][1], points)
    np.testing.assert_allclose(batches[0]["boxes"][0], CAR.astype(np.float32))
    assert batches[1]["labels"] == [["vehicle"]]
