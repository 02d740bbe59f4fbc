"""The shape checks of the tests: jaxtyping and beartype, with what they do at every call done once.

What passes here is what passes there, and whatever does not pass at once is handed to jaxtyping itself: verdicts and
messages are its own (``test_shapes.py`` compares them).
"""

import inspect
from collections.abc import Callable
from functools import partial, wraps
from types import SimpleNamespace
from typing import Any, ForwardRef, TypeVar, get_args

import jaxtyping
from beartype import BeartypeConf, beartype
from jaxtyping import _array_types, _decorator, _storage

Function = TypeVar("Function", bound=Callable[..., Any])
_KINDS = inspect.Parameter
_jaxtypings_own = _array_types._MetaAbstractArray.__instancecheck__
_jaxtypings_decorator = _decorator.jaxtyped
_CHECKS = beartype(conf=BeartypeConf(violation_type=jaxtyping.TypeCheckError, is_pep484_tower=True))  # int for float


def checked(function: Function) -> Function:
    """Check a function's types; pytest takes it as ``--jaxtyping-packages=farfield,shapes.checked``.

    For every function jaxtyping makes two that have these checks: one that takes the arguments and returns anything,
    and one that takes arguments and result and returns the result. When the second is called the first has passed, and
    the sizes that it saw are known: the arguments are not checked again, which took a quarter of the suite's time.
    """
    if inspect.isfunction(function) and function.__annotations__.get("return", Any) is not Any:
        function.__annotations__ = {"return": function.__annotations__["return"]}
    return beartype(function)


def without_arrays(function: Callable[..., Any]) -> bool:
    """Whether a function's annotations name no array, so that no sizes must hold from an argument to another.

    False of what beartype reads in another way than jaxtyping: names of types as text, and what yields or is awaited.
    """
    return not _is_special(function) and not any(map(_names_array, function.__annotations__.values()))


def _is_special(function: Callable[..., Any]) -> bool:
    """Whether a function yields or is awaited."""
    inner = inspect.unwrap(function)
    special = (inspect.isgeneratorfunction, inspect.isasyncgenfunction, inspect.iscoroutinefunction)
    return any(kind(inner) for kind in special)


def _names_array(annotation: Any) -> bool:
    """Whether an annotation names an array, or may: a text or a type's variable is not looked into."""
    if isinstance(annotation, str | ForwardRef | TypeVar | _array_types._MetaAbstractArray):
        return True
    parts = annotation if isinstance(annotation, list | tuple) else get_args(annotation)
    return any(map(_names_array, parts))


CHECKED_CALLS = 50
"""So many calls of a function are checked in a test: a test that calls one a million times says no more by the rest."""


class _Test:
    """The test that runs."""

    number = 0


def begin_test() -> None:
    """Check the next calls of every function again."""
    _Test.number += 1


def typed(function: Any = _decorator._sentinel, *, typechecker: Any = _decorator._sentinel) -> Any:
    """``jaxtyping.jaxtyped``; a function without arrays gets the checks of its types alone, in a fifth of the time."""
    if function is _decorator._sentinel:
        return partial(typed, typechecker=typechecker)
    if typechecker is not _decorator._sentinel and typechecker and inspect.isfunction(function):
        if getattr(function, "__no_type_check__", False) or hasattr(function, "checked_in_tests"):
            return function
        if without_arrays(function):
            return _switched(function, _CHECKS(function))
        if not _is_special(function):
            return _switched(function, _jaxtypings_decorator(function, typechecker=typechecker))
    return _jaxtypings_decorator(function, typechecker=typechecker)


def _switched(function: Function, checked_one: Function) -> Function:
    """The checked function for the first calls of a test, then the bare one, as while checks are switched off."""
    config, last = jaxtyping.config, [-1, 0]

    @wraps(function)
    def either(*args: Any, **kwargs: Any) -> Any:
        if last[0] != _Test.number:
            last[:] = _Test.number, 0
        last[1] += 1
        if last[1] > CHECKED_CALLS or config.jaxtyping_disable:
            return function(*args, **kwargs)
        return checked_one(*args, **kwargs)

    either.checked_in_tests = True  # type: ignore[attr-defined]
    return either  # type: ignore[return-value]


class _Bound:
    """Arguments by name, defaults among them."""

    __slots__ = ("arguments",)

    def __init__(self, arguments: dict[str, Any]) -> None:
        self.arguments = arguments

    def apply_defaults(self) -> None:
        pass


class QuickSignature(inspect.Signature):
    """A signature that binds arguments by a call; Python's own takes longer than all checks of the call."""

    __slots__ = ("_taker",)

    def bind(self, /, *args: Any, **kwargs: Any) -> Any:
        """The arguments by name, defaults included."""
        try:
            taker = self._taker
        except AttributeError:
            taker = self._taker = _taker(self)
        try:
            return _Bound(taker(*args, **kwargs))
        except TypeError:
            return super().bind(*args, **kwargs)  # says what is missing or too much


def _taker(signature: inspect.Signature) -> Callable[..., dict[str, Any]]:
    """A function that takes the signature's arguments and returns them by name."""
    words, last = [], None
    for number, (name, given) in enumerate(signature.parameters.items()):
        if last is _KINDS.POSITIONAL_ONLY and given.kind is not last:
            words.append("/")
        if given.kind is _KINDS.KEYWORD_ONLY and last not in (_KINDS.KEYWORD_ONLY, _KINDS.VAR_POSITIONAL):
            words.append("*")
        star = {_KINDS.VAR_POSITIONAL: "*", _KINDS.VAR_KEYWORD: "**"}.get(given.kind, "")
        words.append(star + name + ("" if given.default is given.empty else f"=_defaults[{number}]"))
        last = given.kind
    if last is _KINDS.POSITIONAL_ONLY:
        words.append("/")
    result = ", ".join(f"{name!r}: {name}" for name in signature.parameters)
    scope = {"_defaults": [given.default for given in signature.parameters.values()]}
    return eval(f"lambda {', '.join(words)}: {{{result}}}", scope)


def _size(size: Any) -> int | str | None:
    """A size that is a plain number, name or anything.

    Raises:
        ValueError: If it is of another kind.
    """
    if size is _array_types._anonymous_dim:
        return None
    if type(size) is _array_types._FixedDim and not size.broadcastable:
        return size.size
    if type(size) is _array_types._NamedDim and not (size.broadcastable or size.treepath):
        return size.name
    raise ValueError(size)


def _plan(annotation: Any) -> tuple[Any, ...] | None:
    """Class and sizes of an annotation's arrays, the types of numbers that passed, where the one name stands that is
    for any number of sizes, and that name; None where jaxtyping itself must look."""
    sizes, place, rest = list(annotation.dims), annotation.index_variadic, None
    if place is not None:
        many = sizes.pop(place)
        rest = "" if many is _array_types._anonymous_variadic_dim else many.name
    try:
        plain = [_size(size) for size in sizes]
    except ValueError:
        return None
    if annotation.array_type is Any or (rest and (many.broadcastable or many.treepath)):
        return None
    return annotation.array_type, plain, set(), place, rest


def _is_array(annotation: Any, value: Any) -> bool:
    """Whether a value is an array of an annotation; the sizes that it names are noted for the rest of the call."""
    try:
        plan = annotation._quick
    except AttributeError:
        plan = annotation._quick = _plan(annotation)
    if plan is None:
        return _jaxtypings_own(annotation, value)
    array_type, sizes, passed, place, rest = plan
    if not isinstance(value, array_type):
        return annotation._skip_instancecheck
    if value.dtype in passed and _fits(value.shape, sizes, place, rest):
        return True
    right = _jaxtypings_own(annotation, value)
    if right and type(value.dtype).__module__.partition(".")[0] in ("numpy", "torch"):
        passed.add(value.dtype)
    return right


def _fits(shape: Any, sizes: list[int | str | None], place: int | None, rest: str | None) -> bool:
    stack = getattr(_storage._shape_storage, "memo_stack", None)
    known, known_rests = stack[-1][:2] if stack else ({}, {})
    if rest is not None:
        after = len(shape) - len(sizes) + place
        if after < place:
            return False
        shape, several = (*shape[:place], *shape[after:]), (False, tuple(shape[place:after]))
        if rest and known_rests.get(rest, several) != several:
            return False
    elif len(shape) != len(sizes):
        return False
    seen: dict[str, int] = {}
    for size, wanted in zip(shape, sizes, strict=True):
        if wanted.__class__ is str:
            if seen.setdefault(wanted, known.get(wanted, size)) != size:
                return False
        elif wanted is not None and wanted != size:
            return False
    known.update(seen)
    if rest:
        known_rests[rest] = several
    return True


_decorator.inspect = SimpleNamespace(**(vars(inspect) | {"signature": QuickSignature.from_callable}))
_array_types._MetaAbstractArray.__instancecheck__ = _is_array
_decorator.jaxtyped = jaxtyping.jaxtyped = typed
