import pytest
from street import write_street

from farfield.cli import main
from farfield.datasets import open_dataset


@pytest.fixture
def street_root(tmp_path, rng):
    return write_street(tmp_path, rng)


def test_convert_writes_then_skips(street_root, tmp_path, capsys):
    target = tmp_path / "kitti"
    assert main(["convert", str(street_root), str(target), "--to", "kitti"]) == 0
    assert "3 written, 0 had been written" in capsys.readouterr().out
    assert main(["convert", str(street_root), str(target), "--to", "kitti"]) == 0
    assert "0 written, 3 had been written" in capsys.readouterr().out
    assert len(open_dataset(target)) == 3


def test_cache_needs_no_target(street_root, capsys):
    assert main(["convert", str(street_root), "--to", "cache"]) == 0
    assert "3 written" in capsys.readouterr().out
    assert (street_root / ".farfield_cache").is_dir()


def test_a_missing_target_exits_1(street_root, capsys):
    assert main(["convert", str(street_root), "--to", "kitti"]) == 1
    assert "expected a target folder" in capsys.readouterr().err
