"""``farfield formats``."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from farfield.cli._output import check_outputs, console, write_json

if TYPE_CHECKING:
    from farfield.inspection.formats import FormatEntry, FormEntry


def run(
    name: tyro.conf.Positional[str] = "",
    /,
    *,
    json: Annotated[Path | None, tyro.conf.arg(aliases=["--json-out"])] = None,
) -> int:
    """List the formats that are read and written: how certain, and how to open each.

    examples:
      farfield formats
      farfield formats kitti
      farfield formats velodyne
      farfield formats --json -

    Data sets come first, then labels, results and single clouds. "real files" lists what a reader was tested on; "no
    real file seen" means that it follows the format's description alone: check its first frames with `farfield show`.

    Args:
        name: Show all that is known of this one, or of those that a word stands for: a sensor (velodyne), a suffix
            (las), a data set, a tool.
        json: Also write everything as JSON into this file; - prints it too.
    """
    from farfield.inspection.formats import FormatEntry, format_catalogue

    check_outputs((), files={"--json": json})
    catalogue = format_catalogue()
    if name:
        matches = catalogue.find(name)
        if len(matches) > 1:
            print(f"{name}: {', '.join(dict.fromkeys(entry.name for entry in matches))}\n")
        for entry in matches:
            _print_details(_details(entry) if isinstance(entry, FormatEntry) else _form_details(entry))
        tree: object = [asdict(entry) for entry in matches]
    else:
        _print_datasets(catalogue.datasets)
        for kind in dict.fromkeys(form.kind for form in catalogue.forms):
            _print_forms(kind, [form for form in catalogue.forms if form.kind == kind])
        print(f"\nwrite one: farfield convert DATA OUT --to TARGET, one of {', '.join(catalogue.targets)}")
        print("all that is known of one: farfield formats NAME")
        tree = asdict(catalogue)
    if json is not None:
        write_json(json, tree)
    return 0


def _print_datasets(entries: Iterable["FormatEntry"]) -> None:
    rows = []
    for entry in entries:
        facts = entry.facts
        words = [entry.broken or "-", "-"] if facts is None else [facts.title, facts.real_files]
        written = ", ".join(entry.written) or "-"
        extra = (facts.extra if facts is not None else "") or "-"
        rows.append([entry.name, *words, written, "yes" if entry.saved else "-", entry.scored or "-", extra])
    _print_table(("data set", "what it is", "real files", "written by", "saved in place", "scored by", "extra"), rows)


def _print_forms(kind: str, forms: Iterable["FormEntry"]) -> None:
    print()
    rows = [
        [form.name, form.facts.title, form.facts.holds, ", ".join(form.uses), form.facts.real_files] for form in forms
    ]
    _print_table((kind, "what it is", "holds", "used by", "real files"), rows)


def _print_table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for number, column in enumerate(columns):
        table.add_column(column, no_wrap=number == 0)
    for row in rows:
        table.add_row(*row)
    console(width=200).print(table)


def _details(entry: "FormatEntry") -> dict[str, str]:
    facts = entry.facts
    fact_words = {} if facts is None else asdict(facts)
    return {
        "format": entry.name,
        "what it is": fact_words.get("title", ""),
        "read": fact_words.get("read", ""),
        "real files": fact_words.get("real_files", ""),
        "open it": fact_words.get("opens", ""),
        "recognised by": entry.looked_for,
        "written by": ", ".join(entry.written) or "nothing",
        "saved in place": "yes, by farfield annotate" if entry.saved else "no: labels are written beside",
        "scored by": entry.scored,
        "extra": fact_words.get("extra", "") or "none",
        "--reader": ", ".join(entry.options),
        "smallest download": fact_words.get("download") or "not known",
        "licence of the data": fact_words.get("licence") or "not known",
        "described in": fact_words.get("source", ""),
        "cannot be used": entry.broken,
        "from": entry.origin,
    }


def _form_details(form: "FormEntry") -> dict[str, str]:
    return {
        form.kind: form.name,
        "what it is": form.facts.title,
        "holds": form.facts.holds,
        "used by": ", ".join(form.uses),
        "real files": form.facts.real_files,
        "extra": form.facts.extra or "none",
        "described in": form.facts.source,
    }


def _print_details(details: dict[str, str]) -> None:
    width = max(map(len, details))
    for what, text in details.items():
        if text:
            print(f"{what:<{width}}  {text}")
    print()
