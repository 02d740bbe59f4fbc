"""The shape checks themselves: wrong arguments, results and sizes are all found, as jaxtyping finds them."""

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import shapes
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import AnnotationError, Bool, Float, Float32, Int, Num, TypeCheckError, _decorator, _storage, jaxtyped
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
    with pytest.raises(TypeCheckError, match="return 0 violates"):
        named(0)


def test_the_first_calls_of_a_test_are_checked_and_a_million_more_are_not() -> None:
    for wrong in (lambda: named(0), lambda: first_rows(np.zeros((4, 3)), 3)):
        for _ in range(2):
            shapes.begin_test()
            for _ in range(shapes.CHECKED_CALLS):
                with pytest.raises(TypeCheckError):
                    wrong()
            wrong()


ARRAYS = [
    np.zeros(shape, kind)
    for shape in ((), (1,), (3,), (1, 3), (2, 3), (3, 3), (3, 2), (2, 3, 4), (4, 3, 3))
    for kind in (np.float32, np.float64, np.int64, bool)
]
ANNOTATIONS = [
    kind[np.ndarray, sizes]
    for kind in (Float, Float32, Int, Bool, Num)
    for sizes in (
        "",
        " n",
        "n 3",
        "3 n",
        "n n",
        "n m",
        "_ n",
        "#n 3",
        "n *rest",
        "*rest 3",
        "... n",
        "n n+1",
        "k n 3",
        "*rest",
        "n *rest 3",
        "*rest n",
        "*#rest n",
    )
]


def _sizes(first: Any, second: Any, arrays: tuple[Any, Any], check: Callable[[Any, Any], bool]) -> list[Any]:
    """What two checks of one call say, and which sizes they note."""
    said: list[Any] = []
    memos = _storage.push_shape_memo({})
    try:
        for annotation, value in zip((first, second), arrays, strict=True):
            try:
                said.append(check(annotation, value))
            except AnnotationError as error:
                said.append(str(error))
        return [*said, *map(dict, memos)]
    finally:
        _storage.pop_shape_memo()


@settings(max_examples=1500)
@given(
    st.tuples(st.sampled_from(ANNOTATIONS), st.sampled_from(ANNOTATIONS)),
    st.tuples(st.sampled_from([*ARRAYS, None, 3.0]), st.sampled_from(ARRAYS)),
)
def test_arrays_are_judged_as_jaxtyping_judges_them(annotations: tuple[Any, Any], arrays: tuple[Any, Any]) -> None:
    theirs = _sizes(*annotations, arrays, shapes._jaxtypings_own)
    for _ in range(2):  # the second time numbers of that type have passed
        assert _sizes(*annotations, arrays, shapes._is_array) == theirs


def _calls() -> list[Callable[..., Any]]:
    return [
        lambda: None,
        lambda a, b=2: None,
        lambda a, /, b, *, c=3: None,
        lambda a, *rest, c, **named: None,
        lambda *, c=[1]: None,
        lambda *rest, a=1: None,
        lambda a=1, /: None,
    ]


def _bound(signature: inspect.Signature, values: range, words: dict[str, int]) -> tuple[str, list[tuple[str, Any]]]:
    try:
        bound = signature.bind(*values, **words)
    except TypeError as error:
        return str(error), []
    bound.apply_defaults()
    return "", list(bound.arguments.items())


@pytest.mark.parametrize("number", range(7))
def test_arguments_are_bound_as_python_binds_them(number: int) -> None:
    call = _calls()[number]
    quick, plain = shapes.QuickSignature.from_callable(call), inspect.signature(call)
    for count in range(4):
        for names in ((), ("a",), ("b",), ("c",), ("b", "c"), ("x",), ("c", "x")):
            words = dict.fromkeys(names, 7)
            assert _bound(quick, range(count), words) == _bound(plain, range(count), words)


def test_the_checks_stand_in_for_jaxtypings() -> None:
    assert type(Float[np.ndarray, "n 3"]).__instancecheck__ is shapes._is_array
    assert _decorator.inspect.signature(named).__class__ is shapes.QuickSignature
