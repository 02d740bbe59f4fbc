"""Which data set a studio opens."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from farfield.datasets.base import Dataset


class DatasetOpener:
    """Opens a data set when it is called, or the frames that ship where no path is given.

    Args:
        path: Folder of a data set, or None.
        **options: Of ``open_dataset``; empty ones are left out.
    """

    def __init__(self, path: Path | None, **options: Any) -> None:
        self.path, self.options = path, {name: value for name, value in options.items() if value}

    @property
    def title(self) -> str:
        """What the page calls it."""
        return "two simulated frames" if self.path is None else self.path.resolve().name

    def __call__(self) -> "Dataset":
        """Open it.

        Raises:
            FarfieldError: If there is no data set.
        """
        if self.path is None:
            from farfield.studio.samples import open_samples

            return open_samples()
        from farfield.datasets import open_dataset

        return open_dataset(self.path, **self.options)
