"""The number type in which a network runs on a processor: what the processor multiplies itself, or a measurement.

Processors with AMX or AVX-512 BF16 multiply bfloat16 themselves, twice as many numbers at a time; those without AVX-512
do not. In between, with AVX-512 alone, oneDNN computes bfloat16 by float32's units, and which is faster depends on the
processor and on what the network mostly does: there both are timed, once, and the answer is kept.
"""

import json
import os
import time
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor

from farfield.files.atomic import write_text
from farfield.frame.provenance import processor

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
        flags: As :func:`flags_of_cpu` gives them; this processor's unless given.

    >>> chosen_precision(flags={"avx512": True, "avx512_bf16": True})
    ('bf16', 'the processor multiplies bfloat16 (AVX-512 BF16)')
    >>> chosen_precision(flags={})
    ('fp32', 'the processor has no bfloat16')
    """
    flags = flags_of_cpu() if flags is None else flags
    usable = torch.backends.mkldnn.is_available()
    native = [name for flag, name in _NATIVE.items() if flags.get(flag)]
    if native and usable:
        return "bf16", f"the processor multiplies bfloat16 ({native[0]})"
    if not flags.get("avx512") or not usable:
        return "fp32", "the processor has no bfloat16"
    work: Work = getattr(network, "work", "dense")
    taken = kept_times()[work]
    faster: Precision = "bf16" if taken["bf16"] < taken["fp32"] else "fp32"
    what = {"dense": "convolutions", "rows": "sparse convolutions"}[work]
    times = f"{taken['fp32']:.1f} ms in fp32 and {taken['bf16']:.1f} ms in bf16"
    return faster, f"the processor emulates bfloat16; {what} took {times}"


@cache
def kept_times() -> dict[Work, dict[Precision, float]]:
    """Milliseconds of each work in each number type on this processor; measured in half a second, and kept in a file.

    The file is ``precision.json`` in ``farfield`` below ``XDG_CACHE_HOME`` or ``~/.cache``; where none can be written,
    each process measures anew.
    """
    path, key = _cache_path(), f"{_processor()}, torch {torch.__version__}"
    known: dict[str, Any] = {}
    try:
        known = json.loads(path.read_text(encoding="utf-8"))
        times = known[key]
        return {work: {name: float(times[work][name]) for name in ("fp32", "bf16")} for work in ("dense", "rows")}
    except (OSError, ValueError, KeyError, TypeError):
        pass
    measured = measured_times()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        others = known if isinstance(known, dict) else {}
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
    taken: dict[Precision, list[float]] = {name: [] for name in runs}
    for _ in range(_ROUNDS + 1):
        for name, run in runs.items():
            began = time.process_time()  # other programs do not count
            run()
            taken[name].append(1e3 * (time.process_time() - began))
    return {name: round(min(times[1:]), 3) for name, times in taken.items()}


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


def _cache_path() -> Path:
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111 - never raises
    return Path(home) / "farfield" / "precision.json"


def _processor() -> str:
    return ", ".join(filter(None, [processor(), os.environ.get("ONEDNN_MAX_CPU_ISA", "")]))
