"""Edits of annotations: a journal of lines, the state that they add up to, and where the journal stands."""

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
