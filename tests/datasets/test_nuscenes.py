"""The reader of the nuScenes schema, on trees that are written from the published schemas and then damaged."""

import json
import shutil
import struct

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.datasets.formats import DATASETS, find_format
from farfield.datasets.nuscenes.dialects import DIALECTS
from farfield.errors import ConfigError, FarfieldError
from farfield.geometry.boxes import count_points_in_boxes

from .generators.nuscenes_trees import write_nuscenes
from .generators.truth import check_dataset


@pytest.fixture(scope="module")
def trees(tmp_path_factory):
    root = tmp_path_factory.mktemp("schema")
    return {name: (root / name, write_nuscenes(root / name, dialect=name)) for name in DIALECTS}


@pytest.fixture
def tree(trees, tmp_path):
    return shutil.copytree(trees["nuscenes"][0], tmp_path / "tree")


@pytest.fixture
def tables(trees, tmp_path):
    """A tree whose tables are a copy, and whose files lie elsewhere, as on another disk."""
    source = trees["nuscenes"][0]
    shutil.copytree(source / "v1.0-mini", tmp_path / "v1.0-mini")
    for name in ("samples", "sweeps"):
        (tmp_path / name).symlink_to(source / name)
    return tmp_path


def change(root, table, edit):
    path = next(root.rglob(f"{table}.json"))
    rows = json.loads(path.read_text())
    edit(rows)
    path.write_text(json.dumps(rows))


@pytest.mark.parametrize("dialect", DIALECTS)
def test_frames_are_those_that_the_generator_wrote(trees, dialect):
    root, truth = trees[dialect]
    data = open_dataset(root)
    assert data.name == dialect
    check_dataset(data, truth)


@pytest.mark.parametrize("dialect", DIALECTS)
def test_no_other_format_recognises_a_dialect(trees, dialect):
    root = trees[dialect][0]
    assert [name for name in DATASETS.builtin if find_format(name).matches(root)] == [dialect]


def test_official_counts_of_points_are_those_in_the_boxes(trees):
    for frame in open_dataset(trees["nuscenes"][0]):
        counts = count_points_in_boxes(frame.cloud("LIDAR_TOP").points_m, frame.boxes)
        np.testing.assert_allclose(counts, frame.boxes.point_count, atol=1)


def test_a_place_in_utm_keeps_its_digits_whichever_frame_is_first(trees):
    root = trees["truckscenes"][0]
    backwards = open_dataset(root)
    clouds = [backwards[index].cloud().points_m for index in reversed(range(len(backwards)))]
    for index, frame in enumerate(open_dataset(root)):
        assert np.linalg.norm(frame.world_T_frame[:2, 3]) > 1e5
        np.testing.assert_array_equal(frame.cloud().points_m, clouds[-1 - index])


def test_a_pose_is_the_nearest_of_those_that_the_scene_s_records_name(trees):
    data = open_dataset(trees["truckscenes"][0])
    store = data.unwrapped.stores[0]
    times, samples = store["ego_pose"]["timestamp"], store["sample"]
    for scene, sample_us in zip(samples["scene_token"].tolist(), samples["timestamp"].tolist(), strict=True):
        own = store.poses.of(scene)
        assert (np.diff(times[own]) >= 0).all()
        for time_us in (sample_us - 10**7, sample_us, sample_us + 30_001, sample_us + 10**7):
            row = store.pose_at(scene, time_us)
            assert row in own
            assert abs(times[row] - time_us) == np.abs(times[own] - time_us).min()


def test_axes_of_the_map_keep_the_places_of_the_tables(trees):
    root = trees["nuscenes"][0]
    rows = json.loads(next(root.rglob("sample_annotation.json")).read_text())
    place = {row["token"]: row["translation"] for row in rows}
    for frame in open_dataset(root, axes="world"):
        np.testing.assert_array_equal(frame.world_T_frame[:3, :3], np.eye(3))
        world = frame.boxes.centre_m + frame.world_T_frame[:3, 3]
        names = frame.annotation.details["annotation_token"]
        np.testing.assert_allclose(world, [place[name] for name in names], atol=1e-9)


def test_sweeps_before_the_key_frame_come_with_their_age(trees):
    one, three = (open_dataset(trees["nuscenes"][0], sweeps=count) for count in (1, 3))
    lags = [np.unique(frame.cloud("LIDAR_TOP").extra["lag_s"]) for frame in three]
    assert max(map(len, lags)) > 1
    assert all((np.diff(ages) > 0).all() and ages[0] == 0 for ages in lags)
    for before, after in zip(one, three, strict=True):
        key = after.cloud("LIDAR_TOP").extra["lag_s"] == 0
        np.testing.assert_array_equal(after.cloud("LIDAR_TOP").points_m[key], before.cloud("LIDAR_TOP").points_m)


def test_stacked_frames_tell_ages_since_the_present_one(trees):
    from farfield.datasets.maps import Sweeps

    data = open_dataset(trees["nuscenes"][0])
    times = data.drives()[0].times_ns
    frame = data.mapped(Sweeps(2))[1]
    ages = np.unique(frame.cloud("LIDAR_TOP").extra["lag_s"])
    np.testing.assert_allclose(ages, [0, (times[1] - times[0]) / 1e9], atol=1e-6)


def test_sizes_by_the_length_first_are_asked_for_and_taken(tables):
    change(
        tables,
        "sample_annotation",
        lambda rows: [row.update(size=[*row["size"][1::-1], row["size"][2]]) for row in rows],
    )
    data, mended = open_dataset(tables), open_dataset(tables, size_order="lwh")
    assert "--size-order lwh" in data.assumptions[0]
    assert not mended.assumptions
    np.testing.assert_array_equal(data[0].boxes.size_m[:, [1, 0, 2]], mended[0].boxes.size_m)


def test_velocities_of_objects_whose_neighbours_are_far_in_time_are_not_known(tables):
    first = 1_532_402_927_647_951
    change(tables, "sample", lambda rows: [row.update(timestamp=10 * row["timestamp"] - 9 * first) for row in rows])
    data = open_dataset(tables)
    assert all(np.isnan(frame.boxes.velocity_m_s).all() for frame in data)


DAMAGES = {
    "an attribute of no record": ("sample_annotation", lambda rows: rows[2].update(attribute_tokens=["f" * 32])),
    "an object of no record": ("sample_annotation", lambda rows: rows[1].update(instance_token="f" * 32)),
    "a pose of no record": ("sample_data", lambda rows: rows[3].update(ego_pose_token="f" * 32)),
    "a token twice": ("ego_pose", lambda rows: rows[1].update(token=rows[0]["token"])),
    "a circle": (
        "sample",
        lambda rows: (rows[-1].update(next=rows[0]["token"]), rows[0].update(prev=rows[-1]["token"])),
    ),
    "one-sided": ("sample_data", lambda rows: rows[0].update(next="")),
    "itself": ("sample", lambda rows: rows[0].update(next=rows[0]["token"], prev=rows[0]["token"])),
    "a text for a number": ("sample_annotation", lambda rows: rows[0].update(num_lidar_pts="7")),
    "true for a number": ("sample", lambda rows: rows[0].update(timestamp=True)),
    "a number too few": ("ego_pose", lambda rows: rows[0].update(translation=[1.0, 2.0])),
    "NaN": ("ego_pose", lambda rows: rows[0].update(translation=[1.0, float("nan"), 0.0])),
    "beyond the earth": ("sample_annotation", lambda rows: rows[0].update(translation=[1e12, 0.0, 0.0])),
    "a rotation of length 2": ("calibrated_sensor", lambda rows: rows[0].update(rotation=[2.0, 0.0, 0.0, 0.0])),
    "a size of 0": ("sample_annotation", lambda rows: rows[0].update(size=[1.0, 0.0, 1.0])),
    "a count below 0": ("sample_annotation", lambda rows: rows[0].update(num_radar_pts=-1)),
    "seconds": ("sample", lambda rows: rows[0].update(timestamp=-5)),
    "no such key": ("scene", lambda rows: rows[0].pop("first_sample_token")),
    "a list": ("sensor", lambda rows: rows.append([])),
    "a modality of no sensor": ("sensor", lambda rows: rows[0].update(modality="sonar")),
    "a lens of a radar": ("calibrated_sensor", lambda rows: [row.update(camera_intrinsic=[[1, 2, 3]]) for row in rows]),
    "a path that escapes": ("sample_data", lambda rows: [row.update(filename="../../etc/passwd") for row in rows]),
    "an absolute path": ("sample_data", lambda rows: [row.update(filename="/etc/passwd") for row in rows]),
    "a scene's name twice": ("scene", lambda rows: rows[1].update(name=rows[0]["name"])),
    "an object twice": ("sample_annotation", lambda rows: rows[1].update(sample_token=rows[0]["sample_token"])),
    "a file of none": ("sample_data", lambda rows: [row.update(filename="") for row in rows]),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_tables_that_disagree_are_refused_by_name(tables, damage):
    table, edit = DAMAGES[damage]
    change(tables, table, edit)
    with pytest.raises(FarfieldError, match=r"\.json|expected"):
        open_dataset(tables)[0].cloud()


@pytest.mark.parametrize("content", ["", "[", "{}", "[{}", "[1]", "[{]", "[{}]x", "[,]", "[{}{}]", "\xff", "[" * 9000])
def test_what_is_no_table_is_refused(tables, content):
    next(tables.rglob("sensor.json")).write_text(content, encoding="latin-1")
    with pytest.raises(FarfieldError, match=r"sensor\.json"):
        open_dataset(tables)


def test_a_missing_table_is_named(tables):
    next(tables.rglob("visibility.json")).unlink()
    with pytest.raises(FarfieldError, match=r"visibility\.json"):
        open_dataset(tables)


def test_several_versions_have_to_be_named(tables):
    shutil.copytree(tables / "v1.0-mini", tables / "v1.0-own")
    with pytest.raises(ConfigError, match=r"v1\.0-mini, v1\.0-own"):
        open_dataset(tables)
    assert len(open_dataset(tables, version="v1.0-own")) == len(open_dataset(tables, version="v1.0-mini"))


def test_a_count_that_is_not_that_of_the_records_is_noted(tables):
    change(tables, "scene", lambda rows: rows[0].update(nbr_samples=99))
    assert "nbr_samples" in open_dataset(tables).notes[0]


def test_points_of_four_columns_are_told_from_five(trees, tmp_path):
    root = shutil.copytree(trees["t4"][0], tmp_path / "t4")
    whole = open_dataset(root)[0].cloud()
    for path in root.rglob("LIDAR_*/*.bin"):
        rows = np.fromfile(path, np.float32).reshape(-1, 5)[:, :4]
        rows.tofile(path)
    for path in root.rglob("LIDAR_*/*.json"):
        path.unlink()
    change(root, "sample_data", lambda rows: [row.pop("info_filename", None) for row in rows])
    data = open_dataset(root)
    np.testing.assert_array_equal(data[0].cloud().points_m, whole.points_m)
    assert "4 columns" in " ".join(data.assumptions)


def test_four_columns_are_refused_where_the_schema_says_five(tree):
    path = sorted((tree / "samples" / "LIDAR_TOP").iterdir())[0]
    np.fromfile(path, np.float32).reshape(-1, 5)[:20, :4].tofile(path)
    with pytest.raises(FarfieldError, match="column 5"):
        [frame.cloud("LIDAR_TOP") for frame in open_dataset(tree)]


def radar_file(points, *, extra=b"\n"):
    """A radar's file byte by byte: 43 bytes a point, and one byte more behind the last."""
    head = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z dyn_prop id rcs vx vy vx_comp vy_comp "
        "is_quality_valid ambig_state x_rms y_rms invalid_state pdh0 vx_rms vy_rms\n"
        "SIZE 4 4 4 1 2 4 4 4 4 4 1 1 1 1 1 1 1 1\nTYPE F F F I I F F F F F I I I I I I I I\n"
        f"COUNT 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1\nWIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {len(points)}\nDATA binary\n"
    )
    rows = [
        struct.pack("<fffbhfffffbbbbbbbb", x, y, 0, 1, 7, 5.0, vx, vy, vx, vy, 1, 3, 0, 0, 0, 1, 0, 0)
        for x, y, vx, vy in points
    ]
    assert all(len(row) == 43 for row in rows)
    return head.encode() + b"".join(rows) + extra


def test_a_radar_is_read_with_the_byte_behind_it_and_turned(tree):
    path = sorted((tree / "samples" / "RADAR_BACK_LEFT").iterdir())[0]
    path.write_bytes(radar_file([(10.0, 0.0, -2.0, 0.0), (0.0, 5.0, 1.0, 3.0)]))
    data = open_dataset(tree)
    name = path.name
    index = next(i for i in range(len(data)) if any(file.name == name for file in data.files(i)))
    cloud = data[index].cloud("RADAR_BACK_LEFT")
    turn = data[index].sensors["RADAR_BACK_LEFT"].frame_T_sensor[:3, :3]
    np.testing.assert_allclose(cloud.extra["doppler_m_s"], [-2, 3], atol=1e-6)
    velocity = np.stack([cloud.extra[axis] for axis in ("vx", "vy", "vz")], axis=1)
    np.testing.assert_allclose(velocity, np.array([[-2, 0, 0], [1, 3, 0]]) @ turn.T, atol=1e-6)
    assert cloud.kind == "radar"


@pytest.mark.parametrize(
    "content", [radar_file([(1.0, 2.0, 0.0, 0.0)], extra=b"ab"), radar_file([(1.0, 2.0, 0.0, 0.0)])[:-9]]
)
def test_a_radar_of_another_length_is_refused(tree, content):
    path = sorted((tree / "samples" / "RADAR_FRONT").iterdir())[0]
    path.write_bytes(content)
    with pytest.raises(FarfieldError, match="RADAR_FRONT"):
        [frame.cloud("RADAR_FRONT") for frame in open_dataset(tree)]


def test_a_first_point_of_nan_is_an_empty_sweep(tree):
    path = sorted((tree / "samples" / "RADAR_FRONT").iterdir())[0]
    path.write_bytes(radar_file([(np.nan, np.nan, np.nan, np.nan)]))
    assert min(len(frame.cloud("RADAR_FRONT")) for frame in open_dataset(tree)) == 0


def test_scenes_are_split_as_published_and_by_a_file_of_ones_own(tables):
    names = ("scene-0061", "scene-0103")
    change(tables, "scene", lambda rows: [row.update(name=name) for row, name in zip(rows, names, strict=True)])
    data = open_dataset(tables)
    assert set(data.split("train").sequences) == {"scene-0061"}
    assert set(data.split("val").sequences) == {"scene-0103"}
    (tables / "v1.0-mini" / "splits.json").write_text('{"val": ["scene-0061"], "train": ["scene-0103"]}')
    assert set(open_dataset(tables).split("val").sequences) == {"scene-0061"}
