"""Progress bars with the time left, on the error stream, so that results can be piped, and who does the work."""

from collections.abc import Iterable, Iterator, Sized
from functools import partial
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from farfield.jobs import JobOptions

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


def hands(workers: int, engine: str, what: str) -> "JobOptions":
    """How a verb does its units: ``--workers``, ``--engine``, and one bar over all workers that is named ``what``."""
    from farfield.jobs import JobOptions

    return JobOptions(workers=workers, engine=engine, progress=partial(bar, what=what, transient=True))
