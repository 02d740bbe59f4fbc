"""Numbers that a column of a data set's sweeps cannot hold are refused: never clipped, cast or left as text."""

import json
from pathlib import Path

import numpy as np
import pytest

from farfield.datasets.argoverse2 import _read_sweep, read_columns
from farfield.datasets.astyx import _read_lidar
from farfield.datasets.cirrus.labels import read_labels
from farfield.datasets.cirrus.layout import Labels
from farfield.datasets.cirrus.reader import _conditions, _pose
from farfield.datasets.kradar.index import FileIndex
from farfield.datasets.kradar.radar_pose import LIDARS_FILE, read_os2_T_os1, read_side_file
from farfield.datasets.radiate import lidar_cloud
from farfield.datasets.sustechpoints import _camera
from farfield.errors import FileFormatError
from farfield.files.astyx import LIDAR_COLUMNS, read_sensors

HOUR_US = 3_600_000_000


def astyx(path: Path, reflectivity: float = 100, start_us: int = 1_286_431_339, laser: float = 3) -> Path:
    rows = np.column_stack([np.arange(1.0, 41), np.zeros(40), np.zeros(40), np.full(40, 7.0), np.full(40, 3.0)])
    rows[5, 3:] = reflectivity, laser
    times = (start_us + np.linspace(0, 99_000, 40).round()) % HOUR_US
    np.savetxt(path, np.column_stack([rows, times]), fmt="%.12g", header=" ".join(LIDAR_COLUMNS), comments="")
    return path


@pytest.mark.parametrize("reflectivity", [-1, 256, 4000])
def test_astyx_reflectivities_are_not_clipped(reflectivity: float, tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=f"Reflectivity.*from 0 to 255.*{reflectivity}"):
        _read_lidar(astyx(tmp_path / "a.txt", reflectivity), np.eye(4))


@pytest.mark.parametrize("start_us", [1_286_431_339, HOUR_US - 40_000, 0])
def test_astyx_points_have_times_since_the_first_of_the_sweep(start_us: int, tmp_path: Path) -> None:
    """They are microseconds of the hour, and the sweep's own time is not told."""
    cloud = _read_lidar(astyx(tmp_path / "a.txt", start_us=start_us), np.eye(4))
    expected = np.linspace(0, 99_000, 40).round() * 1000
    np.testing.assert_array_equal(cloud.extra["offset_ns"], expected.astype(np.int64))
    offsets_s = cloud.offsets_s()
    assert offsets_s is not None
    assert offsets_s.max() == pytest.approx(0.099)


@pytest.mark.parametrize("column", ["laser", "time"])
def test_astyx_whole_numbers_are_whole(column: str, tmp_path: Path) -> None:
    path = astyx(tmp_path / "a.txt", laser=2.5 if column == "laser" else 3)
    if column == "time":
        path.write_text(path.read_text().replace(" 1286431339\n", " 1286431339.5\n"))
    with pytest.raises(FileFormatError, match="whole numbers"):
        _read_lidar(path, np.eye(4))


@pytest.mark.parametrize("ring", ["nan", "inf", "40000", "2.5", "-3"])
def test_radiate_rings_are_not_cast(ring: str, tmp_path: Path) -> None:
    """NaN became ring 0 and 40000 ring -25536."""
    (tmp_path / "1.csv").write_text(f"1,2,3,100,4\n2,3,4,100,{ring}\n")
    with pytest.raises(FileFormatError, match=r"ring.*whole numbers from 0 to"):
        lidar_cloud(tmp_path / "1.csv")


NAMES = ("x", "y", "z", "intensity", "laser_number", "offset_ns")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", ["text", "moments", "lists"])
def test_argoverse_columns_of_other_kinds_are_refused(name: str, kind: str, tmp_path: Path) -> None:
    feather = pytest.importorskip("pyarrow.feather")
    import pyarrow

    columns = {key: pyarrow.array(np.arange(1, 9).astype("f4" if key in "xyz" else "u1")) for key in NAMES}
    wrong = {"text": [str(n) for n in range(8)], "lists": [[1]] * 8, "moments": np.arange(8).astype("datetime64[ns]")}
    columns[name] = pyarrow.array(wrong[kind])
    feather.write_feather(pyarrow.table(columns), tmp_path / "1.feather")
    with pytest.raises(FileFormatError, match=f"column {name}.*numbers"):
        _read_sweep(tmp_path / "1.feather")


def test_argoverse_names_are_texts_and_the_rest_numbers(tmp_path: Path) -> None:
    """A pose's numbers that are texts would be compared with numbers further on."""
    feather = pytest.importorskip("pyarrow.feather")
    import pyarrow

    table = pyarrow.table({"sensor_name": ["a"], "qw": ["1.0"], "tx_m": [1.0]})
    feather.write_feather(table, tmp_path / "1.feather")
    assert read_columns(tmp_path / "1.feather", ("sensor_name", "tx_m"))["tx_m"].tolist() == [1.0]
    with pytest.raises(FileFormatError, match="column qw"):
        read_columns(tmp_path / "1.feather", ("sensor_name", "qw"))


@pytest.mark.parametrize("pose", ["transposed", "scaled"])
def test_astyx_poses_are_rigid_motions(pose: str, tmp_path: Path) -> None:
    """The last row of a transposed matrix holds what should be the place."""
    matrix = np.array([[0, -1, 0, 2], [1, 0, 0, 3], [0, 0, 1, 0.5], [0, 0, 0, 1]], dtype=float)
    matrix = matrix.T if pose == "transposed" else matrix * [[1], [1], [1], [2]]
    sensor = {"sensor_uid": "lidar_vlp16", "calib_data": {"T_to_ref_COS": matrix.tolist()}}
    (tmp_path / "a.json").write_text(json.dumps({"sensors": [sensor]}))
    with pytest.raises(FileFormatError, match="a rotation and a place"):
        read_sensors(tmp_path / "a.json")


TURN = np.array([[0, -1, 0, 0.1], [0, 0, -1, -0.2], [1, 0, 0, 0.3], [0, 0, 0, 1]], dtype=float)
UNFIT = {
    "transposed": TURN.T,
    "sheared": TURN + np.array([[0, 0, 0.5, 0], *np.zeros((3, 4))]),
    "mirrored": TURN * [[-1], [1], [1], [1]],
}


@pytest.mark.parametrize("kind", UNFIT)
@pytest.mark.parametrize("reader", ["sustechpoints", "kradar lidars", "kradar radar", "cirrus"])
def test_poses_of_files_are_rigid_motions(reader: str, kind: str, tmp_path: Path) -> None:
    matrix, path = UNFIT[kind], tmp_path / "1" / "info_calib" / "a.json"
    path.parent.mkdir(parents=True)
    with pytest.raises(FileFormatError, match="rigid motion"):  # noqa: PT012
        if reader == "sustechpoints":
            intrinsic = [500, 0, 32, 0, 500, 24, 0, 0, 1]
            path.write_text(json.dumps({"extrinsic": matrix.ravel().tolist(), "intrinsic": intrinsic}))
            _camera(path, None)
        elif reader == "kradar radar":
            path.write_text(json.dumps({"radar_T_lidar": matrix.tolist(), "yaw_rad": 0.0}))
            read_side_file(path)
        elif reader == "kradar lidars":
            path = path.with_name(LIDARS_FILE)
            path.write_text(json.dumps({"os2_T_os1": matrix.tolist()}))
            read_os2_T_os1(FileIndex([tmp_path]), "1")
        else:
            path.write_text(json.dumps({"labels": [], "world_T_lidar": matrix.tolist()}))
            _pose(read_labels(path, Labels()))


def test_a_cirrus_frame_without_labels_has_its_pose_and_conditions(tmp_path: Path) -> None:
    content = {"labels": [], "world_T_lidar": TURN.tolist(), "conditions": {"weather": "snow"}}
    (tmp_path / "a.json").write_text(json.dumps(content))
    raw = read_labels(tmp_path / "a.json", Labels())
    assert _pose(raw).tolist() == TURN.tolist()
    assert _conditions(raw) == {"weather": "snow"}


def test_a_long_name_of_argoverse_is_refused_before_it_is_repeated(tmp_path: Path) -> None:
    """One text of 130,000 letters for 20,000 rows stands in 900 bytes, and takes 10 GB as an array of texts."""
    feather = pytest.importorskip("pyarrow.feather")
    import pyarrow

    names = pyarrow.DictionaryArray.from_arrays(np.zeros(20_000, np.int8), pyarrow.array(["a" * 130_000]))
    feather.write_feather(pyarrow.table({"sensor_name": names}), tmp_path / "1.feather", compression="zstd")
    assert (tmp_path / "1.feather").stat().st_size < 2000
    with pytest.raises(FileFormatError, match=r"column sensor_name.*text"):
        read_columns(tmp_path / "1.feather", ("sensor_name",))


@pytest.mark.parametrize("left_out", [1, 8, 100])
def test_a_cut_feather_table_is_refused(tmp_path: Path, left_out: int) -> None:
    """Its messages alone would be read, up to where it was cut."""
    feather = pytest.importorskip("pyarrow.feather")
    import pyarrow

    feather.write_feather(pyarrow.table({"tx_m": np.arange(9.0)}), tmp_path / "1.feather")
    data = (tmp_path / "1.feather").read_bytes()
    (tmp_path / "1.feather").write_bytes(data[:-left_out])
    with pytest.raises(FileFormatError, match="the end"):
        read_columns(tmp_path / "1.feather", ("tx_m",))
