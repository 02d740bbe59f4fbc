"""From an experiment to a run: processes, modules, data, loop."""

import json
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from farfield.adaptation.failure_modes import diagnose_log
from farfield.datasets import Dataset
from farfield.datasets.contents import frame_digests
from farfield.datasets.open_sweeps import package_places
from farfield.detectors import build_detector
from farfield.detectors.info import family_with_start, open_places
from farfield.detectors.weights import load_weights, resolve_weights
from farfield.errors import ConfigError, FileFormatError, plain
from farfield.evaluation.leakage import digests_text
from farfield.experiments.frames import held_out, open_frames, spread, without
from farfield.experiments.schema import DataConfig, Experiment, dump_experiment
from farfield.experiments.validation import Validation
from farfield.files.atomic import write_text
from farfield.files.json_text import plain_json, read_json
from farfield.frame.provenance import SIMULATION_FILE, environment
from farfield.inspection.axes_and_units import first_doubts
from farfield.jobs.folders import held
from farfield.simulation.recording import ensure, recorded_frames
from farfield.training.checkpoints import CHECKPOINT_NAME, provenance_in
from farfield.training.config import TrainingConfig
from farfield.training.loop import Training
from farfield.training.method import DETECTOR, LABELLED, METHODS, Method, network_of
from farfield.training.mixed import family_of
from farfield.training.negatives import load_negatives
from farfield.training.param_groups import describe_parts, frozen_names, frozen_now
from farfield.training.processes import fixed_choices, kind_of_device, launch, precision_of
from farfield.training.report import TrainingReport
from farfield.training.samples import TrainingSamples
from farfield.training.transfer import TransferReport, start_network
from farfield.vocabulary.classes import CLUTTER
from farfield.vocabulary.counts import count_of

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
        fingerprints: What stands for that of the frames of a stream in checkpoints and weights: a run that began on
            frames which were simulated elsewhere goes on with it.
    """

    experiment: Experiment
    folder: Path
    data: Mapping[str, Dataset] = field(default_factory=dict)
    fingerprints: Mapping[str, str] = field(default_factory=dict)

    def run(self, report: TrainingReport | None = None) -> Path:
        """Start or join the processes, make what data are to be simulated, and train; a run that stopped goes on.

        Args:
            report: Is informed of the course, in the first process.

        Returns:
            The path of the weights.

        Raises:
            DatasetError: If data are not there, or hold none of the experiment's clouds or classes.
            ConfigError: If the method's streams and the experiment's data do not fit.
        """
        fabric = launch(self._fixed())
        report = report if report is not None and fabric.is_global_zero else TrainingReport()
        with held(self.folder) if fabric.is_global_zero else nullcontext():
            experiment = self.experiment
            # The first process announces, and simulates what is not there
            if fabric.is_global_zero:
                self.announce(report)
                for config in (config for name, config in _groups(experiment).items() if name not in self.data):
                    ensure(config.simulate, config.path, partial(report.reading, what="simulating"), report.say)
            fabric.barrier()
            # Modules: the method's, which take what fits of the weights to start from
            method, transfer = self._method(fresh=not (self.folder / CHECKPOINT_NAME).is_file())
            # Data: the frames of each stream, of which some are held out
            configs = _configs(experiment, method)
            data = {
                name: self.data[name] if name in self.data else open_frames(configs[name], stream, experiment)
                for name, stream in method.streams.items()
            }
            experiment, notes = with_real_data_named(experiment, data)
            for note in notes:
                report.say(note)
            configs = _configs(experiment, method)
            if fabric.is_global_zero:  # of what was not there yet when the run was announced
                for name in (name for name in data if name not in self.data and configs[name].simulate):
                    for doubt in first_doubts(data[name]):
                        report.say(f"warning: {doubt}")
            data, validation, taken_out = self._validation(data, configs, method)
            parts = {name: held_out(frames, method.held_out) for name, frames in data.items()}
            data = {name: trained if own is None else without(trained, own) for name, (trained, own) in parts.items()}
            if empty := next((name for name, frames in data.items() if not len(frames)), None):
                raise ConfigError(
                    f"method {experiment.method.name}: all frames of the stream {empty} ({data[empty].root}) are "
                    f"copies of the {method.held_out} that the method holds out. Add frames that are no copies."
                )
            if taken_out and fabric.is_global_zero:
                report.say(f"validation: {taken_out_text(taken_out)}")
            held_frames = {name: frames for name, (_, frames) in parts.items() if frames is not None}
            # Loop
            training = Training(
                method,
                {name: self._samples(method, name, data[name], configs[name]) for name in method.streams},
                experiment.training,
                self.folder,
                {
                    **_provenance(experiment, data, configs, self.fingerprints),
                    **self._provenance_of_start(transfer),
                    **taken_out,
                },
                fabric=fabric,
                held={
                    name: self._samples(method, name, held_frames[name], configs[name], held=True)
                    for name in held_frames
                },
                score=None if validation is None else validation.score,
            )
            training.check()
            if fabric.is_global_zero:
                for name, samples in training.samples.items():
                    self._name_what_is_left_out(samples.names_left_out(), name, report)
                self.folder.mkdir(parents=True, exist_ok=True)
                if transfer is not None:
                    start = {**transfer.to_json(), **training.provenance["start"]}
                    write_text(self.folder / START_NAME, json.dumps(start, indent=1) + "\n")
                    for line in transfer.lines():
                        report.say(line)
                write_text(self.folder / "experiment.yaml", dump_experiment(experiment))
                write_text(self.folder / "provenance.json", json.dumps(training.provenance, indent=1))
            weights = training.run(report)
            if fabric.is_global_zero and experiment.method.name != "supervised":  # which has nothing that goes wrong so
                for text in diagnose_log(logged(self.folder)):
                    report.say(f"note: {text}")
            return weights

    def _name_what_is_left_out(self, names: Mapping[str, int], stream: str, report: TrainingReport) -> None:
        """Say which boxes are background to the training because nobody said what their names mean."""
        if names:
            shown = ", ".join(f"{name} ({count})" for name, count in list(names.items())[:8])
            key = "data" if stream == LABELLED else f"data.{stream}"
            report.say(
                f"note: boxes of names that are not trained count as background: {shown}. Say what they are by "
                f"-o '{key}.aliases={{{next(iter(names))}: CLASS}}' or a mapping.yaml beside the data"
            )

    def _fixed(self) -> TrainingConfig:
        """The training's settings; of a run that goes on, with what its checkpoint says that it chose."""
        return fixed_choices(self.experiment.training, provenance_in(self.folder / CHECKPOINT_NAME))

    def announce(self, report: TrainingReport) -> None:
        """Say what the run is about to do; errors are those of :meth:`run` that need no simulation to be found."""
        experiment, _ = with_real_data_named(self.experiment, {})
        training = experiment.training
        method, _ = self._method(fresh=False)
        configs = _configs(experiment, method)
        size = sum(parameter.numel() for parameter in method.modules[DETECTOR].parameters())
        how = "" if experiment.method.name == "supervised" else f" by the method {experiment.method.name}"
        detector = experiment.detector
        lines = [
            f"trains {detector.name} ({size / 1e6:.2f} M parameters) to {detector.reach_m:g} m{how}; "
            f"classes {', '.join(detector.class_names)}"
        ]
        counts: list[int] = []
        doubts: list[str] = []
        for name, stream in method.streams.items():
            of_stream = f" of the stream {name}" if len(method.streams) > 1 else ""
            if name not in self.data and configs[name].simulate is not None:
                lines.append(f"data{of_stream}: {_planned(configs[name])}")
                continue
            data = self.data[name] if name in self.data else open_frames(configs[name], stream, experiment)
            drives = len(set(data.sequences))
            counts.append(len(data))
            doubts += [f"warning{of_stream}: {doubt}" for doubt in first_doubts(data)]
            lines.append(
                f"data{of_stream}: {data.root} ({data.name}), {count_of(len(data), 'frame', spec=',')} of "
                f"{count_of(drives, 'drive')}"
            )
        frames = sum(counts) if len(counts) == len(method.streams) else 0
        passes = f", {training.steps * training.batch_size / frames:.1f} passes over the data" if frames else ""
        lines.append(
            f"{count_of(training.steps, 'step', spec=',')} of "
            f"{count_of(training.batch_size, 'frame')}{passes}, learning rate up to "
            f"{training.learning_rate:g}, {precision_of(self._fixed())} on the {kind_of_device(training)}, "
            f"seed {training.seed}"
        )
        if training.start is not None:
            lines.append(f"starts from {training.start.weights}")
        if (validation := training.validation) is not None:
            which = f"of the split {validation.split}" if validation.split else "held out"
            lines.append(
                f"validation every {count_of(validation.every_steps, 'step')} on up to "
                f"{count_of(validation.frames, 'frame')} {which}; the best "
                "weights are kept"
            )
        goes_on = (self.folder / CHECKPOINT_NAME).is_file()
        lines.append(f"run: {self.folder}, {'which goes on from its checkpoint' if goes_on else 'which begins'}")
        for line in [*lines, *doubts]:
            report.say(line)

    def dry_run(self) -> list[str]:
        """What would be taken of the weights to start from, and what each part of the network would do; reads no data.

        Returns:
            Lines for the user.

        Raises:
            ConfigError: As :meth:`run` would before its first step.
        """
        method, transfer = self._method(fresh=True)
        lines = [] if transfer is None else list(transfer.lines())
        network, training = network_of(method.modules), self.experiment.training
        until = {} if training.start is None else training.start.frozen_until
        frozen = frozen_names(network, frozen_now(until, 0, training.steps))
        trained = sum(p.numel() for name, p in network.named_parameters() if name not in frozen)
        lines.append(f"{count_of(training.steps, 'step')}; the first trains {trained} parameters of the detector")
        return [*lines, *(f"  {line}" for line in describe_parts(network, training))]

    def _method(self, *, fresh: bool) -> tuple[Method, TransferReport | None]:
        """The method with its network; a fresh run's network takes the weights to start from."""
        experiment = self.experiment
        network = build_detector(experiment.detector, seed=experiment.training.seed)  # and what the method makes too
        kind, start = METHODS[experiment.method.name], experiment.training.start
        transfer = start_network(network, start.weights, start) if start is not None and fresh else None
        try:
            return kind(network, **experiment.method.settings), transfer
        except TypeError as error:
            raise ConfigError(f"method {experiment.method.name}: a setting does not fit: {plain(error)}") from error

    def _validation(
        self, data: Mapping[str, Dataset], configs: Mapping[str, DataConfig], method: Method
    ) -> tuple[dict[str, Dataset], Validation | None, dict[str, Any]]:
        """The frames that are trained on, those of the first labelled stream that are scored meanwhile, and a record.

        No stream trains on a frame of theirs: all of the split are taken out, and copies of held-out frames.
        """
        settings = self.experiment.training.validation
        if settings is None:
            return dict(data), None, {}
        name = next((name for name, stream in method.streams.items() if stream.labelled), None)
        if name is None:
            raise ConfigError(f"training.validation: the method {self.experiment.method.name} has no labelled stream.")
        config, held = configs[name], None
        if settings.split:
            other = config.model_copy(update={"split": settings.split})
            held = open_frames(other, method.streams[name], self.experiment)
            frames, parted = held.select(spread(len(held), settings.frames)), dict(data)
        else:
            trained, held = held_out(data[name], settings.frames)
            assert held is not None
            frames, parted = held, {**data, name: trained}
        left = {stream: without(part, held) for stream, part in parted.items()}
        for stream, part in left.items():
            if not len(part):
                raise ConfigError(
                    f"training.validation: all {count_of(len(parted[stream]), 'frame')} that are trained on "
                    f"({parted[stream].root}) are validated on too. Name another data.split, another "
                    "training.validation.split, or fewer training.validation.frames."
                )
        taken_out = sum(len(part) - len(left[stream]) for stream, part in parted.items())
        validation = Validation(
            frames=frames,
            cloud=config.clouds[0] if isinstance(config.clouds, tuple) else None,
            aliases=config.aliases,
            precision=self.experiment.training.precision,
        )
        validation.check(self.experiment.detector.class_names)
        record = {
            "frames": len(frames),
            "split": settings.split,
            "taken_out": taken_out,
            "frame_digests": " ".join(frame_digests(frames)),
        }
        return left, validation, {"held_out": record}

    def _samples(
        self, method: Method, name: str, data: Dataset, config: DataConfig, *, held: bool = False
    ) -> TrainingSamples:
        """The samples of a stream; those of held-out frames come as they are, each once."""
        network, training = network_of(method.modules), self.experiment.training
        augmentation = self.experiment.augmentation
        if config.donors is not None:  # objects pasted there have the sweep's own rays; clutter has them already
            clutter = {label: count for label, count in augmentation.pasted.items() if label == CLUTTER}
            augmentation = augmentation.model_copy(update={"pasted": clutter})
        return TrainingSamples(
            data,
            inputs=network.inputs,
            clouds=config.clouds,
            classes=self.experiment.detector.class_names,
            assigner=network.assigner,
            augmentation=augmentation,
            min_points=training.min_points,
            seed=training.seed,
            aliases=config.aliases,
            far_sampling=0.0 if held else training.far_sampling,
            far_from_m=training.far_from_m,
            name=name,
            stream=replace(method.streams[name], changed=False) if held else method.streams[name],
            negatives=None if training.negatives is None else load_negatives(training.negatives).get(name),
        )

    def _provenance_of_start(self, transfer: TransferReport | None) -> dict[str, Any]:
        """What the provenance says of the start: of a run that goes on, what it wrote when it began."""
        if transfer is not None:
            before = load_weights(resolve_weights(transfer.weights))[1]
            places = open_places(before)
            learnt = {
                "frame_digests": digests_text(before),
                "open_sweeps": None if places is None else list(places),
                "family": family_with_start(before),
            }
            return {"start": {**transfer.brief(), **learnt}}
        path = self.folder / START_NAME
        if self.experiment.training.start is None or not path.is_file():
            return {}
        try:
            written = read_json(path)
            start = {name: written[name] for name in ("weights", "sha256", "share")}
            start["frame_digests"] = written.get("frame_digests")
            if not isinstance(start["weights"], str) or not isinstance(start["frame_digests"], str | None):
                raise TypeError("names of weights and frames that are no text")
            locations: Any = written.get("open_sweeps")
            start["open_sweeps"] = locations
            if not isinstance(locations, list | None) or not all(isinstance(text, str) for text in locations or ()):
                raise TypeError("places that are no list of names")
            start["family"] = written.get("family", "")
            if not isinstance(start["family"], str):
                raise TypeError("a family that is no text")
            return {"start": start}
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            fix = "Remove the run's folder to begin anew."
            expected = "what a run took of the weights that it started from"
            raise FileFormatError(path, where="the file", expected=expected, got=plain(error), fix=fix) from error


def taken_out_text(record: Mapping[str, Any]) -> str:
    """What was held out of a training, from the provenance's ``held_out``."""
    held = record["held_out"]
    which = f"the split {held['split']}" if held["split"] else "what is held out"
    count = held["taken_out"]
    frames, were = ("frame", "was") if count == 1 else ("frames", "were")
    taken = f"{count} {frames} of {which} {were} taken out of the training" if count else "none of them is trained on"
    return f"{count_of(held['frames'], 'frame')} of {which}; {taken}"


def logged(folder: Path) -> list[dict[str, float | int]]:
    """The rows of a run's log by step; of steps that a resumed run took again, the last ones.

    A last line that is damaged or has no end is that of a process that was killed while it wrote, and is passed over.

    Raises:
        FileFormatError: If another line is damaged.
    """
    path = folder / LOG_NAME
    *lines, _ = path.read_bytes().split(b"\n") if path.is_file() else [b""]
    rows = {}
    for number, line in enumerate(lines, 1):
        try:
            row = plain_json(line)
            figures = [float(value) for value in row.values() if type(value) in (int, float)]
            if len(figures) < len(row) or type(row["step"]) is not int or row["step"] < 0:
                raise TypeError("a value that is no number, or a step that is no whole one")
            rows[row["step"]] = row
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
            if number == len(lines):
                break
            where, expected = f"line {number}", "the losses of a step as JSON"
            fix = "Remove the line: the run and its page do without."
            raise FileFormatError(path, where=where, expected=expected, got=plain(error)[:200], fix=fix) from error
    return [rows[step] for step in sorted(rows)]


def with_real_data_named(experiment: Experiment, opened: Mapping[str, Dataset]) -> tuple[Experiment, list[str]]:
    """The experiment without ``data.simulate`` where ``farfield simulate`` did not make the data that stand there.

    Args:
        experiment: The experiment.
        opened: Frames of streams that are open already; each must be of a file that ``simulate`` wrote.

    Returns:
        What is true of the data that are there, and a line on each group whose ``simulate`` was dropped.
    """
    groups, notes = _groups(experiment), []
    for name, config in groups.items():
        if config.simulate is None or not config.path.exists():
            continue
        frames = opened.get(name) if name else next(iter(opened.values()), None)
        count = 0 if frames is None else len(frames) - recorded_frames(config.path, frames)
        if not (config.path / SIMULATION_FILE).is_file():
            why = f"farfield simulate did not make {config.path}"
        elif count:
            why = f"farfield simulate did not make {count} of the {len(frames or ())} frames of {config.path}"
        else:
            continue
        groups[name] = config.model_copy(update={"simulate": None})
        key = f"data.{name}.simulate" if name else "data.simulate"
        notes.append(
            f"{key} ({config.simulate.preset}) does not count and is dropped: {why}, and the weights will not say so"
        )
    if not notes:
        return experiment, notes
    data = groups[""] if isinstance(experiment.data, DataConfig) else groups
    return experiment.model_copy(update={"data": data}), notes


def _groups(experiment: Experiment) -> dict[str, DataConfig]:
    """The experiment's data by stream; the only one has no name yet."""
    return {"": experiment.data} if isinstance(experiment.data, DataConfig) else dict(experiment.data)


def _planned(config: DataConfig) -> str:
    """What is going to be simulated, in words."""
    simulation = config.simulate
    assert simulation is not None
    state = "simulated before" if config.path.is_dir() else "which is not there and is simulated first"
    return (
        f"{config.path}, {state}: {simulation.preset}, {count_of(simulation.sequences, 'drive')} "
        f"of {count_of(simulation.frames, 'frame')}"
    )


def _configs(experiment: Experiment, method: Method) -> dict[str, DataConfig]:
    """Data of each stream of the method."""
    groups, names = _groups(experiment), tuple(method.streams)
    if isinstance(experiment.data, DataConfig) and len(names) == 1:
        return {names[0]: experiment.data}
    if set(groups) != set(names):
        described = ", ".join(groups) if not isinstance(experiment.data, DataConfig) else "one data set without a name"
        raise ConfigError(f"method {experiment.method.name}: expected data for {', '.join(names)}; got {described}.")
    return groups


def _provenance(
    experiment: Experiment,
    data: Mapping[str, Dataset],
    configs: Mapping[str, DataConfig],
    fingerprints: Mapping[str, str],
) -> dict[str, Any]:
    """What travels in every checkpoint and in the weights: experiment, data, environment."""
    streams = {
        name: {
            "data_fingerprint": fingerprints.get(name) or frames.fingerprint(),
            "frames": len(frames),
            "clouds": configs[name].clouds,
            "recipe": frames.recipe,
            "frame_digests": " ".join(frame_digests(frames)),
            "simulated": configs[name].simulate is not None,
            **({"open_sweeps": list(places)} if (places := package_places(frames)) else {}),
            **_lent(frames, configs[name]),
        }
        for name, frames in data.items()
    }
    first = next(iter(streams.values()))
    return {
        "experiment": experiment.model_dump(mode="json"),
        "data_fingerprint": first["data_fingerprint"],
        "frames": first["frames"],
        "streams": streams,
        "family": family_of(streams),
        "environment": environment(),
    }


def _lent(data: Dataset, config: DataConfig) -> dict[str, Any]:
    """What the provenance says of sweeps that lent their background: their places, and whose they are."""
    if config.donors is None:
        return {}
    digests = " ".join(dict.fromkeys(frame_digests(data)))  # each sweep lends several frames its background
    lent = {"family": config.donors.family, "places": list(dict.fromkeys(data.sequences))}
    return {"donors": lent, "frame_digests": digests}
