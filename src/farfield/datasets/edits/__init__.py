"""Edits of annotations: a journal of lines, the state that they add up to, and where the journal stands."""

from typing import TYPE_CHECKING

from farfield.datasets.edits.edited import Edited
from farfield.datasets.edits.journal import (
    FOLDER,
    JOURNAL,
    Cell,
    CellEdit,
    CellState,
    EditState,
    Record,
    Replay,
    box_cell,
    decode,
    encode,
    journal_folder,
    label_of,
    numbers,
    read_journal,
    track_cell,
    value_of,
)
from farfield.registry import old_names

__all__ = [
    "FOLDER",
    "JOURNAL",
    "Cell",
    "CellEdit",
    "CellState",
    "EditState",
    "Edited",
    "Record",
    "Replay",
    "box_cell",
    "decode",
    "encode",
    "journal_folder",
    "label_of",
    "numbers",
    "read_journal",
    "track_cell",
    "value_of",
]

if not TYPE_CHECKING:
    __getattr__ = old_names(__name__, Change="CellEdit", State="EditState", Standing="CellState")
