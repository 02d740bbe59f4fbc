"""Files that ``torch.save`` wrote, from anyone: dense tensors that own their numbers, and plain values.

Nothing in them is executed. What torch would read besides is refused in words: tensors without numbers, sparse and
quantized ones, complex numbers, views that stand for more numbers than the file holds, and packed archives.
"""

import warnings
import zipfile
from pathlib import Path
from typing import Any, BinaryIO

import torch
from torch import Tensor

from farfield.errors import FarfieldError, FileFormatError
from farfield.files.archives import check_archive
from farfield.files.limits import MAX_WEIGHTS_BYTES, open_file
from farfield.files.sizes import sized

MOST_VALUES = 1_000_000  # tensors and plain values of a file
_TYPES = frozenset({torch.float16, torch.bfloat16, torch.float32, torch.float64, torch.bool, torch.uint8}) | {
    *(torch.int8, torch.int16, torch.int32, torch.int64)
}
_PICKLE_BYTES = 1 << 26  # of a file of the old form, which begins with its pickles
_SHARE, _SLACK_BYTES = 4, 1 << 20  # numbers that tensors share stand in a file once


def load_torch(path: Path, *, expected: str, fix: str) -> Any:
    """Read tensors and plain values onto the CPU.

    Args:
        path: The file.
        expected: What it should be, for messages.
        fix: What is to be done where it is not.

    Raises:
        FarfieldError: If there is no such file.
        FileFormatError: If it is damaged, holds other objects, or tensors other than dense ones of real numbers.
    """
    if not path.is_file():
        raise FarfieldError(f"{path}: expected {expected}, found nothing.")
    with open_file(path, max_bytes=MAX_WEIGHTS_BYTES) as file:
        is_zip = file.read(2) == b"PK"
        opens = check_archive(path, file, expected=expected)
        fault = "an archive that cannot be opened" if is_zip and not opens else _blank_memory(file, opens)
    if fault:
        raise FileFormatError(path, where="the file", expected=expected, got=fault, fix=fix)
    try:
        with warnings.catch_warnings(action="ignore"):  # of pickle protocols and kinds of tensors other than the usual
            content = torch.load(path, map_location="cpu", weights_only=True)
        fault = _strange(content, _SHARE * path.stat().st_size + _SLACK_BYTES)
    except Exception as error:  # torch raises many kinds for damaged or hostile files
        words = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise FileFormatError(path, where="the file", expected=expected, got=words, fix=fix) from error
    if fault:
        raise FileFormatError(path, where="the file", expected=expected, got=fault, fix=fix)
    return content


def _blank_memory(file: BinaryIO, is_archive: bool) -> str:
    """What a pickle allocates by a size that it names itself, which a hundred bytes do for gigabytes; else empty.

    That is the one callable that torch lets a pickle call with a number of its own: no weights have any.
    """
    if is_archive:
        try:
            with zipfile.ZipFile(file) as archive:
                pickles = [name for name in archive.namelist() if name.rsplit("/", 1)[-1] == "data.pkl"]
                texts = [archive.read(name) for name in pickles]
        except (zipfile.BadZipFile, NotImplementedError, RuntimeError, OSError, ValueError, EOFError) as error:
            return f"a damaged archive ({error})"[:200]
    else:
        file.seek(0)
        texts = [file.read(_PICKLE_BYTES)]
    return "an array of bytes" if any(b"bytearray" in text for text in texts) else ""


def _strange(content: Any, most_bytes: int) -> str:
    """What of the content is no dense tensor of real numbers, or more than a file of its size holds; else empty."""
    waiting, met, total_bytes = [("", content)], set[int](), 0
    while waiting:
        name, value = waiting.pop()
        if id(value) in met:  # lists within lists, of which a short file makes many
            continue
        if isinstance(value, dict | list | tuple | set | Tensor):
            met.add(id(value))
        if len(met) > MOST_VALUES or len(waiting) > MOST_VALUES:
            return f"more than {MOST_VALUES} values"
        if isinstance(value, dict):
            odd = next((key for key in value if isinstance(key, str) and not key.isprintable()), None)
            if odd is not None:
                return f"a name that is no text, {odd[:40]!r}"
            waiting += [(f"{name}.{key}".strip("."), item) for key, item in value.items()]
        elif isinstance(value, list | tuple | set):
            waiting += [(name, item) for item in value]
        elif isinstance(value, Tensor):
            kind = _kind(value)
            if kind:
                return f"{kind} at {name[:80]!r}"
            total_bytes += value.numel() * value.element_size()
            if total_bytes > most_bytes:
                return f"tensors of {sized(total_bytes)}, more than the file holds, up to {name[:80]!r}"
    return ""


def _kind(tensor: Tensor) -> str:
    """Why a tensor is none that weights have; else empty."""
    if tensor.is_meta:
        return "a tensor without numbers"
    if tensor.is_nested or tensor.layout != torch.strided:
        return "a sparse or nested tensor"
    if tensor.is_quantized or tensor.dtype not in _TYPES:
        return f"a tensor of {str(tensor.dtype).removeprefix('torch.')}"
    if type(tensor) not in (Tensor, torch.nn.Parameter):
        return f"a {type(tensor).__name__}"
    if tensor.numel() * tensor.element_size() > tensor.untyped_storage().nbytes():
        return f"a tensor of shape {tuple(tensor.shape)} that repeats {sized(tensor.untyped_storage().nbytes())}"
    return ""
