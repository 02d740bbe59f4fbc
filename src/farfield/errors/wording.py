"""Errors of Python, json, yaml and pydantic in plain words."""

import sys
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from importlib.metadata import Distribution


def plain(error: BaseException) -> str:
    """An error of Python, json, yaml or pydantic in words that name the place and the fault, on one line.

    The texts of those libraries are for programmers; a file's owner needs the place and what is missing there.
    """
    if callable(getattr(error, "errors", None)):  # pydantic's; not imported here, since all import this module
        faults = error.errors()  # type: ignore[attr-defined]
        return "; ".join(_placed(item) for item in faults[:5]) + (" ..." if len(faults) > 5 else "")
    mark = getattr(error, "problem_mark", None)  # yaml's
    if mark is not None:
        tab = " (a tab: indent with blanks)" if "\\t" in str(getattr(error, "problem", "")) else ""
        return f"what is no YAML in line {mark.line + 1}, column {mark.column + 1}{tab}"
    if hasattr(error, "lineno") and hasattr(error, "doc"):  # json's
        return _json_fault(error)
    if isinstance(error, UnicodeDecodeError) and error.object[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "UTF-16 text: save it as UTF-8"
    if isinstance(error, UnicodeDecodeError):
        return f"bytes that are no UTF-8 text, from byte {error.start} on"
    if isinstance(error, RecursionError):
        return "too many groups within one another"
    if type(error) is KeyError:
        return f"no key {error.args[0]!r}" if error.args else "a missing key"
    if isinstance(error, IsADirectoryError):
        return "a folder"
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return " ".join(str(error).split())[:200] or type(error).__name__


def fault_of(item: Mapping[str, Any]) -> str:
    """One entry of a pydantic error in plain words, without its place: ``expected a number, got 'abc'``."""
    kind, limits = str(item["type"]), item.get("ctx") or {}
    if kind in ("missing", "extra_forbidden"):
        return "missing" if kind == "missing" else "no such key"
    if kind in ("value_error", "assertion_error"):
        return str(limits.get("error", item["msg"]))
    expected = _expected(kind, limits)
    if not expected:
        return str(item["msg"]).replace("Input should be", "expected").replace("Value error, ", "")
    text = repr(item.get("input"))
    return f"expected {expected}, got {text if len(text) <= 80 else text[:77] + '...'}"


def _placed(item: Mapping[str, Any]) -> str:
    path = ".".join(map(str, item["loc"]))
    return f"{path}: {fault_of(item)}" if path else fault_of(item)


def _expected(kind: str, limits: Mapping[str, Any]) -> str:
    for name, words in _BOUNDS.items():
        if kind == name:
            return words.format(next(iter(limits.values()), ""))
    if kind in ("too_short", "too_long"):
        bound = limits.get("min_length", limits.get("max_length"))
        return f"at {'least' if kind == 'too_short' else 'most'} {bound} entries"
    return _KINDS.get(kind) or _KINDS.get(kind.rpartition("_")[0]) or _KINDS.get(kind.partition("_")[0], "")


_BOUNDS = {
    "greater_than": "more than {}",
    "greater_than_equal": "{} or more",
    "less_than": "less than {}",
    "less_than_equal": "{} or less",
    "literal_error": "{}",
    "enum": "{}",
}
_KINDS = {
    "int": "a whole number",
    "float": "a number",
    "finite_number": "a finite number",
    "bool": "true or false",
    "string": "text",
    "list": "a list",
    "tuple": "a list",
    "dict": "a group of keys",
    "model": "a group of keys",
    "model_attributes": "a group of keys",
    "path": "a path",
    "json": "JSON",
    "is_instance_of": "another kind of value",
    "none_required": "nothing",
}
_JSON_WORDS = {
    "Expecting value": "a value is missing",
    "Expecting property name": "a key in double quotes is missing",
    "Illegal trailing comma": "a comma stands before the end",
    "Expecting ','": "a comma is missing",
    "Expecting ':'": "a colon is missing",
    "Extra data": "text follows after the end",
    "Unterminated string": "a text has no end quote",
    "Invalid control": "a text holds a control character",
    "Invalid \\": "a text holds a wrong escape",
}


def _json_fault(error: Any) -> str:
    if not str(error.doc).strip():
        return "an empty file"
    words = next((words for begin, words in _JSON_WORDS.items() if str(error.msg).startswith(begin)), "no JSON there")
    return f"a fault in line {error.lineno}, column {error.colno}: {words}"


# Optional dependencies: which extra each belongs to, and how to install it beside this very copy of Farfield.

EXTRAS = {
    "torch": ("detect", "torch"),
    "lightning_fabric": ("detect", "lightning-fabric"),
    "safetensors": ("detect", "safetensors"),
    "tensorboard": ("detect", "tensorboard"),
    "embreex": ("simulate", "embreex"),
    "numba": ("simulate", "numba"),
    "pyarrow": ("argoverse2", "pyarrow"),
    "rosbags": ("bags", "rosbags"),
    "lazrs": ("las", "lazrs"),
    "cv2": ("privacy", "opencv-python-headless"),
    "av": ("video", "av"),
    "onnx": ("export", "onnx"),
    "onnxscript": ("export", "onnxscript"),
    "onnxruntime": ("onnx", "onnxruntime"),
    "ray": ("ray", "ray"),
    "fsspec": ("remote", "fsspec"),
    "obstore": ("remote", "obstore"),
    "aiohttp": ("remote", "aiohttp"),
    "starlette": ("studio", "starlette"),
    "uvicorn": ("studio", "uvicorn"),
    "websockets": ("studio", "websockets"),
    "zstandard": ("sensors", "zstandard"),
}
"""Extra and package of each module that ``import farfield`` can do without."""


def advice(extra: str) -> str:
    """The command that installs an extra, for the way in which Farfield itself was installed.

    From an index the extra's own name does it; a checkout is installed again from its folder; beside a wheel or a
    folder on ``PYTHONPATH`` the packages are named, since no index need have Farfield.
    """
    from importlib.util import find_spec

    way, folder = _installed_from()
    pip = "pip install" if find_spec("pip") else "uv pip install"
    if way == "editable":
        return f"{pip} -e {_quoted(f'{folder}[{extra}]')}"
    packages = _requirements(extra) if way == "file" else []
    return " ".join([pip, *map(_quoted, packages or [f"farfield[{extra}]"])])


def torch_note(package: str) -> str:
    """Which torch suits a Linux machine without a GPU: plain pip takes 4.6 GB of CUDA there. Empty for others."""
    if package != "torch" or not sys.platform.startswith("linux") or has_nvidia_gpu():
        return ""
    return (
        ". This machine shows no NVIDIA GPU: install torch's CPU build before it (0.7 GB), from the index that "
        "PyTorch's own page names; else pip takes the build with CUDA (4.6 GB)"
    )


def has_nvidia_gpu() -> bool:
    """Whether the driver of an NVIDIA GPU is there, as far as can be told without torch."""
    from shutil import which

    return Path("/proc/driver/nvidia/version").exists() or which("nvidia-smi") is not None


def _quoted(words: str) -> str:
    return f'"{words}"'


def _installed_from() -> tuple[Literal["index", "editable", "file"], str]:
    package = _distribution()
    if package is None:
        checkout = _checkout()
        return ("file", "") if checkout is None else ("editable", str(checkout))
    source, folder = _source(package)
    if source.get("dir_info", {}).get("editable"):
        return "editable", folder
    return ("file" if source else "index"), ""


def _source(package: "Distribution") -> tuple[dict[str, Any], str]:
    """Where a distribution was installed from (PEP 610), empty for an index, and the path in it."""
    import json
    from urllib.parse import unquote, urlsplit

    source = json.loads(package.read_text("direct_url.json") or "{}")
    return source, unquote(urlsplit(str(source.get("url", ""))).path)


def _distribution() -> "Distribution | None":
    """Farfield's own, if this copy is the installed one and not a checkout that stands before it on the path."""
    from importlib.metadata import PackageNotFoundError, distribution

    try:
        package = distribution("farfield")
    except PackageNotFoundError:
        return None
    path = Path(__file__).resolve()
    checkout = _checkout()
    if checkout is None or Path(str(package.locate_file(""))).resolve() in path.parents:
        return package
    return package if _source(package)[1] == str(checkout) else None


def _checkout() -> Path | None:
    """The folder with the ``pyproject.toml`` of a checkout in which this file stands."""
    root = Path(__file__).resolve().parents[3]
    return root if (root / "pyproject.toml").is_file() and (root / "src" / "farfield").is_dir() else None


def _requirements(extra: str) -> list[str]:
    import tomllib
    from importlib.metadata import PackageNotFoundError, requires

    checkout = _checkout()
    if checkout is not None:
        project = tomllib.loads((checkout / "pyproject.toml").read_text("utf-8"))["project"]
        return list(project["optional-dependencies"].get(extra, []))
    try:
        lines = requires("farfield") or []
    except PackageNotFoundError:
        return sorted({package for extra_name, package in EXTRAS.values() if extra_name == extra})
    marked = [line.partition(";") for line in lines]
    return [
        requirement.strip()
        for requirement, _, marker in marked
        if marker.replace("'", '"').strip() == f'extra == "{extra}"'
    ]


def did_you_mean(name: str, names: Iterable[str], *, most: int = 1) -> str:
    """A sentence with the names nearest to one that is none of them; empty where none is near.

    Args:
        name: What was written.
        names: What there is.
        most: How many are named.

    >>> did_you_mean("nuscene", ["dds", "nuscenes"]), did_you_mean("kitti", ["dds"])
    (' Did you mean nuscenes?', '')
    """
    by_plain = {other.lower(): other for other in names}
    close = get_close_matches(name.lower(), by_plain, n=most)
    return f" Did you mean {' or '.join(by_plain[plain] for plain in close)}?" if close else ""
