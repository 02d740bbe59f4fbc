"""Triton, where it is installed, and how this project's kernels are compiled.

Modules of kernels stand beside the plain version of what they compute, are named ``triton_...`` and are imported on
first use only: CPU builds of PyTorch lack Triton.
"""

import importlib.util
import inspect
from collections.abc import Callable
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

import torch


@cache
def has_triton() -> bool:
    """Whether Triton is installed."""
    return importlib.util.find_spec("triton") is not None


def kernels_for(device: torch.device, module: str) -> ModuleType | None:
    """A module of kernels, for tensors on a GPU and where there is Triton; else None, and the plain version computes.

    Args:
        device: Where the tensors are.
        module: Its name below ``farfield.detectors``.
    """
    if device.type != "cuda" or not has_triton():
        return None
    return import_module(f"farfield.detectors.{module}")


def jit(kernel: Callable[..., Any]) -> Any:
    """Compile a kernel on first use.

    Triton reads the function's source, so it needs the function itself, not what a type checker wrapped around it.
    """
    return import_module("triton").jit(inspect.unwrap(kernel))
