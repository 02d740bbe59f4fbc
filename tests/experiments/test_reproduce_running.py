"""What a job leaves besides its scores: peak memory of the process, and words that are kept down."""

import logging
import sys

import numpy as np
import pytest

pytest.importorskip("torch")

from farfield.experiments.reproduce.running import forget_peak, peak_memory_mb, quiet


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux says")
def test_peak_memory_is_that_since_it_was_forgotten() -> None:
    forget_peak()
    before = peak_memory_mb()
    large = np.ones(40_000_000)
    assert large.sum() > 0
    there = peak_memory_mb()
    assert before is not None
    assert there is not None
    assert 300 < there - before < 340  # 320 MB more
    del large
    assert peak_memory_mb() >= there - 1
    forget_peak()
    assert peak_memory_mb() < there - 250


def test_trainings_are_kept_from_saying_what_is_in_order() -> None:
    quiet()
    assert logging.getLogger("lightning_fabric").getEffectiveLevel() == logging.WARNING
