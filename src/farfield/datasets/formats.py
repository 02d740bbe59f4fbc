"""The formats of data sets: what an entry is, and the registry, open to packages. Entries stand in ``entries``."""

import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from farfield.errors import ConfigError
from farfield.registry import PluginError, Registry, named

NO_REAL_FILE = "no real file seen"
"""How certain a format is of which only files were read that were written by its description."""


@dataclass(frozen=True, kw_only=True)
class FormatFacts:
    """What a user needs to know of a format before opening it; writers, savers and scores are derived from the code.

    Args:
        title: What people call it: ``"KITTI, object benchmark"``.
        read: What the reader takes, in words.
        real_files: Real files that were read: which, and how many; else :data:`NO_REAL_FILE`, alone or of a part of it.
        opens: A command that opens it.
        source: Where the format is described: an address or a publication.
        download: The smallest download that is of use, as known from its pages; None where that is not known.
        extra: The optional extra that its reader needs, such as ``"argoverse2"``; empty: none.
        licence: Licence of the data, where it is known.
    """

    title: str
    read: str
    real_files: str
    opens: str
    source: str
    download: str | None = None
    extra: str = ""
    licence: str | None = None


@dataclass(frozen=True, kw_only=True)
class Format:
    """One format.

    Args:
        name: Its name.
        looked_for: What it is recognised by, for people: ``"training/velodyne/*.bin"``.
        recognises: Whether a folder is of this format, or ``"module:function"`` of it; quick, true of no other format.
        reader: The :class:`~farfield.datasets.base.Dataset` subclass that reads it, or ``"module:Class"`` of it.
        facts: What `farfield formats` says of it; every format of this package has them.
    """

    name: str
    looked_for: str
    recognises: Callable[[Path], bool] | str
    reader: Any
    facts: FormatFacts | None = None

    def load(self) -> Any:
        """The reader, imported if need be."""
        return named(self.reader) if isinstance(self.reader, str) else self.reader

    def matches(self, root: Path) -> bool:
        """Whether a folder is of this format."""
        recognises = named(self.recognises) if isinstance(self.recognises, str) else self.recognises
        return bool(recognises(root))


_FIRST = (  # tried in this order, before all others: View-of-Delft and TJ4DRadSet lie in KITTI's folders
    "cirrus",
    "view_of_delft",
    "tj4dradset",
    "kitti_odometry",  # whose sequences alone look like the object benchmark's clouds
    "dual_radar",  # which may bear the names of KITTI's folders
    "kitti",
    "kitti_tracking",
    "kitti_raw",
    "argoverse2",
    "kradar",
    "radiate",
    "astyx",
)
_LAST = (  # after all others: a data set's folder may hold a bag, a capture or loose clouds beside
    "bags",
    "ouster",
    "osf",
    "captures",
    "open_sweeps",
    "sustechpoints",
    "cvat",
    "supervisely",
    "xtreme1",
    "labelcloud",
    "openlabel",
    "segments_ai",
    "scale",
    "folder",
)


def _ordered() -> list[str]:
    """Names of the entries, in the order in which they are tried; those that no order names by the alphabet."""
    names = sorted(module.name for module in pkgutil.iter_modules([str(Path(__file__).parent / "entries")]))
    return [*_FIRST, *(name for name in names if name not in (*_FIRST, *_LAST)), *_LAST]


DATASETS: Registry[Format] = Registry(
    "farfield.datasets",
    "data set format",
    {name: f"farfield.datasets.entries.{name}:FORMAT" for name in _ordered()},
)
"""Formats by name, in the order in which folders are tried; those of other packages come before ``folder``."""


def dataset(name: str) -> Callable[[Any], Any]:
    """Register a :class:`~farfield.datasets.base.Dataset` subclass as a format of this process, as a decorator.

    The class says what it is recognised by: ``looked_for``, a text, and ``recognises(root)``, a static method.

    Args:
        name: The format's name.

    Raises:
        ConfigError: If the name is built in, or the class lacks one of the two.
    """
    return _Register(name)


class _Register:
    def __init__(self, name: str) -> None:
        self.name = name

    def __call__(self, reader: Any) -> Any:
        DATASETS.register(self.name)(format_of(self.name, reader))
        return reader


def format_of(name: str, registered: Any) -> Format:
    """What a package registered as a format: a :class:`Format`, or a reader class that describes itself.

    Raises:
        ConfigError: If it is neither.
    """
    if isinstance(registered, Format):
        return registered
    looked_for, recognises = getattr(registered, "looked_for", None), getattr(registered, "recognises", None)
    if not (isinstance(looked_for, str) and callable(recognises)):
        raise ConfigError(
            f"data set format {name!r}: expected a Format, or a Dataset class with looked_for and "
            f"recognises(root); got {registered!r}"
        )
    return Format(name=name, looked_for=looked_for, recognises=recognises, reader=registered)


def find_format(name: str) -> Format:
    """The format of a name.

    Raises:
        ConfigError: If there is none.
        PluginError: If another package's cannot be used.
    """
    return format_of(name, DATASETS[name])


def looked_for() -> dict[str, str]:
    """What each format is recognised by; of one that cannot be used, why."""
    texts = {}
    for name in DATASETS.names():
        try:
            texts[name] = find_format(name).looked_for
        except (PluginError, ConfigError) as error:
            texts[name] = f"cannot be used: {error}"
    return texts
