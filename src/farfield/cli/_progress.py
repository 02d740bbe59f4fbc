"""Progress bars with the time left, on the error stream, so that results can be piped."""

from collections.abc import Iterable, Iterator, Sized
from typing import TypeVar

T = TypeVar("T")


def bar(items: Iterable[T], what: str, *, transient: bool = False) -> Iterator[T]:
    """Iterate with a progress bar named ``what``, which goes away at the end if it is transient."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    listed = items if isinstance(items, Sized) else list(items)
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=transient) as progress:
        yield from progress.track(listed, total=len(listed), description=what)
