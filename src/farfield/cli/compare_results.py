"""``farfield compare-results``: results side by side, never two conventions in one column."""

from pathlib import Path
from typing import Literal

from tyro.conf import Positional


def run(
    results: Positional[tuple[Path, ...]],
    *,
    names: str = "",
    label: str | None = None,
    figures: tuple[str, ...] = (),
    by: Literal["none", "weather", "road", "time", "range", "visibility", "azimuth"] = "none",
    separate: bool = False,
    paper: bool = False,
) -> int:
    """Set results side by side, a row a result; numbers of different conventions or data never share a column.

    examples:
      farfield compare-results runs/evaluation-second-data runs/evaluation-pointpillars-data
      farfield compare-results rtnh.json rtn.json pointpillars.json
      farfield compare-results rtnh.json rtn.json --by weather --figures 3d/0.3 --label vehicle
      farfield compare-results rtnh.json rtn.json --paper
      farfield compare-results ours.json theirs.json --separate
      farfield compare-results a.json b.json --by range --figures dds/0.003/dds

    Reads what farfield score --json and farfield evaluate write. Two results share a convention if they agree in every
    setting that affects their figures. If they do not, the command lists the differences and stops, or, with
    --separate, gives each convention columns of its own. Different data (by the fingerprints of files, reader options
    and annotated boxes) always get columns of their own. The source of each row is listed under the table.

    Args:
        results: JSON files of results, or folders of farfield evaluate.
        names: Names of the rows, comma-separated (default: detector, data and cloud of an evaluation, else the file's
            name).
        label: The class (default: all).
        figures: Figures to show, such as dds/0/map or, of K-Radar's protocols, 3d/0.3 (default: the main ones).
        by: Columns: none: the figures of the whole; else the parts by that, a table a figure.
        separate: Put numbers of different conventions into separate columns.
        paper: The table of the K-Radar paper by weather (or --by road, time) as Markdown, with the published rows under
            it; of one label (vehicle) and figure (3d/0.3).
    """
    from farfield.metrics.comparing import compare, read_results

    called = [word.strip() for word in names.split(",")] if names else []
    entries = read_results(results, called)
    if paper:
        from farfield.figures.tables import paper_table

        results_by_name = {entry.name: entry.tree for entry in entries}
        print(paper_table(results_by_name, label=label or "vehicle", figures=figures, by=by), end="")
        return 0
    print(compare(entries, label=label, figures=figures, by=by, separate=separate))
    return 0
