"""LAS, LAZ, PLY and npz as clouds of one's own: coordinates of maps, full scales of intensities, times, folders."""

import struct
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from las_files import las_bytes, point_1

from farfield.datasets import open_dataset, recognise
from farfield.datasets.cloud_reading import CloudReading
from farfield.datasets.memory import CloudFiles
from farfield.errors import DatasetError, FarfieldError, FileFormatError
from farfield.frame.cloud import Cloud, CloudSettings, read_cloud
from farfield.geometry.poses import transform_points

EAST, NORTH, UP = 691_000.0, 5_334_000.0, 512.0


def on_a_map(path: Path, east: float = EAST, *, strength: int = 200, flags: int = 0, north: float = NORTH) -> Path:
    points = [point_1(x, y, z, strength) for x, y, z in ((-1500, 250, 1), (0, 0, 2), (12_345, -7, 3))]
    points.append(point_1(20, 30, 40, flags=flags))
    path.write_bytes(las_bytes(points, offset=(east, north, UP if north else 0)))
    return path


def test_a_single_cloud_of_a_map_loses_its_middle_in_float64_and_says_so(tmp_path: Path) -> None:
    path = on_a_map(tmp_path / "tile.las")
    with pytest.warns(UserWarning, match=r"coordinates of a map; \(691000, 5334000, 512\) m"):
        cloud = Cloud.from_file(path)
    np.testing.assert_allclose(
        cloud.points_m, [[-1.5, 0.25, 0.001], [0, 0, 0.002], [12.345, -0.007, 0.003], [0.02, 0.03, 0.04]], atol=1e-6
    )
    near = on_a_map(tmp_path / "near.las")
    near.write_bytes(near.read_bytes().replace(struct.pack("<3d", EAST, NORTH, UP), struct.pack("<3d", 0, 0, 0)))
    assert Cloud.from_file(near).points_m[2].tolist() == pytest.approx([12.345, -0.007, 0.003])  # and no warning


def test_a_folder_has_one_origin_whichever_cloud_is_opened_first(tmp_path: Path) -> None:
    for number in range(3):
        on_a_map(tmp_path / f"{number}.las", EAST + 10 * number)
    places = []
    for order in ((0, 1, 2), (2, 1, 0)):
        data = open_dataset(tmp_path)
        places.append({index: data[index].cloud().points_m[1, 0] for index in order})
        assert [sentence for sentence in data.unwrapped.assumptions if "691000" in sentence]
    assert places[0] == places[1] == {0: 0.0, 1: 10.0, 2: 20.0}
    assert any("3 clouds of a map lose that origin alike" in sentence for sentence in data.unwrapped.assumptions)
    assert data[0].world_T_frame is None


def test_tiles_far_apart_are_placed_by_poses_and_said(tmp_path: Path) -> None:
    for number, away_m in enumerate((0, 9_000, 12_000, 400_000)):
        on_a_map(tmp_path / f"{number}.las", EAST + away_m)
    data = open_dataset(tmp_path)
    for made in (data, CloudFiles(sorted(tmp_path.glob("*.las")))):
        for number, away_m in enumerate((0, 9_000, 12_000, 400_000)):
            frame = made[number]
            pose = frame.world_T_frame
            assert pose is not None
            places_m = transform_points(pose, frame.cloud().points_m.astype(np.float64))
            assert places_m[1, 0] == pytest.approx(away_m, abs=1e-3)  # the first tile's origin is that point
            assert len(frame.cloud()) == 4
            assert abs(frame.cloud().points_m[1, 0]) < 9_001
        assert any("2 of 4 clouds lie more than 10 km" in sentence for sentence in made.unwrapped.assumptions)
    drive = data.drives()[0]
    assert drive.world_T_frame is not None
    assert drive.world_T_frame[:, 0, 3] == pytest.approx([0, 0, 12_000, 400_000], abs=10)


def test_where_frames_have_no_poses_far_tiles_are_refused_by_name(tmp_path: Path) -> None:
    paths = [on_a_map(tmp_path / "a.las"), on_a_map(tmp_path / "b.las", EAST + 12_000)]
    with pytest.raises(DatasetError, match=r"b\.las: expected clouds within 10 km"):
        CloudReading(paths)(paths[1])


@pytest.mark.parametrize("first", ["local", "map"])
def test_local_clouds_among_those_of_a_map_are_refused_by_name(tmp_path: Path, first: str) -> None:
    places = [(0.0, 0.0), (EAST, NORTH)]
    for number, (east, north) in enumerate(places if first == "local" else places[::-1]):
        on_a_map(tmp_path / f"{number}.las", east, north=north)
    data = open_dataset(tmp_path)
    assert len(data[0].cloud()) == 4
    got = "coordinates of a map" if first == "local" else "coordinates near the sensor"
    with pytest.raises(DatasetError, match=rf"1\.las: expected .*, got {got}"):
        data[1].cloud()


def test_tiles_far_apart_share_one_full_scale(tmp_path: Path) -> None:
    on_a_map(tmp_path / "0.las", strength=7)
    on_a_map(tmp_path / "1.las", EAST + 12_000, strength=60_000)
    intensity = open_dataset(tmp_path)[0].cloud().intensity
    assert intensity is not None
    assert intensity[0] == pytest.approx(7 / 65535)


def test_a_lack_of_memory_while_the_origin_is_decided_is_no_damaged_cloud(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(2):
        on_a_map(tmp_path / f"{number}.las", EAST + 100 * number)
    short = FarfieldError("no memory")
    monkeypatch.setattr("farfield.datasets.cloud_reading.read_las", Mock(side_effect=short))
    with pytest.raises(FarfieldError, match="no memory"):
        open_dataset(tmp_path)[1].cloud()


def test_withheld_points_and_origins_are_said_of_named_files(tmp_path: Path) -> None:
    data = CloudFiles([on_a_map(tmp_path / "a.las", flags=0x80), on_a_map(tmp_path / "b.las")])
    assert len(data[0].cloud()) == 3
    assert [sentence.partition(": ")[2][:20] for sentence in data.assumptions] == [
        "1 point of 4 marked ", "coordinates of a map", "2 clouds of a map lo",
    ]  # fmt: skip
    assert data.remarks[0][0] == "note"


@pytest.mark.parametrize(("strengths", "scale"), [((7, 255), 255), ((7, 256), 65535), ((7, 65535), 65535)])
def test_the_full_scale_of_intensities_is_one_for_all_clouds(
    tmp_path: Path, strengths: tuple[int, int], scale: int
) -> None:
    for number, strength in enumerate(strengths):
        points = [point_1(1000 * x, 5, 5, strength) for x in range(4)]
        (tmp_path / f"{number}.las").write_bytes(las_bytes(points))
    intensity = open_dataset(tmp_path)[0].cloud().intensity
    assert intensity is not None
    np.testing.assert_allclose(intensity, 7 / scale, rtol=1e-6)


def test_times_of_a_sweep_are_offsets_and_others_can_be_named(tmp_path: Path) -> None:
    path = tmp_path / "a.las"
    path.write_bytes(las_bytes([point_1(1, 1, 1, time=7.0), point_1(2, 2, 2, time=7.08)]))
    np.testing.assert_array_equal(Cloud.from_file(path).extra["offset_ns"], [0, 80_000_000])
    path.write_bytes(las_bytes([point_1(1, 1, 1, time=4.8e12), point_1(2, 2, 2, time=4.8e12 + 8e7)]))
    with pytest.warns(UserWarning, match="no seconds of a GPS week"):
        assert "offset_ns" not in Cloud.from_file(path).extra
    cloud = read_cloud(path, CloudSettings(point_times="ns", origin_m=(0.0, 0.0, 0.0)))
    np.testing.assert_array_equal(cloud.extra["offset_ns"], [0, 80_000_000])


def test_folders_of_the_new_kinds_are_recognised_and_mixed(tmp_path: Path) -> None:
    rows = np.array([[1, 2, 3, 0.5], [4, 5, 6, 1.0]], dtype=np.float32)
    head = "ply\nformat binary_big_endian 1.0\nelement vertex 2\n"
    head += "".join(f"property float {name}\n" for name in ("x", "y", "z", "intensity")) + "end_header\n"
    (tmp_path / "a.PLY").write_bytes(head.encode() + rows.astype(">f4").tobytes())
    np.savez(tmp_path / "b.npz", rows)
    assert recognise(tmp_path) == "folder"
    clouds = [frame.cloud() for frame in open_dataset(tmp_path)]
    np.testing.assert_array_equal(clouds[0].points_m, clouds[1].points_m)
    np.testing.assert_array_equal(clouds[0].intensity, clouds[1].intensity)


@pytest.mark.parametrize("name", ["a.las", "a.laz", "a.ply", "a.npz"])
def test_other_content_under_the_name_is_refused(tmp_path: Path, name: str) -> None:
    for content in (b"", b"\0" * 500, b"# .PCD v0.7\n", b"LASF", b"ply\n"):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FarfieldError):
            Cloud.from_file(tmp_path / name)
    (tmp_path / "a.bin").write_bytes(las_bytes([point_1(1, 2, 3)]))
    with pytest.raises(FileFormatError, match="a LAS"):
        Cloud.from_file(tmp_path / "a.bin")
