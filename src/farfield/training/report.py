"""What a running training reports, and to whom: nothing by default."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from farfield.registry import take_old_methods


class TrainingReport:
    """Receives the course of a training, in the first process only; a subclass shows what it likes."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        take_old_methods(cls, begins="on_train_start", ends="on_train_end")

    def reading(self, numbers: Iterable[int], what: str) -> Iterable[int]:
        """Wrap the numbers of frames that are read or simulated before the first step, to show progress."""
        del what
        return numbers

    def say(self, text: str) -> None:
        """A line for the user."""

    def on_train_start(self, step: int, steps: int) -> None:
        """The first step is about to be taken: ``step`` are done, of ``steps``."""

    def step(self, step: int, losses: dict[str, float]) -> None:
        """A step is done; ``step`` counts from 1."""

    def on_train_end(self, weights: Path | None) -> None:
        """The weights are written, or, without any, the training was interrupted."""
