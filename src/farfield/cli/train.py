"""``farfield train``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from rich.console import Console

    from farfield.experiment import DataConfig
    from farfield.training.loop import Training


def run(
    experiment: tyro.conf.Positional[Path],
    override: Annotated[tyro.conf.UseAppendAction[list[str]], tyro.conf.arg(aliases=["-o"])],
    out: Path = Path("runs"),
) -> int:
    """Train a detector from one YAML file; run the same command again to resume.

    examples:
      farfield train experiments/pointpillars_cirrus_sim.yaml
      farfield train experiments/pointpillars_cirrus_sim.yaml -o training.steps=500 -o name=short
      farfield train experiments/pointpillars_cirrus.yaml -o data.path=/data/Cirrus_dataset1

    The run's folder OUT/NAME holds experiment.yaml (every setting), log.jsonl, checkpoint.pt and, at the end,
    weights.safetensors. A killed run resumes from its checkpoint to the same weights.

    Args:
        experiment: The experiment's YAML file.
        override: Change one setting, as key.key=value; may be given several times.
        out: Folder of all runs.
    """
    import json

    from rich.console import Console
    from rich.progress import track

    from farfield.api import prepare_training
    from farfield.experiment import dump_experiment, load_experiment
    from farfield.files.atomic import write_text

    console = Console(stderr=True)
    settings = load_experiment(experiment, override)
    _simulate_if_absent(settings.data)
    folder = out / settings.name
    folder.mkdir(parents=True, exist_ok=True)
    training = prepare_training(
        settings, folder, progress=lambda items: track(list(items), "cutting out objects", console=console)
    )
    write_text(folder / "experiment.yaml", dump_experiment(settings))
    write_text(folder / "provenance.json", json.dumps(training.provenance, indent=1))
    weights = _train(training, console)
    console.print(f"weights: {weights}\nnext: farfield evaluate {folder} DATA")
    return 0


def _simulate_if_absent(data: "DataConfig") -> None:
    """Make the simulated data set that the experiment describes, where its path holds nothing yet."""
    begun = (data.path / "simulation.json").is_file()  # then the rest is simulated, or nothing is missing
    if data.simulate is None or (data.path.exists() and not begun):
        return
    from farfield.cli import simulate

    wanted = data.simulate
    frames = wanted.sequences * wanted.frames
    simulate.run(
        wanted.preset,
        data.path,
        frames=frames,
        sequences=wanted.sequences,
        sensors=wanted.sensors,
        seed=wanted.seed,
        cache=True,
    )


def _train(training: "Training", console: "Console") -> Path:
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
