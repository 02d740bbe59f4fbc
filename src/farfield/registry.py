"""Names to things, with a door for other packages: built in, by decorator, by entry point, asked in this order."""

import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Generic, TypeVar

from farfield.errors import ConfigError, FarfieldError, did_you_mean

T = TypeVar("T")
Registered = TypeVar("Registered")


def named(target: str) -> Any:
    """What stands at ``"module:attribute"``, imported now.

    So a method of a lower room, such as ``Frame._repr_html_``, reaches the upper room that does the work, which it
    knows by name alone.
    """
    module, _, attribute = target.partition(":")
    return getattr(import_module(module), attribute)


def old_names(module: str, **names: str) -> Callable[[str], Any]:
    """A module's ``__getattr__``, by which old names of its public parts work for one version, with a warning.

    Args:
        module: The module's name.
        names: New names by the old ones.
    """
    return partial(_renamed, module, names)


def _renamed(module: str, names: Mapping[str, str], name: str) -> Any:
    if name not in names:
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    warnings.warn(f"{module}.{name} is now {module}.{names[name]}", DeprecationWarning, stacklevel=2)
    return getattr(import_module(module), names[name])


def take_old_methods(cls: type, **names: str) -> None:
    """Let a subclass override a method by the old name of it for one version, with a warning.

    Args:
        cls: The subclass, in its base's ``__init_subclass__``.
        names: New names by the old ones.
    """
    for old, new in names.items():
        if old in vars(cls):
            warnings.warn(f"{cls.__name__}.{old} is called {new} now", DeprecationWarning, stacklevel=3)
            setattr(cls, new, vars(cls)[old])


_DISPLAYS: dict[str, Callable[[Any], str]] = {}


def register_display(kind: str, draw: Callable[[Any], str]) -> None:
    """Say what draws a kind of object for a notebook.

    So a method of a lower room, such as ``Frame._repr_html_``, shows what an upper room draws, which it does not know.

    Args:
        kind: Such as ``"frame"``.
        draw: Gives HTML of an object of this kind.
    """
    _DISPLAYS[kind] = draw


def display_html(kind: str, shown: object) -> str | None:
    """What a notebook shows of an object as HTML; None where nothing draws its kind, and a notebook shows its text."""
    draw = _DISPLAYS.get(kind)
    return None if draw is None else draw(shown)


class PluginError(FarfieldError):
    """What another package registered cannot be used: it fails to import, or two packages use one name."""


class Registry(Generic[T]):
    """What goes by a name: data sets, detectors, protocols.

    A name is looked up among the built-in ones, then among those that a decorator registered in this process, then
    among the entry points of installed packages. Nothing is imported before it is asked for, and entry points are read
    only where a name is found nowhere else or names are listed.

    Args:
        group: Group of the entry points, such as ``"farfield.detectors"``.
        what: What a name stands for, for messages: ``"detector"``.
        builtin: Name to ``"module:attribute"``.
    """

    def __init__(self, group: str, what: str, builtin: Mapping[str, str]) -> None:
        self.group, self.what, self.builtin = group, what, dict(builtin)
        self._registered: dict[str, T] = {}
        self._loaded: dict[str, T] = {}

    def __getitem__(self, name: str) -> T:
        """What goes by a name.

        Raises:
            ConfigError: If nothing does; the message lists the names there are.
            PluginError: If another package's cannot be imported, or several packages use the name.
        """
        if name in self._registered:
            return self._registered[name]
        if name not in self._loaded:
            self._loaded[name] = self._load(name)
        return self._loaded[name]

    def _load(self, name: str) -> T:
        if name in self.builtin:
            loaded: T = named(self.builtin[name])
            return loaded
        points = [point for point in self._points() if point.name == name]
        if not points:
            names = ", ".join(self.names())
            raise ConfigError(
                f"Expected a {self.what}, one of {names}; got {name!r}.{did_you_mean(str(name), self.names())}"
            )
        if len(points) > 1:
            packages = " and ".join(sorted(_package(point) for point in points))
            raise PluginError(f"{self.what} {name!r}: registered by {packages}; uninstall one of them.")
        try:
            plugin: T = points[0].load()
        except (Exception, SystemExit) as error:
            raise PluginError(
                f"{self.what} {name!r} of the package {_package(points[0])} cannot be used: "
                f"{type(error).__name__}: {error}"
            ) from error
        return plugin

    def __contains__(self, name: object) -> bool:
        return name in self.builtin or name in self._registered or any(p.name == name for p in self._points())

    def __iter__(self) -> Iterator[str]:
        return iter(self.names())

    def names(self) -> tuple[str, ...]:
        """All names: the built-in ones first, then those registered here, then those of other packages."""
        return tuple(dict.fromkeys([*self.builtin, *self._registered, *sorted(p.name for p in self._points())]))

    def origin(self, name: str) -> str:
        """Where a name comes from: ``"farfield"``, ``"registered here"``, or the packages that have it."""
        if name in self.builtin:
            return "farfield"
        if name in self._registered:
            return "registered here"
        return " and ".join(sorted(_package(point) for point in self._points() if point.name == name))

    def broken(self, name: str) -> str:
        """Why a name cannot be used; empty where it can."""
        try:
            self[name]
        except PluginError as error:
            return str(error)
        return ""

    def register(self, name: str) -> Callable[[Registered], Registered]:
        """A decorator that registers what it decorates in this process, as a notebook does; run again, it replaces it.

        Raises:
            ConfigError: If the name is a built-in one.
        """
        if name in self.builtin:
            raise ConfigError(f"{self.what} {name!r} is built in; choose another name.")

        return partial(self._keep, name)

    def _keep(self, name: str, thing: Registered) -> Registered:
        self._registered[name] = thing  # type: ignore[assignment]
        return thing

    def _points(self) -> list[EntryPoint]:
        """Entry points of other packages, each once, though a distribution may be found twice on the path."""
        unique: dict[tuple[str, str, str], EntryPoint] = {}
        for point in entry_points(group=self.group):
            if point.name not in self.builtin:
                unique[point.name, point.value, _package(point)] = point
        return list(unique.values())


def _package(point: EntryPoint) -> Any:
    return point.dist.name if point.dist is not None else point.value.partition(":")[0]
