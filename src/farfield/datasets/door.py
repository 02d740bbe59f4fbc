"""What people hold data in, as a :class:`Dataset`: one door for paths, lists, arrays, tables and data sets."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from farfield.datasets.base import Dataset
from farfield.datasets.memory import CloudFiles, InMemory
from farfield.datasets.opening import open_dataset
from farfield.errors import ConfigError, DatasetError
from farfield.files.remote_paths import as_path
from farfield.files.tables import columns_in
from farfield.frame import Cloud, Frame
from farfield.frame.door import FRAME_TAKES, frame_of


def dataset_of(value: Any) -> Dataset:
    """Data of any kind as a data set; what is one stays what it is.

    Args:
        value: A data set; a folder's path, which is opened; a cloud file's path; a frame, a cloud, an array or a
            table, which is one sweep; or a list or another iterable of paths or of sweeps.

    Raises:
        ConfigError: If it is nothing of these, or an array cannot be what it is taken for.
        DatasetError: If there is no such file or folder, or no frame at all.

    >>> dataset_of([np.zeros((4, 3)), np.ones((5, 3))])
    InMemory(frames: 2, sequences: 1)
    """
    if isinstance(value, Dataset):
        return value
    if isinstance(value, str | Path):
        path = as_path(value).expanduser()
        return CloudFiles([path]) if path.is_file() else open_dataset(value)
    is_one = isinstance(value, Frame | Cloud) or columns_in(value) is not None
    if is_one or (hasattr(value, "__array__") and np.ndim(value) <= 2):
        return InMemory([frame_of(value)])
    if not isinstance(value, Iterable):
        raise ConfigError(
            f"data: expected a data set, the path of a folder or of a cloud file, {FRAME_TAKES}, or a list of such; "
            f"got {type(value).__name__}"
        )
    entries = list(value)
    if entries and all(isinstance(entry, str | Path) for entry in entries):
        paths = [as_path(entry).expanduser() for entry in entries]
        missing = [str(path) for path in paths if not path.is_file()]
        if missing:
            raise DatasetError(f"data: expected cloud files, found none at {', '.join(missing[:5])}")
        return CloudFiles(paths)
    return InMemory(frame_of(entry, frame_id=str(number)) for number, entry in enumerate(entries))
