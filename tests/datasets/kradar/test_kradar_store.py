"""The store of radar cells: equal to what the reader makes of the whole files, resumable, verified, with a manifest."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from drive import frame

from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.datasets.convert import convert
from farfield.datasets.kradar import KRadar, KRadarWriter
from farfield.datasets.kradar.products import read_moments, read_polar3d, read_products
from farfield.datasets.kradar.store import (
    PUBLISHED_BYTES,
    TASKS,
    StoreSettings,
    convert_to_store,
    modalities,
    needs,
    verify_store,
)
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.mat import write_mat
from farfield.jobs import JobOptions, Outcome
from farfield.radar.axes import KRADAR_AXES
from farfield.radar.products import doppler_cube, moments, polar3d, sparse_cloud, zyx_cube

NARROW = StoreSettings(region="narrow")


def tensor(rng: np.random.Generator) -> np.ndarray:
    """Noise that is the same in many cells, so that it is drawn fast, and a few strong echoes."""
    whole = np.empty(KRADAR_AXES.shape, dtype=np.float32)
    whole[:] = rng.exponential(8e10, (64, 256, 1, 1))
    whole *= rng.uniform(0.5, 2.0, (1, 1, 37, 107)).astype(np.float32)
    whole[40, 30:60, 18, 50:57] *= 1000
    return whole


def counts(outcome: Outcome) -> tuple[int, int]:
    return outcome.written, outcome.skipped


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frame 1 has a tesseract, 2 a cube, 3 a polar map, 4 none of them."""
    root, rng = tmp_path_factory.mktemp("data"), np.random.default_rng(3)
    whole = tensor(rng)
    contents = {
        1: {"tesseract": whole},
        2: {"cube": zyx_cube(moments(whole).mean_power)},
        3: {"polar3d": polar3d(whole)},
        4: {"sparse": np.abs(rng.normal(0, 30, (50, 4)))},
    }
    writer = KRadarWriter(root, columns=512)
    for number, radar in contents.items():
        writer.write(frame(number, radar=radar))
    writer.finish()
    return root


@pytest.fixture(scope="module")
def store(tree: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("store")
    assert counts(convert_to_store(KRadar(tree), target, NARROW)) == (3, 0)
    return target


def test_a_tesseract_read_in_blocks_gives_the_plain_sums(tree: Path) -> None:
    path = tree / "1" / "radar_tesseract" / "tesseract_00033.mat"
    whole = np.asarray(KRadar(tree)[0].radar["tesseract"])
    found = read_moments(path)
    np.testing.assert_allclose(found.mean_power, whole.mean(0, dtype=np.float64), rtol=1e-6)
    np.testing.assert_allclose(found.mean_power_63, whole[1:].mean(0, dtype=np.float64), rtol=1e-6)
    velocity = KRADAR_AXES.doppler_m_s[1:]
    np.testing.assert_allclose(
        found.velocity_moment, np.tensordot(velocity / 63, whole[1:].astype(np.float64), 1), rtol=1e-5
    )
    np.testing.assert_allclose(read_polar3d(path)[0], whole[1:].mean(0).transpose(0, 2, 1) / 1e13, rtol=1e-5)


def test_all_products_at_once_are_the_single_ones(tree: Path) -> None:
    path = tree / "1" / "radar_tesseract" / "tesseract_00033.mat"
    found, reduced = read_products(path, (0.01, 0.1), over="valid"), read_moments(path)
    np.testing.assert_array_equal(found.polar3d, read_polar3d(path))
    np.testing.assert_array_equal(found.cube, zyx_cube(reduced.mean_power))
    for rate, cloud in found.clouds.items():
        np.testing.assert_array_equal(cloud, sparse_cloud(found.cube, rate, over="valid"))


def test_another_array_is_no_tesseract(tmp_path: Path) -> None:
    write_mat(tmp_path / "a.mat", "arrDREA", np.zeros((64, 256, 37, 106), dtype=np.float32)[:, :1])
    with pytest.raises(FileFormatError, match=r"expected floating-point numbers of shape \(64, 256, 37, 107\)"):
        read_moments(tmp_path / "a.mat")


def test_the_reader_sees_the_same_cloud_with_the_store_alone(tree: Path, store: Path, tmp_path: Path) -> None:
    """From tesseract and cube, with every label and cloud of the source, but none of its tensors."""
    light = tmp_path / "light"
    shutil.copytree(tree, light, ignore=shutil.ignore_patterns("radar_*", "rdr_polar_3d"))
    options = {"reference": "radar", "radar_region": "narrow", "radar_rate": 0.01}
    for index in (0, 1):
        whole, stored = open_dataset(tree, **options)[index], open_dataset(light, roots=[store], **options)[index]
        assert "cells" in stored.radar
        assert not {"tesseract", "cube"} & set(stored.radar)
        one, other = whole.cloud("radar"), stored.cloud("radar")
        assert len(one) > 500
        np.testing.assert_array_equal(one.points_m, other.points_m)
        np.testing.assert_allclose(one.extra["power"], other.extra["power"], rtol=6e-4)
        assert ("doppler_m_s" in other.extra) == (index == 0)  # a cube tells none


def test_cells_have_the_doppler_cubes_velocity(tree: Path, store: Path) -> None:
    cells = KRadar(store)[0].radar["cells"]
    found = moments(np.asarray(KRadar(tree)[0].radar["tesseract"]))
    expected = doppler_cube(found.mean_power_63, found.velocity_moment).ravel()[cells.index]
    np.testing.assert_allclose(cells.doppler_m_s, expected, atol=6e-5)
    power = zyx_cube(found.mean_power).ravel()[cells.index] / 1e13
    np.testing.assert_allclose(cells.power, power, rtol=4e-4)


def test_a_polar_map_stands_in_for_the_tensor(store: Path) -> None:
    """Its mean lacks one of the 64 bins: the cells' powers differ by percents, not more."""
    full, polar = (KRadar(store)[index].radar["cells"] for index in (0, 2))
    np.testing.assert_array_equal(full.index, polar.index)
    np.testing.assert_allclose(np.median(polar.power / full.power), 1.0, atol=0.05)
    np.testing.assert_allclose(polar.doppler_m_s, full.doppler_m_s, atol=2e-4)


def test_conversion_goes_on_mends_and_verifies(tree: Path, store: Path, tmp_path: Path) -> None:
    target, data = tmp_path / "store", KRadar(tree)
    shutil.copytree(store, target)
    assert counts(convert_to_store(data, target, NARROW)) == (0, 3)
    assert verify_store(data, target, NARROW) == []
    broken = target / "radar_cells" / "1" / "cells_00034.h5"
    whole = broken.read_bytes()
    broken.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    assert verify_store(data, target, NARROW) == ["1/00034: damaged or missing: radar_cells/1/cells_00034.h5"]
    left: list[int] = []
    watched = JobOptions(progress=lambda numbers: (left.append(number) or number for number in numbers))
    assert counts(convert_to_store(data, target, NARROW, bulk=watched)) == (1, 2)
    assert left == [0]
    assert broken.read_bytes() == whole
    faults = verify_store(data, target, StoreSettings(region="narrow", rate=0.1))
    assert len(faults) == 3
    assert "with other settings" in faults[0]
    with pytest.raises(DatasetError, match="expected a radar store"):
        verify_store(data, tmp_path, NARROW)


def test_a_lower_rate_makes_smaller_files_with_the_same_strong_cells(tree: Path, store: Path, tmp_path: Path) -> None:
    settings = StoreSettings(region="narrow", rate=0.05)
    convert(KRadar(tree).select([1]), tmp_path, to="radar-store", store=settings)
    files = [root / "radar_cells" / "1" / "cells_00034.h5" for root in (tmp_path, store)]
    assert files[0].stat().st_size < files[1].stat().st_size
    few, all_cells = (
        open_dataset(root, radar_region="narrow")[index].radar["cells"] for root, index in ((tmp_path, 0), (store, 1))
    )
    np.testing.assert_array_equal(few.select("narrow", 0.01).index, all_cells.select("narrow", 0.01).index)


def test_several_workers_and_the_command_write_the_same_store(tree: Path, store: Path, tmp_path: Path, capsys) -> None:
    command = ["convert", str(tree), str(tmp_path), "--to", "radar-store", "--region", "narrow"]
    assert main([*command, "--workers", "2"]) == 0
    assert "3 written, 0 had been written" in capsys.readouterr().out
    for path in store.rglob("*.h5"):
        assert (tmp_path / path.relative_to(store)).read_bytes() == path.read_bytes()
    assert main([*command, "--verify"]) == 0
    assert "intact" in capsys.readouterr().out
    next(tmp_path.rglob("*.h5")).unlink()
    assert main([*command, "--verify"]) == 1
    assert "found 1 that are not" in capsys.readouterr().err


def test_polar_maps_are_written_from_tesseracts_alone(tree: Path, tmp_path: Path) -> None:
    settings = StoreSettings(products=("polar3d",))
    assert counts(convert_to_store(KRadar(tree), tmp_path, settings)) == (1, 0)
    stored = np.asarray(KRadar(tmp_path)[0].radar["polar3d"])
    np.testing.assert_allclose(stored, polar3d(np.asarray(KRadar(tree)[0].radar["tesseract"])), rtol=1e-6, atol=1e-7)


def test_the_manifest_counts_bytes_by_task(tree: Path, store: Path) -> None:
    text = json.loads((store / "radar_store.json").read_text())
    assert text["settings"].startswith("radar-store 1 cells narrow 1.0")
    assert text["store"]["cells"]["files"] == 3
    assert text["store"]["cells"]["bytes"] == sum(path.stat().st_size for path in store.rglob("*.h5"))
    assert text["source"]["tesseract"] == {"files": 1, "bytes": 259_457_224}
    assert {name: text["source"][name]["files"] for name in ("os2-64", "os1-128", "cam-front", "labels")} == {
        "os2-64": 4,
        "os1-128": 4,
        "cam-front": 4,
        "labels": 4,
    }
    rtnh, lidar = (text["tasks"][task] for task in ("train RTNH (sparse radar)", "train a LiDAR baseline"))
    assert rtnh["reads"] == ["cells", "labels"]
    assert rtnh["bytes"] == text["store"]["cells"]["bytes"] + text["source"]["labels"]["bytes"]
    assert lidar["bytes"] == text["source"]["os2-64"]["bytes"] + text["source"]["labels"]["bytes"]
    assert not lidar["missing"]
    assert modalities(KRadar(store)) == {"cells": (3, text["store"]["cells"]["bytes"])}


def test_published_sizes_add_up_to_the_thirteen_terabytes_told() -> None:
    assert sum(PUBLISHED_BYTES.values()) - PUBLISHED_BYTES["polar3d"] == pytest.approx(13e12, rel=0.1)
    bare = needs({})
    assert set(bare) == set(TASKS)
    assert bare["score files of boxes"]["missing"] == ["labels"]
    assert bare["score files of boxes"]["bytes"] == 0
    assert bare["train a LiDAR baseline"]["published_bytes_about"] == pytest.approx(0.2e12, rel=0.1)


@pytest.mark.parametrize("options", [{"products": ()}, {"products": ("cube",)}, {"rate": 0.07}, {"region": "here"}])
def test_impossible_settings_are_refused(options: dict) -> None:
    with pytest.raises(ConfigError, match="radar"):
        StoreSettings(**options)


def test_nothing_to_convert_is_an_error(tree: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="expected frames with radar_tesseract"):
        convert_to_store(KRadar(tree).select([3]), tmp_path)
    (tmp_path / "other").mkdir()
    np.save(tmp_path / "other" / "a.npy", np.zeros((3, 4), dtype=np.float32))
    with pytest.raises(DatasetError, match="expected K-Radar"):
        convert(open_dataset(tmp_path / "other"), tmp_path / "store", to="radar-store")


def test_a_damaged_source_is_named(tree: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(tree, copy, ignore=shutil.ignore_patterns("radar_tesseract"))
    cube = copy / "1" / "radar_zyx_cube" / "cube_00034.mat"
    cube.write_bytes(cube.read_bytes()[:1000])
    with pytest.raises(FileFormatError, match="cube_00034"):
        convert_to_store(KRadar(copy), tmp_path / "store", NARROW)


def test_verify_is_for_what_was_converted(tree: Path, tmp_path: Path, capsys) -> None:
    assert main(["convert", str(tree), str(tmp_path), "--to", "kitti", "--verify"]) == 1
    assert "wrote, found no .farfield_convert.jsonl" in capsys.readouterr().err
    assert main(["convert", str(tree), "--to", "radar-store", "--verify"]) == 1
    assert "expected the folder that was written" in capsys.readouterr().err


def test_a_set_on_several_disks_is_converted_whole(tree: Path, tmp_path: Path, capsys) -> None:
    """Labels under one root, cubes under another."""
    labels, radar = tmp_path / "labels", tmp_path / "radar"
    shutil.copytree(tree, labels, ignore=shutil.ignore_patterns("radar_*", "rdr_polar_3d", "os*", "cam-*"))
    (radar / "1").mkdir(parents=True)
    (radar / "1" / "radar_zyx_cube").symlink_to(tree / "1" / "radar_zyx_cube")
    command = ["convert", str(labels), str(tmp_path / "store"), "--to", "radar-store", "--roots", str(radar)]
    assert main([*command, "--region", "narrow", "--rate", "0.1"]) == 0
    assert "1 written" in capsys.readouterr().out
    thin = open_dataset(labels, roots=[tmp_path / "store"], radar_rate=0.01, reference="radar")
    assert len(thin[1].cloud("radar")) > 100
