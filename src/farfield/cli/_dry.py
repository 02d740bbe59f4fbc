"""What ``--dry-run`` says in every verb: what would be written, where and how much, and that nothing is."""

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from farfield.datasets import Dataset


def would_write(what: str, where: Path | str, much: str = "") -> None:
    """Print it.

    Args:
        what: Such as ``"3 frames"``.
        where: File or folder.
        much: How much it is or comes from, as far as it is known.
    """
    print(f"would write {what} to {where}{', ' + much if much else ''}; nothing is written now")


def sized(count: int) -> str:
    """Bytes in GB, small numbers of them in MB."""
    return f"{count / 1e9:.2f} GB" if count >= 1e8 else f"{count / 1e6:.2f} MB"


def from_files(paths: Iterable[Path]) -> str:
    """How much the files hold that something is made of."""
    total = 0
    for path in set(paths):
        with suppress(OSError):  # an absent one is said when it is read
            total += path.stat().st_size
    return f"from {sized(total)} of files"


def from_data(dataset: "Dataset") -> str:
    """How much a data set's files hold."""
    return from_files(Path(file) for index in range(len(dataset)) for file in dataset.files(index))
