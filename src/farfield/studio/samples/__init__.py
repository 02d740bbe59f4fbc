"""Two small simulated frames that ship with Farfield: one in the layout of Cirrus, one in that of K-Radar."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from farfield.datasets import open_dataset
from farfield.datasets.base import Dataset
from farfield.frame import Annotation, Frame

HERE = Path(__file__).resolve().parent
WORLDS = ("cirrus", "kradar")


class Samples(Dataset):
    """The frames that ship, of both worlds in one data set; each keeps its own coordinates.

    Args:
        parts: Data sets, whose frames follow each other.
        root: Folder that is shown as theirs.
    """

    name = "samples"

    def __init__(self, parts: Sequence[Dataset], root: Path = HERE) -> None:
        self.root, self.parts = root, tuple(parts)
        self._places = [(part, index) for part in self.parts for index in range(len(part))]
        self.sequences = tuple(f"{part.name}-{part.sequences[index]}" for part, index in self._places)
        self.frame_ids = tuple(part.frame_ids[index] for part, index in self._places)

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        part, row = self._places[index]
        return replace(part.frame(row), sequence=self.sequences[index], simulated=True)

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``."""
        part, row = self._places[index]
        return part.files(row)

    def annotation(self, index: int) -> Annotation | None:
        """What was annotated in frame ``index``."""
        part, row = self._places[index]
        return part.annotation(row)

    def has_annotation(self, index: int) -> bool:
        """Whether frame ``index`` was annotated."""
        part, row = self._places[index]
        return part.has_annotation(row)


def open_samples(**options: Any) -> Samples:
    """Open them; options are those of the readers."""
    return Samples([open_dataset(HERE / world, **options) for world in WORLDS])
