"""Cells of a cube: against the published sparse cloud's own definition, and through the file and back."""

from pathlib import Path

import numpy as np
import pytest

from farfield.errors import ConfigError, FileFormatError
from farfield.files.radar_cells import read_radar_cells, write_radar_cells
from farfield.radar.axes import KRADAR_AXES
from farfield.radar.cells import RATES, REGIONS, RadarRegion, cells_of_cube
from farfield.radar.products import sparse_cloud, zyx_cube


@pytest.fixture(scope="module")
def cube() -> np.ndarray:
    """Exponential noise with a strong cell, on K-Radar's grid."""
    rng = np.random.default_rng(3)
    power = (rng.exponential(10**10.9, KRADAR_AXES.shape[1:])).astype(np.float32)
    power[80, 18, 50] = 3e14
    return zyx_cube(power)


@pytest.mark.parametrize("over", ["all", "valid"])
@pytest.mark.parametrize("rate", [0.01, 0.1])
def test_a_rate_keeps_the_points_of_the_published_cloud(cube: np.ndarray, rate: float, over: str) -> None:
    """The same quantile of the whole cube, then the region; a code's width (0.06 %) may take the weakest of them."""
    region = REGIONS["wide"]
    points = sparse_cloud(cube, rate, over=over)
    low, high = (np.array([axis[end] for axis in (region.x_m, region.y_m, region.z_m)]) for end in (0, 1))
    expected = points[((points[:, :3] >= low) & (points[:, :3] < high)).all(axis=1)]
    chosen = cells_of_cube(cube, "wide").select("wide", rate, over=over)
    assert len(expected) * 0.998 - 2 <= len(chosen) <= len(expected)
    ours = {tuple(row) for row in np.round(chosen.points_m(), 3).tolist()}
    theirs = {tuple(row) for row in np.round(expected[:, :3], 3).tolist()}
    assert ours <= theirs
    strongest = chosen.points_m()[chosen.power.argmax()]
    np.testing.assert_allclose(strongest, expected[expected[:, 3].argmax(), :3], atol=1e-5)
    assert chosen.power.max() == pytest.approx(expected[:, 3].max(), rel=4e-4)


def test_a_rate_over_the_region_keeps_the_points_of_the_published_corridor(cube: np.ndarray) -> None:
    """Benchmark v1.0: the corridor is cut out first and counts its own quantile, cells without a view included.

    Cells of one code (0.06 % of power) stay or go together.
    """
    part = cube[REGIONS["narrow"].slices()]
    expected = np.sort(part[part > np.quantile(part, 0.9)])
    assert REGIONS["narrow"].cells == part.size
    for kept in ("wide", "narrow"):
        chosen = cells_of_cube(cube, kept).select("narrow", 0.1, over="region")
        assert len(expected) * 0.998 <= len(chosen) <= len(expected)
        np.testing.assert_allclose(np.sort(chosen.power), expected[-len(chosen) :] / 1e13, rtol=4e-4)
    assert len(cells_of_cube(cube, "narrow").select("narrow", 0.1)) > 1.5 * len(expected)
    thinned = cells_of_cube(cube, "narrow").select("narrow", 0.3, over="region")
    assert np.array_equal(thinned.select("narrow", 0.1, over="region").index, chosen.index)


def test_all_cells_of_a_region_are_those_in_the_field_of_view(cube: np.ndarray) -> None:
    cells = cells_of_cube(cube, "cube").select("narrow")
    part = cube[REGIONS["narrow"].slices()]
    assert part.shape == (20, 32, 180)
    assert len(cells) == np.count_nonzero(part > -1)
    np.testing.assert_allclose(cells.power, part[part > -1] / 1e13, rtol=4e-4)
    assert np.all(np.diff(cells.index) > 0)


def test_regions_lie_inside_each_other(cube: np.ndarray) -> None:
    wide = cells_of_cube(cube, "wide")
    assert np.array_equal(wide.select("narrow", 0.1).index, cells_of_cube(cube, "narrow").select("narrow", 0.1).index)


def test_a_cell_that_is_outside_the_field_of_view_never_counts(cube: np.ndarray) -> None:
    """Half of the cube's cells lie outside: a rate of 0.5 or more of all keeps every valid one, or nearly."""
    cells = cells_of_cube(cube, "wide")
    assert len(cells.select("wide", 0.5, over="all")) >= 0.95 * len(cells)
    assert len(cells.select("wide", 0.5, over="valid")) < 0.6 * len(cells)


@pytest.mark.parametrize("with_doppler", [True, False])
def test_cells_survive_the_file(cube: np.ndarray, tmp_path: Path, with_doppler: bool) -> None:
    rng = np.random.default_rng(0)
    doppler = rng.uniform(-1.93, 1.87, cube.shape).astype(np.float32) if with_doppler else None
    cells = cells_of_cube(cube, "narrow", doppler_m_s=doppler)
    columns = {"index": cells.index, "code": cells.code, "quantiles": cells.quantiles, "doppler": cells.doppler}
    write_radar_cells(tmp_path / "a.h5", **columns)
    write_radar_cells(tmp_path / "b.h5", **columns)
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    back = read_radar_cells(tmp_path / "a.h5")
    assert set(back) == {name for name, values in columns.items() if values is not None}
    for name, values in back.items():
        np.testing.assert_array_equal(values, columns[name])
    if doppler is not None:
        assert cells.doppler_m_s == pytest.approx(doppler.ravel()[cells.index], abs=5.1e-5)


def test_no_cells_survive_the_file(cube: np.ndarray, tmp_path: Path) -> None:
    empty = cells_of_cube(np.full_like(cube, -1), "narrow")
    assert len(empty) == 0
    write_radar_cells(tmp_path / "a.h5", index=empty.index, code=empty.code, quantiles=empty.quantiles)
    assert len(read_radar_cells(tmp_path / "a.h5")["index"]) == 0


def test_every_damage_is_told(cube: np.ndarray, tmp_path: Path) -> None:
    cells = cells_of_cube(cube, "narrow").select("narrow", 0.01)
    path = tmp_path / "a.h5"
    write_radar_cells(path, index=cells.index, code=cells.code, quantiles=cells.quantiles)
    whole, rng = path.read_bytes(), np.random.default_rng(0)
    for _ in range(50):
        damaged = bytearray(whole)
        damaged[rng.integers(len(whole))] ^= int(rng.integers(1, 256))
        path.write_bytes(bytes(damaged[: rng.integers(1, len(whole))]) if rng.random() < 0.3 else bytes(damaged))
        if path.read_bytes()[:90] == whole[:90] and path.read_bytes()[512:] == whole[512:]:
            continue  # what stands between the checksum and the data means nothing
        with pytest.raises(FileFormatError):
            read_radar_cells(path)


def test_wrong_settings_are_told(cube: np.ndarray) -> None:
    cells = cells_of_cube(cube, "narrow")
    with pytest.raises(ConfigError, match="expected 1 or one of"):
        cells.select("narrow", 0.07)
    with pytest.raises(ConfigError, match="narrow, wide, cube"):
        cells.select("corridor")
    with pytest.raises(ConfigError, match="rising"):
        RadarRegion((1, 0), (0, 1), (0, 1))
    with pytest.raises(ConfigError, match="found none"):
        RadarRegion((500, 501), (0, 1), (0, 1)).slices()
    assert tuple(sorted(RATES)) == RATES


def test_quantiles_are_those_of_all_codes_at_once(cube: np.ndarray) -> None:
    cells, valid = cells_of_cube(cube, "cube"), cube[cube > -1]
    code = np.sort(cells.code)[::-1]
    assert len(code) == len(valid)
    for row, count in enumerate((cube.size, len(valid))):
        for rate, quantile in zip(RATES, cells.quantiles[row], strict=True):
            most = int(rate * count)
            above = int(np.count_nonzero(code > quantile))
            assert above <= most or quantile == -1
            assert quantile <= 0 or np.count_nonzero(code > quantile - 1) > most
