"""The number type in which a network runs on a processor: what the processor multiplies itself decides."""

from collections.abc import Mapping
from typing import Any, Literal

import torch

Precision = Literal["fp32", "bf16"]
_ASKED = {
    "amx": "_is_amx_tile_supported",
    "avx512_bf16": "_is_avx512_bf16_supported",
    "avx512": "_is_avx512_supported",
}
_NATIVE = {"amx": "AMX", "avx512_bf16": "AVX-512 BF16"}


def flags_of_cpu() -> dict[str, bool]:
    """What torch says of the processor: ``amx``, ``avx512_bf16`` and ``avx512``."""
    return {flag: bool(getattr(torch.cpu, name, bool)()) for flag, name in _ASKED.items()}


def chosen_precision(network: Any = None, flags: Mapping[str, bool] | None = None) -> tuple[Precision, str]:
    """The number type that suits a network on a processor, and why.

    Processors with AMX or AVX-512 BF16 multiply bfloat16 itself, twice as many numbers at a time. With AVX-512 alone
    oneDNN multiplies it by float32's units: dense convolutions then take longer than in float32, while a network that
    mostly gathers and scatters rows still gains from their halved size; which it is, is the network's ``emulated``.

    Args:
        network: The network, or its class.
        flags: As :func:`flags_of_cpu` gives them; this processor's unless given.

    >>> chosen_precision(flags={"avx512": True, "avx512_bf16": True})
    ('bf16', 'the processor multiplies bfloat16 (AVX-512 BF16)')
    >>> chosen_precision(flags={"avx512": True})[0], chosen_precision(flags={})[0]
    ('fp32', 'fp32')
    """
    flags = flags_of_cpu() if flags is None else flags
    usable = torch.backends.mkldnn.is_available()
    native = [name for flag, name in _NATIVE.items() if flags.get(flag)]
    if native and usable:
        return "bf16", f"the processor multiplies bfloat16 ({native[0]})"
    if flags.get("avx512") and usable:
        if getattr(network, "emulated", "fp32") == "bf16":
            return "bf16", "the processor only emulates bfloat16, from which this network's gathering still gains"
        return "fp32", "the processor only emulates bfloat16 (AVX-512 without BF16 or AMX)"
    return "fp32", "the processor has no bfloat16"
