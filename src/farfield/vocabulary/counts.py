"""Numbers of things in words."""

from typing import SupportsIndex


def count_of(count: SupportsIndex, one: str, more: str = "", *, spec: str = "") -> str:
    """A number and what is counted: ``1 frame``, ``2 frames``, ``1 box``, ``2 boxes``.

    Args:
        count: How many; numpy's whole numbers too.
        one: The word for a single one, with the verb if one follows: ``frame is``.
        more: The words for none or several (default: ``one`` with s or es).
        spec: How the number is written, such as ``,``.
    """
    several = more or one + ("es" if one.endswith(("x", "ch", "s")) else "s")
    return f"{count:{spec}} {one if count == 1 else several}"
