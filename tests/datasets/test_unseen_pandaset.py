"""PandaSet by a generator that has not seen the reader."""

import gzip

import pytest

from farfield.errors import FarfieldError

from .generators.pandaset import write_pandaset
from .generators.pickle_assembler import HOSTILE
from .generators.truth import check_dataset, open_recognised


@pytest.mark.parametrize("version", ["1.0", "1.5", "2.2"])
def test_a_tree_is_read_as_it_was_written(version, tmp_path):
    write_pandaset(tmp_path / "probe", version=version, frames=1)
    apart = len(open_recognised(tmp_path / "probe")[0].clouds) > 1
    truth = write_pandaset(tmp_path / "set", version=version, apart=apart)
    check_dataset(open_recognised(tmp_path / "set"), truth)


def test_a_pickle_that_would_run_a_command_is_refused(tmp_path, monkeypatch):
    write_pandaset(tmp_path, frames=1)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "001/lidar/00.pkl.gz").write_bytes(gzip.compress(HOSTILE))
    with pytest.raises(FarfieldError, match="system"):
        open_recognised(tmp_path)[0].cloud()
    assert not (tmp_path / "farfield-was-here").exists()
