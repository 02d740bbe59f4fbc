"""Sweeps of Cirrus: their columns, and intensity brought to 0..1."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from farfield.datasets.cirrus.mapping import Xyz
from farfield.datasets.cloud_files import intensity_scale_of, read_rows
from farfield.errors import FileFormatError
from farfield.frame import Cloud


def read_columns(path: Path, root: Path, pattern: str, settings: Xyz) -> dict[str, np.ndarray]:
    """Columns of a cloud by the mapping's names, in the file's own units.

    Args:
        path: The file.
        root: Folder that holds the cache folder.
        pattern: ``"gaussian"`` or ``"uniform"``.
        settings: Names of the columns, and how they are separated.
    """
    names = getattr(settings.columns, pattern)
    count = None if len(names) in (5, 8) else len(names)
    columns = read_rows(path, root, columns=count, delimiter=settings.delimiter)
    names = (*names, *(f"extra{number}" for number in range(len(names) - 4, len(columns) - 4)))
    keep = len(columns) if settings.on_extra_columns == "keep" else 4
    return dict(list(zip(names, columns, strict=False))[:keep])


class IntensityScale:
    """Value that stands for full reflectance, by pattern: given, or decided from a few files at the first access.

    Args:
        files: Files (and the roots of their caches) to decide from, by pattern.
        settings: The mapping's settings.
    """

    def __init__(self, files: dict[str, tuple[tuple[Path, Path], ...]], settings: Xyz) -> None:
        self.files, self.settings = files, settings

    @cached_property
    def by_pattern(self) -> dict[str, float]:
        """The scales."""
        return {name: self._of(name) for name in self.files}

    def __call__(self) -> dict[str, float]:
        """The scales, as a loader gives them."""
        return self.by_pattern

    def _of(self, pattern: str) -> float:
        if self.settings.intensity_scale != "auto":
            return float(self.settings.intensity_scale)
        read = (read_columns(path, root, pattern, self.settings) for path, root in self.files[pattern])
        return intensity_scale_of(max(float(columns["intensity"].max(initial=0.0)) for columns in read))


@dataclass(frozen=True)
class CirrusSweep:
    """One sweep on disk; called, it reads its cloud.

    Args:
        path: The file.
        root: Folder that holds the cache folder.
        pattern: ``"gaussian"`` or ``"uniform"``.
        settings: The mapping's settings.
        scale: The value that stands for full reflectance.
    """

    path: Path
    root: Path
    pattern: str
    settings: Xyz
    scale: IntensityScale

    def columns(self) -> dict[str, np.ndarray]:
        """Its columns in the file's own units."""
        return read_columns(self.path, self.root, self.pattern, self.settings)

    def __call__(self) -> Cloud:
        """Read it; intensity is brought to 0..1.

        Raises:
            FileFormatError: If the file is damaged or its intensity exceeds the scale.
        """
        columns = self.columns()
        scale = self.scale.by_pattern[self.pattern]
        strength = columns["intensity"].astype(np.float32) / np.float32(scale)
        if len(strength) and (strength.max() > 1 + 1e-5 or strength.min() < 0):
            raise FileFormatError(
                self.path,
                where="the intensity column",
                expected=f"values from 0 to {scale:g}",
                found=f"{columns['intensity'].min():g} to {columns['intensity'].max():g}",
                mend="Give the true full scale in the mapping: xyz: {intensity_scale: 255}.",
            )
        points = np.stack([columns[axis] for axis in "xyz"], axis=1).astype(np.float32)
        extra = {name: column for name, column in columns.items() if name not in ("x", "y", "z", "intensity")}
        return Cloud(points, np.minimum(strength, np.float32(1.0)), extra)
