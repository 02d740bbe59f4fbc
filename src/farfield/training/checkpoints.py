"""Checkpoints of a running training: whole or absent, never torn, never pickled code."""

import io
from pathlib import Path
from typing import Any

import torch

from farfield.errors import FileFormatError
from farfield.files.atomic import write_bytes


def save_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Write tensors and plain values atomically: a killed process leaves the previous checkpoint."""
    buffer = io.BytesIO()
    torch.save(state, buffer)
    write_bytes(path, buffer.getvalue())


def load_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint; anything but tensors and plain values is refused.

    Raises:
        FileFormatError: If the file is damaged or holds other objects.
    """
    try:
        state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises many kinds for damaged or hostile files
        raise FileFormatError(
            path,
            where="file",
            expected="a checkpoint of farfield train",
            found=str(error)[:200],
            mend="Remove it to begin anew.",
        ) from error
    return state
