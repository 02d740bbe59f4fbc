"""What verbs write to the terminal: progress bars, what a dry run would do, JSON."""

import json
import sys
from collections.abc import Iterable, Iterator, Sized
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from farfield.datasets import Dataset

T = TypeVar("T")

OUTPUT = Path("-")
"""What ``--json -`` names: the output instead of a file."""


def write_json(path: Path, tree: Any) -> None:
    """Write JSON into a file, all or nothing, or onto the output for ``-``."""
    from farfield.files.atomic import write_text

    text = json.dumps(tree, indent=1) + "\n"
    if path == OUTPUT:
        sys.stdout.write(text)
    else:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, text)


def read_json(path: Path) -> Any:
    """What one of our own JSON files holds."""
    return json.loads(path.read_text(encoding="utf-8"))


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


def print_doubts(data: "Dataset", cloud: str | None = None) -> None:
    """Warn where a data set's axes or units seem to be others than ours, as ``farfield doctor`` does.

    Args:
        data: The data set, as the detector is to see it.
        cloud: Which of its clouds; the first of a LiDAR unless given.
    """
    from farfield.inspection.axes_and_units import first_doubts

    for doubt in first_doubts(data, cloud=cloud):
        print(f"warning: {doubt}", file=sys.stderr)


def would_write(what: str, where: Path | str, much: str = "") -> None:
    """Print it.

    Args:
        what: Such as ``"3 frames"``.
        where: File or folder.
        much: How much it is or comes from, as far as it is known.
    """
    print(f"would write {what} to {where}{', ' + much if much else ''}; nothing is written now")


def from_files(paths: Iterable[Path]) -> str:
    """How much the files hold that something is made of."""
    from farfield.files.sizes import sized

    total = 0
    for path in set(paths):
        with suppress(OSError):  # an absent one is said when it is read
            total += path.stat().st_size
    return f"from {sized(total)} of files"


def from_data(dataset: "Dataset") -> str:
    """How much a data set's files hold."""
    return from_files(Path(file) for index in range(len(dataset)) for file in dataset.files(index))
