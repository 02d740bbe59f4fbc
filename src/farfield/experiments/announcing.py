"""What a training is about to do, in a few lines, before it does it."""

from collections.abc import Iterator, Mapping
from pathlib import Path

from farfield.datasets import Dataset
from farfield.detectors.network import Network
from farfield.experiments.schema import DataConfig, Experiment
from farfield.training.config import TrainingConfig
from farfield.training.loop import CHECKPOINT_NAME
from farfield.training.processes import kind_of_device, precision_of


def lines_of(
    experiment: Experiment, folder: Path, network: Network, data: Mapping[str, Dataset | DataConfig]
) -> Iterator[str]:
    """The detector, the data, the steps, where, and whether a run goes on.

    Args:
        experiment: What is trained.
        folder: The run's folder.
        network: Its network.
        data: The frames of each stream, or, of simulated ones, what they are to be.
    """
    size = sum(parameter.numel() for parameter in network.parameters())
    method = experiment.method.name
    how = "" if method == "supervised" else f" by the method {method}"
    yield (
        f"trains {experiment.detector.name} ({size / 1e6:.2f} M parameters) to {experiment.detector.reach_m:g} m{how}; "
        f"classes {', '.join(experiment.detector.class_names)}"
    )
    for name, each in data.items():
        of = f" of the stream {name}" if len(data) > 1 else ""
        yield f"data{of}: {_planned(each) if isinstance(each, DataConfig) else _opened(each)}"
    frames = [len(each) for each in data.values() if isinstance(each, Dataset)]
    yield from _course(experiment.training, sum(frames) if len(frames) == len(data) else 0)
    goes_on = (folder / CHECKPOINT_NAME).is_file()
    yield f"run: {folder}, {'which goes on from its checkpoint' if goes_on else 'which begins'}"


def _opened(data: Dataset) -> str:
    drives = len(set(data.sequences))
    return f"{data.root} ({data.name}), {len(data):,} frames of {drives} {'drive' if drives == 1 else 'drives'}"


def _planned(config: DataConfig) -> str:
    wanted = config.simulate
    assert wanted is not None
    there = "simulated before" if config.path.is_dir() else "which is not there and is simulated first"
    return f"{config.path}, {there}: {wanted.preset}, {wanted.sequences} drives of {wanted.frames} frames"


def _course(training: TrainingConfig, frames: int) -> Iterator[str]:
    passes = f", {training.steps * training.batch_size / frames:.1f} passes over the data" if frames else ""
    yield (
        f"{training.steps:,} steps of {training.batch_size} frames{passes}, learning rate up to "
        f"{training.learning_rate:g}, {precision_of(training)} on the {kind_of_device(training)}, seed {training.seed}"
    )
    if training.start is not None:
        yield f"starts from {training.start.weights}"
    if (looks := training.validation) is not None:
        which = f"of the split {looks.split}" if looks.split else "held out"
        yield f"validation every {looks.every_steps} steps on {looks.frames} frames {which}; the best weights are kept"
