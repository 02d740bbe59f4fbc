"""The course of a training on the error stream: lines for a log file, a moving bar for a terminal."""

import time
from collections import deque
from collections.abc import Iterable
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farfield.cli._output import bar
from farfield.training.report import TrainingReport
from farfield.vocabulary.counts import count_of

if TYPE_CHECKING:
    from rich.console import Console


class LineReport(TrainingReport):
    """Plain lines, the first step and those that are logged: a log file takes no moving bar.

    Args:
        console: Where to.
        folder: The run's folder.
        every: Steps between lines; losses are means over as many.
        following: The command to run next, which is printed at the end.
    """

    def __init__(self, console: "Console", folder: Path, every: int, following: str = "") -> None:
        self.console, self.folder, self.every, self.following = console, folder, every, following
        self.recent: deque[dict[str, float]] = deque(maxlen=every)
        self.steps, self.started = 0, time.monotonic()
        self.first: tuple[int, float] | None = None

    def reading(self, numbers: Iterable[int], what: str) -> Iterable[int]:
        """With a progress bar."""
        return bar(numbers, what)

    def say(self, text: str) -> None:
        """Print it."""
        self.console.print(text, soft_wrap=True)

    def on_train_start(self, step: int, steps: int) -> None:
        """Start the clock; a run that goes on says so."""
        self.steps, self.started = steps, time.monotonic()
        self.recent.clear()
        if step >= steps:
            self.say(f"all {count_of(steps, 'step is', 'steps are')} done")
        elif step:
            self.say(f"resumes after step {step} of {steps} ({self.folder / 'checkpoint.pt'})")

    def step(self, step: int, losses: dict[str, float]) -> None:
        """A line now and then."""
        self.recent.append(losses)
        now = time.monotonic()
        if self.first is None:
            self.first = step, now
        elif step % self.every and step != self.steps:
            return
        begun, since = self.first
        left_s = (now - since) / max(step - begun, 1) * (self.steps - step)
        left = f", {timedelta(seconds=round(left_s))} left" if step > begun else ""
        elapsed = timedelta(seconds=round(now - self.started))
        self.say(f"step {step}/{self.steps}: {self.means}, {elapsed} elapsed{left}")

    @property
    def means(self) -> str:
        """Each loss on average over the last steps."""
        names = dict.fromkeys(name for losses in self.recent for name in losses)
        values = {name: [losses[name] for losses in self.recent if name in losses] for name in names}
        return " ".join(f"{name} {sum(numbers) / len(numbers):.3f}" for name, numbers in values.items())

    def on_train_end(self, weights: Path | None) -> None:
        """Write the run's page; name it, the weights, and what to do with them."""
        if weights is not None:
            from farfield.experiments.course import course_of

            self.say(f"weights: {weights}")
            self.say(f"report: {course_of(self.folder)}")
            if self.following:
                self.say(f"next: {self.following}")


class BarReport(LineReport):
    """A moving bar with the losses and the time left."""

    def on_train_start(self, step: int, steps: int) -> None:
        """Show the bar."""
        super().on_train_start(step, steps)
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
            TextColumn("{task.fields[status]}", markup=False),
            TimeElapsedColumn(),
            TimeRemainingColumn(elapsed_when_finished=True),
        )
        self.progress: Any = Progress(*columns, console=self.console)
        self.task = self.progress.add_task("training", total=steps, completed=step, status="")
        self.progress.start()

    def step(self, step: int, losses: dict[str, float]) -> None:
        """Move the bar."""
        self.recent.append(losses)
        self.progress.update(self.task, completed=step, status=self.means)

    def on_train_end(self, weights: Path | None) -> None:
        """Leave the bar and name the weights."""
        self.progress.stop()
        super().on_train_end(weights)
