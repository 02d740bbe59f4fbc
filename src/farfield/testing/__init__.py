"""Checks that every data set, detector and protocol passes, whoever wrote it; other packages call them in their tests.

They are plain functions that need no test runner: what does not hold raises an AssertionError that says how to fix it.

>>> from farfield.testing import check_protocol
>>> check_protocol("dds")
"""

from collections.abc import Mapping
from typing import Any

from farfield.testing.datasets import check_dataset
from farfield.testing.protocols import check_protocol

__all__ = ["check_dataset", "check_detector", "check_protocol"]


def check_detector(name: str, settings: Mapping[str, Any] | None = None, *, processes: bool = False) -> None:
    """Check a detector: gradients, assigner, features, order of points, empty clouds, weights files, training.

    Args:
        name: Its name in ``farfield.detectors.DETECTORS``, built in, registered or of an installed package.
        settings: Settings of a small network, which a processor runs in a second.
        processes: Also take a step in two processes, which must be that of one; it starts them, and takes seconds.

    Raises:
        AssertionError: If something does not hold; the message says what and how to fix it.
        MissingExtraError: If torch is not installed.
    """
    from farfield.detectors import DETECTORS

    _ = DETECTORS[name].network_class  # names the missing extra where torch is absent
    from farfield.testing.detectors import check_network
    from farfield.testing.processes import check_two_processes

    check_network(name, settings or {})
    if processes:
        check_two_processes(name, settings or {})
