"""What ``farfield sync`` writes: a table of matches a recording, one JSON and one page."""

import json
from collections.abc import Sequence
from pathlib import Path

from farfield.errors import ConfigError, FarfieldError
from farfield.files.atomic import write_text
from farfield.files.clock_logs import read_clock_log
from farfield.jobs.folders import sweep_out_file
from farfield.pages.sync_page import write_sync_page
from farfield.sync.exchange import ExchangeClock, summarised
from farfield.sync.sources import RecordedStreams
from farfield.sync.synchronising import SyncResult, best_reference, describe, synchronise
from farfield.sync.tables import match_table


def write_synchronised(
    folder: Path | str, found: Sequence[RecordedStreams], *, to: str | None, tolerance_ns: int | None, title: str
) -> list[SyncResult]:
    """Match each recording and write ``matches.csv`` (``matches-NAME.csv`` of several), ``sync.json``, ``sync.html``.

    Args:
        folder: Made if absent.
        found: The recordings.
        to: The stream to which the others are matched; None takes the best.
        tolerance_ns: Largest distance; None takes half the period of the faster stream of each pair.
        title: Title of the page.

    Raises:
        ConfigError: If a recording has no such stream, or two recordings have one name.
    """
    folder = Path(folder)
    names = [recording.name for recording in found]
    if len(set(names)) < len(names):
        raise ConfigError(f"expected recordings of different names, got {', '.join(names)}")
    folder.mkdir(parents=True, exist_ok=True)
    tables = [folder / ("matches.csv" if len(found) == 1 else f"matches-{name}.csv") for name in names]
    for path in (*tables, folder / "sync.json", folder / "sync.html"):
        sweep_out_file(path)  # what a killed command left
    done = [_synchronise(path, recording, to, tolerance_ns) for path, recording in zip(tables, found, strict=True)]
    content = {"recordings": [each.to_json() for each in done]}
    write_text(folder / "sync.json", json.dumps(content, indent=2, allow_nan=False) + "\n")
    write_sync_page(folder / "sync.html", done, title=title)
    return done


def _synchronise(path: Path, recording: RecordedStreams, to: str | None, tolerance_ns: int | None) -> SyncResult:
    reference = best_reference(describe(recording)) if to is None else to
    labels = {name: source.labels for name, source in recording.streams.items() if source.labels is not None}
    with match_table(path, reference, labels) as table:
        return synchronise(
            recording,
            to=reference,
            tolerance_ns=tolerance_ns,
            exchanges={log.name: _exchange_clock(log) for log in recording.logs},
            row=table.add,
        )


def _exchange_clock(log: Path) -> ExchangeClock:
    try:
        return summarised(read_clock_log(log))
    except FarfieldError as error:
        raise ConfigError(f"the log of a clock beside the stamps cannot be used: {error}") from error
