"""Values by key that stand in a file instead of in memory."""

import pickle
import tempfile
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Generic, TypeVar

K = TypeVar("K")
V = TypeVar("V")
W = TypeVar("W")


class DiskDict(MutableMapping[K, V]):
    """A mapping whose values are written to a file without a name, and read anew each time they are asked for.

    The file goes with the mapping, whatever ends the process; nobody else can read or write it.

    Args:
        folder: Where the file is; the system's folder for such files if None.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - open as long as the mapping
        self._places: dict[K, tuple[int, int]] = {}
        self._end = 0

    def __setitem__(self, key: K, value: V) -> None:
        packed = pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)
        self._file.seek(self._end)
        self._file.write(packed)
        self._places[key] = (self._end, len(packed))
        self._end += len(packed)

    def __getitem__(self, key: K) -> V:
        offset, length = self._places[key]
        self._file.seek(offset)
        value: V = pickle.loads(self._file.read(length))  # noqa: S301 - our own: the file has no name
        return value

    def __delitem__(self, key: K) -> None:
        del self._places[key]

    def __contains__(self, key: object) -> bool:
        return key in self._places

    def __iter__(self) -> Iterator[K]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def __reduce__(self) -> Any:
        return dict, (dict(self),)

    def __del__(self) -> None:
        if hasattr(self, "_file"):  # it may have failed to open
            with suppress(OSError):  # on a full disk what waits cannot be written, and nobody is going to read it
                self._file.close()


class MappedView(Mapping[K, W], Generic[K, V, W]):
    """What a function makes of each value of a mapping, made anew each time it is asked for.

    Args:
        values: The mapping.
        function: The function.
    """

    def __init__(self, values: Mapping[K, V], function: Callable[[V], W]) -> None:
        self.source, self.function = values, function

    def __getitem__(self, key: K) -> W:
        return self.function(self.source[key])

    def __contains__(self, key: object) -> bool:
        return key in self.source

    def __iter__(self) -> Iterator[K]:
        return iter(self.source)

    def __len__(self) -> int:
        return len(self.source)


def alike(values: Mapping[K, Any]) -> MutableMapping[K, Any]:
    """An empty mapping that keeps its values where another one does: in a file or in memory."""
    return DiskDict(values.folder) if isinstance(values, DiskDict) else {}
