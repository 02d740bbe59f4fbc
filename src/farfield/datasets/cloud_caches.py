"""ASCII clouds as a binary cache beside them: one file a cloud, read in the text's place while the text is the same."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from farfield.datasets.base import Dataset
from farfield.datasets.cirrus import Cirrus
from farfield.datasets.folder import Folder
from farfield.errors import DatasetError
from farfield.files.outputs import check_room
from farfield.files.xyz import xyz_columns
from farfield.frame.cloud import CACHE_FOLDER, cache_path, is_fresh, write_rows_cache
from farfield.jobs import JobOptions, Outcome, Unit, UnitResult, run
from farfield.jobs.folders import held, sweep_out

_TEXT_FACTOR = 4  # text takes more than numbers


def convert_to_cache(dataset: Dataset, overwrite: bool, bulk: JobOptions) -> Outcome:
    """Write the cache of each ASCII cloud that has none, or one of other bytes.

    Args:
        dataset: The source.
        overwrite: Write everything anew.
        bulk: How.

    Raises:
        DatasetError: If it has no ASCII clouds.
    """
    reader = dataset.unwrapped
    if isinstance(reader, Cirrus):
        columns, delimiter = reader.mapping.xyz.columns, reader.mapping.xyz.delimiter
        sources: list[tuple[Path, Path, int | None]] = [
            (getattr(entry, pattern), entry.part.root, len(getattr(columns, pattern)))
            for entry in (reader.entries[index] for index in dataset.origins)
            for pattern in ("gaussian", "uniform")
            if getattr(entry, pattern) is not None
        ]
    elif isinstance(reader, Folder):
        clouds = (reader.clouds[index] for index in dataset.origins)
        sources = [(path, dataset.root, xyz_columns(path)) for path in clouds if path.suffix.lower() == ".xyz"]
        delimiter = "auto"
    else:
        sources = []
        delimiter = "auto"
    if not sources:
        raise DatasetError(f"{dataset.root}: expected ASCII clouds (.xyz) to cache; the clouds are binary already")
    sources = list(dict.fromkeys(sources))
    with ExitStack() as stack:
        for folder in sorted({root / CACHE_FOLDER for _, root, _ in sources}):
            stack.enter_context(held(folder))
        return _write_caches(sources, delimiter, overwrite, bulk)


def _write_caches(
    sources: Sequence[tuple[Path, Path, int | None]], delimiter: str, overwrite: bool, bulk: JobOptions
) -> Outcome:
    missing = [source for source in sources if overwrite or not is_fresh(cache_path(source[0], source[1]), source[0])]
    for root in {root for _, root, _ in missing}:  # a row of text takes about three times what its numbers take
        check_room(root, sum(source.stat().st_size for source, other, _ in missing if other == root) / _TEXT_FACTOR)
    folders = {root / CACHE_FOLDER for _, root, _ in missing}
    for folder in folders:
        sweep_out(folder)
    units = [Unit(str(source), (source,), (root, count)) for source, root, count in missing]
    try:
        outcome = run(_CloudCache(delimiter), units, bulk)
    finally:
        for folder in folders:  # a worker that was killed left what it was at
            sweep_out(folder)
    return Outcome(written=outcome.written, skipped=len(sources) - outcome.written)


@dataclass(frozen=True)
class _CloudCache:
    """Writes the cache of one cloud."""

    delimiter: str

    def __call__(self, unit: Unit) -> UnitResult:
        root, count = unit.parameters
        columns = None if count in (5, 8) else count
        return UnitResult(files=(write_rows_cache(unit.sources[0], root, columns=columns, delimiter=self.delimiter),))
