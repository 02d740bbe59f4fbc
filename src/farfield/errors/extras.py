"""Optional dependencies: which extra each belongs to, and how to install it beside this very copy of Farfield."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from importlib.metadata import Distribution

EXTRAS = {
    "torch": ("detect", "torch"),
    "lightning_fabric": ("detect", "lightning-fabric"),
    "safetensors": ("detect", "safetensors"),
    "tensorboard": ("detect", "tensorboard"),
    "embreex": ("simulate", "embreex"),
    "numba": ("simulate", "numba"),
    "pyarrow": ("argoverse2", "pyarrow"),
    "rosbags": ("bags", "rosbags"),
    "cv2": ("privacy", "opencv-python-headless"),
    "av": ("video", "av"),
    "starlette": ("studio", "starlette"),
    "uvicorn": ("studio", "uvicorn"),
    "websockets": ("studio", "websockets"),
    "zstandard": ("studio", "zstandard"),
}
"""Extra and package of each module that ``import farfield`` can do without."""


def advice(extra: str) -> str:
    """The command that installs an extra, for the way in which Farfield itself was installed.

    From an index the extra's own name does it; a checkout is installed again from its folder; beside a wheel or a
    folder on ``PYTHONPATH`` the packages are named, since no index need have Farfield.
    """
    from importlib.util import find_spec

    way, place = _installed_from()
    pip = "pip install" if find_spec("pip") else "uv pip install"
    if way == "editable":
        return f"{pip} -e {_quoted(f'{place}[{extra}]')}"
    packages = _requirements(extra) if way == "file" else []
    return " ".join([pip, *map(_quoted, packages or [f"farfield[{extra}]"])])


def _quoted(words: str) -> str:
    return f'"{words}"'


def _installed_from() -> tuple[Literal["index", "editable", "file"], str]:
    found = _distribution()
    if found is None:
        checkout = _checkout()
        return ("file", "") if checkout is None else ("editable", str(checkout))
    source, place = _source(found)
    if source.get("dir_info", {}).get("editable"):
        return "editable", place
    return ("file" if source else "index"), ""


def _source(found: "Distribution") -> tuple[dict[str, Any], str]:
    """Where a distribution was installed from (PEP 610), empty for an index, and the path in it."""
    import json
    from urllib.parse import unquote, urlsplit

    source = json.loads(found.read_text("direct_url.json") or "{}")
    return source, unquote(urlsplit(str(source.get("url", ""))).path)


def _distribution() -> "Distribution | None":
    """Farfield's own, if this copy is the installed one and not a checkout that stands before it on the path."""
    from importlib.metadata import PackageNotFoundError, distribution

    try:
        found = distribution("farfield")
    except PackageNotFoundError:
        return None
    place = Path(__file__).resolve()
    checkout = _checkout()
    if checkout is None or Path(str(found.locate_file(""))).resolve() in place.parents:
        return found
    return found if _source(found)[1] == str(checkout) else None


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
        return sorted({package for each, package in EXTRAS.values() if each == extra})
    marked = [line.partition(";") for line in lines]
    return [words.strip() for words, _, marker in marked if marker.replace("'", '"').strip() == f'extra == "{extra}"']
