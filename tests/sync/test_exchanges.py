"""Two-way exchanges against simulated delays."""

from pathlib import Path

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.files.clock_logs import read_clock_log
from farfield.sync.clocks import summarised, two_way


def test_exchanges_tell_offset_and_delay_apart(rng: np.random.Generator) -> None:
    there, back = rng.integers(500, 600, 200), rng.integers(500, 600, 200)
    t1 = np.arange(200) * 10**9
    t3 = t1 + 10**6
    offset = 123_456
    found, delay = two_way(t1, t1 + there + offset, t3 + offset, t3 + back)
    np.testing.assert_allclose(found - offset, (there - back) / 2)
    np.testing.assert_allclose(delay, (there + back) / 2)
    assert (np.abs(found - offset) <= delay).all()


def test_a_log_is_summarised(tmp_path: Path) -> None:
    lines = ["ptp4l[1.0]: master offset 99999 s0 freq +0 path delay 900"]
    lines += [f"ptp4l[{k}.5]: master offset {v} s2 freq -2500 path delay 560" for k, v in enumerate((-3, 4, 5, 4, 90))]
    path = tmp_path / "ptp4l.log"
    path.write_text("\n".join(lines))
    found = summarised(read_clock_log(path))
    assert (found.exchanges, found.unlocked, found.offset_ns, found.worst_ns) == (5, 1, 4, 90)
    assert (found.delay_ns, found.asymmetry_limit_ns, found.drift_ppm) == (560, 560, 2.5)
    path.write_text(lines[0])
    with pytest.raises(ConfigError, match="locked"):
        summarised(read_clock_log(path))
