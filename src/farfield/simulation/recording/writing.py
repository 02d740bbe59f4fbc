"""Frames written whole: all files of a frame appear at once or not at all, and what carries labels appears last."""

import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from farfield.jobs.folders import STAGING
from farfield.simulation.recording.rigs import writer_for

if TYPE_CHECKING:
    from farfield.frame import Frame
    from farfield.simulation import Preset

# Folders whose files are moved last, in this order.
_LABELS = ("dataset1_annotation", "info_label", "KRadar_revised_visibility", "label_2", "frame_record")


def write_whole(preset: "Preset", frame: "Frame", out: Path, *, cache: bool = False) -> tuple[Path, ...]:
    """Write a frame beside the data set, then move its files to their places, the labels last.

    Args:
        preset: What the frame was simulated with; its rig says which layout is written.
        frame: The frame.
        out: Folder of the data set.
        cache: Also write the binary cache of its clouds.

    Returns:
        Its files.
    """
    staging = out / f"{STAGING}{os.getpid()}"
    shutil.rmtree(staging, ignore_errors=True)
    try:
        writer = writer_for(preset, staging)
        paths = writer.write(frame)
        made = [*paths.values()]
        if cache:
            from farfield.datasets.cloud_files import write_rows_cache

            made += [write_rows_cache(paths[name], writer.root) for name in frame.clouds]
        files = [path for path in sorted(staging.rglob("*")) if path.is_file()]
        for path in sorted(files, key=_rank):
            target = out / path.relative_to(staging)
            target.parent.mkdir(parents=True, exist_ok=True)
            path.replace(target)
        return tuple(out / path.relative_to(staging) for path in made)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _rank(path: Path) -> int:
    """What makes a frame count is moved last."""
    return max((_LABELS.index(part) + 1 for part in path.parts if part in _LABELS), default=0)
