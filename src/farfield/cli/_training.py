"""The course of a training on the error stream: lines for a log file, a moving bar for a terminal."""

import time
from collections.abc import Iterable
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farfield.training.report import Report

if TYPE_CHECKING:
    from rich.console import Console


class LineReport(Report):
    """Plain lines, the first step and those that are logged: a log file takes no moving bar.

    Args:
        console: Where to.
        folder: The run's folder.
        every: Steps between lines.
    """

    def __init__(self, console: "Console", folder: Path, every: int) -> None:
        self.console, self.folder, self.every = console, folder, every
        self.steps, self.started = 0, time.monotonic()
        self.first: tuple[int, float] | None = None

    def reading(self, numbers: Iterable[int], what: str) -> Iterable[int]:
        """With a progress bar."""
        from rich.progress import track

        return track(list(numbers), what, console=self.console)

    def say(self, text: str) -> None:
        """Print it."""
        self.console.print(text, soft_wrap=True, highlight=False)

    def begins(self, step: int, steps: int) -> None:
        """Start the clock."""
        del step
        self.steps, self.started = steps, time.monotonic()

    def step(self, step: int, losses: dict[str, float]) -> None:
        """A line now and then."""
        now = time.monotonic()
        if self.first is None:
            self.first = step, now
        elif step % self.every and step != self.steps:
            return
        begun, since = self.first
        left_s = (now - since) / max(step - begun, 1) * (self.steps - step)
        left = f", {timedelta(seconds=round(left_s))} left" if step > begun else ""
        parts = " ".join(f"{name} {value:.3f}" for name, value in losses.items())
        self.say(f"step {step}/{self.steps}: {parts}, {timedelta(seconds=round(now - self.started))} elapsed{left}")

    def ends(self, weights: Path | None) -> None:
        """Name the weights and what to do with them."""
        if weights is not None:
            self.say(f"weights: {weights}\nnext: farfield evaluate {self.folder} DATA")


class BarReport(LineReport):
    """A moving bar with the losses and the time left."""

    def begins(self, step: int, steps: int) -> None:
        """Show the bar."""
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        columns = (
            TextColumn("training"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[status]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(elapsed_when_finished=True),
        )
        self.progress: Any = Progress(*columns, console=self.console)
        self.task = self.progress.add_task("training", total=steps, completed=step, status="")
        self.progress.start()

    def step(self, step: int, losses: dict[str, float]) -> None:
        """Move the bar."""
        status = " ".join(f"{name} {value:.3f}" for name, value in losses.items())
        self.progress.update(self.task, completed=step, status=status)

    def ends(self, weights: Path | None) -> None:
        """Leave the bar and name the weights."""
        self.progress.stop()
        super().ends(weights)
