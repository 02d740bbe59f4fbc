"""Where a network runs and in which number type: the device, memory, precision, and Triton's kernels."""

import importlib.util
import inspect
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache, lru_cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import torch
from torch import Tensor

from farfield.errors import ConfigError, FarfieldError, FileFormatError
from farfield.files.atomic import write_text
from farfield.files.json_text import read_json
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
    free, total = torch.cuda.mem_get_info()
    own = torch.cuda.memory_reserved()
    others = max(total - free - own, 0)
    gib = [f"{size / 2**30:.1f}" for size in (total, own, others)]
    return (
        f"The memory of the GPU {torch.cuda.get_device_name()} is not enough: of {gib[0]} GiB this process holds "
        f"{gib[1]}, other programs hold {gib[2]}."
    )


# The number type in which a network runs on a processor: what it has instructions for, or a measurement.
#
# Processors with AMX or AVX-512 BF16 have instructions for bfloat16, twice as many numbers at a time; those without
# AVX-512 do not. In between, with AVX-512 alone, oneDNN computes bfloat16 by float32's units, and which is faster
# depends on the processor and on what the network mostly does: there both are timed, once, and the answer is kept.

Precision = Literal["fp32", "bf16"]
Work = Literal["dense", "rows"]
"""What a network mostly does: convolve maps, or gather rows, multiply them and add them up elsewhere."""
_ASKED = {
    "amx": "_is_amx_tile_supported",
    "avx512_bf16": "_is_avx512_bf16_supported",
    "avx512": "_is_avx512_supported",
}
_NATIVE = {"amx": "AMX", "avx512_bf16": "AVX-512 BF16"}
_ROUNDS = 5


def flags_of_cpu() -> dict[str, bool]:
    """What torch says of the processor: ``amx``, ``avx512_bf16`` and ``avx512``."""
    return {flag: bool(getattr(torch.cpu, name, bool)()) for flag, name in _ASKED.items()}


def chosen_precision(network: Any = None, flags: Mapping[str, bool] | None = None) -> tuple[Precision, str]:
    """The number type that suits a network on a processor, and why.

    Args:
        network: The network, or its class: its ``work`` says what is timed where that is needed.
        flags: As :func:`flags_of_cpu` gives them (default: this processor's).

    >>> chosen_precision(flags={"avx512": True, "avx512_bf16": True})
    ('bf16', 'this processor has bfloat16 instructions (AVX-512 BF16)')
    >>> chosen_precision(flags={})
    ('fp32', 'the processor has no bfloat16')
    """
    flags = flags_of_cpu() if flags is None else flags
    usable = torch.backends.mkldnn.is_available()
    native = [name for flag, name in _NATIVE.items() if flags.get(flag)]
    if native and usable:
        return "bf16", f"this processor has bfloat16 instructions ({native[0]})"
    if not flags.get("avx512") or not usable:
        return "fp32", "the processor has no bfloat16"
    work: Work = getattr(network, "work", "dense")
    times_ms = kept_times()[work]
    faster: Precision = "bf16" if times_ms["bf16"] < times_ms["fp32"] else "fp32"
    what = {"dense": "convolutions", "rows": "sparse convolutions"}[work]
    times = f"{times_ms['fp32']:.1f} ms in fp32 and {times_ms['bf16']:.1f} ms in bf16"
    return faster, f"the processor emulates bfloat16; {what} took {times}"


@cache
def kept_times() -> dict[Work, dict[Precision, float]]:
    """Milliseconds of each work in each number type on this processor; measured in half a second, and kept in a file.

    The file is ``precision.json`` in ``farfield`` below ``XDG_CACHE_HOME`` or ``~/.cache``; where none can be written,
    each process measures anew.
    """
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111 - never raises
    path = Path(home) / "farfield" / "precision.json"
    machine = filter(None, [processor(), os.environ.get("ONEDNN_MAX_CPU_ISA", "")])
    key = f"{', '.join(machine)}, torch {torch.__version__}"
    cached: dict[str, Any] = {}
    try:
        cached = read_json(path, max_bytes=1 << 20)
        times = cached[key]
        return {work: {name: float(times[work][name]) for name in ("fp32", "bf16")} for work in ("dense", "rows")}
    except (OSError, FileFormatError, ValueError, KeyError, TypeError):
        pass
    measured = measured_times()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        others = cached if isinstance(cached, dict) else {}
        write_text(path, json.dumps({**others, key: measured}, indent=1) + "\n")
    except OSError:
        pass  # measured again by the next process
    return measured


def measured_times() -> dict[Work, dict[Precision, float]]:
    """The same, measured now: the least of a few rounds in which both number types take turns."""
    types: dict[Precision, torch.dtype] = {"fp32": torch.float32, "bf16": torch.bfloat16}
    runs: dict[Work, Callable[[torch.dtype], Callable[[], Tensor]]] = {"dense": _Dense, "rows": _GatherMultiply}
    with torch.inference_mode():
        return {work: _least({name: make(dtype) for name, dtype in types.items()}) for work, make in runs.items()}


def _least(runs: Mapping[Precision, Callable[[], Tensor]]) -> dict[Precision, float]:
    times_ms: dict[Precision, list[float]] = {name: [] for name in runs}
    for _ in range(_ROUNDS + 1):
        for name, run in runs.items():
            began = time.process_time()  # other programs do not count
            run()
            times_ms[name].append(1e3 * (time.process_time() - began))
    return {name: round(min(times[1:]), 3) for name, times in times_ms.items()}


class _Dense:
    """A convolution of 3 x 3 over a map of 64 channels."""

    def __init__(self, dtype: torch.dtype) -> None:
        self.map = torch.ones(1, 64, 96, 96, dtype=dtype).contiguous(memory_format=torch.channels_last)
        self.kernel = torch.ones(64, 64, 3, 3, dtype=dtype).contiguous(memory_format=torch.channels_last)

    def __call__(self) -> Tensor:
        return torch.nn.functional.conv2d(self.map, self.kernel, padding=1)


class _GatherMultiply:
    """Rows gathered, multiplied, and added up elsewhere."""

    def __init__(self, dtype: torch.dtype) -> None:
        self.features, self.kernel = torch.ones(20_000, 64, dtype=dtype), torch.ones(64, 64, dtype=dtype)
        self.places = torch.arange(20_000) * 7919 % 20_000

    def __call__(self) -> Tensor:
        out = torch.zeros_like(self.features)
        return out.index_add_(0, self.places, self.features[self.places] @ self.kernel)


def default_precision(device: torch.device, network: Any = None) -> tuple[str, str]:
    """The number type that suits a device and a network, and why.

    ``"bf16"`` where the device multiplies it itself, else ``"fp32"``, or ``"fp16"`` on GPUs with that alone; for
    processors see :func:`chosen_precision`.
    """
    if device.type == "cuda":
        return gpu_precision(device), "what the GPU has matrix units for"
    return chosen_precision(network)


# Triton, where it is installed, and how this project's kernels are compiled.
#
# Modules of kernels stand beside the plain version of what they compute, are named ``triton_...`` and are imported on
# first use only: CPU builds of PyTorch lack Triton.


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
