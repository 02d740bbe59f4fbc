"""From an experiment to a run: data, network, method, samples, loop."""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from farfield.adaptation.failure_modes import signs_of
from farfield.datasets import Dataset, open_dataset
from farfield.datasets.maps import Sweeps
from farfield.detectors import build_detector
from farfield.errors import ConfigError, DatasetError, plain
from farfield.experiments.announcing import lines_of
from farfield.experiments.schema import DataConfig, Experiment, dump_experiment
from farfield.files.atomic import write_text
from farfield.frame.provenance import environment
from farfield.simulation.recording import ensure
from farfield.training.loop import CHECKPOINT_NAME, Training
from farfield.training.method import DETECTOR, METHODS, Method, Stream
from farfield.training.param_groups import described, frozen_names, frozen_now
from farfield.training.processes import launch
from farfield.training.report import TrainingReport
from farfield.training.samples import TrainingSamples
from farfield.training.transfer import TransferReport, start_network
from farfield.training.validating import Validation, spread

LOG_NAME = "log.jsonl"
START_NAME = "start.json"
"""In a run's folder: what was taken of the weights that it started from."""


@dataclass(frozen=True)
class Plan:
    """What a run will do. It pickles, and neither reads, writes nor launches anything before :meth:`run`.

    Args:
        experiment: What to train, and how.
        folder: The run's folder.
        data: Frames of streams that are open already, as they are to be trained on; those of the others are opened.
    """

    experiment: Experiment
    folder: Path
    data: Mapping[str, Dataset] = field(default_factory=dict)

    def run(self, report: TrainingReport | None = None) -> Path:
        """Start or join the processes, make what data are to be simulated, and train; a run that stopped goes on.

        Args:
            report: Is informed of the course, in the first process.

        Returns:
            The path of the weights.

        Raises:
            DatasetError: If data are not there, or hold none of the clouds or classes asked for.
            ConfigError: If the method's streams and the experiment's data do not fit.
        """
        experiment = self.experiment
        fabric = launch(experiment.training)
        report = report if report is not None and fabric.is_global_zero else TrainingReport()
        if fabric.is_global_zero:
            self.announce(report)
            for config in (config for name, config in _groups(experiment).items() if name not in self.data):
                ensure(config.simulate, config.path, partial(report.reading, what="simulating"), report.say)
        fabric.barrier()
        method, start = _method(experiment, fresh=not (self.folder / CHECKPOINT_NAME).is_file())
        configs = _configs(experiment, method)
        data = {
            name: self.data[name] if name in self.data else _opened(configs[name], stream, experiment)
            for name, stream in method.streams.items()
        }
        data, validation = self._validation(data, configs, method)
        parts = {name: held_out(each, method.held_out) for name, each in data.items()}
        data = {name: trained for name, (trained, _) in parts.items()}
        training = Training(
            method,
            {name: self._samples(method, name, data[name], configs[name]) for name in method.streams},
            experiment.training,
            self.folder,
            {**_provenance(experiment, data, configs), **self._started(start)},
            fabric=fabric,
            held={
                name: self._samples(method, name, held, configs[name], held=True)
                for name, (_, held) in parts.items()
                if held is not None
            },
            validation=validation,
        )
        training.check()
        if fabric.is_global_zero:
            self.folder.mkdir(parents=True, exist_ok=True)
            if start is not None:
                write_text(self.folder / START_NAME, json.dumps(start.to_json(), indent=1) + "\n")
                for line in start.lines():
                    report.say(line)
            write_text(self.folder / "experiment.yaml", dump_experiment(experiment))
            write_text(self.folder / "provenance.json", json.dumps(training.provenance, indent=1))
        weights = training.run(report)
        if fabric.is_global_zero and experiment.method.name != "supervised":  # which has nothing that goes wrong so
            for text in signs_of(logged(self.folder)):
                report.say(f"note: {text}")
        return weights

    def announce(self, report: TrainingReport) -> None:
        """Say what the run is about to do; errors are those of :meth:`run` that can be told without simulating."""
        method, _ = _method(self.experiment, fresh=False)
        configs = _configs(self.experiment, method)
        data: dict[str, Dataset | DataConfig] = {
            name: self.data[name]
            if name in self.data
            else (configs[name] if configs[name].simulate else _opened(configs[name], stream, self.experiment))
            for name, stream in method.streams.items()
        }
        for line in lines_of(self.experiment, self.folder, method.modules[DETECTOR], data):
            report.say(line)

    def _validation(
        self, data: Mapping[str, Dataset], configs: Mapping[str, DataConfig], method: Method
    ) -> tuple[dict[str, Dataset], Validation | None]:
        """The frames that are trained on, and those of the first labelled stream that are scored meanwhile."""
        wanted, training = self.experiment.training.validation, self.experiment.training
        if wanted is None:
            return dict(data), None
        name = next((name for name, stream in method.streams.items() if stream.labelled), None)
        if name is None:
            raise ConfigError(f"training.validation: the method {self.experiment.method.name} has no labelled stream.")
        config, data = configs[name], dict(data)
        if wanted.split:
            other = config.model_copy(update={"split": wanted.split})
            frames = spread(_opened(other, method.streams[name], self.experiment), wanted.frames)
        else:
            data[name], held = held_out(data[name], wanted.frames)
            assert held is not None
            frames = held
        cloud = config.clouds[0] if isinstance(config.clouds, tuple) else None
        validation = Validation(
            frames=frames,
            every_steps=wanted.every_steps,
            cloud=cloud,
            aliases=config.aliases,
            precision=training.precision,
        )
        validation.check(self.experiment.detector.class_names)
        return data, validation

    def rehearse(self) -> list[str]:
        """What would be taken of the weights to start from, and what each part of the network would do; reads no data.

        Returns:
            Lines for the user.

        Raises:
            ConfigError: As :meth:`run` would before its first step.
        """
        method, start = _method(self.experiment, fresh=True)
        lines = [] if start is None else list(start.lines())
        network, training = method.modules[DETECTOR], self.experiment.training
        until = {} if training.start is None else training.start.frozen_until
        held = frozen_names(network, frozen_now(until, 0, training.steps))
        trained = sum(p.numel() for name, p in network.named_parameters() if name not in held)
        lines.append(f"{training.steps} steps; the first trains {trained} parameters of the detector")
        return [*lines, *(f"  {line}" for line in described(network, training))]

    def _started(self, start: TransferReport | None) -> dict[str, Any]:
        """What the provenance says of the start: of a run that goes on, what it wrote when it began."""
        if start is not None:
            return {"start": start.brief()}
        path = self.folder / START_NAME
        if self.experiment.training.start is None or not path.is_file():
            return {}
        said = json.loads(path.read_text(encoding="utf-8"))
        return {"start": {name: said[name] for name in ("weights", "sha256", "share")}}

    def _samples(
        self, method: Method, name: str, data: Dataset, config: DataConfig, *, held: bool = False
    ) -> TrainingSamples:
        """The samples of a stream; those of held-out frames come as they are, each once."""
        network, training = method.modules["detector"], self.experiment.training
        return TrainingSamples(
            data,
            inputs=network.inputs,
            clouds=config.clouds,
            classes=self.experiment.detector.class_names,
            assigner=network.assigner,
            augmentation=self.experiment.augmentation,
            min_points=training.min_points,
            seed=training.seed,
            aliases=config.aliases,
            far_sampling=0.0 if held else training.far_sampling,
            far_from_m=training.far_from_m,
            name=name,
            stream=replace(method.streams[name], changed=False) if held else method.streams[name],
        )


def logged(folder: Path) -> list[dict[str, float | int]]:
    """The rows of a run's log by step; of steps that a resumed run took again, the last ones."""
    path = folder / LOG_NAME
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    rows = {row["step"]: row for row in map(json.loads, lines)}
    return [rows[step] for step in sorted(rows)]


def _groups(experiment: Experiment) -> dict[str, DataConfig]:
    """The experiment's data by stream; the only one has no name yet."""
    return {"": experiment.data} if isinstance(experiment.data, DataConfig) else dict(experiment.data)


def _method(experiment: Experiment, *, fresh: bool) -> tuple[Method, TransferReport | None]:
    """The method with its network; a fresh run's network takes the weights to start from."""
    network = build_detector(experiment.detector, seed=experiment.training.seed)  # and what the method makes, with it
    kind, start = METHODS[experiment.method.name], experiment.training.start
    found = start_network(network, start.weights, start) if start is not None and fresh else None
    try:
        return kind(network, **experiment.method.settings), found
    except TypeError as error:
        raise ConfigError(f"method {experiment.method.name}: a setting does not fit: {plain(error)}") from error


def _configs(experiment: Experiment, method: Method) -> dict[str, DataConfig]:
    """Data of each stream of the method."""
    groups, names = _groups(experiment), tuple(method.streams)
    if isinstance(experiment.data, DataConfig) and len(names) == 1:
        return {names[0]: experiment.data}
    if set(groups) != set(names):
        given = ", ".join(groups) if not isinstance(experiment.data, DataConfig) else "one data set without a name"
        raise ConfigError(f"method {experiment.method.name}: expected data for {', '.join(names)}; got {given}.")
    return groups


def _opened(config: DataConfig, stream: Stream, experiment: Experiment) -> Dataset:
    """The frames of a stream as they are trained on.

    Raises:
        DatasetError: If they lack a cloud, or a labelled stream has frames without annotation.
    """
    if not config.path.is_dir():
        raise DatasetError(
            f"{experiment.name}: expected its data in {config.path}, found no folder there. Name where they are: "
            f"farfield train {experiment.name} -o data.path=FOLDER"
        )
    data = open_dataset(config.path, **config.options)
    data = data.mapped(Sweeps(config.sweeps)) if config.sweeps > 1 else data
    if config.split:
        data = data.split(config.split)
    data = part_of(data, config.part, config.part_draw) if config.part != (0.0, 1.0) else data
    wanted = config.clouds if isinstance(config.clouds, tuple) else sum(config.clouds.values(), ())
    missing = [name for name in wanted if name not in data[0].clouds]
    if missing:
        raise DatasetError(f"{data.root}: expected the clouds {missing}; its frames hold {list(data[0].clouds)}.")
    return annotated_frames(data, experiment.training.unannotated) if stream.labelled else data


def part_of(data: Dataset, part: tuple[float, float], draw: int = 0) -> Dataset:
    """The frames of a part of the sequences, whole ones; smaller parts that begin alike lie in larger ones.

    Args:
        data: The frames.
        part: From where to where in the drawn order of the sequences, shares of their number.
        draw: Draws the order, by the sequences' names alone.

    Raises:
        DatasetError: If no sequence falls into the part.
    """
    names = sorted({sequence for sequence, _ in data.keys})
    names.sort(key=lambda name: hashlib.sha256(f"{draw}:{name}".encode()).digest())
    first, last = (math.floor(share * len(names) + 0.5) for share in part)
    kept = set(names[first:last])
    if not kept:
        raise DatasetError(
            f"{data.root}: expected at least one of its {len(names)} sequences in the part {part[0]:g} to {part[1]:g}; "
            "got none. Take a larger part."
        )
    return data.select([index for index, (sequence, _) in enumerate(data.keys) if sequence in kept])


def held_out(data: Dataset, count: int) -> tuple[Dataset, Dataset | None]:
    """Part frames into those that are trained on and some that are not.

    Whole sequences are held out where there are others: neighbouring frames look alike. Of a single sequence it is its
    end.

    Args:
        data: The frames.
        count: How many to hold out; 0 holds out none.

    Raises:
        DatasetError: If that leaves no frame to train on.
    """
    if not count:
        return data, None
    names = sorted(set(data.sequences), key=lambda name: hashlib.sha256(f"held:{name}".encode()).digest())
    taken: set[str] = set()
    for name in names[:-1]:
        if sum(sequence in taken for sequence in data.sequences) < count:
            taken.add(name)
    held = [index for index, sequence in enumerate(data.sequences) if sequence in taken]
    if len(held) < count:
        held = list(range(len(data)))[-count:]
    trained = [index for index in range(len(data)) if index not in set(held)]
    if not trained:
        raise DatasetError(f"{data.root}: expected more than {count} frames, to hold so many out; got {len(data)}.")
    return data.select(trained), data.select([held[place * len(held) // count] for place in range(count)])


def annotated_frames(data: Dataset, unannotated: str) -> Dataset:
    """The frames that were annotated; those without any box were, those without an annotation were not.

    Args:
        data: The frames.
        unannotated: ``"refuse"`` or ``"skip"``.

    Raises:
        DatasetError: If there are frames without annotation and they are refused, or if no frame has one.
    """
    kept = [index for index in range(len(data)) if data.has_annotation(index)]
    lacking = len(data) - len(kept)
    if lacking and unannotated == "refuse":
        raise DatasetError(
            f"{data.root}: {lacking} of {len(data)} frames have no annotation and would train as empty ones. "
            "Set training.unannotated=skip to leave them out, or name a split or folder of annotated ones."
        )
    if not kept:
        raise DatasetError(f"{data.root}: expected annotated frames to train on, found none.")
    return data.select(kept) if lacking else data


def _provenance(experiment: Experiment, data: dict[str, Dataset], configs: dict[str, DataConfig]) -> dict[str, Any]:
    """What travels in every checkpoint and in the weights: experiment, data, environment."""
    streams = {
        name: {
            "data_fingerprint": each.fingerprint(),
            "frames": len(each),
            "clouds": configs[name].clouds,
            "recipe": each.recipe,
        }
        for name, each in data.items()
    }
    first = next(iter(streams.values()))
    return {
        "experiment": experiment.model_dump(mode="json"),
        "data_fingerprint": first["data_fingerprint"],
        "frames": first["frames"],
        "streams": streams,
        "environment": environment(),
    }
