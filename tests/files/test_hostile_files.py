"""Small files that would fill the memory, read others or never end: each is refused, in little memory and time."""

import sys
from pathlib import Path

import pytest

pytest.importorskip("h5py")

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))
try:
    import _fuzz_hostile

    ATTACKS = _fuzz_hostile.hostile_files()
finally:
    sys.path.remove(str(BENCHMARKS))

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="peaks are read from /proc")


HEAVY = ("megapixels", "gigapixels", "other names", "unpack", "holes", "kpoint", "imported")
"""Files that take long to write."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * any(part in name for part in HEAVY)) for name in ATTACKS]
)
def test_a_hostile_file_is_refused_in_little_memory_and_time(tmp_path: Path, name: str) -> None:
    outcome = held(tmp_path, name)
    if outcome.time_s > _fuzz_hostile.LIMIT_S:  # seconds of a processor that others heat are several times as long
        (tmp_path / "again").mkdir()
        outcome = held(tmp_path / "again", name)
    assert outcome.time_s < _fuzz_hostile.LIMIT_S, outcome.time_s


def held(folder: Path, name: str) -> "_fuzz_hostile.Outcome":
    """An attempt that is refused in little memory."""
    outcome = _fuzz_hostile.attempt(ATTACKS[name], folder)
    assert outcome.refused, outcome.words
    assert outcome.peak_bytes < _fuzz_hostile.LIMIT_BYTES, outcome.peak_bytes
    return outcome


def test_what_is_not_refused_is_noticed(tmp_path: Path) -> None:
    def careless(folder: Path) -> bytes:
        return (folder / "a").read_bytes() * (5 << 28)

    attack = _fuzz_hostile.Attack(lambda folder: folder.joinpath("a").write_bytes(b"x"), careless)
    outcome = _fuzz_hostile.attempt(attack, tmp_path)
    assert not outcome.refused
    assert outcome.peak_bytes > _fuzz_hostile.LIMIT_BYTES
    assert not outcome.held
