"""Work over many jobs with several processes."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing import get_context
from typing import TypeVar

from farfield.errors import DatasetError

Job = TypeVar("Job")
Done = TypeVar("Done")


def work(function: Callable[[Job], Iterable[Done]], jobs: Sequence[Job], processes: int) -> Iterator[Done]:
    """Do all jobs in order and yield what they yield; with several processes, a whole job at once.

    Args:
        function: Does one job; a function of a module, since it travels to other processes.
        jobs: What it takes, one after the other.
        processes: How many processes work; 1 works in this one.

    Raises:
        DatasetError: If a worker process was killed; what was written stays.
    """
    if processes <= 1:
        for job in jobs:
            yield from function(job)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        try:
            for done in pool.map(partial(_whole, function), jobs):
                yield from done
        except BrokenProcessPool as error:
            raise DatasetError(
                "a worker process was killed, perhaps for want of memory: run the same command again to go on, with "
                "fewer --workers"
            ) from error
        except BaseException:  # the frames that wait would only fail the same way
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _whole(function: Callable[[Job], Iterable[Done]], job: Job) -> list[Done]:
    from numba import set_num_threads

    set_num_threads(1)  # as many processes as cores are at work already
    return list(function(job))
