"""Real files whose suffixes are in upper case, as cameras and Windows write them, are the same data set."""

from pathlib import Path

import numpy as np
import pytest

from farfield.datasets import open_dataset

SUFFIXES = (".bin", ".pcd", ".xyz", ".jpg", ".png", ".npy", ".mat")
HEADER = "* idx(tesseract_os2-64_cam-front_os1-128_cam-lrr)=00001_00001_00001_00001_00001, timestamp=1643292946.71\n"
SETS = {  # folder of the shared files, and what else bears a frame's name
    "cirrus_layout": (".json",),
    "kitti": (),
    "kitti_raw": (),
    "kradar": (),
    "radiate": (".csv",),
    "view_of_delft": (),
    "argoverse2": (),
    "tj4dradset": (),
    "astyx": (),
    "sustechpoints": (),
}


@pytest.mark.parametrize("name", SETS)
def test_the_same_with_suffixes_in_upper_case(name: str, shared_real: Path, tmp_path: Path) -> None:
    root = next((path for path in _roots(shared_real / name) if _opens(path)), None)
    if root is None:
        pytest.skip("no such files")
    for path in root.rglob("*"):
        if path.is_file():
            numbered = path.stem[:1].isdigit() or path.stem[-1:].isdigit()
            upper = path.suffix in (*SUFFIXES, *SETS[name]) and numbered
            upper |= path.suffix == ".feather" and path.stem.isdigit()
            copy = tmp_path / path.relative_to(root)
            copy.parent.mkdir(parents=True, exist_ok=True)
            (copy.with_suffix(path.suffix.upper()) if upper else copy).symlink_to(path)
    mine, theirs = open_dataset(tmp_path), open_dataset(root)
    assert mine.unwrapped.name == theirs.unwrapped.name
    assert mine.frame_ids == theirs.frame_ids
    frame, other = mine[0], theirs[0]
    assert (set(frame.clouds), set(frame.images), set(frame.radar)) == (
        set(other.clouds),
        set(other.images),
        set(other.radar),
    )
    for cloud in other.clouds:
        np.testing.assert_array_equal(frame.clouds[cloud].points_m, other.clouds[cloud].points_m)
    assert (frame.annotation is None) == (other.annotation is None)


def test_kradars_files(tmp_path: Path) -> None:
    root = tmp_path / "1"
    for name in ("os2-64/os2-64_00001.PCD", "cam-front/cam-front_00001.PNG", "info_label/00001_00001.TXT"):
        (root / name).parent.mkdir(parents=True)
        (root / name).write_text(HEADER)
    data = open_dataset(tmp_path)
    assert (data.unwrapped.name, data.frame_ids) == ("kradar", ("00001_00001",))
    assert {path.suffix for path in data.files(0)} == {".PCD", ".PNG", ".TXT"}


def _roots(folder: Path) -> list[Path]:
    return [folder, *sorted(path for path in folder.glob("*") if path.is_dir())] if folder.is_dir() else []


def _opens(path: Path) -> bool:
    try:
        data = open_dataset(path)
    except Exception:
        return False
    return len(data) > 0 and data.unwrapped.name != "folder"
