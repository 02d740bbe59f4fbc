"""Edits of annotations: a journal of lines, the state that they add up to, and where the journal stands."""

from farfield.datasets.edits.edited import Edited
from farfield.datasets.edits.places import FOLDER, JOURNAL, journal_folder
from farfield.datasets.edits.reading import Replay, read_journal
from farfield.datasets.edits.records import Cell, CellEdit, Record, box_cell, decode, encode, track_cell
from farfield.datasets.edits.state import CellState, EditState
from farfield.datasets.edits.values import label_of, numbers, value_of

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
