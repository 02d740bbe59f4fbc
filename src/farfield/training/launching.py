"""The start of a training's processes on their devices, by Lightning Fabric, which takes a second to import."""

import atexit
import os
from datetime import timedelta

import torch
from lightning_fabric import Fabric
from lightning_fabric.strategies import DDPStrategy
from torch import distributed

from farfield.detectors.devices import default_precision
from farfield.training.config import TrainingConfig

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


def kind_of_device(config: TrainingConfig) -> str:
    """``"GPU"`` or ``"CPU"``."""
    return "GPU" if _accelerator(config) in ("gpu", "cuda") else "CPU"


def _accelerator(config: TrainingConfig) -> str:
    if config.accelerator != "auto":
        return config.accelerator
    return "gpu" if torch.cuda.is_available() else "cpu"
