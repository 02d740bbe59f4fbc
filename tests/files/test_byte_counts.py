"""Numbers of bytes in messages: never nothing where there is something, never alike where they differ."""

import re

import numpy as np
import pytest

from farfield.files.sizes import room, sized
from farfield.jobs.runs import fitting
from farfield.jobs.units import BulkError


def test_no_number_of_bytes_reads_as_nothing() -> None:
    for count in [*range(1, 3000), *np.geomspace(1, 1e15, 500).astype(np.int64).tolist()]:
        number, unit = sized(float(count)).split()
        value = float(number) * {"byte": 1, "bytes": 1, "kB": 1e3, "MB": 1e6, "GB": 1e9, "TB": 1e12}[unit]
        assert value == pytest.approx(count, rel=0.06), count
    assert sized(0) == "0 bytes"


def test_what_is_needed_never_reads_as_what_is_free() -> None:
    for needed in np.geomspace(1e3, 1e13, 300).astype(np.int64):
        for free in (0, needed - 1, needed // 2, int(needed * 0.999)):
            first, second = re.findall(r"([\d.,]+ \w+) are", room(float(needed), float(free)))
            assert first != second


def test_workers_that_do_not_fit_are_said_in_units_that_show_it() -> None:
    with pytest.raises(BulkError, match=r"expected memory for 4 of 30.00 MB each: 0.12 GB are needed, 60.00 MB are fr"):
        fitting(4, 30_000_000, exactly=True, available=60_000_000)
