"""K-Radar's conditions: weather, road and time of day of each sequence, and the files that state them."""

import csv
import io
from collections.abc import Iterable, Mapping
from pathlib import Path

from farfield.errors import ConfigError, FileFormatError
from farfield.files.atomic import read_bytes
from farfield.files.description import read_description
from farfield.frame.drive import Key
from farfield.vocabulary.conditions import CONDITIONS, condition_name, fits_kind
from farfield.vocabulary.kradar import DESCRIPTION_ORDER, DESCRIPTIONS, published_conditions

PUBLISHED = "published"
_MAX_BYTES = 1 << 24
_COLUMNS = ("sequence", *DESCRIPTION_ORDER)


def read_conditions(path: Path | str, keys: Iterable[Key]) -> dict[Key, dict[str, str]]:
    """Conditions of frames, from a table, a K-Radar tree or what was published.

    Args:
        path: A CSV with the columns sequence, road, time, weather; or a folder of ``<sequence>/description.txt``, each
            with one line ``road,time,weather``; or the word ``"published"`` for the table of K-Radar's 58 sequences.
        keys: (sequence, frame) of the frames.

    Returns:
        Conditions by frame; frames of sequences without known conditions are absent.

    Raises:
        ConfigError: If there is no such file or folder, or it states no sequence of the frames.
        FileFormatError: If a file is not of that form.
    """
    keys = list(keys)
    sequences = sorted({sequence for sequence, _ in keys})
    if path == PUBLISHED:
        return {key: published for key in keys if (published := published_conditions(key[0]))}
    path = Path(path)
    if path.is_dir():
        described = {name: _description(path, name) for name in sequences}
        conditions = {name: read_description(file) for name, file in described.items() if file is not None}
    elif path.is_file():
        conditions = _table(path)
    else:
        raise ConfigError(f"conditions: expected a CSV file or a folder of sequences, found nothing at {path}")
    if keys and not set(conditions) & set(sequences):
        raise ConfigError(
            f"conditions: expected the sequences of the labels ({', '.join(sequences[:5])}...) in {path}, got "
            f"{', '.join(sorted(conditions)[:5]) or 'none'}"
        )
    return {key: conditions[key[0]] for key in keys if key[0] in conditions}


def _description(path: Path, name: str) -> Path | None:
    files = [path / name / file for file in DESCRIPTIONS] if Path(name).name == name else []
    return next((file for file in files if file.is_file()), None)


def _table(path: Path) -> dict[str, dict[str, str]]:
    rows = csv.reader(io.StringIO(_text(path), newline=""), strict=True)
    conditions: dict[str, dict[str, str]] = {}
    try:
        header = [name.strip().lower() for name in next(rows, [])]
        if sorted(header) != sorted(_COLUMNS):
            expected = f"a header with the columns {', '.join(_COLUMNS)}"
            raise FileFormatError(path, where="line 1", expected=expected, got=repr(",".join(header))[:100])
        for row in rows:
            if not row:
                continue
            cells = dict(zip(header, (cell.strip() for cell in row), strict=False))
            name = cells.pop("sequence", "")
            if len(row) != len(header) or not all([name, *cells.values()]) or name in conditions:
                expected = "four filled cells, each sequence once"
                raise FileFormatError(path, where=f"line {rows.line_num}", expected=expected, got=repr(row)[:100])
            conditions[name] = {kind: condition_name(word) for kind, word in cells.items()}
            strange = [kind for kind, word in conditions[name].items() if not fits_kind(word, kind)]
            if strange:
                expected = f"a word for {strange[0]}, which is none of another kind"
                actual = repr(cells[strange[0]])[:100]
                raise FileFormatError(path, where=f"line {rows.line_num}", expected=expected, got=actual)
    except csv.Error as error:
        raise FileFormatError(
            path, where=f"line {rows.line_num}", expected="comma-separated text", got=str(error)
        ) from None
    return conditions


def _text(path: Path) -> str:
    try:
        return read_bytes(path, max_bytes=_MAX_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        value = f"byte 0x{error.object[error.start]:02x}"
        raise FileFormatError(path, where=f"byte {error.start}", expected="UTF-8 text", got=value) from None


def group_conditions(conditions: Mapping[Key, Mapping[str, str]], kind: str) -> tuple[str, ...]:
    """Values of one kind of condition: K-Radar's, and then whatever else occurs."""
    present = {condition_name(values[kind]) for values in conditions.values() if kind in values}
    return (*CONDITIONS[kind], *sorted(present - set(CONDITIONS[kind])))
