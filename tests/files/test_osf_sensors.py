"""OSF: what metadata say of sensors, where they stand on their carrier and to what their reflectivities count."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from osf_files import (
    COLUMNS,
    METADATA,
    RANGE_MM,
    REFLECTIVITY,
    Fields,
    Structs,
    array,
    buffer,
    opened,
    png,
    recording,
    sweep,
    zpng,
)

from farfield.datasets.osf import Osf
from farfield.errors import FileFormatError

STANDS = np.array([[0.0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])


def extrinsic(pose: np.ndarray, number: int = 3) -> Fields:
    """An entry that says apart from the metadata where sensor 1 stands."""
    content = buffer({0: array(pose, "<f8"), 1: ("I", 1)})
    return {0: ("I", number), 1: "ouster/v1/os_sensor/Extrinsics", 2: content}


@pytest.mark.parametrize("where", ["in its group", "beside the angles", "apart"])
def test_where_the_sensor_stands_on_its_carrier_is_counted_into_the_poses(tmp_path: Path, where: str) -> None:
    poses = np.tile(np.eye(4), (COLUMNS, 1, 1))
    poses[:, :2, :2], poses[:, 0, 3] = [[0, -1], [1, 0]], 5.0  # turned left by a quarter
    written = {"extrinsic": (np.eye(4) if where == "apart" else STANDS).reshape(-1).tolist()}
    metadata = METADATA | (written if where == "beside the angles" else {"ouster-sdk": written})
    further = [extrinsic(STANDS)] if where == "apart" else []
    data = opened(tmp_path, recording([sweep(0, _6=array(poses, "<f8"))], metadata=metadata, further=further))
    pose = data[0].world_T_frame
    assert pose is not None
    np.testing.assert_allclose(pose, [[-1, 0, 0, 3], [0, -1, 0, 1], [0, 0, 1, 3], [0, 0, 0, 1]], atol=1e-12)
    assert any("(1.000, 2.000, 3.000) m on its carrier" in note for note in data.assumptions)
    data = opened(tmp_path, recording([sweep(0)], metadata=metadata, further=further))
    assert data[0].world_T_frame is None
    assert any("there are no poses" in note for note in data.assumptions)


@pytest.mark.parametrize(
    ("written", "further", "part"),
    [
        ([0.0] * 16, [], "extrinsic: expected a rotation"),
        ([1.0] * 15, [], "16 numbers"),
        (np.eye(4).reshape(-1).tolist(), [extrinsic(STANDS), extrinsic(np.eye(4), 4)], "several that differ"),
        (np.eye(4).reshape(-1).tolist(), [extrinsic(np.diag([1.0, 1, -1, 1]))], "expected a rotation"),
    ],
)
def test_extrinsics_that_are_none_are_refused(tmp_path: Path, written: Any, further: Any, part: str) -> None:
    content = recording([sweep(0)], metadata=METADATA | {"ouster-sdk": {"extrinsic": written}}, further=further)
    with pytest.raises(FileFormatError, match=part):
        opened(tmp_path, content)


def test_two_extrinsics_that_differ_are_refused(tmp_path: Path) -> None:
    metadata = METADATA | {
        "extrinsic": STANDS.reshape(-1).tolist(),
        "ouster-sdk": {"extrinsic": np.eye(4).reshape(-1).tolist()},
    }
    with pytest.raises(FileFormatError, match="two that differ"):
        opened(tmp_path, recording([sweep(0)], metadata=metadata))


def stored(
    folder: Path,
    profile: str,
    kind: int,
    values: np.ndarray = REFLECTIVITY,
    *,
    firmware: str = "v2.3.0",
    pack: Any = zpng,
) -> Osf:
    """A recording whose reflectivity is stored in a width."""
    pictures = {1: (3, RANGE_MM), 5: (kind, values)}
    fields = [{0: pack(values.astype(f"u{[0, 1, 2, 4][width]}"))} for width, values in pictures.values()]
    kinds = Structs(2, bytes(byte for name, (width, _) in pictures.items() for byte in (name, width)))
    metadata = METADATA | {"data_format": METADATA["data_format"] | {"udp_profile_lidar": profile}}  # type: ignore[operator]
    content = recording([sweep(0, _0=fields, _1=kinds)], metadata=metadata | {"build_rev": firmware})
    return opened(folder, content)


@pytest.mark.parametrize("pack", [zpng, png])
@pytest.mark.parametrize(
    ("profile", "kind"),
    [
        ("RNG19_RFL8_SIG16_NIR16", 1),
        ("RNG19_RFL8_SIG16_NIR16", 2),
        ("RNG15_RFL8_NIR8", 2),
        ("FIVE_WORD_PIXEL", 2),
        ("LEGACY", 3),
        ("ANOTHER", 1),
    ],
)
def test_the_profile_says_the_full_reflectivity(tmp_path: Path, pack: Any, profile: str, kind: int) -> None:
    cloud = stored(tmp_path, profile, kind, pack=pack)[0].clouds["lidar"]
    assert cloud.intensity is not None
    assert cloud.intensity.max() == REFLECTIVITY[RANGE_MM > 0].max() / 255
    np.testing.assert_allclose(cloud.intensity, cloud.extra["reflectivity"] / 255, rtol=1e-6)


def test_reflectivities_of_early_firmware_are_of_16_bits_or_none(tmp_path: Path) -> None:
    values = REFLECTIVITY.astype(np.uint16) * 257
    cloud = stored(tmp_path, "LEGACY", 3, values, firmware="v1.13.0")[0].clouds["lidar"]
    assert cloud.intensity is not None
    assert cloud.intensity.max() == pytest.approx(values[RANGE_MM > 0].max() / 65535)
    data = stored(tmp_path, "LEGACY", 1, firmware="v2.0.0")
    assert data[0].clouds["lidar"].intensity is None
    assert "reflectivity" not in data[0].clouds["lidar"].extra
    assert any("neither reflectivity nor intensity" in note for note in data.assumptions)


@pytest.mark.parametrize(
    ("profile", "values", "part"),
    [
        ("ANOTHER", REFLECTIVITY, "a profile whose largest reflectivity is known"),
        ("RNG19_RFL16", REFLECTIVITY, "a profile whose largest reflectivity is known"),
        ("RNG15_RFL8_NIR8", REFLECTIVITY.astype(np.uint16) * 2, "reflectivities to 255"),
    ],
)
def test_reflectivities_without_a_full_scale_are_refused(
    tmp_path: Path, profile: str, values: np.ndarray, part: str
) -> None:
    data = stored(tmp_path, profile, 2, values)
    with pytest.raises(FileFormatError, match=part):
        _ = data[0].clouds["lidar"]
