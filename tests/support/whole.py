"""How much of the slowest tests runs: a sample, or all of it with FARFIELD_WHOLE=1."""

import os
from typing import TypeVar

Value = TypeVar("Value")
WHOLE = bool(os.environ.get("FARFIELD_WHOLE"))


def whole_or(whole: Value, sample: Value) -> Value:
    """What a test takes where the suite runs whole, or its sample.

    Args:
        whole: Cases, or how many of them, of the whole suite.
        sample: Those of the ordinary one.
    """
    return whole if WHOLE else sample
