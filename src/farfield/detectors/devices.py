"""Where a network runs, in which number type, how numbers get there, and what to change where they do not fit."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache

import torch
from torch import Tensor

from farfield.errors import ConfigError, FarfieldError
from farfield.frame.provenance import processor

DTYPES = {"fp32": torch.float32, "bf16": torch.bfloat16, "fp16": torch.float16}
"""The number types that a network runs in, by name."""

_TENSOR_CORES = (7, 0)  # from this compute capability on float16 has matrix units (CUDA C++ Programming Guide, 5.)
_CPU_WORDS = ("not enough memory", "can't allocate memory")  # how PyTorch's allocator of the CPU says it


class OutOfMemory(FarfieldError):  # noqa: N818 - it ends in what happened, as torch's does
    """A network's numbers do not fit into the memory of its device."""


def chosen_device(device: str | torch.device | None = None) -> torch.device:
    """The device of a name such as ``"cuda:0"``; for None or ``"auto"`` a GPU if there is one, else the CPU.

    Raises:
        ConfigError: If there is no such device.
    """
    if device is None or device == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        chosen = torch.device(device)
    except RuntimeError as error:
        raise ConfigError(f"device: expected auto, cpu, cuda or cuda:NUMBER; got {device!r}.") from error
    if chosen.type == "cuda" and (chosen.index or 0) >= torch.cuda.device_count():
        built = "was built without CUDA" if torch.version.cuda is None else f"is built for CUDA {torch.version.cuda}"
        raise ConfigError(
            f"device: expected one of the {torch.cuda.device_count()} GPUs that torch {torch.__version__} sees (it "
            f"{built}); got {device!r}. Take auto or cpu, or install a build of torch that fits the GPU's driver."
        )
    return chosen


def gpu_precision(device: torch.device) -> str:
    """The number type that suits a GPU: bfloat16 or else float16 where it has matrix units for it, else float32.

    PyTorch calls bfloat16 supported where it is only emulated; that is left out here.
    """
    with torch.cuda.device(device):
        if torch.cuda.is_bf16_supported(including_emulation=False):
            return "bf16"
    return "fp16" if torch.cuda.get_device_capability(device) >= _TENSOR_CORES else "fp32"


def sent(tensor: Tensor, device: torch.device) -> Tensor:
    """A tensor of the CPU on a device; to a GPU through pinned memory, so that the copy does not stop this thread."""
    if device.type != "cuda":
        return tensor.to(device)
    return tensor.pin_memory().to(device, non_blocking=True)


@lru_cache(maxsize=256)
def constant(
    values: tuple[float, ...] | tuple[tuple[float, ...], ...],
    device: torch.device,
    dtype: torch.dtype = torch.float64,
) -> Tensor:
    """Fixed numbers on a device: they travel once for each process. Not to be written to."""
    with torch.inference_mode(False):
        return torch.tensor(values, dtype=dtype, device=device)


@contextmanager
def fitting(advice: str) -> Iterator[None]:
    """Say what to change where memory is not enough.

    Args:
        advice: What to change, a sentence.

    Raises:
        OutOfMemory: In place of PyTorch's error.
    """
    try:
        yield
    except torch.OutOfMemoryError as error:
        raise OutOfMemory(f"{_taken(error)} {advice}") from error
    except RuntimeError as error:
        if not any(words in str(error) for words in _CPU_WORDS):
            raise
        raise OutOfMemory(f"The memory of this machine is not enough. {advice}") from error


def name_of(device: torch.device) -> str:
    """What a device is called: the GPU, or the processor."""
    return torch.cuda.get_device_name(device) if device.type == "cuda" else processor()


def _taken(error: Exception) -> str:
    """How much of the GPU is taken and by whom, as far as it can be asked."""
    if not torch.cuda.is_available():
        return f"The memory of the GPU is not enough ({str(error).splitlines()[0]})."
    free, whole = torch.cuda.mem_get_info()
    mine = torch.cuda.memory_reserved()
    others = max(whole - free - mine, 0)
    gib = [f"{size / 2**30:.1f}" for size in (whole, mine, others)]
    return (
        f"The memory of the GPU {torch.cuda.get_device_name()} is not enough: of {gib[0]} GiB this process holds "
        f"{gib[1]}, other programs hold {gib[2]}."
    )
