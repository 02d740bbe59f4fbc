"""The folder of an adaptation: what stands there, and that nothing of others is written over or removed."""

import re
import shutil
from pathlib import Path

from farfield.datasets.cards import CARD_NAME
from farfield.errors import ConfigError
from farfield.experiments.adapting.options import THRESHOLDS
from farfield.experiments.adapting.source import FOLDER

WEIGHTS, PAGE, SCORES = "weights.safetensors", "report.html", "scores.json"
_OURS = re.compile(
    rf"{THRESHOLDS}|{CARD_NAME}|{WEIGHTS}|{PAGE}|{SCORES}|{FOLDER}|round-\d+|\.(found|measured)-.*|\..*\.part"
)


def clear(folder: Path) -> None:
    """Remove what an adaptation left in its folder, but not the source frames that it simulated."""
    for path in folder.iterdir():
        if path.is_file():
            path.unlink()
        elif path.name != FOLDER:
            shutil.rmtree(path)


def check_folder(folder: Path) -> None:
    """See that a folder is an adaptation's, or empty, or absent: nothing else is written over or removed.

    Raises:
        ConfigError: If it holds something else.
    """
    names = {path.name for path in folder.iterdir()} if folder.exists() else set()
    strange = sorted(name for name in names if not _OURS.fullmatch(name))
    if WEIGHTS in names and THRESHOLDS not in names:
        strange.append(WEIGHTS)
    if strange:
        raise ConfigError(
            f"{folder}: expected an empty or absent folder, or one that farfield adapt began; it holds "
            f"{', '.join(strange[:4])}. Name another folder with --out."
        )
