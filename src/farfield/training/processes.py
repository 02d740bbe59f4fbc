"""The processes of a training: how they start, how they stop, and how several train as one would with the whole batch.

Gradients are averaged here after each backward pass rather than by DistributedDataParallel, which demands that every
process use every parameter: a process whose frames have no points or no proposals does not.
"""

import atexit
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from datetime import timedelta
from types import FrameType
from typing import Any, NoReturn

import torch
from lightning_fabric import Fabric
from lightning_fabric.strategies import DDPStrategy
from torch import Tensor, distributed, nn
from torch.nn.modules.batchnorm import _BatchNorm

from farfield.detectors.devices import default_precision
from farfield.detectors.losses import process_count, sum_over_processes
from farfield.training.config import TrainingConfig

# The start of the processes, by Lightning Fabric, which takes a second to import

_PATIENCE = timedelta(days=1)  # the first process may simulate the data while the others wait


def launch(config: TrainingConfig) -> Fabric:
    """Start, or join, the processes of a training.

    Under torchrun the number of processes is torchrun's; otherwise it is ``config.devices``.
    """
    accelerator, precision = _accelerator(config), precision_of(config)
    devices, nodes = config.devices, 1
    if distributed.is_torchelastic_launched():
        devices = int(os.environ["LOCAL_WORLD_SIZE"])
        nodes = int(os.environ["WORLD_SIZE"]) // devices
    several = nodes > 1 or devices != 1
    fabric = Fabric(
        accelerator=accelerator,
        devices=devices,
        num_nodes=nodes,
        strategy=DDPStrategy(timeout=_PATIENCE) if several else "auto",
        precision="bf16-mixed" if precision == "bf16" else "32-true",
    )
    fabric.launch()
    if several:
        atexit.register(_disconnect)
    return fabric


def _disconnect() -> None:
    """Close the connections before the interpreter goes: gloo's threads else may meet a process that is gone."""
    if distributed.is_available() and distributed.is_initialized():
        distributed.destroy_process_group()


def precision_of(config: TrainingConfig) -> str:
    """``"fp32"`` or ``"bf16"``: what ``config.precision`` means on this machine."""
    device = torch.device("cuda" if kind_of_device(config) == "GPU" else "cpu")
    if config.precision != "auto":
        return config.precision
    return "bf16" if default_precision(device)[0] == "bf16" else "fp32"  # float16's gradients would want a scale


def fixed_choices(config: TrainingConfig, provenance: Mapping[str, Any]) -> TrainingConfig:
    """Settings whose number type and threads are those of a run's checkpoint where the settings leave them open.

    The number type may rest on a measurement, and the threads on the cores that a process may use: neither may change
    in the middle of a run, whose weights would be others. An ``OMP_NUM_THREADS`` is an order, and stands; another kind
    of device takes what suits it.

    Args:
        config: The settings.
        provenance: Of the checkpoint; empty where the run begins.
    """
    precision, threads, device = (provenance.get(name) for name in ("precision", "threads", "device_kind"))
    choices: dict[str, Any] = {}
    if config.precision == "auto" and precision in ("fp32", "bf16") and device in (None, kind_of_device(config)):
        choices["precision"] = precision
    if not config.threads and isinstance(threads, int) and threads > 0 and "OMP_NUM_THREADS" not in os.environ:
        choices["threads"] = threads
    return config.model_copy(update=choices)


def kind_of_device(config: TrainingConfig) -> str:
    """``"GPU"`` or ``"CPU"``."""
    return "GPU" if _accelerator(config) in ("gpu", "cuda") else "CPU"


def _accelerator(config: TrainingConfig) -> str:
    if config.accelerator != "auto":
        return config.accelerator
    return "gpu" if torch.cuda.is_available() else "cpu"


@torch.no_grad()
def average_gradients(parameters: Iterable[nn.Parameter]) -> None:
    """Replace each gradient by its mean over all processes; parameters that no process used keep none."""
    count = process_count()
    if count == 1:
        return
    trained = [parameter for parameter in parameters if parameter.requires_grad]
    used = torch.tensor([p.grad is not None for p in trained], dtype=torch.float32, device=trained[0].device)
    used = sum_over_processes(used) > 0
    chosen = [parameter for parameter, here in zip(trained, used.tolist(), strict=True) if here]
    if not chosen:
        return
    rows = [(torch.zeros_like(p) if p.grad is None else p.grad).float().flatten() for p in chosen]
    total = sum_over_processes(torch.cat(rows)) / count
    for parameter, part in zip(chosen, total.split([p.numel() for p in chosen]), strict=True):
        parameter.grad = part.view(parameter.shape).to(parameter.dtype)


def average_values(values: dict[str, float], device: torch.device) -> dict[str, float]:
    """Mean of each value over all processes."""
    if process_count() == 1:
        return values
    total = sum_over_processes(torch.tensor(list(values.values()), dtype=torch.float64, device=device))
    return dict(zip(values, (total / process_count()).tolist(), strict=True))


@torch.no_grad()
def spread_state(network: nn.Module) -> None:
    """Give every process the first one's weights and statistics."""
    if process_count() > 1:
        for value in network.state_dict().values():
            distributed.broadcast(value, 0)


def synchronise_norms(network: nn.Module) -> None:
    """Let the network's batch normalisations take their statistics over all processes; parameters stay the same."""
    if process_count() == 1:
        return
    for module in list(network.modules()):
        for name, child in list(module.named_children()):
            if type(child) in _SYNCED:
                setattr(module, name, _SYNCED[type(child)].sharing(child))


class _SyncedNorm(_BatchNorm):
    """Batch normalisation over the batches of all processes, which may be empty; channels are the second axis.

    Not a subclass of ``nn.BatchNorm1d``, whose callers pass it by where a process has fewer than two rows: here every
    process takes part.
    """

    @classmethod
    def sharing(cls, norm: _BatchNorm) -> "_SyncedNorm":
        """Make one with the parameters and statistics of a plain one."""
        synced = cls(norm.num_features, norm.eps, norm.momentum, norm.affine, norm.track_running_stats)
        synced.weight, synced.bias = norm.weight, norm.bias
        synced.running_mean, synced.running_var = norm.running_mean, norm.running_var
        synced.num_batches_tracked = norm.num_batches_tracked
        synced.train(norm.training)
        return synced

    def _check_input_dim(self, input: Tensor) -> None:
        """Any number of axes."""

    def forward(self, input: Tensor) -> Tensor:
        """Normalise, shape (n, channels, ...)."""
        if not self.training or process_count() == 1:
            return super().forward(input)
        with torch.autocast(input.device.type, enabled=False):
            values = input.to(torch.promote_types(input.dtype, torch.float32))
            axes = [axis for axis in range(values.ndim) if axis != 1]
            shape = [-1 if axis == 1 else 1 for axis in range(values.ndim)]
            rows = values.new_tensor([values.numel() // values.shape[1]])
            sums = sum_over_processes(torch.cat([values.sum(axes), rows]))
            count = sums[-1].detach()
            if count < 2:  # one row has no spread
                assert self.running_mean is not None
                assert self.running_var is not None
                mean, variance = self.running_mean, self.running_var
                centred = values - mean.view(shape)
            else:
                mean = sums[:-1] / count
                centred = values - mean.view(shape)
                variance = sum_over_processes(centred.square().sum(axes)) / count
                self._track(mean.detach(), variance.detach() * count / (count - 1))
            scale = torch.rsqrt(variance + self.eps)
            scale = scale if self.weight is None else scale * self.weight
            out = centred * scale.view(shape)
            out = out if self.bias is None else out + self.bias.view(shape)
        return out.to(input.dtype)

    @torch.no_grad()
    def _track(self, mean: Tensor, variance: Tensor) -> None:
        if self.running_mean is None or self.running_var is None or self.num_batches_tracked is None:
            return
        self.num_batches_tracked += 1
        share = 1 / float(self.num_batches_tracked) if self.momentum is None else self.momentum
        self.running_mean.lerp_(mean, share)
        self.running_var.lerp_(variance, share)


class _SyncedNorm3d(_SyncedNorm, nn.BatchNorm3d):
    """The same, still a ``nn.BatchNorm3d`` to layers that take its parameters and normalise themselves."""


_SYNCED: dict[Any, Any] = {nn.BatchNorm1d: _SyncedNorm, nn.BatchNorm2d: _SyncedNorm, nn.BatchNorm3d: _SyncedNorm3d}


# Ctrl-C and SIGTERM between two steps, so that a run keeps what it has done

Handler = Callable[[int, FrameType | None], Any] | int | None


class StopSignal:
    """Whether a signal asked to stop. A second one ends at once, as it would have without."""

    def __init__(self) -> None:
        self.number = 0
        self.before: dict[int, Handler] = {}

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Receive a signal."""
        before = self.before[number]
        if self.number and callable(before):
            before(number, frame)
        self.number = number

    def requested(self, device: torch.device) -> bool:
        """Whether any process was asked to stop: all of them hear of it after the same step."""
        return average_values({"requested": float(self.number > 0)}, device)["requested"] > 0

    def end_run(self) -> NoReturn:
        """End as the signal would have ended it.

        Raises:
            KeyboardInterrupt: After Ctrl-C, or where another process was asked to stop.
            SystemExit: After SIGTERM, where the command line ends by it.
        """
        before = self.before.get(self.number)
        if self.number != signal.SIGINT and callable(before):
            before(self.number, None)
        raise KeyboardInterrupt


@contextmanager
def stop_signals() -> Iterator[StopSignal]:
    """Let Ctrl-C and SIGTERM wait for the end of a step; outside the main thread they stay as they are."""
    stop = StopSignal()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    for number in (signal.SIGINT, signal.SIGTERM):
        if callable(signal.getsignal(number)):  # one that ends the process by itself is left alone
            stop.before[number] = signal.signal(number, stop)
    try:
        yield stop
    finally:
        for received, before in stop.before.items():
            signal.signal(received, before)
