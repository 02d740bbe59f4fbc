"""Values that stand in a file instead of in memory."""

import gc
import pickle
import tracemalloc
from operator import itemgetter
from pathlib import Path

import numpy as np
import pytest

from farfield.files.disk_dict import DiskDict, MappedView, alike


def test_gives_back_what_was_put_in_whatever_came_between(tmp_path: Path) -> None:
    spool = DiskDict[str, np.ndarray](tmp_path / "made")
    spool["a"], spool["b"] = np.arange(5), np.arange(3)
    assert spool["a"].tolist() == [0, 1, 2, 3, 4]
    spool["c"] = np.arange(2)  # written after something was read
    spool["a"] = np.arange(1)
    assert {name: len(values) for name, values in spool.items()} == {"a": 1, "b": 3, "c": 2}
    del spool["b"]
    assert list(spool) == ["a", "c"]
    assert len(spool) == 2
    assert "b" not in spool
    with pytest.raises(KeyError):
        spool["b"]


def test_leaves_no_file(tmp_path: Path) -> None:
    spool = DiskDict[int, int](tmp_path)
    spool[0] = 1
    assert not list(tmp_path.iterdir())


def test_values_do_not_stand_in_memory(tmp_path: Path) -> None:
    spool = DiskDict[int, bytes](tmp_path)
    tracemalloc.start()
    try:
        for number in range(200):
            spool[number] = bytes(100_000)
        assert tracemalloc.get_traced_memory()[1] < 2_000_000  # of 20 MB
    finally:
        tracemalloc.stop()


def test_views_follow_and_pickle_as_a_dictionary(tmp_path: Path) -> None:
    spool = DiskDict[str, tuple[int, str]](tmp_path)
    view = MappedView(spool, itemgetter(1))
    spool["x"] = (1, "one")
    assert dict(view) == {"x": "one"}
    assert "x" in view
    assert len(view) == 1
    assert pickle.loads(pickle.dumps(spool)) == {"x": (1, "one")}


def test_alike_keeps_values_where_the_other_does(tmp_path: Path) -> None:
    assert isinstance(alike(DiskDict(tmp_path)), DiskDict)
    assert alike({}) == {}
    assert isinstance(alike({}), dict)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no full device")
@pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")
def test_one_that_a_full_disk_could_not_take_goes_without_a_word() -> None:
    """What waits cannot be written when it is cleared away: the interpreter printed a traceback."""
    spool: DiskDict[str, int] = DiskDict()
    spool._file.close()
    spool._file = Path("/dev/full").open("w+b")  # noqa: SIM115 - the spool closes it
    spool["a"] = 1
    file = spool._file
    del spool
    gc.collect()
    assert file.closed
