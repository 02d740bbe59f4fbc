"""The errors that users meet. Each says what, where, expected, got, and how to mend it."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from farfield.errors.wording import EXTRAS, advice, fault_of, plain

__all__ = [
    "EXTRAS",
    "ConfigError",
    "DatasetError",
    "FarfieldError",
    "FileFormatError",
    "MissingCloudError",
    "MissingExtraError",
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
        found: What stands there instead.
        mend: How to mend it, if that is known.
    """

    def __init__(self, path: Path | str, *, where: str, expected: str, found: str, mend: str = "") -> None:
        self.path, self.where, self.expected, self.found, self.mend = path, where, expected, found, mend
        super().__init__(f"{path}, {where}: expected {expected}, found {found}." + (f" {mend}" if mend else ""))

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        keywords = {"where": self.where, "expected": self.expected, "found": self.found, "mend": self.mend}
        return partial(FileFormatError, **keywords), (self.path,)


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
        self.known = (package, extra, purpose)
        super().__init__(f"{purpose} needs {package}. Install it with: {advice(extra)}")

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return MissingExtraError, self.known

    @classmethod
    def of(cls, error: ImportError, purpose: str) -> "MissingExtraError | None":
        """The same for a package that an ``import`` did not find; None if it belongs to no extra.

        Args:
            error: What the import raised.
            purpose: Who needs it.
        """
        extra, package = EXTRAS.get((error.name or "").partition(".")[0], ("", ""))
        return cls(package, extra, purpose) if extra else None
