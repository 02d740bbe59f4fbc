"""Fingerprints of simulated frames that runs learnt from, so that runs which another machine began count here.

The same settings and simulator give frames on another machine that differ by roundings of its processor, and so have
another fingerprint. A folder of runs holds that of the frames which its first trainings saw; it travels with the runs.
"""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from farfield.errors import FileFormatError, plain
from farfield.files.atomic import read_bytes, write_text
from farfield.files.json_text import plain_json
from farfield.papers.jobs import code_digest
from farfield.papers.locations import DataLocation, fingerprints_of

LEARNT = "learnt.json"
"""The file, in the folder of a grid."""
_MAX_BYTES = 1 << 20
_ROOMS = ("simulation", "vocabulary")


def learnt_fingerprints(folder: Path, locations: Mapping[str, DataLocation], names: Iterable[str]) -> dict[str, str]:
    """Fingerprints of the sets that runs learn from: of simulated ones those of the frames with which runs began.

    Args:
        folder: The folder of the grid.
        locations: All sets.
        names: Those that runs learn from.

    Returns:
        Fingerprint by set. A set without frames here, of which none was noted, is left out.

    Raises:
        FileFormatError: If what was noted is damaged.
    """
    noted, fingerprints = _read(folder / LEARNT), {}
    for name in names:
        location = locations[name]
        of_set = noted.get(location.path.name, {})
        if location.simulated is not None and of_set.get("simulator") == code_digest(_ROOMS):
            fingerprints[name] = str(of_set["fingerprint"])
        elif location.has_frames:
            fingerprints |= fingerprints_of({name: location})
    return fingerprints


def note_fingerprints(folder: Path, locations: Mapping[str, DataLocation], fingerprints: Mapping[str, str]) -> None:
    """Write what :func:`learnt_fingerprints` reads, of simulated sets alone; what stands there of others stays.

    Args:
        folder: The folder of the grid.
        locations: All sets.
        fingerprints: Fingerprint by set.
    """
    entries = {
        locations[name].path.name: {"fingerprint": fingerprint, "simulator": code_digest(_ROOMS)}
        for name, fingerprint in fingerprints.items()
        if locations[name].simulated is not None
    }
    tree = {**_read(folder / LEARNT), **entries}
    if entries and tree != _read(folder / LEARNT):
        write_text(folder / LEARNT, json.dumps(tree, indent=1, sort_keys=True) + "\n")


def _read(path: Path) -> dict[str, Any]:
    if not path.is_file():
        return {}
    try:
        return dict(plain_json(read_bytes(path, max_bytes=_MAX_BYTES)))
    except ValueError as error:
        raise FileFormatError(path, where="the file", expected="fingerprints by set", got=plain(error)) from None
