"""The process pool: order, and what happens when a worker dies or fails."""

import os
from collections.abc import Iterator

import pytest

from farfield.errors import DatasetError
from farfield.recording.pool import work

pytest.importorskip("numba")


def doubled(job: int) -> Iterator[int]:
    yield from (job, job)


@pytest.mark.parametrize("processes", [1, 2])
def test_all_jobs_are_done_in_order(processes: int) -> None:
    assert list(work(doubled, [3, 1, 2], processes)) == [3, 3, 1, 1, 2, 2]


def test_a_killed_worker_is_an_error_that_says_how_to_go_on() -> None:
    with pytest.raises(DatasetError, match="run the same command again to go on"):
        list(work(os._exit, [1, 1, 1], 2))
