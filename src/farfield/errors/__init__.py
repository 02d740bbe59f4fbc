"""The errors that users meet. Each says what, where, expected, got, and how to fix it."""

import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from farfield.errors.wording import EXTRAS, advice, did_you_mean, fault_of, plain, torch_note

__all__ = [
    "EXTRAS",
    "ConfigError",
    "DatasetError",
    "FarfieldError",
    "FileFormatError",
    "MissingCloudError",
    "MissingExtraError",
    "did_you_mean",
    "fault_of",
    "plain",
]


class FarfieldError(Exception):
    """Base of all errors that Farfield raises on purpose."""


class FileFormatError(FarfieldError):
    """A file is truncated, empty, over-long or contradicts its own header.

    Args:
        path: The file, or a name for bytes that came from elsewhere.
        where: Line or byte, such as ``"line 7"`` or ``"byte 1024"``.
        expected: What the format requires.
        got: What stands there instead.
        fix: How to fix it, if that is known.
        **old_names: ``got`` and ``fix`` by the names that they had before, ``found`` and ``mend``.
    """

    def __init__(
        self, path: Path | str, *, where: str, expected: str, got: str = "", fix: str = "", **old_names: str
    ) -> None:
        for old in old_names:
            if old not in ("found", "mend"):
                raise TypeError(f"FileFormatError: got an unexpected keyword argument {old!r}")
            warnings.warn("FileFormatError: found= is got= now, mend= is fix=", DeprecationWarning, stacklevel=2)
        got, fix = old_names.get("found", got), old_names.get("mend", fix)
        self.path, self.where, self.expected, self.got, self.fix = path, where, expected, got, fix
        super().__init__(f"{path}, {where}: expected {expected}, found {got}." + (f" {fix}" if fix else ""))

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        stated = {"where": self.where, "expected": self.expected, "got": self.got, "fix": self.fix}
        return partial(FileFormatError, **stated), (self.path,)


class DatasetError(FarfieldError):
    """A data set's folder does not hold what its layout promises."""


class ConfigError(FarfieldError):
    """An argument or a configuration value is not one of those possible."""


class MissingCloudError(ConfigError, KeyError):
    """A frame has no cloud of the name."""

    def __str__(self) -> str:
        return Exception.__str__(self)


class MissingExtraError(FarfieldError, ImportError):
    """An optional dependency is not installed."""

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        self.needed = (package, extra, purpose)
        super().__init__(f"{purpose} needs {package}. Install it with: {advice(extra)}{torch_note(package)}")

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return MissingExtraError, self.needed

    @classmethod
    def of(cls, error: ImportError, purpose: str) -> "MissingExtraError | None":
        """The same for a package that an ``import`` did not find; None if it belongs to no extra.

        Args:
            error: What the import raised.
            purpose: Who needs it.
        """
        extra, package = EXTRAS.get((error.name or "").partition(".")[0], ("", ""))
        return cls(package, extra, purpose) if extra else None
