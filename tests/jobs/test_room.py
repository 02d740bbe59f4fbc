"""A work says before it begins that the disk has no room for what is left of it."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from wrong_inputs import own_folder

import farfield as ff
from farfield.datasets.convert import convert
from farfield.errors import ConfigError


@pytest.mark.parametrize("to", ["kitti", "cirrus", "sustechpoints", "cvat"])
def test_a_conversion_looks_at_the_room_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, to: str) -> None:
    data = ff.open_dataset(own_folder(tmp_path / "own"))
    with monkeypatch.context() as patch:
        patch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=50_000))
        with pytest.raises(ConfigError, match=r"out: about 57.60 kB are needed, 50.00 kB are free. Make room"):
            convert(data, tmp_path / "out", to=to)
        assert not [path for path in (tmp_path / "out").rglob("*") if path.is_file()]
    convert(data, tmp_path / "out", to=to)
    monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=0))
    assert convert(data, tmp_path / "out", to=to).written == 0  # nothing is left to write
