"""Folders that several commands write into: held while something is written, swept of what killed ones left."""

import contextlib
import glob
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

STAGING = ".unfinished-"
"""How the names of folders begin in which a unit's files are made before they are moved to their places."""

_PARTIAL = re.compile(r"\..*\.[0-9a-f]{12}\.part")  # of farfield.files.atomic


@contextlib.contextmanager
def locked(folder: Path, *, shared: bool) -> Iterator[None]:
    """Hold a folder together with others, or alone, until done or killed; without locks where there are none (NFS).

    Raises:
        BlockingIOError: If it is to be held alone and others hold it.
    """
    if fcntl is None:
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH if shared else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if isinstance(error, BlockingIOError):
                raise
        yield
    finally:
        os.close(descriptor)


def sweep_out(folder: Path) -> None:
    """Remove what killed workers left unfinished, unless another command writes into the same folder."""
    with contextlib.suppress(BlockingIOError), locked(folder, shared=False):
        for root, folders, files in os.walk(folder):
            for name in [name for name in folders if name.startswith(STAGING)]:
                shutil.rmtree(Path(root, name), ignore_errors=True)
                folders.remove(name)
            for name in files:
                if _PARTIAL.fullmatch(name):
                    Path(root, name).unlink(missing_ok=True)


def sweep_out_file(path: Path) -> None:
    """Remove what killed commands left of one file that they wrote."""
    for part in path.parent.glob(f".{glob.escape(path.name[:100])}.*.part"):
        if _PARTIAL.fullmatch(part.name):
            part.unlink(missing_ok=True)
