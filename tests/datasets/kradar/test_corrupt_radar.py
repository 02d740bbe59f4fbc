"""NaN, infinite and negative power is refused by every reader of a radar's products: it never becomes a finite cell."""

from pathlib import Path

import numpy as np
import pytest

from farfield.datasets.kradar.products import (
    CUBE_SHAPE,
    POLAR_SHAPE,
    TESSERACT_SHAPE,
    read_moments,
    read_radar,
    write_radar,
)
from farfield.errors import ConfigError, FileFormatError
from farfield.radar.cells import cells_of_cube

WRONG = [np.nan, np.inf, -np.inf, -3.0]
SHAPES = {
    "cube": CUBE_SHAPE,
    "polar3d": POLAR_SHAPE,
    "sparse": (50, 4),
    "corridor": (50, 5),
    "polar_cloud": (50, 11),
    "polar_cloud_5p": (50, 5),
    "polar_cloud_30p": (50, 5),
}


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("product", SHAPES)
def test_power_that_cannot_be_is_refused(product: str, wrong: float, tmp_path: Path) -> None:
    values = np.ones(SHAPES[product], np.float32)
    if product == "cube":
        values[:10] = -1  # outside the field of view
    path = tmp_path / ("a.mat" if product == "cube" else "a.npy")
    write_radar(path, product, values)
    assert np.asarray(read_radar(path, product)).shape == SHAPES[product]
    place = {"cube": (75, 200, 100), "polar3d": (0, 3, 4, 5)}.get(product, (7, 3))
    values[place] = wrong
    write_radar(path, product, values)
    with pytest.raises(FileFormatError, match=r"finite power.*1 cell"):
        read_radar(path, product)


@pytest.mark.parametrize("wrong", WRONG)
def test_a_tensor_that_is_read_through_is_refused(wrong: float, tmp_path: Path) -> None:
    tensor = np.ones(TESSERACT_SHAPE, np.float32)
    tensor[3, 4, 5, 6] = wrong
    write_radar(tmp_path / "a.mat", "tesseract", tensor)
    for read in (read_moments, lambda path: read_radar(path, "tesseract")):
        with pytest.raises(FileFormatError, match="finite power"):
            read(tmp_path / "a.mat")


@pytest.mark.parametrize("wrong", WRONG)
def test_a_cube_in_memory_is_refused(wrong: float) -> None:
    cube = np.ones(CUBE_SHAPE, np.float32)
    cube[75, 200, 100] = wrong
    with pytest.raises(ConfigError, match="finite power"):
        cells_of_cube(cube)


def test_doppler_that_is_not_finite_is_refused(tmp_path: Path) -> None:
    for product, place in (("polar3d", (1, 3, 4, 5)), ("corridor", (7, 4)), ("sparse", (7, 0))):
        values = np.ones(SHAPES[product], np.float32)
        values[place] = np.nan
        write_radar(tmp_path / "a.npy", product, values)
        with pytest.raises(FileFormatError, match="finite"):
            read_radar(tmp_path / "a.npy", product)


def test_disks_of_the_authors_and_every_density_open(tmp_path: Path) -> None:
    from farfield.datasets import open_dataset

    for disk, sequence, density in (("dir_1to20", "1", "5p"), ("dir_21to37", "21", "30p")):
        folder = tmp_path / disk / f"pc{density}" / sequence
        folder.mkdir(parents=True)
        write_radar(folder / "rpc_00033.npy", f"polar_cloud_{density}", np.ones((50, 5), np.float32))
    data = open_dataset(tmp_path)
    assert (data.name, data.sequences) == ("kradar", ("1", "21"))
    assert [len(cloud) for frame in data for cloud in frame.radar.values()] == [50, 50]
