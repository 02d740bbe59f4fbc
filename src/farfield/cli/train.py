"""``farfield train``."""

import os
import time
from collections.abc import Callable
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from farfield.cli._progress import bar
from farfield.errors import ConfigError

if TYPE_CHECKING:
    from rich.console import Console

    from farfield.training.loop import Training


def run(
    experiment: tyro.conf.Positional[str],
    override: Annotated[tyro.conf.UseAppendAction[list[str]], tyro.conf.arg(aliases=["-o"])],
    out: Path = Path("runs"),
) -> int:
    """Train a detector: a shipped experiment, or one YAML file; run the same command again to resume.

    examples:
      farfield train pointpillars-cirrus-sim
      farfield train pointpillars-cirrus-sim -o training.steps=500 -o name=short
      farfield train pointpillars-cirrus -o data.path=/data/Cirrus_dataset1
      farfield train mine.yaml
      torchrun --nproc-per-node 2 -m farfield.cli train pointpillars-cirrus-sim

    The run's folder OUT/NAME holds experiment.yaml (every setting), log.jsonl, checkpoint.pt and, at the end,
    weights.safetensors. A killed run resumes from its checkpoint to the same weights. Several processes, torchrun's or
    those of training.devices, share each batch and follow the course of one.

    Args:
        experiment: Name of a shipped experiment (farfield experiments lists them), or a YAML file.
        override: Change one setting, as key.key=value; may be given several times.
        out: Folder of all runs.
    """
    import json

    from rich.console import Console
    from rich.progress import track

    from farfield.api import prepare_training
    from farfield.experiments.catalogue import find
    from farfield.experiments.schema import dump_experiment, load_experiment
    from farfield.files.atomic import write_text
    from farfield.recording import ensure

    first = _is_first_process()
    console = Console(stderr=True, quiet=not first)
    settings = load_experiment(find(experiment), override)
    if first:
        simulating = partial(bar, what="simulating", transient=True)
        ensure(settings.data.simulate, settings.data.path, simulating, print)  # the others wait in prepare_training
    if not settings.data.path.exists():
        raise ConfigError(
            f"{settings.data.path}: expected a data set's folder, found nothing. Name it: farfield train {experiment} "
            "-o data.path=FOLDER"
        )
    folder = out / settings.name
    training = prepare_training(
        settings, folder, progress=lambda items: track(list(items), "reading frames", console=console)
    )
    if first:
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / "experiment.yaml", dump_experiment(settings))
        write_text(folder / "provenance.json", json.dumps(training.provenance, indent=1))
    weights = _train(training, console)
    console.print(f"weights: {weights}\nnext: farfield evaluate {folder} DATA")
    return 0


def _is_first_process() -> bool:
    """Whether this is the process that prints and writes, by what torchrun or Lightning Fabric tell the others."""
    return os.environ.get("RANK", os.environ.get("LOCAL_RANK", "0")) == "0"


def _train(training: "Training", console: "Console") -> Path:
    """Train with a progress bar, or, where nobody watches a terminal, with plain lines now and then."""
    if console.quiet:
        return training.run()
    if not console.is_terminal:
        return training.run(_plain_lines(training, console))
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
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("training", total=training.config.steps, status="")

        def report(step: int, losses: dict[str, float]) -> None:
            progress.update(task, completed=step, status=" ".join(f"{k} {v:.3f}" for k, v in losses.items()))

        return training.run(report)


def _plain_lines(training: "Training", console: "Console") -> Callable[[int, dict[str, float]], None]:
    """Report the first step and those that are logged, a line each: a log file takes no moving bar."""
    config, started = training.config, time.monotonic()
    first: list[tuple[int, float]] = []

    def report(step: int, losses: dict[str, float]) -> None:
        now = time.monotonic()
        if not first:
            first.append((step, now))
        elif step % config.log_every_steps and step != config.steps:
            return
        begun, since = first[0]
        left_s = (now - since) / max(step - begun, 1) * (config.steps - step)
        left = f", {timedelta(seconds=round(left_s))} left" if step > begun else ""
        parts = " ".join(f"{name} {value:.3f}" for name, value in losses.items())
        elapsed = timedelta(seconds=round(now - started))
        console.print(f"step {step}/{config.steps}: {parts}, {elapsed} elapsed{left}", soft_wrap=True, highlight=False)

    return report
