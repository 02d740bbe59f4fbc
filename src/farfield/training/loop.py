"""The training loop: plain PyTorch, with Lightning Fabric for devices and processes.

:meth:`Training.run` is the loop, by its steps: sample, forward, losses, backward, clip, step, average, validate, log,
checkpoint. What a method does in a step is its own (:mod:`farfield.training.method`).
"""

import json
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from lightning_fabric import Fabric
from torch import Tensor, nn

from farfield.detectors.devices import fitting, name_of
from farfield.detectors.network import Network
from farfield.detectors.runtime import give_back_freed_memory, keep_freed_memory
from farfield.detectors.weights import save_weights
from farfield.errors import ConfigError
from farfield.training.averaging import averaged, copy_state, follow, reestimate, save_reestimated, state_of
from farfield.training.checkpoints import (
    CHECKPOINT_NAME,
    BestScore,
    TrainingState,
    begin_log,
    best_of,
    check_sound,
    load_run,
    prolonged,
    provenance_in,
    remove_best,
    resume_optimizer,
    resumed_otherwise,
    save_checkpoint,
)
from farfield.training.config import TrainingConfig
from farfield.training.method import DETECTOR, Method, ParamGroup, network_of, total_of
from farfield.training.param_groups import always_frozen, freeze, frozen_now, groups_of, one_cycle, rates_of, set_rates
from farfield.training.processes import (
    average_gradients,
    average_values,
    fixed_choices,
    kind_of_device,
    launch,
    precision_of,
    spread_state,
    stop_signals,
    synchronise_norms,
)
from farfield.training.report import TrainingReport
from farfield.training.samples import TrainingSample, TrainingSamples, batch_shares, batches, to_batch

_TOO_LARGE = (
    "To train in less: a smaller training.batch_size, or as large a one over more training.devices, training.precision "
    "bf16, or a shorter range or larger cells in detector.grid. The run goes on from its last checkpoint."
)
_LOOKS = 10  # at held-out frames, in a training
_STEPS_BEFORE_MEMORY_IS_GIVEN_BACK = 200
"""A few milliseconds in minutes: batches leave holes among the memory that the network's maps are kept in."""


@dataclass
class Training:
    """One training run in a folder: begins, or resumes where the folder's checkpoint stands.

    Args:
        method: What is trained, and how its losses come about.
        samples: The training samples of each of its streams.
        config: The loop's settings.
        folder: Receives checkpoint.pt, log.jsonl and at the end weights.safetensors.
        provenance: Travels in every checkpoint and in the weights.
        step: Steps done.
        fabric: The processes to train with, launched (default: :meth:`run` launches those of ``config``).
        held: Held-out samples of its streams, as they are; all of them are looked at.
        score: Scores a network on held-out frames, from 0 to 1: every ``config.validation.every_steps`` steps it scores
            the averaged weights, and the best are stored as best.safetensors.

    Raises:
        ConfigError: If the streams of the samples are not those of the method.
    """

    method: Method
    samples: Mapping[str, TrainingSamples]
    config: TrainingConfig
    folder: Path
    provenance: dict[str, Any] = field(default_factory=dict)
    step: int = 0
    fabric: Fabric | None = None
    held: Mapping[str, TrainingSamples] = field(default_factory=dict)
    score: Callable[[Network], float] | None = None
    _report: TrainingReport = field(default_factory=TrainingReport, init=False)
    _optimizer: torch.optim.Optimizer = field(init=False)
    _average: dict[str, Tensor] = field(default_factory=dict, init=False)
    _frozen: tuple[str, ...] | None = field(default=None, init=False)
    _trained: list[nn.Parameter] = field(default_factory=list, init=False)
    _saved_s: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        if set(self.samples) != set(self.method.streams):
            raise ConfigError(
                f"Expected samples for the streams {', '.join(self.method.streams)}; got {', '.join(self.samples)}."
            )

    @property
    def modules(self) -> nn.ModuleDict:
        """All that is saved, averaged, spread and synchronised."""
        return self.method.modules

    def run(self, report: TrainingReport | None = None) -> Path:
        """Train to the last step and write the weights.

        Args:
            report: Is informed of the course, in the first process.

        Returns:
            The path of the weights: an exponential average over the last steps.
        """
        fabric = self._start(report)
        with self._interruption_reported(), stop_signals() as stop:
            # 1. Sample: frames of each stream, augmented by a seed of the sample's position: a resumed run repeats them
            for samples in self._batches(fabric):
                set_rates(self._optimizer, one_cycle(self.step, self.config))
                with fitting(_TOO_LARGE):
                    self._seed_torch(fabric.global_rank)
                    batch = {name: to_batch(part, fabric) for name, part in samples.items()}
                    # A method whose players take turns minimises by itself; None: the loop minimises
                    with fabric.autocast():
                        own_losses = self.method.step(batch, self.step, self._minimise)
                    if own_losses is not None:
                        losses = own_losses
                    else:
                        # 2. Forward and 3. losses: the method's
                        with fabric.autocast():
                            losses = self.method.losses(batch, self.step)
                        # 4 to 6, as _minimise says
                        self._minimise(losses, tuple(self.modules))
                    figures = _mean_over_processes(losses, fabric)
                # 7. Average: of weights and statistics, then the method's own, such as a teacher's
                frozen = [f"{DETECTOR}.{part}" for part in self._frozen or ()]
                decay = self.config.average_decay
                follow(self._average, self.modules.state_dict(), step=self.step, decay=decay, frozen=frozen)
                self.method.after_step(self.step)
                self.step += 1  # from here: steps done
                if self.step % _STEPS_BEFORE_MEMORY_IS_GIVEN_BACK == 0:
                    give_back_freed_memory()
                # Thaw what this step has freed, and put what trains into training mode
                self._freeze()
                stopped = stop.requested(fabric.device)
                held_figures = {} if stopped else self._inspect(fabric)
                if fabric.is_global_zero:
                    # 8. Validate: the averaged weights, where it is due
                    held_figures = held_figures if stopped else {**held_figures, **self._validate()}
                    # 9. Log
                    self._log(figures, held_figures)
                    # 10. Checkpoint: now and then, and as the run stops
                    if stopped or time.monotonic() - self._saved_s > self.config.checkpoint_every_s:
                        self._save()
                if stopped:
                    fabric.barrier()
                    self._report.say(
                        f"stopped after step {self.step} of {self.config.steps}; {self.checkpoint_path} keeps it"
                    )
                    stop.end_run()
        if fabric.is_global_zero:
            self._save()
            self._export()
        fabric.barrier()
        self._report.on_train_end(self.weights_path)
        return self.weights_path

    @contextmanager
    def _interruption_reported(self) -> Iterator[None]:
        """Let the report know of a training that ends by an error or a signal."""
        try:
            yield
        except BaseException:
            self._report.on_train_end(None)
            raise

    def _minimise(self, losses: Mapping[str, Tensor], names: Collection[str]) -> None:
        """Steps 4 to 6: minimise the sum of the losses over the parameters of some modules."""
        groups = self._groups(names)
        parameters = [parameter for members, _ in groups for parameter in members]
        chosen = {id(parameter) for parameter in parameters}
        # 4. Backward, in float32; what is not chosen gets no gradient, and every process the mean of all. That mean is
        # taken here, since DistributedDataParallel demands that every process use every parameter
        self.modules.zero_grad(set_to_none=True)
        with torch.autocast(parameters[0].device.type, enabled=False):
            total_of(losses).backward()
        for parameter in self.modules.parameters():
            if id(parameter) not in chosen:
                parameter.grad = None
        average_gradients(parameters)
        lay_out_gradients(parameters)
        # 5. Clip: the norm over all modules that are trained alike; one that is not finite ends the run, on purpose,
        # before it reaches the weights and the averages
        for members, group in groups:
            nn.utils.clip_grad_norm_(members, group.clip, error_if_nonfinite=True)
        # 6. Step
        self._optimizer.step()

    @property
    def weights_path(self) -> Path:
        """Where the finished weights are written."""
        return self.folder / "weights.safetensors"

    @property
    def checkpoint_path(self) -> Path:
        """Where the running state is written."""
        return self.folder / CHECKPOINT_NAME

    def check(self) -> None:
        """Refuse a folder that holds another run, before anything is written there.

        Raises:
            ConfigError: If it does; the message names what differs.
        """
        load_run(self.checkpoint_path, self.provenance, self.modules)

    def _start(self, report: TrainingReport | None) -> Fabric:
        """Processes, modules, optimiser and average, as the checkpoint has them; the first frames are read."""
        self.config = fixed_choices(self.config, provenance_in(self.checkpoint_path))
        if self.config.threads:
            torch.set_num_threads(self.config.threads)
        keep_freed_memory()
        self.folder.mkdir(parents=True, exist_ok=True)
        choices = {"precision": precision_of(self.config), "threads": torch.get_num_threads()}
        self.provenance = {**self.provenance, **choices, "device_kind": kind_of_device(self.config)}
        fabric = self.fabric or launch(self.config)
        self._report = report if report is not None and fabric.is_global_zero else TrainingReport()
        self.provenance["device"] = name_of(fabric.device)
        cast(Any, self.modules).to(fabric.device, memory_format=torch.channels_last)
        for name in self.method.frozen():
            self.modules[name].requires_grad_(False)
        self._trained = [p for p in self.modules.parameters() if p.requires_grad]
        synchronise_norms(self.modules)
        spread_state(self.modules)
        self.method.on_train_start(self.config.steps, self.config.seed)
        counts = self._counts(fabric)
        self._optimizer = self._new_optimizer()
        self._average = {name: value.detach().clone().float() for name, value in self.modules.state_dict().items()}
        self._resume()
        if fabric.is_global_zero:
            begin_log(self.folder / "log.jsonl", anew=not self.step)
        for name, samples in self.samples.items():
            samples.prepare(self.step * counts[name], partial(self._report.reading, what="reading frames"))
        self._reestimate_statistics(fabric)
        self._freeze()
        self._report.on_train_start(self.step, self.config.steps)
        self._saved_s = time.monotonic()
        return fabric

    def _counts(self, fabric: Fabric) -> dict[str, int]:
        """Samples of each stream in a batch, over all processes."""
        units = {name: samples.together for name, samples in self.samples.items()}
        return batch_shares(self.config.batch_size, self.method.streams, fabric.world_size, units)

    def _batches(self, fabric: Fabric, steps: int | None = None) -> Iterable[dict[str, list[TrainingSample]]]:
        """This process' samples of the steps that are left, or of the next ``steps``."""
        return batches(
            self.samples,
            self._counts(fabric),
            first_step=self.step,
            steps=steps or self.config.steps,
            workers=self.config.workers,
            rank=fabric.global_rank,
            world=fabric.world_size,
            pinned=fabric.device.type == "cuda",
        )

    def _seed_torch(self, rank: int) -> None:
        """Make what a network draws at random a function of seed, step and process, so that a resumed run repeats."""
        entropy = np.random.SeedSequence(self.config.seed, spawn_key=(4, self.step, rank))
        torch.manual_seed(int(entropy.generate_state(1)[0]))

    def _freeze(self) -> None:
        """Put all into training mode and let it have gradients, but for what is frozen now.

        There batch normalisation keeps its statistics. Nothing happens where the same is frozen as before.
        """
        start = self.config.start
        frozen = () if start is None else frozen_now(start.frozen_until, self.step, self.config.steps)
        if self._frozen == frozen:
            return
        self._frozen = frozen
        self.modules.train()
        for parameter in self._trained:
            parameter.requires_grad_(True)
        freeze(self.modules[DETECTOR], frozen)

    def _new_optimizer(self) -> torch.optim.Optimizer:
        network, start = self.modules[DETECTOR], self.config.start
        rates, never = rates_of(network, start), always_frozen(network, start)
        own = {id(p): rates[name] for name, p in network.named_parameters()}
        left_out = {id(p) for name, p in network.named_parameters() if name in never}
        groups = []
        for members, group in self._groups(tuple(self.modules)):
            trained = [parameter for parameter in members if id(parameter) not in left_out]
            groups += groups_of(trained, own, weight_decay=self.config.weight_decay, rate=group.rate)
        return torch.optim.AdamW(groups, lr=self.config.learning_rate, betas=(0.9, 0.99), fused=True)

    def _groups(self, names: Collection[str]) -> list[tuple[list[nn.Parameter], ParamGroup]]:
        """The parameters of the named modules that gradients train: those with a rate of their own stand apart.

        Each parameter stands once, though modules may share it.
        """
        frozen, own = set(self.method.frozen()), self.method.param_groups()
        chosen = [name for name in self.modules if name in names and name not in frozen]
        together = ParamGroup(clip=self.config.gradient_clip)
        groups = []
        for members, group in [
            ([name for name in chosen if name not in own], together),
            *(([name], own[name]) for name in chosen if name in own),
        ]:
            parameters = [p for name in members for p in self.modules[name].parameters() if p.requires_grad]
            if members:
                groups.append((list({id(parameter): parameter for parameter in parameters}.values()), group))
        return groups

    def _reestimate_statistics(self, fabric: Fabric) -> None:
        """Before the first step, batch statistics of the frames that are learnt from, if the start says so."""
        settings = self.config.start.statistics if self.config.start is not None else None
        if settings is None or self.step:
            return
        self._seed_torch(fabric.global_rank)
        scores = [self._score() if fabric.is_global_zero else None]
        with fabric.autocast():
            drawn = (
                {name: to_batch(part, fabric) for name, part in samples.items()}
                for samples in self._batches(fabric, settings.reestimate_batches)
            )
            count = reestimate(network_of(self.modules), drawn)
        copy_state(self._average, self.modules.state_dict())
        if fabric.is_global_zero:
            self._report.say(save_reestimated(self.folder, count, [*scores, self._score()]))

    def _score(self) -> float | None:
        """The averaged weights' score on held-out frames, if there are any."""
        return None if self.score is None else self.score(averaged(network_of(self.modules), self._average, DETECTOR))

    def _validate(self) -> dict[str, float]:
        """The averaged weights' score on held-out frames where it is due; the best weights are written."""
        settings = self.config.validation
        if self.score is None or settings is None:
            return {}
        if self.step % settings.every_steps and self.step != self.config.steps:
            return {}
        score, best = self._score(), BestScore.read(self.folder)
        assert score is not None
        better = best is None or score >= best.score
        if better:
            best = BestScore(self.step, score)
            self._export(best)
            best.write(self.folder)
        assert best is not None
        comparison = "the best so far" if better else f"best {best.score:.3f} after step {best.step}"
        self._report.say(f"validation after step {self.step}: {score:.3f} mean AP, {comparison}")
        return {"validation": score}

    def _inspect(self, fabric: Fabric) -> Mapping[str, float]:
        """What the method says of held-out frames, at each tenth of the training."""
        if not self.held or self.step * _LOOKS // self.config.steps == (self.step - 1) * _LOOKS // self.config.steps:
            return {}
        with fabric.autocast():
            return self.method.inspect({name: to_batch(part, fabric) for name, part in self._held_samples.items()})

    @cached_property
    def _held_samples(self) -> dict[str, list[TrainingSample]]:
        """The held-out samples, read once."""
        return {name: [samples[number] for number in range(len(samples))] for name, samples in self.held.items()}

    def _log(self, losses: dict[str, float], held_figures: Mapping[str, float]) -> None:
        """Log every step's losses; what the method says besides at some steps, and to TensorBoard then too."""
        shown = self.step % self.config.log_every_steps == 0 or self.step == self.config.steps or bool(held_figures)
        figures = {**losses, **(self.method.figures() if shown else {}), **held_figures}
        rate = one_cycle(self.step - 1, self.config)
        line = {"step": self.step, "learning_rate": rate, **figures, "time": time.time()}
        with (self.folder / "log.jsonl").open("a") as file:
            file.write(json.dumps(line) + "\n")
        if self.config.tensorboard and shown:
            for name, value in figures.items():
                self._board.add_scalar(f"training/{name}", value, self.step)
            self._board.add_scalar("training/learning_rate", line["learning_rate"], self.step)
        self._report.step(self.step, losses)

    @cached_property
    def _board(self) -> Any:
        """TensorBoard's writer, imported on first use."""
        from torch.utils.tensorboard import SummaryWriter

        return SummaryWriter(str(self.folder), purge_step=self.step)

    def _resume(self) -> None:
        """Modules, optimiser and average of the checkpoint, if there is one; else nothing of another run stays."""
        run = load_run(self.checkpoint_path, self.provenance, self.modules)
        if run is None:
            remove_best(self.folder, [best_of(stem) for stem in self.method.exported()])
            return
        if raised := prolonged(run.provenance, self.provenance, run.step):
            self.provenance = {**self.provenance, "prolonged": raised}
        if changes := resumed_otherwise(run.provenance, self.provenance, run.step):
            self.provenance = {**self.provenance, "resumed_otherwise": changes}
            for name, (before, now) in changes[-1]["changes"].items() if changes[-1]["step"] == run.step else ():
                self._report.say(f"note: {name} was {before}, is {now}: other weights than of a run in one go")
        resume_optimizer(self.checkpoint_path, run.optimizer, self._optimizer)
        self.modules.load_state_dict(run.modules)
        copy_state(self._average, run.average)
        self.step = run.step

    def _save(self) -> None:
        """Write the checkpoint; a state that could not be read again leaves the previous one."""
        state, optimizer = self.modules.state_dict(), self._optimizer.state_dict()
        check_sound(self.checkpoint_path, "modules", state)
        run = TrainingState(self.step, state, optimizer, self._average, self.provenance)
        save_checkpoint(self.checkpoint_path, run.state())
        self._saved_s = time.monotonic()

    def _export(self, best: BestScore | None = None) -> None:
        """Write the averaged weights of the modules that the method exports, as ordinary detectors; or the best so far.

        These bear their step and score.
        """
        validation = {} if best is None else {"validation": {"step": best.step, "score": best.score}}
        for stem, name in self.method.exported().items():
            network = network_of(self.modules, name)
            path = self.folder / f"{stem if best is None else best_of(stem)}.safetensors"
            stream = self.method.meant_for().get(stem)
            provenance = {**self.provenance, **({} if stream is None else {"stream": stream}), **validation}
            state = state_of(network, self._average, name)
            save_weights(path, state, config=network.config, provenance=provenance)


def lay_out_gradients(parameters: Iterable[nn.Parameter]) -> None:
    """Give each gradient the memory layout of its parameter: PyTorch's fused optimizers trust that they have it."""
    for parameter in parameters:
        if parameter.grad is not None and parameter.grad.stride() != parameter.stride():
            parameter.grad = torch.empty_like(parameter).copy_(parameter.grad)


def _mean_over_processes(losses: Mapping[str, Tensor], fabric: Fabric) -> dict[str, float]:
    """The losses' sum and each of them, for the log."""
    values = {"loss": float(total_of(losses).detach())}
    return average_values(values | {name: float(loss.detach()) for name, loss in losses.items()}, fabric.device)
