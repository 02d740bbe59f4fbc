"""``farfield train``."""

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from farfield.cli._output import check_outputs, console, leave_card, would_write
from farfield.cli._training_report import BarReport, LineReport
from farfield.vocabulary.counts import count_of

if TYPE_CHECKING:
    from farfield.experiments.schema import Experiment


def run(
    experiment: tyro.conf.Positional[str],
    override: Annotated[tyro.conf.UseAppendAction[list[str]], tyro.conf.arg(aliases=["-o"])],
    out: Path = Path("runs"),
    dry_run: bool = False,
) -> int:
    """Train a detector from one experiment; run the same command again to resume.

    examples:
      farfield train pointpillars-cirrus-sim --dry-run
      farfield train pointpillars-cirrus-sim -o training.steps=500 -o name=short
      farfield train my-experiment.yaml -o data.path=/data/Cirrus_dataset1
      farfield train my-experiment.yaml -o training.start_from=runs/other --dry-run
      torchrun --nproc-per-node 2 -m farfield.cli train pointpillars-cirrus-sim

    The run's folder OUT/NAME holds experiment.yaml (every setting), log.jsonl, checkpoint.pt and, at the end,
    weights.safetensors and course.html, a page of curves and warnings; `farfield report OUT/NAME` writes the page of a
    run in progress. A killed run resumes from its checkpoint to the same weights; Ctrl-C writes a checkpoint. A larger
    training.steps prolongs a finished run; training.validation scores it on held-out frames and keeps the best weights.
    Several processes, torchrun's or those of training.devices, share each batch and train as one would.

    Args:
        experiment: A shipped experiment's name, as `farfield experiments` lists them, or a YAML file.
        override: Change one setting, as key.key=value; may be given several times.
        out: Folder of all runs.
        dry_run: Say what would be learnt from, what would be taken of the weights to start from, which parts learn how
            fast, and where it would be written, and write nothing.
    """
    from farfield.experiments.catalogue import find
    from farfield.experiments.plan import Plan
    from farfield.experiments.schema import load_experiment

    settings = load_experiment(find(experiment), override)
    terminal = console(stderr=True)
    training = settings.training
    kind = BarReport if terminal.is_terminal else LineReport
    folder = out / settings.name
    plan = Plan(settings, folder)
    groups = settings.data.values() if isinstance(settings.data, Mapping) else [settings.data]
    start = () if training.start is None else (training.start.weights,)
    check_outputs((experiment, *(group.path for group in groups), *start), folders={"--out": folder})
    report = kind(terminal, folder, training.log_every_steps, _following(folder, settings))
    if not dry_run:
        plan.run(report)
        data = settings.data.values() if isinstance(settings.data, Mapping) else [settings.data]
        sources = (Path(part.path) for part in data)
        leave_card(folder, "Weights of a detector, and its training", *sources, weights="".join(start))
        return 0
    plan.announce(report)
    for line in plan.dry_run():
        print(line)
    would_write(f"weights, log and checkpoints of {count_of(training.steps, 'step')}", folder)
    return 0


def _following(folder: Path, settings: "Experiment") -> str:
    """The command that evaluates the run: on the part of its data that it does not learn from, where they are split."""
    data = settings.data if not isinstance(settings.data, Mapping) else next(iter(settings.data.values()))
    words = ["farfield", "evaluate", str(folder), str(data.path)]
    validation = settings.training.validation
    if validation is not None and validation.split:
        return shlex.join([*words, "--split", validation.split])
    if data.split in ("train", "time-train"):
        return shlex.join([*words, "--split", data.split.replace("train", "val")])
    return f"{shlex.join(words)}  # these are the frames that it learnt from; others say more"
