"""What verbs write to the terminal: progress bars, what a dry run would do, JSON."""

import json
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sized
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from rich.console import Console

    from farfield.datasets import Dataset

T = TypeVar("T")

OUTPUT = Path("-")
"""What ``--json -`` names: the output instead of a file."""


def check_outputs(
    inputs: Iterable[Path | str | None],
    *,
    files: Mapping[str, Path | None] | None = None,
    folders: Mapping[str, Path | None] | None = None,
    apart: bool = False,
) -> None:
    """Look at what a verb is going to write, as :func:`farfield.files.outputs.check_outputs` does, before it works.

    Args:
        inputs: Files and folders that are read; names of nothing count as none.
        files: Files by the flags that name them; ``-`` is the output and none.
        folders: Folders by the flags that name them.
        apart: Whether folders must stand beside those that are read.
    """
    from farfield.files import outputs

    named = {flag: path for flag, path in (files or {}).items() if path != OUTPUT}
    weights = [(source, Path(source) / "weights.safetensors") for source in inputs if source is not None]
    inputs = [own if own.is_file() else source for source, own in weights]  # of a run the weights alone are read
    outputs.check_outputs(inputs, files=named, folders=folders, apart=apart)


def write_json(path: Path, tree: Any) -> None:
    """Write JSON into a file, all or nothing, or onto the output for ``-``."""
    from farfield.files.atomic import write_text
    from farfield.jobs.folders import held

    text = json.dumps(tree, indent=1) + "\n"
    if path == OUTPUT:
        sys.stdout.write(text)
    else:
        with held(path, file=True):
            write_text(path, text)


def console(*, stderr: bool = False, width: int | None = None) -> "Console":
    """The one way to print tables and long lines: names of files, classes and sequences are no markup and no emoji.

    Args:
        stderr: Print on the error stream.
        width: Columns where the output is no terminal (default: as the surroundings say).
    """
    from rich.console import Console

    stream = sys.stderr if stderr else sys.stdout
    own = width if stream is None or not stream.isatty() else None
    made = Console(stderr=stderr, width=own, markup=False, emoji=False, highlight=False)
    made.on_broken_pipe = _raise_again  # type: ignore[method-assign]  # rich would end the process with status 1
    return made


def _raise_again() -> None:
    raise


def bar(items: Iterable[T], what: str, *, transient: bool = False) -> Iterator[T]:
    """Iterate with a progress bar named ``what``, which goes away at the end if it is transient.

    Where the error stream is no terminal, a line is printed now and then instead.
    """
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    listed = items if isinstance(items, Sized) else list(items)
    if sys.stderr is None or not sys.stderr.isatty():
        yield from _with_lines(listed, what)
        return
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console(stderr=True), transient=transient) as progress:
        yield from progress.track(listed, total=len(listed), description=what)


def _with_lines(items: Iterable[T], what: str) -> Iterator[T]:
    """Iterate, with a line of how many are done and how long the others may take, every half a minute."""
    count = len(items) if isinstance(items, Sized) else 0
    began = latest = time.monotonic()
    for number, item in enumerate(items, 1):
        yield item
        now = time.monotonic()
        if now - latest >= EVERY_S and number < count:
            left_s = (now - began) / number * (count - number)
            print(f"{what}: {number} of {count}, about {left_s / 60:.1f} minutes left", file=sys.stderr, flush=True)
            latest = now


EVERY_S = 30.0


def print_doubts(data: "Dataset", cloud: str | None = None) -> None:
    """Warn where a data set's axes or units seem to be others than ours, as ``farfield doctor`` does.

    Args:
        data: The data set, as the detector is to see it.
        cloud: Which of its clouds (default: the first of a LiDAR).
    """
    from farfield.inspection.axes_and_units import first_doubts

    for doubt in first_doubts(data, cloud=cloud):
        print(f"warning: {doubt}", file=sys.stderr)


_words: list[str] = []
"""The words of the command that runs, for cards."""


def note_command(words: Iterable[str]) -> None:
    """Keep the words of the command, without ``farfield``, for the cards of what it writes."""
    _words[:] = words


def leave_card(folder: Path, what: str, *sources: "Dataset | Path", weights: str = "") -> None:
    """Write source, licence and command beside derived files, see :mod:`farfield.datasets.cards`.

    Args:
        folder: Where they stand.
        what: What they are.
        *sources: The data sets that they were made of, or their folders.
        weights: Weights that a training started from.
    """
    from farfield.datasets import open_sweeps
    from farfield.datasets.cards import write_card
    from farfield.datasets.recognition import recognise

    folders = [open_sweeps.ROOT if str(one) == open_sweeps.NAME else one for one in sources]
    named = [
        ((recognise(one) if one.is_dir() else None) or "folder", one)
        if isinstance(one, Path)
        else (one.unwrapped.name, one.root)
        for one in folders
    ]
    write_card(folder, what=what, sources=named, command=_words, weights=weights)


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
