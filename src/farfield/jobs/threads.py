"""One thread a worker: as many workers as cores are at work, and sums in another order have other last digits."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""What libraries read when they are loaded."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Let numpy, torch and numba compute on one thread meanwhile, whether they are loaded yet or not."""
    from threadpoolctl import threadpool_limits

    before = {name: os.environ.get(name) for name in VARIABLES}
    os.environ.update(dict.fromkeys(VARIABLES, "1"))
    torch, numba = sys.modules.get("torch"), sys.modules.get("numba")
    of_torch = None if torch is None else torch.get_num_threads()
    of_numba = None if numba is None else numba.get_num_threads()
    try:
        with threadpool_limits(1):
            if torch is not None:
                torch.set_num_threads(1)
            if numba is not None:
                numba.set_num_threads(1)
            yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        if torch is not None:
            torch.set_num_threads(of_torch)
        if numba is not None:
            numba.set_num_threads(of_numba)
