"""The radar's cloud and its frame: the same points from every product, everything moved alike."""

from pathlib import Path

import numpy as np
import pytest
from drive import frame

from farfield.datasets import open_dataset
from farfield.datasets.kradar import KRadar, KRadarWriter
from farfield.errors import ConfigError
from farfield.radar.axes import KRADAR_AXES
from farfield.radar.cells import cells_of_cube
from farfield.radar.products import polar3d_from_moments, zyx_cube
from farfield.vocabulary.kradar import KRADAR_ORIGIN_M


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three frames; the first has its cells, the second its cube, the third its polar map."""
    rng = np.random.default_rng(5)
    power = rng.exponential(10**10.9, KRADAR_AXES.shape[1:]).astype(np.float32)
    power[60, 18, 53] = 2e14  # 27.8 m straight ahead
    cube = zyx_cube(power)
    polar = polar3d_from_moments(power, power * np.float32(0.5))
    products = ({"cells": cells_of_cube(cube, "wide")}, {"cube": cube}, {"polar3d": polar})
    root = tmp_path_factory.mktemp("kradar")
    writer = KRadarWriter(root)
    for number, radar in enumerate(products, start=1):
        writer.write(frame(number, radar=radar))
    writer.finish()
    return root


def test_cells_and_cube_give_the_same_points(root: Path) -> None:
    data = open_dataset(root, format="kradar", reference="radar", radar_rate=0.01, radar_region="narrow")
    cells, cube = data[0].clouds["radar"], data[1].clouds["radar"]
    assert len(cells) > 100
    np.testing.assert_array_equal(cells.points_m, cube.points_m)
    np.testing.assert_array_equal(cells.extra["power"], cube.extra["power"])


@pytest.mark.parametrize("index", [0, 1, 2])
def test_the_strongest_point_is_the_target(root: Path, index: int) -> None:
    view = {"reference": "radar", "radar_rate": 0.01, "radar_region": "narrow"}
    cloud = open_dataset(root, format="kradar", **view)[index].clouds["radar"]
    np.testing.assert_allclose(cloud.points_m[cloud.extra["power"].argmax()], [27.77, 0.0, 0.0], atol=0.45)
    assert 10 < cloud.extra["power"].max() <= 20.01  # a node of the Cartesian grid lies beside the polar cell
    assert ("doppler_m_s" in cloud.extra) == (index == 2)


def test_a_share_of_the_region_is_the_same_from_every_product(root: Path) -> None:
    """A tenth of the corridor's cells, and of the polar cells that lie in it."""
    options = {"reference": "radar", "radar_region": "narrow", "radar_over": "region"}
    cells, cube, polar = (
        frame.clouds["radar"] for frame in open_dataset(root, format="kradar", radar_rate=0.1, **options)
    )
    assert len(cells) == pytest.approx(20 * 32 * 180 * 0.1, rel=1e-3)
    np.testing.assert_array_equal(cells.points_m, cube.points_m)
    every = open_dataset(root, format="kradar", radar_rate=1, **options)[2].clouds["radar"]
    assert len(polar) == pytest.approx(0.1 * len(every), abs=2)
    assert polar.extra["power"].min() >= np.sort(every.extra["power"])[-len(polar)]


def test_a_frame_is_moved_as_a_whole(root: Path) -> None:
    ours, theirs = KRadar(root)[0], open_dataset(root, format="kradar", reference="radar")[0]
    origin = np.array(KRADAR_ORIGIN_M)
    assert (ours.reference, theirs.reference) == ("os2-64", "radar")
    np.testing.assert_allclose(theirs.boxes.centre_m, ours.boxes.centre_m - origin, atol=1e-12)
    for name in ("os2-64", "radar"):
        np.testing.assert_allclose(theirs.clouds[name].points_m, ours.clouds[name].points_m - origin, atol=2e-5)
    np.testing.assert_array_equal(theirs.clouds["os1-128"].points_m, ours.clouds["os1-128"].points_m)
    point = np.append(ours.boxes.centre_m[0], 1.0)
    for name, camera in ours.cameras.items():
        moved = theirs.cameras[name].camera_T_lidar @ np.append(theirs.boxes.centre_m[0], 1.0)
        np.testing.assert_allclose(moved, camera.camera_T_lidar @ point, atol=1e-9)
    np.testing.assert_allclose(theirs.world_T_frame[:3, 3], (ours.world_T_frame @ np.append(origin, 1.0))[:3])


def test_wrong_settings_of_the_radar_are_told(root: Path) -> None:
    for options, told in (
        ({"reference": "camera"}, "os2-64 or radar"),
        ({"radar_rate": 0.4}, "radar_rate"),
        ({"radar_region": "corridor"}, "narrow, wide, cube"),
        ({"radar_over": "some"}, "all, valid, region"),
    ):
        with pytest.raises(ConfigError, match=told):
            open_dataset(root, format="kradar", **options)


@pytest.mark.parametrize(
    ("product", "columns"), [("sparse_1p", 4), ("corridor", 5), ("polar_cloud", 11), ("polar_cloud_1p", 5)]
)
def test_every_published_cloud_is_read(tmp_path: Path, product: str, columns: int) -> None:
    rng = np.random.default_rng(2)
    points = np.column_stack([rng.uniform(0, 72, 40), rng.uniform(-30, 30, (40, 2)), rng.random((40, columns - 3))])
    writer = KRadarWriter(tmp_path)
    writer.write(frame(1, radar={product: points}))
    writer.finish()
    back = open_dataset(tmp_path, format="kradar", reference="radar", radar_region="cube")[0]
    np.testing.assert_array_equal(back.radar[product], points)
    np.testing.assert_allclose(back.clouds["radar"].points_m, points[:, :3], rtol=1e-6)
    np.testing.assert_allclose(back.clouds["radar"].extra["power"], points[:, 3], rtol=1e-6)
    assert ("doppler_m_s" in back.clouds["radar"].extra) == (columns > 4)


def test_of_two_clouds_that_of_the_rate_is_taken(tmp_path: Path) -> None:
    thick, thin = np.full((3, 4), 5.0), np.full((1, 4), 5.0)
    writer = KRadarWriter(tmp_path)
    writer.write(frame(1, radar={"sparse": thick, "sparse_1p": thin}))
    writer.finish()
    assert len(open_dataset(tmp_path, format="kradar", radar_rate=0.1)[0].clouds["radar"]) == 3
    assert len(open_dataset(tmp_path, format="kradar", radar_rate=0.01)[0].clouds["radar"]) == 1


def test_the_corridor_is_the_cloud_of_the_region(tmp_path: Path) -> None:
    writer = KRadarWriter(tmp_path)
    writer.write(frame(1, radar={"sparse": np.full((3, 4), 5.0), "corridor": np.full((2, 4), 5.0)}))
    writer.finish()
    assert len(open_dataset(tmp_path, format="kradar", radar_region="narrow")[0].clouds["radar"]) == 3
    assert (
        len(open_dataset(tmp_path, format="kradar", radar_region="narrow", radar_over="region")[0].clouds["radar"]) == 2
    )
