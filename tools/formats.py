"""Write docs/formats.md: every format that is registered, with its facts, from the code.

python tools/formats.py            print the page
python tools/formats.py --write    write it
"""

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from farfield.datasets.convert import CAPACITIES, TARGETS
from farfield.datasets.losses import ITEMS, Capacity
from farfield.inspection.formats import FormatEntry, format_catalogue
from farfield.metrics import PROTOCOLS

PAGE = Path(__file__).resolve().parents[1] / "docs" / "formats.md"
HEAD = """# Formats

Printed by `tools/formats.py` from what the code registers; `farfield formats` prints the same, `farfield formats NAME`
all that is known of one, and `farfield formats velodyne` (any sensor, suffix, data set or tool) what is read of it. A
folder's format is recognised from what it holds; `--format NAME` overrules it. Options of a reader that have no flag are
given as `--reader NAME=VALUE`, such as `--reader whole_scenes=true`.

**No real file seen** means that the reader follows the format's description, and that the files in its tests were
written by that description too: look at the first frames with `farfield show DATA`. What is checked on the way in
stands in [checks](checks.md), what one file may cost in [limits](limits.md), how own data are laid out in [own
data](own-data.md).
"""
TARGETS_HEAD = """`farfield convert DATA OUT --to TARGET` writes another layout. What the target does not hold of what
the frames say is said before anything is written, a line each; `--dry-run` says it too, and the folder's
`.farfield_losses.jsonl` keeps it. The lines are of up to five frames that are spread over the set. A box is its centre,
sizes and yaw in every target: roll and pitch were left out, or refused, when the source was read. A cache stands beside
its source and loses nothing; a radar store holds radar products alone and is opened together with its source."""
PICTURES = {
    "none": "",
    "first": "the image of the calibrated camera that looks ahead, else the first image",
    "front": "the image of the calibrated camera that looks ahead",
    "calibrated": "the images of calibrated cameras",
}
KINDS = {"labels": "Labels", "results": "Results", "clouds": "Single clouds"}


def cell(text: str) -> str:
    """A text that stands in one cell of a table; addresses and pages of these docs become links."""
    return " ".join(map(_word, text.split()))


def _word(word: str) -> str:
    bare = word.rstrip(",.;")
    rest = word[len(bare) :]
    if bare.startswith("https://"):
        return f"<{bare}>{rest}"
    if bare.startswith("docs/") and bare.endswith(".md"):
        return f"[{bare[5:-3]}]({bare[5:]}){rest}"
    return word.replace("|", "\\|").replace("*", "\\*").replace("<", "&lt;").replace("_", "\\_")


def table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; the first cell of each row is a name."""
    lines = [f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}"]
    lines += [f"| `{first}` | {' | '.join(map(cell, rest))} |" for first, *rest in rows]
    return "\n".join(lines)


def section(entry: FormatEntry) -> str:
    """All that is known of a data set's format."""
    facts = entry.facts
    if facts is None:
        return ""
    lines = [
        f"**Read**: {cell(facts.read)}.",
        f"**Real files**: {cell(facts.real_files)}.",
        f"**Open it**: `{facts.opens}`" + (f', after `pip install ".[{facts.extra}]"`.' if facts.extra else "."),
        f"**Recognised by**: {cell(entry.looked_for)}.",
        f"**Smallest useful download**: {cell(facts.download or 'not known')}.",
        f"**Licence of the data**: {cell(facts.licence or 'not known')}.",
        f"**Described in**: {cell(facts.source)}.",
    ]
    return f"### {entry.name}\n\n{facts.title}\n\n" + "\n".join(f"- {line}" for line in lines)


def page() -> str:
    """The whole page; formats of other packages are left out."""
    catalogue = format_catalogue()
    own = [entry for entry in catalogue.datasets if entry.origin == "farfield"]
    rows = []
    for entry in own:
        real_files = entry.facts.real_files if entry.facts is not None else ""
        saved = "yes" if entry.saved else ""
        rows.append((entry.name, real_files, ", ".join(entry.written), saved, entry.scored))
    parts = [HEAD.rstrip(), "## Data sets"]
    protocols = ", ".join(f"`{name}`" for name in PROTOCOLS.builtin)
    parts.append(f"The last column is the protocol of `farfield evaluate` unless another is named: {protocols}.")
    parts.append(table(("data set", "real files", "written by", "labels saved in place", "scored by"), rows))
    parts += [section(entry) for entry in own]
    for kind, title in KINDS.items():
        forms = [form for form in catalogue.forms if form.kind == kind]
        rows_of_kind = [
            (form.name, form.facts.holds, ", ".join(form.uses), form.facts.real_files, form.facts.source)
            for form in forms
        ]
        parts += [f"## {title}", table((kind, "holds", "used by", "real files", "described in"), rows_of_kind)]
    targets = [
        (CAPACITIES[name].words or name, CAPACITIES[name].title, held(CAPACITIES[name]))
        for name in TARGETS
        if name not in ("cache", "radar-store")  # which have no boxes and are no copy
    ]
    parts += ["## Conversions", TARGETS_HEAD, table(("target", "what it is", "what it holds beside boxes"), targets)]
    return "\n\n".join(parts) + "\n"


def held(capacity: Capacity) -> str:
    """What a target holds, in words."""
    several = "clouds of LiDARs and radars" if capacity.chosen is not None else "one cloud"
    words = [" and ".join(capacity.together) or several] if capacity.one_cloud else []
    words += [PICTURES[capacity.pictures], *sorted(capacity.attributes)]
    words += [text for item, text in ITEMS.items() if item in capacity.holds]
    return ", ".join(filter(None, words))


if __name__ == "__main__":
    if "--write" in sys.argv[1:]:
        PAGE.write_text(page(), encoding="utf-8")
    else:
        print(page(), end="")
