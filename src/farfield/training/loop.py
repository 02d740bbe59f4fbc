"""The training loop: plain PyTorch, with Lightning Fabric for devices and processes."""

import json
import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lightning_fabric import Fabric
from torch import Tensor, nn

from farfield.detectors.runtime import keep_freed_memory
from farfield.detectors.weights import save_weights
from farfield.errors import ConfigError
from farfield.training.bank import Progress
from farfield.training.checkpoints import load_checkpoint, save_checkpoint
from farfield.training.config import TrainingConfig
from farfield.training.distributed import (
    average_gradients,
    average_values,
    launch,
    precision_of,
    spread_state,
    synchronise_norms,
)
from farfield.training.samples import TrainingSamples, batches

Report = Callable[[int, dict[str, float]], None]


def lay_out_gradients(parameters: Iterable[nn.Parameter]) -> None:
    """Give each gradient the memory layout of its parameter: PyTorch's fused optimizers trust that they have it."""
    for parameter in parameters:
        if parameter.grad is not None and parameter.grad.stride() != parameter.stride():
            parameter.grad = torch.empty_like(parameter).copy_(parameter.grad)


def one_cycle(step: int, config: TrainingConfig) -> float:
    """Learning rate at a step: a cosine up over the warm-up, a cosine down to nearly nothing (Smith 2018)."""
    peak, rise = config.learning_rate, max(1.0, config.warmup * config.steps)
    if step < rise:
        return peak * (0.1 + 0.9 * (1 - math.cos(math.pi * step / rise)) / 2)
    return peak * (1e-3 + (1 - 1e-3) * (1 + math.cos(math.pi * (step - rise) / max(1.0, config.steps - rise))) / 2)


@dataclass
class Training:
    """One training run in a folder: begins, or resumes where the folder's checkpoint stands.

    Args:
        network: The network to train.
        samples: Its training samples.
        config: The loop's settings.
        folder: Receives checkpoint.pt, log.jsonl and at the end weights.safetensors.
        provenance: Travels in every checkpoint and in the weights.
        step: Steps done.
        progress: Wraps the numbers of the frames that are read before the first step.
        fabric: The processes to train with, launched; :meth:`run` launches those of ``config`` unless given.
    """

    network: nn.Module
    samples: TrainingSamples
    config: TrainingConfig
    folder: Path
    provenance: dict[str, Any] = field(default_factory=dict)
    step: int = 0
    progress: Progress = iter
    fabric: Fabric | None = None

    def run(self, report: Report | None = None) -> Path:
        """Train to the last step and write the weights.

        Returns:
            The path of the weights: an exponential average over the last steps.
        """
        fabric = self._begin()
        optimizer = self._optimizer()
        average = {name: value.detach().clone().float() for name, value in self.network.state_dict().items()}
        self._resume(optimizer, average)
        self.samples.prepare(self.step * self.config.batch_size, self.progress)
        saved_at = time.monotonic()
        self.network.train()
        stream = batches(
            self.samples,
            first_step=self.step,
            steps=self.config.steps,
            batch_size=self.config.batch_size,
            workers=self.config.workers,
            rank=fabric.global_rank,
            world=fabric.world_size,
        )
        for batch in stream:
            losses = self._update(fabric, optimizer, batch)
            self._average(average)
            self.step += 1
            if fabric.is_global_zero:
                if self.step % self.config.log_every_steps == 0 or self.step == self.config.steps:
                    self._log(losses)
                if report is not None:
                    report(self.step, losses)
                if time.monotonic() - saved_at > self.config.checkpoint_every_s:
                    self._save(optimizer, average)
                    saved_at = time.monotonic()
        if fabric.is_global_zero:
            self._save(optimizer, average)
            save_weights(
                self.weights_path, self._averaged(average), config=self.network.config, provenance=self.provenance
            )
        fabric.barrier()
        return self.weights_path

    @property
    def weights_path(self) -> Path:
        """Where the finished weights are written."""
        return self.folder / "weights.safetensors"

    @property
    def checkpoint_path(self) -> Path:
        """Where the running state is written."""
        return self.folder / "checkpoint.pt"

    def _begin(self) -> Fabric:
        if self.config.threads:
            torch.set_num_threads(self.config.threads)
        keep_freed_memory()
        self.folder.mkdir(parents=True, exist_ok=True)
        precision = precision_of(self.config)
        self.provenance = {**self.provenance, "precision": precision, "threads": torch.get_num_threads()}
        fabric = self.fabric or launch(self.config)
        self.network.to(fabric.device, memory_format=torch.channels_last)
        synchronise_norms(self.network)
        spread_state(self.network)
        return fabric

    def _optimizer(self) -> torch.optim.Optimizer:
        decayed = [p for p in self.network.parameters() if p.ndim > 1]
        plain = [p for p in self.network.parameters() if p.ndim <= 1]
        groups = [{"params": decayed, "weight_decay": self.config.weight_decay}, {"params": plain, "weight_decay": 0.0}]
        return torch.optim.AdamW(groups, lr=self.config.learning_rate, betas=(0.9, 0.99), fused=True)

    def _update(self, fabric: Fabric, optimizer: Any, batch: list[Any]) -> dict[str, float]:
        for group in optimizer.param_groups:
            group["lr"] = one_cycle(self.step, self.config)
        self._seed_torch(fabric.global_rank)
        targets = [sample.targets for sample in batch]
        with fabric.autocast():
            outputs = self.network({"points": [fabric.to_device(sample.points) for sample in batch]}, targets)
        losses = self.network.losses(outputs, targets)
        total = sum(losses.values())
        optimizer.zero_grad(set_to_none=True)
        total.backward()
        average_gradients(self.network.parameters())
        lay_out_gradients(self.network.parameters())
        nn.utils.clip_grad_norm_(self.network.parameters(), self.config.gradient_clip, error_if_nonfinite=True)
        optimizer.step()
        named = {name: float(value.detach()) for name, value in losses.items()}
        return average_values({"loss": float(total.detach()), **named}, fabric.device)

    def _seed_torch(self, rank: int) -> None:
        """Make what a network draws at random a function of seed, step and process, so that a resumed run repeats."""
        words = np.random.SeedSequence(self.config.seed, spawn_key=(4, self.step, rank))
        torch.manual_seed(int(words.generate_state(1)[0]))

    def _average(self, average: dict[str, Tensor]) -> None:
        """Exponential average of weights and statistics; it follows closely at first and slowly later."""
        decay = min(self.config.average_decay, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            for name, value in self.network.state_dict().items():
                average[name].lerp_(value.to(average[name].device, torch.float32), 1 - decay)

    def _averaged(self, average: dict[str, Tensor]) -> dict[str, Tensor]:
        state = self.network.state_dict()
        return {name: average[name].to(value.dtype) for name, value in state.items()}

    def _resume(self, optimizer: Any, average: dict[str, Tensor]) -> None:
        if not self.checkpoint_path.is_file():
            return
        state = load_checkpoint(self.checkpoint_path)
        ours = {key: self.provenance.get(key) for key in ("experiment", "data_fingerprint")}
        theirs = {key: json.loads(state["provenance"]).get(key) for key in ours}
        if ours != theirs:
            changed = [key for key in ours if ours[key] != theirs[key]]
            raise ConfigError(
                f"{self.checkpoint_path} was made by another {' and another '.join(changed)}. "
                "Choose another run folder, or remove this one."
            )
        self.network.load_state_dict(state["network"])
        optimizer.load_state_dict(state["optimizer"])
        for name in average:
            average[name].copy_(state["average"][name])
        self.step = int(state["step"])

    def _save(self, optimizer: Any, average: dict[str, Tensor]) -> None:
        state = {
            "step": self.step,
            "network": self.network.state_dict(),
            "optimizer": optimizer.state_dict(),
            "average": average,
            "provenance": json.dumps(self.provenance),
        }
        save_checkpoint(self.checkpoint_path, state)

    def _log(self, losses: dict[str, float]) -> None:
        line = {
            "step": self.step,
            "learning_rate": one_cycle(self.step - 1, self.config),
            **losses,
            "time": time.time(),
        }
        with (self.folder / "log.jsonl").open("a") as file:
            file.write(json.dumps(line) + "\n")
        if self.config.tensorboard:
            for name, value in losses.items():
                self._board.add_scalar(f"training/{name}", value, self.step)
            self._board.add_scalar("training/learning_rate", line["learning_rate"], self.step)

    @cached_property
    def _board(self) -> Any:
        """TensorBoard's writer, imported when it is asked for."""
        from torch.utils.tensorboard import SummaryWriter

        return SummaryWriter(str(self.folder), purge_step=self.step)
