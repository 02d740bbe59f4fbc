"""One scale of intensities and one unit of times for all clouds of a data set, under every name that fields have."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.datasets.memory import CloudFiles
from farfield.errors import ConfigError, FileFormatError
from farfield.files.clouds import write_cache
from farfield.files.intensities import intensity_scale_of
from farfield.files.pcd import write_pcd
from farfield.frame.cloud import read_cloud

START_NS, TURN_NS, POINTS = 1_700_000_000_123_456_789, 100_000_000, 400
LAYOUTS = ("folder", "files", "sustechpoints", "supervisely")


def places(points: int = POINTS) -> dict[str, np.ndarray]:
    random = np.random.default_rng(0)
    return {axis: random.uniform(1, 50, points).astype(np.float32) for axis in "xyz"}


def strong(largest: float) -> np.ndarray:
    return np.linspace(0, largest, POINTS).astype(np.float32)


def opened(layout: str, root: Path, clouds: dict[str, dict[str, np.ndarray]], **options):
    """Clouds by stem in a layout of own data."""
    folder = {"sustechpoints": "lidar", "supervisely": "pointcloud"}.get(layout, "")
    (root / folder).mkdir(parents=True, exist_ok=True)
    for stem, columns in clouds.items():
        write_pcd(root / folder / f"{stem}.pcd", columns)
    if layout == "sustechpoints":
        (root / "label").mkdir(exist_ok=True)
    if layout == "supervisely":
        (root / "ann").mkdir(exist_ok=True)
        (root / "ann" / "0.pcd.json").write_text('{"figures": [], "objects": []}')
    if layout == "files":
        return CloudFiles(sorted(root.glob("*.pcd")), **options)
    return open_dataset(root, **options)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_one_outlier_does_not_darken_its_sweep(layout: str, tmp_path: Path) -> None:
    """The sweep before it stays what it is; the one that holds it is refused, or read by the scale that is given."""
    beyond = strong(0.9)
    beyond[7] = 1.05
    clouds = {"0": places() | {"intensity": strong(0.9)}, "1": places() | {"intensity": beyond}}
    data = opened(layout, tmp_path, clouds)
    assert data[0].cloud().column("intensity").max() == pytest.approx(0.9)
    with pytest.raises(FileFormatError, match=r"0 to 1\b.*--intensity-scale 1\.05"):
        data[1].cloud()
    data = opened(layout, tmp_path, clouds, intensity_scale=1.05)
    for frame in data:
        assert np.median(frame.cloud().column("intensity")) == pytest.approx(0.45 / 1.05, rel=1e-2)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_dark_and_bright_sweeps_share_a_scale(layout: str, tmp_path: Path) -> None:
    clouds = {"0": places() | {"intensity": strong(0.9)}, "1": places() | {"intensity": strong(200)}}
    found = [frame.cloud().column("intensity").max() for frame in opened(layout, tmp_path, clouds)]
    np.testing.assert_allclose(found, [0.9 / 255, 200 / 255], rtol=1e-5)


@pytest.mark.parametrize("name", ["reflectivity", "Intensity", "i", "intensities", "INTENSITY", "reflectance"])
@pytest.mark.parametrize("suffix", [".pcd", ".ffcloud"])
def test_the_usual_names_are_read(name: str, suffix: str, tmp_path: Path) -> None:
    write = write_pcd if suffix == ".pcd" else write_cache
    write(tmp_path / f"a{suffix}", places() | {name: strong(0.8)})
    cloud = open_dataset(tmp_path)[0].cloud()
    np.testing.assert_allclose(cloud.column("intensity"), strong(0.8), atol=1e-6)
    assert not cloud.extra


def test_upper_case_axes_are_axes(tmp_path: Path) -> None:
    write_pcd(tmp_path / "a.pcd", {name.upper(): column for name, column in places().items()})
    assert len(read_cloud(tmp_path / "a.pcd")) == POINTS


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_fields_of_several_numbers(encoding: str, tmp_path: Path) -> None:
    three = np.arange(3 * POINTS, dtype=np.float32).reshape(-1, 3)
    write_pcd(tmp_path / "a.pcd", places() | {"normal": three}, encoding=encoding)
    cloud = read_cloud(tmp_path / "a.pcd")
    np.testing.assert_array_equal(cloud.extra["normal_1"], three[:, 1])
    assert cloud[:3].extra["normal_2"].shape == (3,)
    write_pcd(tmp_path / "a.pcd", places() | {"intensity": three[:, :2]}, encoding=encoding)
    with pytest.raises(FileFormatError, match="COUNT 1"):
        read_cloud(tmp_path / "a.pcd")


def test_the_scale_of_a_data_set() -> None:
    assert intensity_scale_of([]) == 1
    assert intensity_scale_of([np.array([0, 1], np.uint8)]) == 255
    assert intensity_scale_of([np.arange(256, dtype=np.uint16)]) == 255
    assert intensity_scale_of([np.arange(3_000, dtype=np.uint16)]) == 65535
    signal = np.r_[np.arange(250.0).repeat(100), 4_000.0]  # photon counts: whole numbers, few of them large
    assert intensity_scale_of([signal]) == 65535
    assert intensity_scale_of([np.r_[np.linspace(0, 1, 1_000), 80.0]]) == 1
    assert intensity_scale_of([np.array([1e5, 3.0])]) == 1e5
    with pytest.raises(ConfigError, match="positive"):
        CloudFiles([], intensity_scale=-1)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_points_times_become_offsets(layout: str, tmp_path: Path) -> None:
    """Milliseconds since the stamp and seconds since 1970, in sweeps that are named by their time."""
    turn = np.linspace(0, 100, POINTS)
    for name, values in (("t", turn.astype(np.float32)), ("timestamp", START_NS / 1e9 + turn / 1e3)):
        clouds = {str(START_NS + k * TURN_NS): places() | {name: values + (k * 0.1 if k and name != "t" else 0)}
                  for k in range(3)}  # fmt: skip
        shutil.rmtree(tmp_path, ignore_errors=True)
        if layout == "supervisely":
            clouds = {"0": clouds.pop(str(START_NS)), **clouds}
        for frame in opened(layout, tmp_path, clouds):
            offsets = frame.cloud().extra["offset_ns"]
            assert offsets.dtype == np.int64
            np.testing.assert_allclose(offsets, turn * 1e6, atol=500)


def test_times_that_cannot_be_told_are_refused_until_the_flag(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clouds = {"0": places() | {"intensity": strong(0.5), "time": np.linspace(0, 1, POINTS)}}
    data = opened("folder", tmp_path / "own", clouds)
    with pytest.raises(FileFormatError, match="--point-times s, ms, us or ns, or none"):
        data[0].cloud()
    words = ["convert", str(tmp_path / "own"), str(tmp_path / "kitti"), "--to", "kitti"]
    assert main(words) != 0
    assert "--point-times" in "".join(capsys.readouterr())
    assert main([*words, "--point-times", "none"]) == 0
    assert opened("folder", tmp_path / "own", clouds, point_times="none")[0].cloud().columns[-1] == "time"


def test_a_real_sweep_of_a_velodyne_has_offsets(shared_real: Path) -> None:
    offsets = read_cloud(shared_real / "pcd" / "radar2lidar" / "lidar.pcd").extra["offset_ns"]
    assert (offsets.min(), 90_000_000 < offsets.max() < 110_000_000) == (0, True)
