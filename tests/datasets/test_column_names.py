"""Names that a user gives the columns of files that name none."""

from pathlib import Path

import numpy as np
import pytest

import farfield as ff
from farfield.cli import main
from farfield.datasets.memory import CloudFiles
from farfield.errors import ConfigError, FarfieldError

NAMES = ("x", "y", "z", "time", "Reflectivity")


def rows() -> np.ndarray:
    rng = np.random.default_rng(4)
    times_s = np.linspace(0, 0.1, 500)
    points_m = rng.uniform(1, 60, (500, 3)) * [1, 1, 0.05]
    return np.column_stack([points_m, times_s, rng.uniform(0, 1, 500)]).astype(np.float32)


@pytest.mark.parametrize("suffix", ["bin", "npy", "xyz"])
def test_columns_bear_the_names_that_are_given(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"0.{suffix}"
    if suffix == "bin":
        rows().tofile(path)
    elif suffix == "npy":
        np.save(path, rows())
    else:
        np.savetxt(path, rows(), fmt="%.9g")
    unnamed = ff.open_dataset(tmp_path)[0].cloud()
    assert unnamed.columns[4] != "time"
    for data in (ff.open_dataset(tmp_path, column_names=NAMES), CloudFiles([path], column_names=NAMES)):
        cloud = data[0].cloud()
        np.testing.assert_allclose(cloud.intensity, rows()[:, 4], atol=1e-6)
        assert np.ptp(cloud.extra["offset_ns"]) == pytest.approx(1e8, abs=1e3)


@pytest.mark.parametrize("words", ["x,y,z", "x,y,z,time,ring,intensity"])
def test_rows_with_other_columns_are_refused(words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.save(tmp_path / "0.npy", rows())
    assert main(["stats", str(tmp_path), "--columns", words]) == 1
    assert f"expected {words.count(',') + 1} columns, as --columns names them" in capsys.readouterr().err
    main(["doctor", str(tmp_path), "--columns", ",".join(NAMES)])
    assert "(x, y, z, intensity, offset_ns)" in capsys.readouterr().out


@pytest.mark.parametrize(
    "names", [("x", "y", "intensity"), ("x", "y", "z", "z"), ("x", "y", "z", "a b"), ("x", "X", "y", "z")]
)
def test_what_cannot_be_names_is_refused(names: tuple[str, ...], tmp_path: Path) -> None:
    np.save(tmp_path / "0.npy", rows())
    with pytest.raises(ConfigError, match="expected names such as x,y,z,intensity,time"):
        ff.open_dataset(tmp_path, column_names=names)


def test_a_format_that_names_its_columns_says_so(tmp_path: Path) -> None:
    (tmp_path / "training" / "velodyne").mkdir(parents=True)
    rows()[:, :4].tofile(tmp_path / "training" / "velodyne" / "000000.bin")
    with pytest.raises(FarfieldError, match=r"column_names.*its format names its columns"):
        ff.open_dataset(tmp_path, column_names=NAMES)


def test_columns_in_another_order_share_one_scale(tmp_path: Path) -> None:
    """Two sweeps of full scale 255, the second of values 0 and 1 alone, with a stamp before x."""
    for number, brightest in enumerate((255, 1)):
        own = rows()
        strength = np.round(own[:, 4] * brightest)
        stamps_ns = 1.7e18 + np.arange(len(own)) * 2e5
        np.save(tmp_path / f"{number}.npy", np.column_stack([stamps_ns, own[:, :3].astype(float), strength]))
    data = ff.open_dataset(tmp_path, column_names=("timestamp", "x", "y", "z", "intensity"))
    np.testing.assert_allclose(data[0].cloud().points_m, rows()[:, :3])
    assert data[0].cloud().intensity.max() == pytest.approx(1.0, abs=0.01)
    assert data[1].cloud().intensity.max() == pytest.approx(1 / 255)
