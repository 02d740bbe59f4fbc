"""A notebook's way in and out: arrays, files and tables become clouds, frames and boxes, and the other way."""

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import farfield as ff
from farfield.errors import ConfigError

N_POINTS = 40
BOXES = ff.Boxes(
    centre_m=np.array([[12.0, 2.0, -0.5], [40.0, -3.0, -0.25]]),
    size_m=np.array([[4.5, 1.9, 1.6], [8.0, 2.5, 3.0]]),
    yaw_rad=np.array([0.25, -1.5]),
    label=np.array(["vehicle", "large_vehicle"]),
    score=np.array([0.9, 0.4]),
    track_id=np.array([7, -1]),
    point_count=np.array([31, 4]),
    velocity_m_s=np.array([[3.0, 0.5], [np.nan, np.nan]]),
)


@pytest.fixture
def points(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform([2, -10, -2], [60, 10, 1], (N_POINTS, 3))


def same(a: ff.Boxes, b: ff.Boxes) -> None:
    for name, value in vars(a).items():
        np.testing.assert_array_equal(value, getattr(b, name), err_msg=name)


def test_a_cloud_needs_points_alone_in_any_numbers(points: np.ndarray) -> None:
    cloud = ff.Cloud(points)
    assert cloud.points_m.dtype == np.float32
    assert cloud.intensity is None
    frame = ff.Frame.of(cloud)
    assert frame.sensors["lidar"].kind == "lidar", "points without a radar's columns are a LiDAR's"
    assert ff.Frame.of(ff.Cloud(points, extra={"power": np.ones(N_POINTS)})).reference == "radar"


@pytest.mark.usefixtures("without_shape_checks")
def test_points_of_another_shape_are_refused_in_words(points: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"Cloud.points_m: expected shape \(n, 3\), got \(40, 2\)"):
        ff.Cloud(points[:, :2])


def test_a_frame_of_an_array_reads_its_columns_as_a_file_does(points: np.ndarray) -> None:
    assert ff.Frame.of(points).cloud().intensity is not None, "zeros, as for a file of three columns"
    with_bytes = np.column_stack([points, np.linspace(0, 255, N_POINTS), np.arange(N_POINTS) % 8])
    cloud = ff.Frame.of(with_bytes).cloud()
    assert cloud.intensity is not None
    assert cloud.intensity.max() == 1.0
    assert cloud.extra["ring"].tolist() == [float(n % 8) for n in range(N_POINTS)]
    frame = ff.Frame.of(points, BOXES, sequence="mine", frame_id="3")
    assert frame.key == ("mine", "3")
    assert len(frame.boxes or ()) == 2
    with pytest.raises(ConfigError, match=r"expected rows of 3 or more numbers, got shape \(40, 2\)"):
        ff.Frame.of(points[:, :2])


@pytest.mark.parametrize("suffix", [".npy", ".bin"])
def test_a_cloud_comes_from_a_file(suffix: str, points: np.ndarray, tmp_path: Path) -> None:
    rows = np.column_stack([points, np.linspace(0, 1, N_POINTS)]).astype(np.float32)
    path = tmp_path / f"scan{suffix}"
    np.save(path, rows) if suffix == ".npy" else rows.tofile(path)
    for given in (path, str(path)):
        cloud = ff.Cloud.from_file(given)
        np.testing.assert_array_equal(cloud.points_m, rows[:, :3])
        np.testing.assert_array_equal(cloud.intensity, rows[:, 3])
    with pytest.raises(ff.FarfieldError, match=r"none\.pcd"):
        ff.Cloud.from_file(tmp_path / "none.pcd")


def test_show_takes_a_cloud_an_array_and_boxes(points: np.ndarray) -> None:
    for shown in (ff.Cloud(points), points, ff.Frame.of(points)):
        assert ff.show(shown, BOXES).axes[0].collections
    wide = ff.Cloud(points - [500, 0, 0])
    low, high = ff.show(wide).axes[0].get_xlim()
    assert low <= wide.points_m[:, 0].min(), "a cloud behind the sensor is shown whole"
    assert high >= wide.points_m[:, 0].max()


def test_boxes_go_to_csv_and_back(tmp_path: Path) -> None:
    path = tmp_path / "boxes.csv"
    BOXES.to_csv(path, sequence="a", frame="1")
    same(ff.Boxes.from_csv(path), BOXES)
    assert path.read_text().startswith("sequence,frame,label,x,y,z,l,w,h,yaw_rad,score")
    ff.Boxes.empty().to_csv(tmp_path / "none.csv")
    assert len(ff.Boxes.from_csv(tmp_path / "none.csv")) == 0
    text = path.read_text().splitlines()
    path.write_text("\n".join([*text, text[1].replace("a,1,", "a,2,")]) + "\n")
    with pytest.raises(ConfigError, match=r"boxes.csv: expected the boxes of one frame, got 2.*frame="):
        ff.Boxes.from_csv(path)
    assert len(ff.Boxes.from_csv(path, frame="2")) == 1
    with pytest.raises(ConfigError, match=r"no boxes of the frame '3'.*1, 2"):
        ff.Boxes.from_csv(path, frame="3")


def test_boxes_go_to_an_array_and_back() -> None:
    rows = BOXES.to_numpy()
    assert rows.shape == (2, 7)
    assert rows[0].tolist() == [12.0, 2.0, -0.5, 4.5, 1.9, 1.6, 0.25]
    again = ff.Boxes.from_numpy(rows, label=BOXES.label, score=BOXES.score)
    same(again, BOXES.replace(track_id=None, point_count=None, velocity_m_s=None))
    with pytest.raises(ConfigError, match=r"shape \(n, 7\): x, y, z, length, width, height, yaw.* got \(2, 6\)"):
        ff.Boxes.from_numpy(rows[:, :6])


def test_degrees_in_an_array_are_refused() -> None:
    rows = BOXES.to_numpy()
    rows[:, 6] = [90.0, 180.0]
    with pytest.raises(ConfigError, match="radians"):
        ff.Boxes.from_numpy(rows)


class Table:
    """What a DataFrame and a dictionary of columns have in common; like a DataFrame it is no Mapping."""

    def __init__(self, columns: dict[str, Any]) -> None:
        self.columns = columns

    def keys(self) -> list[str]:
        return [*self.columns]

    def __getitem__(self, name: str) -> Any:
        return self.columns[name]


@pytest.mark.skipif(importlib.util.find_spec("pandas") is not None, reason="pandas is installed")
def test_without_pandas_the_way_to_it_is_named() -> None:
    with pytest.raises(ConfigError, match="pip install pandas"):
        BOXES.to_pandas()


def test_boxes_come_from_any_table_of_named_columns() -> None:
    table = Table(BOXES.columns())
    assert table.keys() == [
        "label",
        "x",
        "y",
        "z",
        "l",
        "w",
        "h",
        "yaw_rad",
        "score",
        "track_id",
        "point_count",
        "vx_m_s",
        "vy_m_s",
    ]
    same(ff.Boxes.from_pandas(table), BOXES)
    table.columns["track_id"] = np.array([7.0, np.nan])  # as pandas writes whole numbers where one is missing
    same(ff.Boxes.from_pandas(table), BOXES)
    nameless = {name: column for name, column in table.columns.items() if name != "yaw_rad"}
    with pytest.raises(ConfigError, match=r"expected the columns .*yaw_rad; missing: yaw_rad.*yaw"):
        ff.Boxes.from_pandas(nameless | {"yaw": [0, 0]})
    with pytest.raises(ConfigError, match="the boxes of one frame, got 2"):
        ff.Boxes.from_pandas({**table.columns, "frame": ["1", "2"]})


def test_boxes_go_to_pandas_and_back() -> None:
    pandas = pytest.importorskip("pandas")
    frame = BOXES.to_pandas()
    assert isinstance(frame, pandas.DataFrame)
    same(ff.Boxes.from_pandas(frame[frame.score > 0]), BOXES)
    same(ff.Boxes.from_pandas(frame.astype({"track_id": "Int64"}).replace({"track_id": {-1: pandas.NA}})), BOXES)
    two = pandas.concat([frame.assign(frame="1"), frame.assign(frame="2")], ignore_index=True)
    with pytest.raises(ConfigError, match="the boxes of one frame, got 2"):
        ff.Boxes.from_pandas(two)
    same(ff.Boxes.from_pandas(two[two.frame == "2"]), BOXES)
    assert len(ff.Boxes.from_pandas(frame[frame.score > 2])) == 0


def test_every_repr_is_one_line(points: np.ndarray) -> None:
    cloud = ff.Cloud(points, np.ones(N_POINTS), {"ring": np.arange(N_POINTS)})
    frame = ff.Frame.of(cloud, BOXES, conditions={"weather": "fog"})
    assert repr(cloud).startswith(f"Cloud({N_POINTS} points to ")
    assert "intensity, ring" in repr(cloud)
    assert repr(frame) == "Frame(memory/0: cloud lidar; annotated; weather fog)"
    assert repr(frame.annotation) == "Annotation(2: 1 large_vehicle, 1 vehicle)"
    assert repr(frame.sensors["lidar"]) == "Sensor(lidar, at an unknown place)"
    assert not any("\n" in repr(thing) for thing in (cloud, frame, BOXES))
    assert repr(ff.Cloud(np.zeros((0, 3)))) == "Cloud(0 points; x_m, y_m, z_m)"


def test_a_repr_loads_nothing() -> None:
    from farfield.frame import Lazy

    frame = ff.Frame(sequence="a", frame_id="b", clouds=Lazy({"lidar": lambda: 1 / 0}), load_annotation=lambda: 1 / 0)
    assert repr(frame) == "Frame(a/b: cloud lidar; annotated)"


def test_train_is_a_function(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    with pytest.raises(ConfigError, match="no-such-experiment: expected an experiment's YAML file or the name"):
        ff.train("no-such-experiment", out=tmp_path)
    with pytest.raises(ff.FarfieldError, match="expected its data in"):
        ff.train("pointpillars-kitti", {"data.path": str(tmp_path / "absent")}, out=tmp_path)
