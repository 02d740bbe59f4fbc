"""The boxes of one side, predicted or annotated, while its files are read."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from farfield.errors import ConfigError
from farfield.files.kitti import KittiObjects
from farfield.frame.drive import Key
from farfield.geometry.boxes import Boxes
from farfield.metrics.frames import check_crowd
from farfield.metrics.sanity import beyond_a_turn


@dataclass(eq=False)
class BoxSide:
    """The boxes of one side, predicted or annotated, as they are read.

    Args:
        scored: Whether these are predictions, whose scores count.
        class_names: Names of numbered classes, for files that name none.
        boxes: By (sequence, frame).
        details: Rows beside them.
        texts: KITTI's rows by file and frame, whose axes are decided once all are read.
        without_score: How many predictions have none.
        scored_rows: How many annotated boxes have one.
        headings: How many headings lie beyond a turn, of how many.
        reference: Coordinates that the files name.
        ego_m: Where the car stood, by frame.
        notes: What was assumed.
    """

    scored: bool
    class_names: tuple[str, ...] = ()
    boxes: dict[Key, Boxes] = field(default_factory=dict)
    details: dict[Key, dict[str, np.ndarray]] = field(default_factory=dict)
    texts: list[tuple[Path, Key, KittiObjects]] = field(default_factory=list)
    without_score: int = 0
    scored_rows: int = 0
    headings: tuple[int, int] = (0, 0)
    reference: str = ""
    ego_m: dict[Key, np.ndarray] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def stands_in(self, path: Path, reference: str) -> None:
        """Note the coordinates that a file names."""
        if self.reference and reference and self.reference != reference:
            raise ConfigError(
                f"{path}: expected boxes in the coordinates of {self.reference}, as in the files before; they stand in "
                f"those of {reference}"
            )
        self.reference = self.reference or reference

    def add(self, path: Path, key: Key, boxes: Boxes, details: dict[str, np.ndarray] | None = None) -> None:
        """Take the boxes of a frame.

        Raises:
            ConfigError: If the frame has boxes already, or too many.
        """
        if key in self.boxes:
            raise ConfigError(f"{path}: expected each frame in one file, got {key} for the second time")
        check_crowd(f"{path}, frame {key}", len(boxes))
        self.boxes[key] = boxes
        if details is not None:
            self.details[key] = details

    def turned(self, yaw_rad: np.ndarray) -> None:
        """Note the headings of a file as they stand there: boxes keep them modulo a turn."""
        beyond, total = self.headings
        self.headings = (beyond + beyond_a_turn(yaw_rad), total + len(yaw_rad))

    def scores(self, score: np.ndarray | None, count: int) -> np.ndarray | None:
        """Scores for predictions (1 where the file has none), None for annotated boxes."""
        if not self.scored:
            self.scored_rows += 0 if score is None else count
            return None
        if score is None:
            self.without_score += count
            return np.ones(count)
        return score
