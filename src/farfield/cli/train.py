"""``farfield train``."""

import time
from collections.abc import Iterable
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from farfield.training.report import Report

if TYPE_CHECKING:
    from rich.console import Console


def run(
    experiment: tyro.conf.Positional[str],
    override: Annotated[tyro.conf.UseAppendAction[list[str]], tyro.conf.arg(aliases=["-o"])],
    out: Path = Path("runs"),
) -> int:
    """Train a detector from one experiment; run the same command again to resume.

    examples:
      farfield train pointpillars-cirrus-sim
      farfield train pointpillars-cirrus-sim -o training.steps=500 -o name=short
      farfield train my-experiment.yaml -o data.path=/data/Cirrus_dataset1
      torchrun --nproc-per-node 2 -m farfield.cli train pointpillars-cirrus-sim

    The run's folder OUT/NAME holds experiment.yaml (every setting), log.jsonl, checkpoint.pt and, at the end,
    weights.safetensors. A killed run resumes from its checkpoint to the same weights. Several processes, torchrun's or
    those of training.devices, share each batch and follow the course of one.

    Args:
        experiment: A shipped experiment's name, as `farfield experiments` lists them, or a YAML file.
        override: Change one setting, as key.key=value; may be given several times.
        out: Folder of all runs.
    """
    from rich.console import Console

    from farfield.experiments.catalogue import find
    from farfield.experiments.plan import Plan
    from farfield.experiments.schema import load_experiment

    settings = load_experiment(find(experiment), override)
    console = Console(stderr=True)
    training = settings.training
    kind = BarReport if console.is_terminal else LineReport
    Plan(settings, out / settings.name).run(kind(console, out / settings.name, training.log_every_steps))
    return 0


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
