"""Own clouds of other layouts: more columns, rows for columns, few columns, directions without return."""

from pathlib import Path

import numpy as np
import pytest

import farfield as ff
from farfield.api import open_dataset
from farfield.datasets.memory import CloudFiles
from farfield.errors import DatasetError, FileFormatError
from farfield.evaluation import detect
from farfield.files.pcd import write_pcd
from farfield.frame import Boxes, Cloud, Frame
from farfield.frame.cloud import read_cloud
from farfield.inspection.doctor import examine


def rows_of(points: int = 3_000) -> np.ndarray:
    """x, y, z, intensity to 255 and ring, as nuScenes has them."""
    random = np.random.default_rng(0)
    place = random.uniform((-60, -50, -2), (60, 50, 3), (points, 3))
    return np.column_stack([place, random.integers(0, 256, points), np.arange(points) % 32]).astype(np.float32)


def test_five_columns_are_not_read_as_four(tmp_path: Path) -> None:
    rows = rows_of()
    rows.tofile(tmp_path / "a.bin")
    cloud = open_dataset(tmp_path)[0].clouds["lidar"]
    np.testing.assert_array_equal(cloud.points_m, rows[:, :3])
    np.testing.assert_array_equal(cloud.extra["ring"], rows[:, 4])
    assert cloud.intensity is not None
    assert cloud.intensity.max() == pytest.approx(1)
    topics = [finding.what for finding in examine(open_dataset(tmp_path)).findings if finding.topic == "cloud lidar"]
    assert topics[0].startswith("5 columns (x, y, z, intensity, ring)")


def test_the_number_of_columns_can_be_said(tmp_path: Path) -> None:
    np.random.default_rng(1).normal(size=(500, 4)).astype(np.float32).tofile(tmp_path / "a.bin")
    with pytest.raises(FileFormatError, match="bin_columns="):
        open_dataset(tmp_path)[0].clouds["lidar"]
    assert len(open_dataset(tmp_path, bin_columns=5)[0].clouds["lidar"]) == 400


def test_kittis_folders_with_five_columns_are_read_as_five(tmp_path: Path) -> None:
    rows = rows_of()
    (tmp_path / "training" / "velodyne").mkdir(parents=True)
    rows.tofile(tmp_path / "training" / "velodyne" / "000000.bin")
    data = open_dataset(tmp_path)
    assert data.name == "kitti"
    np.testing.assert_array_equal(data[0].clouds["lidar"].points_m, rows[:, :3])


def test_an_array_that_lies_transposed_is_turned(tmp_path: Path) -> None:
    rows = rows_of()[:, :4]
    np.save(tmp_path / "a.npy", rows.T)
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.npy").points_m, rows[:, :3])


@pytest.mark.parametrize("count", [3, 4])
def test_text_of_three_or_four_columns_is_read(tmp_path: Path, count: int) -> None:
    rows = rows_of(50)[:, :count]
    np.savetxt(tmp_path / "a.xyz", rows, fmt="%.4f", delimiter=",")
    cloud = read_cloud(tmp_path / "a.xyz")
    np.testing.assert_allclose(cloud.points_m, rows[:, :3], atol=1e-4)
    assert cloud.intensity is not None
    assert (cloud.intensity.max() > 0) == (count == 4)


def test_directions_without_return_are_left_out_and_counted(tmp_path: Path) -> None:
    rows = rows_of(600)
    rows[::3, :3] = np.nan
    fields = {name: rows[:, number] for number, name in enumerate(("x", "y", "z", "intensity"))}
    write_pcd(tmp_path / "a.pcd", fields, height=20)
    cloud = read_cloud(tmp_path / "a.pcd")
    assert (len(cloud), cloud.missing) == (400, 200)
    topics = [finding.what for finding in examine(open_dataset(tmp_path)).findings if finding.topic == "cloud lidar"]
    assert "200 invalid points (no return) left out" in topics[0]


def test_an_infinite_place_is_an_error_still(tmp_path: Path) -> None:
    rows = rows_of(60)
    rows[3, 1] = np.inf
    write_pcd(tmp_path / "a.pcd", {name: rows[:, number] for number, name in enumerate("xyz")})
    with pytest.raises(DatasetError, match="finite coordinates"):
        read_cloud(tmp_path / "a.pcd")


def test_pandasets_organised_sweep_opens(shared_real: Path) -> None:
    cloud = open_dataset(shared_real / "pandaset")[0].clouds["lidar"]
    assert len(cloud) + cloud.missing == 64 * 1856
    assert cloud.missing > 0


def test_clouds_of_one_name_in_two_folders_stay_apart(tmp_path: Path) -> None:
    for folder in ("morning", "evening"):
        (tmp_path / folder).mkdir()
        np.save(tmp_path / folder / "1.npy", rows_of(20)[:, :4])
    files = [tmp_path / folder / "1.npy" for folder in ("morning", "evening")]
    clouds = CloudFiles(files)
    assert clouds.keys == (("morning", "1"), ("evening", "1"))
    assert [frame.key for frame in clouds] == list(clouds.keys)
    with pytest.raises(DatasetError, match="each cloud once"):
        CloudFiles([*files, files[0]])


def test_frames_of_one_name_are_not_scored_as_one() -> None:
    rows = rows_of(20)
    frames = [Frame.of(Cloud(rows[:, :3] + shift), boxes=Boxes.empty(), frame_id="1") for shift in (0, 1)]
    with pytest.raises(DatasetError, match="each frame once"):
        ff.evaluate({frames[0].key: Boxes.empty(scored=True)}, frames)
    with pytest.raises(DatasetError, match="each frame once"):
        detect(nothing_found, frames)


def nothing_found(frame: Frame) -> Boxes:
    """A detector that finds nothing."""
    del frame
    return Boxes.empty(scored=True)


@pytest.mark.parametrize("kind", ["rows", "structured"])
@pytest.mark.parametrize("change", ["longer", "cut"])
def test_an_array_of_another_size_than_its_header_says_is_refused(tmp_path: Path, kind: str, change: str) -> None:
    """A header of 50 points before 100: numpy reads the first 50 without a word."""
    rows = rows_of(50).astype(np.float32)[:, :4]
    names = [(name, "f4") for name in ("x", "y", "z", "intensity")]
    np.save(tmp_path / "a.npy", rows if kind == "rows" else np.ascontiguousarray(rows).view(names)[:, 0])
    data = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(data + rows.tobytes() if change == "longer" else data[:-4])
    with pytest.raises(
        (DatasetError, FileFormatError), match=r"a\.npy.*" + ("1600 bytes" if change == "longer" else "")
    ):
        read_cloud(tmp_path / "a.npy")


def test_an_empty_cloud_with_a_field_of_several_numbers_is_empty(tmp_path: Path) -> None:
    """As a driver writes a sweep in which nothing returned: its fields stay what they are."""
    none = np.zeros(0, dtype=np.float32)
    write_pcd(tmp_path / "a.pcd", {"x": none, "y": none, "z": none, "normal": np.zeros((0, 3), dtype=np.float32)})
    cloud = read_cloud(tmp_path / "a.pcd")
    assert len(cloud) == 0
    assert {*cloud.extra} == {"normal_0", "normal_1", "normal_2"}


@pytest.mark.parametrize("columns", [4, 5, 7])
def test_rows_without_a_point_are_an_empty_cloud(tmp_path: Path, columns: int) -> None:
    np.save(tmp_path / "a.npy", np.zeros((0, columns), dtype=np.float32))
    np.save(tmp_path / "b.npy", rows_of(200)[:, :4])
    assert len(open_dataset(tmp_path)[0].cloud()) == 0
    assert len(read_cloud(tmp_path / "a.npy")) == 0


@pytest.mark.parametrize("number", [">f4", "<f8"])
@pytest.mark.parametrize("columns", [4, 5])
def test_other_numbers_under_said_columns_are_no_places(tmp_path: Path, number: str, columns: int) -> None:
    """Big-endian or double numbers read as float32 stand at 1e-30 and 1e25 m."""
    rows = rows_of(400)[:, :columns].astype(number)
    (tmp_path / "a.bin").write_bytes(rows.tobytes())
    with pytest.raises(DatasetError, match=r"within 10,000 km.*order of bytes"):
        open_dataset(tmp_path, bin_columns=columns)[0].cloud()


def test_one_impossible_place_is_refused_in_every_format(tmp_path: Path) -> None:
    rows = rows_of(300)[:, :4].astype(np.float64)
    rows[7, 1] = 3e12
    fields = dict(zip(("x", "y", "z", "intensity"), rows.T, strict=True))
    write_pcd(tmp_path / "a.pcd", fields)
    np.save(tmp_path / "a.npy", rows)
    rows.astype("f4").tofile(tmp_path / "a.bin")
    (tmp_path / "a.xyz").write_text("\n".join(" ".join(map(str, row)) for row in rows.tolist()))
    for suffix in ("pcd", "npy", "bin", "xyz"):
        with pytest.raises(DatasetError, match=r"within 10,000 km, got .*[23]\d{12}\."):
            read_cloud(tmp_path / f"a.{suffix}", bin_columns=4)
