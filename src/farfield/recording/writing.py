"""Frames written whole: all files of a frame appear at once or not at all, and what carries labels appears last."""

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from farfield.recording.rigs import writer_for

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

if TYPE_CHECKING:
    from farfield.frame import Frame
    from farfield.simulation import Preset

_STAGING = ".unfinished-"
_LABELS = ("dataset1_annotation", "info_label", "KRadar_revised_visibility", "frame_record")  # in this order, last


def write_whole(preset: "Preset", frame: "Frame", out: Path, *, cache: bool = False) -> None:
    """Write a frame beside the data set, then move its files to their places, the labels last.

    Args:
        preset: What the frame was simulated with; its rig says which layout is written.
        frame: The frame.
        out: Folder of the data set.
        cache: Also write the binary cache of its clouds.
    """
    with locked(out, shared=True):
        staging = out / f"{_STAGING}{os.getpid()}"
        shutil.rmtree(staging, ignore_errors=True)
        try:
            writer = writer_for(preset, staging)
            paths = writer.write(frame)
            if cache:
                from farfield.datasets.cloud_files import write_rows_cache

                for name in frame.clouds:
                    write_rows_cache(paths[name], writer.root)
            files = [path for path in sorted(staging.rglob("*")) if path.is_file()]
            for path in sorted(files, key=_rank):
                target = out / path.relative_to(staging)
                target.parent.mkdir(parents=True, exist_ok=True)
                path.replace(target)
        finally:
            shutil.rmtree(staging, ignore_errors=True)


@contextlib.contextmanager
def locked(folder: Path, *, shared: bool) -> Iterator[None]:
    """Hold a folder together with others, or alone, until done or killed; without locks where there are none (NFS).

    Raises:
        BlockingIOError: If it is to be held alone and others hold it.
    """
    if fcntl is None:
        yield
        return
    held = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(held, fcntl.LOCK_SH if shared else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if isinstance(error, BlockingIOError):
                raise
        yield
    finally:
        os.close(held)


def _rank(path: Path) -> int:
    """What makes a frame count is moved last."""
    return max((_LABELS.index(part) + 1 for part in path.parts if part in _LABELS), default=0)


def sweep_out(out: Path) -> None:
    """Remove what killed workers left unfinished, unless another command writes a frame into the same folder."""
    with contextlib.suppress(BlockingIOError), locked(out, shared=False):
        for folder in out.glob(f"{_STAGING}*"):
            shutil.rmtree(folder, ignore_errors=True)
