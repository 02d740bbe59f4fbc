"""Arrays that nobody changes in place: what frames, boxes and clouds hold."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Shaped


def read_only(values: Shaped[np.ndarray, "*shape"]) -> Shaped[np.ndarray, "*shape"]:
    """The same numbers as an array that cannot be written to; the caller's own array stays as it is.

    >>> read_only(np.zeros(3)).flags.writeable
    False
    """
    view = values.view()
    view.flags.writeable = False
    return view


def locked(value: Any) -> Any:
    """An array read-only, and those of a mapping; anything else as it is."""
    if isinstance(value, np.ndarray):
        return read_only(value)
    if type(value) is dict:
        return {name: locked(inner) for name, inner in value.items()}
    return value


class Locked:
    """Base of frozen records whose arrays are read-only, also once they were pickled or copied."""

    def lock(self) -> None:
        """Make the arrays read-only: at the end of ``__post_init__``."""
        self.__setstate__(vars(self))

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        for name, value in state.items():
            self.__dict__[name] = locked(value)
