"""What of a written file is compared: texts without times and places, pixels, arrays, bytes."""

import base64
import binascii
import gzip
import hashlib
import io
import json
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

TEXTS = {
    *(".json", ".jsonl", ".html", ".csv", ".yaml", ".yml", ".txt", ".xml", ".md", ".svg", ".xyz", ".log", ".ts"),
    *(".out", ".err", ".py"),
}
PICTURES = {".png", ".gif", ".webp", ".jpg", ".jpeg"}
LEFT_OUT = (
    (r"(^|/)events\.out\.tfevents\.", "time, host and process stand in name and bytes; log.jsonl has the numbers"),
    (r"(^|/)__pycache__/", "compiled sources"),
)
"""Files that are not recorded, and why."""

KEPT_BYTES = 1 << 20
"""Arrays of numbers up to this size are kept, so that a difference can be measured."""

_TIMES = (
    r"cpu_ms|eta_s|hours|milliseconds|minutes|ms|ms_per_frame|ms_a_frame|peak_memory_mb|samples_a_second|seconds"
    r"|seconds_per_step|spent_s|steps_a_second|took_s|wall_s|worked_s"
)
_RULES: tuple[tuple[str, str], ...] = (
    (r"\x1b\[[0-9;?]*[A-Za-z]", ""),  # colours and moves of the cursor
    (r"(?m)^.*[━╸╺].*\d+/\d+.*\n?", ""),  # progress bars
    (r"(?m)^.*\b\d+/\d+ \d+:\d\d:\d\d.*\n?", ""),
    (r"(?m)^.*━.*\b\d+% \d+:\d\d:\d\d.*\n?", ""),
    (r"127\.0\.0\.1:\d+", "127.0.0.1:PORT"),
    (r"token=[\w-]+", "token=TOKEN"),
    (rf'("(?:{_TIMES})": ?)-?\d[\d.e+-]*', r"\1TIME"),
    (r"\b\d[\d.,]* ms a frame\b", "TIME ms a frame"),
    (r"\b\d[\d.,]* ms of CPU a sweep\b", "TIME ms of CPU a sweep"),
    (r"\bdone in \d[\d.,]* (s|min)\b", "done in TIME"),
    (r"\b\d+:\d\d:\d\d (elapsed|left)\b", r"TIME \1"),
    (r'(?m)^[0-9a-f]{8} (?=\{"seq")', "SUM "),  # of a journal's line, its time included
    (r"\b\d{8}T\d{6}(\.\d+)?Z", "STAMP"),
    (r"\b0x[0-9a-f]{8,}\b", "ADDRESS"),
    (r'("commit": ")(?:[0-9a-f]{7,40}|COMMIT)(?:-dirty)?', r"\1COMMIT"),
    (r"\bcommit [0-9a-f]{12}(?:-dirty)?\b", "commit COMMIT"),  # that of the tree; those of shipped weights are shorter
    (r"(<dt>commit</dt><dd>)(?:[0-9a-f]{7,40}|COMMIT)(?:-dirty)?", r"\1COMMIT"),
    (r'("(?:farfield|numpy|scipy|torch|python)": ")\d[^"]*', r"\1VERSION"),
    (r"TREE/src/[\w/]+\.py:\d+", "SOURCE"),  # of a warning
    (r'File "TREE/src/[\w/]+\.py", line \d+, in \w+\n.*\n(?: *[\^~]+\n)?', "SOURCE\n"),  # of a traceback
)
"""What differs from run to run without a change of behaviour, and what stands for it."""

_RULES_OF_FILES: tuple[tuple[str, str, str], ...] = (
    # digest of the sources' times of change; those of simulations are of settings alone
    (r"(^|/)\.(?!farfield_simulate)[^/]*\.jsonl$", r'("source": ")[0-9a-f]{32}"', r'\1SOURCES"'),
    (r"(^|/)timing\.json$", r"(?<![\w.])\d[\d.e+-]*", "TIME"),
    (r"/lock$", r"\d+", "PROCESS"),
)
"""The same for files whose names match."""


@dataclass(frozen=True)
class Places:
    """What a run's texts may name, and must not be compared.

    Args:
        words: Folders and names of this run and machine, and the word that stands for each.
        began_s: When the run began; its own times are found by it.
        ends_s: A time after its end.
    """

    words: Mapping[str, str]
    began_s: float
    ends_s: float

    def plain(self, text: str) -> str:
        """The text without what is this run's alone."""
        for word in sorted(self.words, key=len, reverse=True):
            text = text.replace(word, self.words[word])
        text = ruled(text)
        text = re.sub(_DATES, self._date, text)
        return re.sub(r"(?<![\w.])1\d{9}(?:\.\d+|\d{3}|\d{6}|\d{9})?(?![\w.])", self._moment, text)

    def _date(self, found: re.Match[str]) -> str:
        days = {np.datetime64(int(second), "s").astype("datetime64[D]") for second in (self.began_s, self.ends_s)}
        return "DATE" if np.datetime64(found.group(1)) in days else found.group()

    def _moment(self, found: re.Match[str]) -> str:
        whole = found.group().partition(".")[0]
        seconds = int(whole) / 10 ** (len(whole) - 10)
        return "NOW" if self.began_s - 1 <= seconds <= self.ends_s + 1 else found.group()


def ruled(text: str) -> str:
    """A text after the rules that hold for every run; a record made under fewer rules needs them again."""
    for pattern, stands in _RULES:
        text = re.sub(pattern, stands, text)
    return text


_DATES = r"\b(20\d\d-\d\d-\d\d)(?:[T ]\d\d:\d\d(?::\d\d(?:\.\d+)?)?(?: ?(?:UTC|Z|[+-]\d\d:?\d\d))?)?"


def sha(data: bytes) -> str:
    """Bytes by their name."""
    return hashlib.sha256(data).hexdigest()[:24]


def is_left_out(name: str) -> bool:
    """Whether a file is not recorded."""
    return any(re.search(pattern, name) for pattern, _ in LEFT_OUT)


class Digester:
    """Turns written files into what is compared; keeps texts and small arrays beside the record.

    Args:
        places: What is this run's alone.
        arrays: Folder for the arrays that are kept.
    """

    def __init__(self, places: Places, arrays: Path) -> None:
        self.places, self.arrays = places, arrays

    def file(self, name: str, data: bytes) -> tuple[dict[str, Any], str | None]:
        """What is compared of a file: the entry of the record, and its text if it is one."""
        suffix = Path(name).suffix.lower()
        try:
            if suffix == ".gz":
                inner, text = self.file(name[:-3], gzip.decompress(data))
                return {"kind": "gz", "inside": inner}, text
            if suffix in PICTURES:
                return self.picture(data), None
            reader = _READERS.get(suffix)
            if reader is not None:
                return self._members(reader(data)), None
        except Exception as error:  # noqa: BLE001 - a damaged file is one too
            return {"kind": "bytes", "sha": sha(data), "unread": type(error).__name__}, None
        text = self._text(data) if suffix in TEXTS or b"\0" not in data[:4096] else None
        if text is None:
            return {"kind": "bytes", "sha": sha(data), "size": len(data)}, None
        for file, pattern, stands in _RULES_OF_FILES:
            text = re.sub(pattern, stands, text) if re.search(file, name) else text
        return {"kind": "text", "sha": sha(text.encode())}, text

    def text(self, text: str) -> str:
        """A text without times and places; what is packed into it by name."""
        text = re.sub(r"data:([\w/+.-]+);base64,([A-Za-z0-9+/=]+)", self._embedded, text)
        text = re.sub(r"(?<![A-Za-z0-9+/=])[A-Za-z0-9+/]{200,}={0,2}", self._packed, text)
        return self.places.plain(text)

    def picture(self, data: bytes) -> dict[str, Any]:
        """A picture by its pixels, every one of a film's, and by what is written beside them."""
        pixels, frames = hashlib.sha256(), 0
        with Image.open(io.BytesIO(data)) as image:
            info = {key: value for key, value in image.info.items() if isinstance(value, str | int | float | tuple)}
            for number in range(getattr(image, "n_frames", 1)):
                image.seek(number)
                pixels.update(image.tobytes())
                frames += 1
            told = {key: self.text(str(value)) for key, value in info.items() if key != "Software"}
            return {
                "kind": "picture",
                "sha": pixels.hexdigest()[:24],
                "size": [*image.size, frames],
                "mode": image.mode,
                "told": told,
            }

    def _text(self, data: bytes) -> str | None:
        try:
            return self.text(data.decode("utf-8"))
        except UnicodeDecodeError:
            return None

    def _embedded(self, found: re.Match[str]) -> str:
        data = base64.b64decode(found.group(2))
        what = self.picture(data)["sha"] if found.group(1) in ("image/png", "image/webp") else sha(data)
        return f"data:{found.group(1)};{what}"

    def _packed(self, found: re.Match[str]) -> str:
        try:
            data = base64.b64decode(found.group(), validate=True)
        except (binascii.Error, ValueError):
            return found.group()
        return f"PACKED {sha(gzip.decompress(data) if data[:2] == _GZIP else data)}"

    def _members(self, members: Iterator[tuple[str, Any]]) -> dict[str, Any]:
        arrays: dict[str, Any] = {}
        told: dict[str, Any] = {}
        for name, value in members:
            if isinstance(value, np.ndarray) and value.dtype != object:
                arrays[name] = self.array(value)
            elif isinstance(value, bytes):
                told[name], _ = self.file(name, value)
            else:
                told[name] = self.text(value if isinstance(value, str) else repr(value))
        return {"kind": "arrays", "arrays": arrays, "told": told}

    def array(self, value: np.ndarray) -> dict[str, Any]:
        """An array by its name; small ones are kept."""
        data = np.ascontiguousarray(value)
        name = sha(data.tobytes())
        if data.dtype.kind in "fiu" and 0 < data.nbytes <= KEPT_BYTES:
            path = self.arrays / f"{name}.npy"
            if not path.exists():
                self.arrays.mkdir(parents=True, exist_ok=True)
                np.save(path, data)
        return {"dtype": str(value.dtype), "shape": list(value.shape), "sha": name}


_GZIP = b"\x1f\x8b"


def _npy(data: bytes) -> Iterator[tuple[str, Any]]:
    yield "", np.load(io.BytesIO(data), allow_pickle=False)


def _zip(data: bytes) -> Iterator[tuple[str, Any]]:
    with zipfile.ZipFile(io.BytesIO(data)) as packed:
        for name in packed.namelist():
            inside = packed.read(name)
            yield name, np.load(io.BytesIO(inside), allow_pickle=False) if name.endswith(".npy") else inside


def _safetensors(data: bytes) -> Iterator[tuple[str, Any]]:
    from safetensors.torch import load

    head = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    for key, value in sorted(head.get("__metadata__", {}).items()):
        yield f"metadata {key}", value
    for name, tensor in load(data).items():
        yield name, _numbers(tensor)


def _checkpoint(data: bytes) -> Iterator[tuple[str, Any]]:
    import torch

    yield from _leaves("", torch.load(io.BytesIO(data), map_location="cpu", weights_only=True))


def _leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for key in value:
            yield from _leaves(f"{name}/{key}", value[key])
    elif isinstance(value, list | tuple):
        for number, each in enumerate(value):
            yield from _leaves(f"{name}/{number}", each)
    elif hasattr(value, "untyped_storage"):
        yield name, _numbers(value)
    else:
        yield name, value if isinstance(value, np.ndarray) else repr(value)


def _numbers(tensor: Any) -> np.ndarray:
    if str(tensor.dtype) in ("torch.bfloat16", "torch.float16"):
        tensor = tensor.float()
    return np.asarray(tensor.detach().cpu().numpy())


def _hdf5(data: bytes) -> Iterator[tuple[str, Any]]:
    import h5py

    found: list[tuple[str, Any]] = []
    with h5py.File(io.BytesIO(data), "r") as file:
        found += [(f"/@{key}", repr(value)) for key, value in sorted(file.attrs.items())]
        names: list[str] = []
        file.visit(names.append)
        for name in names:
            found += [(f"{name}@{key}", repr(value)) for key, value in sorted(file[name].attrs.items())]
            if isinstance(file[name], h5py.Dataset):
                found.append((name, file[name][()]))
    yield from found


_READERS: dict[str, Callable[[bytes], Iterator[tuple[str, Any]]]] = {
    ".npy": _npy,
    ".npz": _zip,
    ".zip": _zip,
    ".safetensors": _safetensors,
    ".pt": _checkpoint,
    ".pth": _checkpoint,
    ".h5": _hdf5,
}
