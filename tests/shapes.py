"""The shape checks of the tests: beartype, with each argument checked once a call."""

import inspect
from collections.abc import Callable
from typing import Any, TypeVar

from beartype import beartype

Function = TypeVar("Function", bound=Callable[..., Any])


def checked(function: Function) -> Function:
    """Check a function's types; pytest takes it as ``--jaxtyping-packages=farfield,shapes.checked``.

    For every function jaxtyping makes two that have these checks: one that takes the arguments and returns anything,
    and one that takes arguments and result and returns the result. When the second is called the first has passed, and
    the sizes that it saw are known: the arguments are not checked again, which took a quarter of the suite's time.
    """
    if inspect.isfunction(function) and function.__annotations__.get("return", Any) is not Any:
        function.__annotations__ = {"return": function.__annotations__["return"]}
    return beartype(function)
