"""A mapping whose values are loaded when they are read."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any


class Constant:
    """A loader of a value that is in memory already; unlike a lambda it can be pickled.

    >>> Given(42)()
    42
    """

    def __init__(self, value: Any) -> None:
        self.value = value

    def __call__(self) -> Any:
        """The value."""
        return self.value


class Lazy(Mapping[str, Any]):
    """A read-only mapping whose values are loaded at the first access and then kept.

    It pickles if its loaders do (functools.partial of functions of a module, or :class:`Constant`); values that were
    loaded stay behind, so that frames travel light.

    >>> clouds = Lazy({"gaussian": lambda: 42})
    >>> list(clouds), clouds["gaussian"]
    (['gaussian'], 42)
    """

    def __init__(self, loaders: Mapping[str, Callable[[], Any]]) -> None:
        self._loaders = dict(loaders)
        self._loaded: dict[str, Any] = {}

    def loader(self, key: str) -> Callable[[], Any]:
        """The function that loads the value of a key, which a further mapping may wrap."""
        return self._loaders[key]

    def __getitem__(self, key: str) -> Any:
        if key not in self._loaders:
            raise KeyError(f"{key!r}; present: {', '.join(self._loaders) or 'nothing'}")
        if key not in self._loaded:
            self._loaded[key] = self._loaders[key]()
        return self._loaded[key]

    def __contains__(self, key: object) -> bool:
        return key in self._loaders  # Mapping's own would load the value

    def __iter__(self) -> Iterator[str]:
        return iter(self._loaders)

    def __len__(self) -> int:
        return len(self._loaders)

    def __repr__(self) -> str:
        return f"Lazy({', '.join(key + ('' if key in self._loaded else ' (not loaded)') for key in self._loaders)})"

    def __getstate__(self) -> dict[str, Any]:
        return {"_loaders": self._loaders, "_loaded": {}}
