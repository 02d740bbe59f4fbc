"""The shape checks themselves: wrong arguments, wrong results and sizes that disagree are all found."""

import numpy as np
import pytest
from jaxtyping import Float, TypeCheckError, jaxtyped
from shapes import checked


@jaxtyped(typechecker=checked)
def first_rows(rows: Float[np.ndarray, "n 3"], count: int, *, whole: bool = False) -> Float[np.ndarray, " n"]:
    return rows[:, 0] if whole else rows[:count, 0]


@jaxtyped(typechecker=checked)
def named(number: int) -> str:
    return str(number) if number else number  # type: ignore[return-value]


def test_what_is_right_passes() -> None:
    assert first_rows(np.zeros((4, 3)), 4).shape == (4,)
    assert first_rows(np.zeros((4, 3)), 1, whole=True).shape == (4,)
    assert named(3) == "3"


def test_wrong_arguments_are_found() -> None:
    for rows, count in ((np.zeros((4, 2)), 4), (np.zeros((4, 3), int), 4), (np.zeros((4, 3)), "4"), ([[0, 0, 0]], 1)):
        with pytest.raises(TypeCheckError, match="parameters of"):
            first_rows(rows, count)


def test_wrong_results_are_found_and_sizes_hold_from_argument_to_result() -> None:
    with pytest.raises(TypeCheckError, match="return value of"):
        first_rows(np.zeros((4, 3)), 3)
    with pytest.raises(TypeCheckError, match="return value of"):
        named(0)
