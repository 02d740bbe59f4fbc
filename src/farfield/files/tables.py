"""Tables of any library as columns by name: pandas, polars, pyarrow, dictionaries, structured arrays."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Shaped

from farfield.errors import ConfigError
from farfield.registry import named


def columns_in(value: Any) -> dict[str, Shaped[np.ndarray, " n"]] | None:
    """The columns of a table by name; None where it is no table.

    Args:
        value: A mapping of columns, a DataFrame of pandas or polars, a table of pyarrow, a structured array.
    """
    if isinstance(value, Mapping):
        return {str(name): np.asarray(column) for name, column in value.items()}
    if isinstance(value, np.ndarray):
        names = value.dtype.names
        return None if names is None else {name: value[name].reshape(-1) for name in names}
    names = getattr(value, "column_names", None)
    names = getattr(value, "columns", None) if names is None else names
    if names is None or not hasattr(value, "__getitem__") or callable(names):
        return None
    return {str(name): np.asarray(value[name]) for name in names}


def table_of(columns: Mapping[str, Any], library: str, caller: str) -> Any:
    """A DataFrame of columns.

    Args:
        columns: The columns by name.
        library: ``"pandas"`` or ``"polars"``.
        caller: What needs it, for messages.

    Raises:
        ConfigError: If the library is not installed.
    """
    try:
        frame = named(f"{library}:DataFrame")
    except ImportError as error:
        raise ConfigError(f"{caller} needs {library}. Install it with: pip install {library}") from error
    return frame(dict(columns))
