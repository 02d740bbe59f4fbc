"""Where the edits of a data set stand: beside its labels, or in the user's own folder where those cannot be written."""

import hashlib
import os
import tempfile
from pathlib import Path

from farfield.errors import DatasetError

FOLDER = ".farfield-studio"
JOURNAL = "edits.jsonl"


def journal_folder(labels: Path) -> Path:
    """The folder of a data set's journal, made if it is missing.

    It stands beside the labels if something can be written there; else below ``$XDG_DATA_HOME`` (or
    ``~/.local/share``), under a name made of the labels' path.

    Args:
        labels: Folder of the labels.

    Raises:
        DatasetError: If edits stand beside the labels already and cannot be gone on with.
    """
    here = labels.resolve() / FOLDER
    if _writable(here):
        return here
    if (here / JOURNAL).is_file():
        raise DatasetError(
            f"{here / JOURNAL}: expected a journal that can be written to, as it holds edits. Make the folder "
            "writable, or copy the labels with it to where you can write."
        )
    there = user_folder(labels)
    there.mkdir(parents=True, exist_ok=True)
    return there


def user_folder(labels: Path) -> Path:
    """The folder of the user's own for edits of labels that cannot be written beside."""
    base = os.environ.get("XDG_DATA_HOME") or "~/.local/share"
    digest = hashlib.sha256(os.fsencode(labels.resolve())).hexdigest()[:12]
    return Path(base).expanduser() / "farfield" / "studio" / f"{labels.resolve().name}-{digest}"


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False
