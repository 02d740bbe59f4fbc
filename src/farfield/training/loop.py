"""The training loop: plain PyTorch, with Lightning Fabric for devices and processes."""

import json
import time
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lightning_fabric import Fabric
from torch import Tensor, nn

from farfield.detectors.devices import fitting, name_of
from farfield.detectors.runtime import keep_freed_memory
from farfield.detectors.weights import save_weights
from farfield.errors import ConfigError
from farfield.training.averaging import averaged, follow, keep_reestimated, reestimate, state_of, take_over
from farfield.training.checkpoints import TrainingState, load_run, prolonged, save_checkpoint
from farfield.training.config import TrainingConfig
from farfield.training.method import DETECTOR, Method, ParamGroup, total_of
from farfield.training.param_groups import always_frozen, frozen_now, groups_of, hold, one_cycle, rates_of, set_rates
from farfield.training.processes import (
    StopSignal,
    average_gradients,
    average_values,
    launch,
    precision_of,
    spread_state,
    stopping,
    synchronise_norms,
)
from farfield.training.report import TrainingReport
from farfield.training.samples import TrainingSample, TrainingSamples, batch_of, batch_shares, batches
from farfield.training.validating import Best, Validation, best_of, forget

CHECKPOINT_NAME = "checkpoint.pt"
_TOO_LARGE = (
    "To train in less: a smaller training.batch_size, or as large a one over more training.devices, training.precision "
    "bf16, or a shorter range or larger cells in detector.grid. The run goes on from its last checkpoint."
)
_LOOKS = 10  # at held-out frames, in a training


def lay_out_gradients(parameters: Iterable[nn.Parameter]) -> None:
    """Give each gradient the memory layout of its parameter: PyTorch's fused optimizers trust that they have it."""
    for parameter in parameters:
        if parameter.grad is not None and parameter.grad.stride() != parameter.stride():
            parameter.grad = torch.empty_like(parameter).copy_(parameter.grad)


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
        fabric: The processes to train with, launched; :meth:`run` launches those of ``config`` unless given.
        held: Held-out samples of its streams, as they are; all of them are looked at.
        validation: Scores the averaged weights while it runs; the best are kept as best.safetensors.

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
    validation: Validation | None = None
    _held_now: tuple[str, ...] | None = field(default=None, init=False)
    _learning: list[nn.Parameter] = field(default_factory=list, init=False)

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
        fabric = self._begin()
        report = report if report is not None and fabric.is_global_zero else TrainingReport()
        units = {name: samples.together for name, samples in self.samples.items()}
        counts = batch_shares(self.config.batch_size, self.method.streams, fabric.world_size, units)
        optimizer = self._optimizer()
        average = {name: value.detach().clone().float() for name, value in self.modules.state_dict().items()}
        self._resume(optimizer, average)
        for name, samples in self.samples.items():
            samples.prepare(self.step * counts[name], partial(report.reading, what="reading frames"))
        self._take_statistics(counts, fabric, average, report)
        report.begins(self.step, self.config.steps)
        try:
            with stopping() as stop:
                self._steps(fabric, counts, optimizer, average, report, stop)
        except BaseException:
            report.ends(None)
            raise
        if fabric.is_global_zero:
            self._save(optimizer, average)
            self._export(average)
        fabric.barrier()
        report.ends(self.weights_path)
        return self.weights_path

    def _steps(
        self,
        fabric: Fabric,
        counts: Mapping[str, int],
        optimizer: torch.optim.Optimizer,
        average: dict[str, Tensor],
        report: TrainingReport,
        stop: StopSignal,
    ) -> None:
        """The steps that are left; asked to stop, it keeps what is done and ends."""
        saved_at = time.monotonic()
        self._hold()
        for batch in self._batches(counts, fabric):
            with fitting(_TOO_LARGE):
                losses = self._update(fabric, optimizer, batch)
            self._average(average)
            self.method.after_step(self.step)
            self.step += 1
            self._hold()
            stopped = stop.asked(fabric.device)
            held = {} if stopped else self._inspected(fabric)
            if fabric.is_global_zero:
                held = held if stopped else {**held, **self._validated(average, report)}
                self._note(losses, held, report)
                if stopped or time.monotonic() - saved_at > self.config.checkpoint_every_s:
                    self._save(optimizer, average)
                    saved_at = time.monotonic()
            if stopped:
                fabric.barrier()
                report.say(f"stopped after step {self.step} of {self.config.steps}; {self.checkpoint_path} keeps it")
                stop.follow()

    @property
    def weights_path(self) -> Path:
        """Where the finished weights are written."""
        return self.folder / "weights.safetensors"

    @property
    def checkpoint_path(self) -> Path:
        """Where the running state is written."""
        return self.folder / CHECKPOINT_NAME

    def _begin(self) -> Fabric:
        if self.config.threads:
            torch.set_num_threads(self.config.threads)
        keep_freed_memory()
        self.folder.mkdir(parents=True, exist_ok=True)
        precision = precision_of(self.config)
        self.provenance = {**self.provenance, "precision": precision, "threads": torch.get_num_threads()}
        fabric = self.fabric or launch(self.config)
        self.provenance["device"] = name_of(fabric.device)
        self.modules.to(fabric.device, memory_format=torch.channels_last)
        for name in self.method.frozen():
            self.modules[name].requires_grad_(False)
        self._learning = [p for p in self.modules.parameters() if p.requires_grad]
        synchronise_norms(self.modules)
        spread_state(self.modules)
        self.method.begins(self.config.steps, self.config.seed)
        return fabric

    @property
    def _frozen(self) -> tuple[str, ...]:
        """Parts of the detector that stay as they are at this step."""
        start = self.config.start
        return () if start is None else frozen_now(start.frozen_until, self.step, self.config.steps)

    def _hold(self) -> None:
        """Training mode and gradients, but for what is frozen now: there batch normalisation keeps its statistics."""
        if self._held_now == self._frozen:
            return
        self._held_now = self._frozen
        self.modules.train()
        for parameter in self._learning:
            parameter.requires_grad_(True)
        hold(self.modules[DETECTOR], self._held_now)

    def _take_statistics(
        self, counts: Mapping[str, int], fabric: Fabric, average: dict[str, Tensor], report: TrainingReport
    ) -> None:
        """Before the first step, batch statistics of the frames that are learnt from, if asked for."""
        wanted = self.config.start.statistics if self.config.start is not None else None
        if wanted is None or self.step:
            return
        self._seed_torch(fabric.global_rank)
        scored = [self._score(average) if fabric.is_global_zero else None]
        drawn = self._batches(counts, fabric, wanted.reestimate_batches)
        with fabric.autocast():
            each = ({name: batch_of(part, fabric) for name, part in batch.items()} for batch in drawn)
            count = reestimate(self.modules[DETECTOR], each)
        take_over(average, self.modules.state_dict())
        if fabric.is_global_zero:
            report.say(keep_reestimated(self.folder, count, [*scored, self._score(average)]))

    def _score(self, average: Mapping[str, Tensor]) -> float | None:
        """The averaged weights' score on held-out frames, if there are any."""
        if self.validation is None:
            return None
        return self.validation.score(averaged(self.modules[DETECTOR], average, f"{DETECTOR}."))

    def _optimizer(self) -> torch.optim.Optimizer:
        network, start = self.modules[DETECTOR], self.config.start
        rates, never = rates_of(network, start), always_frozen(network, start)
        own = {id(p): rates[name] for name, p in network.named_parameters()}
        left_out = {id(p) for name, p in network.named_parameters() if name in never}
        groups = []
        for party, pace in self._parties(tuple(self.modules)):
            trained = [parameter for parameter in party if id(parameter) not in left_out]
            groups += groups_of(trained, own, weight_decay=self.config.weight_decay, rate=pace.rate)
        return torch.optim.AdamW(groups, lr=self.config.learning_rate, betas=(0.9, 0.99), fused=True)

    def _parties(self, names: Collection[str]) -> list[tuple[list[nn.Parameter], ParamGroup]]:
        """The parameters of the named modules that gradients train: those with a pace of their own stand apart."""
        frozen, own = set(self.method.frozen()), self.method.paces()
        chosen = [name for name in self.modules if name in names and name not in frozen]
        together = ParamGroup(clip=self.config.gradient_clip)
        parties = [([name for name in chosen if name not in own], together)]
        parties += [([name], own[name]) for name in chosen if name in own]
        return [(self._parameters(party), pace) for party, pace in parties if party]

    def _parameters(self, names: Collection[str]) -> list[nn.Parameter]:
        """The parameters of some modules that are not frozen, each once though modules may share them."""
        every = [p for name in names for p in self.modules[name].parameters() if p.requires_grad]
        return list({id(parameter): parameter for parameter in every}.values())

    def _batches(
        self, counts: Mapping[str, int], fabric: Fabric, steps: int | None = None
    ) -> Iterable[dict[str, list[TrainingSample]]]:
        return batches(
            self.samples,
            counts,
            first_step=self.step,
            steps=steps or self.config.steps,
            workers=self.config.workers,
            rank=fabric.global_rank,
            world=fabric.world_size,
            pinned=fabric.device.type == "cuda",
        )

    def _update(self, fabric: Fabric, optimizer: Any, samples: Mapping[str, list[TrainingSample]]) -> dict[str, float]:
        set_rates(optimizer, one_cycle(self.step, self.config))
        self._seed_torch(fabric.global_rank)
        batch = {name: batch_of(each, fabric) for name, each in samples.items()}
        with fabric.autocast():
            losses = self.method.step(batch, self.step, partial(self._optimise, optimizer))
            whole = self.method.losses(batch, self.step) if losses is None else None
        if losses is None:
            assert whole is not None
            self._optimise(optimizer, whole, tuple(self.modules))
            losses = whole
        named = {name: float(value.detach()) for name, value in losses.items()}
        return average_values({"loss": float(total_of(losses).detach()), **named}, fabric.device)

    def _optimise(self, optimizer: Any, losses: Mapping[str, Tensor], names: Collection[str]) -> None:
        """Minimise the sum of the losses over the parameters of some modules, one step."""
        parties = self._parties(names)
        parameters = [parameter for party, _ in parties for parameter in party]
        chosen = {id(parameter) for parameter in parameters}
        self.modules.zero_grad(set_to_none=True)
        with torch.autocast(parameters[0].device.type, enabled=False):
            total_of(losses).backward()
        for parameter in self.modules.parameters():
            if id(parameter) not in chosen:
                parameter.grad = None
        average_gradients(parameters)
        lay_out_gradients(parameters)
        for party, pace in parties:
            nn.utils.clip_grad_norm_(party, pace.clip, error_if_nonfinite=True)
        optimizer.step()

    def _seed_torch(self, rank: int) -> None:
        """Make what a network draws at random a function of seed, step and process, so that a resumed run repeats."""
        words = np.random.SeedSequence(self.config.seed, spawn_key=(4, self.step, rank))
        torch.manual_seed(int(words.generate_state(1)[0]))

    def _average(self, average: dict[str, Tensor]) -> None:
        """Exponential average of weights and statistics; it follows closely at first and slowly later."""
        frozen = {f"{DETECTOR}.{part}" for part in self._held_now or ()}
        state, decay = self.modules.state_dict(), self.config.average_decay
        follow(average, state, step=self.step, decay=decay, frozen=frozen)

    def _export(self, average: Mapping[str, Tensor], best: Best | None = None) -> None:
        """Write the averaged weights of the modules that the method exports, as ordinary detectors; or the best so far.

        These bear their step and score.
        """
        reached = {} if best is None else {"validation": {"step": best.step, "score": best.score}}
        for stem, module in self.method.exported().items():
            state = state_of(self.modules[module], average, f"{module}.")
            path = self.folder / f"{best_of(stem) if best is not None else stem}.safetensors"
            stream = self.method.meant_for().get(stem)
            provenance = {**self.provenance, **({} if stream is None else {"stream": stream}), **reached}
            save_weights(path, state, config=self.modules[module].config, provenance=provenance)

    def check(self) -> None:
        """Refuse a folder that holds another run, before anything is written there.

        Raises:
            ConfigError: If it does; the message names what differs.
        """
        load_run(self.checkpoint_path, self.provenance, self.modules)

    def _resume(self, optimizer: Any, average: dict[str, Tensor]) -> None:
        run = load_run(self.checkpoint_path, self.provenance, self.modules)
        if run is None:
            forget(self.folder, [best_of(stem) for stem in self.method.exported()])
            return
        if longer := prolonged(run.provenance, self.provenance, run.step):
            self.provenance = {**self.provenance, "prolonged": longer}
        self.modules.load_state_dict(run.modules)
        optimizer.load_state_dict(run.optimizer)
        take_over(average, run.average)
        self.step = run.step

    def _save(self, optimizer: Any, average: dict[str, Tensor]) -> None:
        run = TrainingState(self.step, self.modules.state_dict(), optimizer.state_dict(), average, self.provenance)
        save_checkpoint(self.checkpoint_path, run.state())

    def _validated(self, average: Mapping[str, Tensor], report: TrainingReport) -> dict[str, float]:
        """The averaged weights' score on held-out frames where it is due; the best weights are written."""
        if self.validation is None or not self.validation.due(self.step, self.config.steps):
            return {}
        score, best = self._score(average), Best.read(self.folder)
        assert score is not None
        better = best is None or score >= best.score
        if better:
            best = Best(self.step, score)
            self._export(average, best)
            best.write(self.folder)
        assert best is not None
        said = "the best so far" if better else f"best {best.score:.3f} after step {best.step}"
        report.say(f"validation after step {self.step}: {score:.3f} mean AP, {said}")
        return {"validation": score}

    def _inspected(self, fabric: Fabric) -> Mapping[str, float]:
        """What the method says of held-out frames, at each tenth of the training."""
        if not self.held or self.step * _LOOKS // self.config.steps == (self.step - 1) * _LOOKS // self.config.steps:
            return {}
        with fabric.autocast():
            return self.method.inspect({name: batch_of(each, fabric) for name, each in self._held.items()})

    @cached_property
    def _held(self) -> dict[str, list[TrainingSample]]:
        """The held-out samples, read once."""
        return {name: [samples[number] for number in range(len(samples))] for name, samples in self.held.items()}

    def _note(self, losses: dict[str, float], held: Mapping[str, float], report: TrainingReport) -> None:
        """Every step's losses are logged; what the method says besides at some steps, and TensorBoard then too."""
        shown = self.step % self.config.log_every_steps == 0 or self.step == self.config.steps or bool(held)
        self._log({**losses, **(self.method.figures() if shown else {}), **held}, board=shown)
        report.step(self.step, losses)

    def _log(self, losses: dict[str, float], *, board: bool) -> None:
        line = {
            "step": self.step,
            "learning_rate": one_cycle(self.step - 1, self.config),
            **losses,
            "time": time.time(),
        }
        with (self.folder / "log.jsonl").open("a") as file:
            file.write(json.dumps(line) + "\n")
        if self.config.tensorboard and board:
            for name, value in losses.items():
                self._board.add_scalar(f"training/{name}", value, self.step)
            self._board.add_scalar("training/learning_rate", line["learning_rate"], self.step)

    @cached_property
    def _board(self) -> Any:
        """TensorBoard's writer, imported when it is asked for."""
        from torch.utils.tensorboard import SummaryWriter

        return SummaryWriter(str(self.folder), purge_step=self.step)
