"""Cards: what derived files were made of, under which licence, and by which commands; they stand beside them."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from farfield.datasets.formats import DATASETS, find_format
from farfield.files.atomic import read_bytes, write_text
from farfield.frame.provenance import is_simulated

CARD_NAME = "CARD.md"
"""The file's name."""
_COMMAND = "    farfield "
_IDLE = ("--workers", "--engine", "--address", "--overwrite")  # which decide nothing; all but the last have a value
_UNLICENSED = ("cirrus", "t4")  # data sets of owners whose licence is not known here
_MOST_COMMANDS, _MOST_BYTES = 20, 1 << 16

TERMS: tuple[tuple[str, str], ...] = (
    (
        "ND",
        "nothing derived may be passed on (no derivatives): who has the data set makes it anew by the commands below; "
        "figures and the settings may be told",
    ),
    ("NC-SA", "for non-commercial purposes, with credit to its authors, under the same licence"),
    ("research", "not without its owners' consent: whoever needs it asks them for the data set"),
    ("CC BY", "with credit to its authors"),
    ("Apache", "with its authors' licences and notices"),
)
"""Part of a licence's name, and what it lets pass on of derived files; the first that stands in the name counts."""
UNKNOWN_TERMS = "its licence is not known here: ask its owners before any of this is passed on"


def terms_of(licence: str | None) -> str:
    """What may be passed on of files derived from data of a licence.

    >>> terms_of("CC BY-NC-SA 4.0")
    'for non-commercial purposes, with credit to its authors, under the same licence'
    """
    return next((terms for part, terms in TERMS if part in (licence or "")), UNKNOWN_TERMS)


def write_card(
    folder: Path, *, what: str, sources: Sequence[tuple[str, Path]], command: Sequence[str], weights: str = ""
) -> Path:
    """Write the card of derived files, or add a command to it; paths of the machine are cut to their last name.

    Args:
        folder: Where the files stand.
        what: What they are, such as ``"A radar store"``.
        sources: Format and folder of each data set that they were made of.
        command: The words of the command, without ``farfield``.
        weights: Weights that a training started from.

    Returns:
        The card.
    """
    from farfield import __version__

    path = folder / CARD_NAME
    lines = [f"# {what}", "", f"Made by Farfield {__version__}. No model of its data's owners is implied."]
    for name, root in dict.fromkeys(sources):
        lines += ["", *_source(name, root)]
    if weights:
        lines += [
            "",
            f"- Weights at the start: {_last_name(weights)}, with what they learnt from; their terms hold too.",
        ]
    words = " ".join(_deciding(command, folder))
    commands = dict.fromkeys([*_commands(path), f"{_COMMAND}{words}"])
    lines += ["", "Commands, with their paths' last names:", "", *list(commands)[-_MOST_COMMANDS:]]
    write_text(path, "\n".join(lines) + "\n")
    return path


def _source(name: str, root: Path) -> list[str]:
    if root.is_dir() and is_simulated(root):
        return [
            f"- Source: {root.name}, simulated by Farfield ({name}'s layout); no data of others.",
            "- Licence: free.",
        ]
    facts = find_format(name).facts if name in DATASETS.names() else None
    if facts is None or name == "folder":
        return [f"- Source: {root.name}, a folder of one's own.", f"- Passing on: {UNKNOWN_TERMS}."]
    if facts.licence is None and name not in _UNLICENSED:  # a tool's layout, which says nothing of whose data they are
        layout = f"the layout of {facts.title} ({facts.source})"
        return [f"- Source: {root.name}, data of one's own in {layout}.", f"- Passing on: {UNKNOWN_TERMS}."]
    return [
        f"- Source: {facts.title} ({root.name}): {facts.source}",
        f"- Licence of the source: {facts.licence or 'not known here'}",
        f"- Passing on: {terms_of(facts.licence)}.",
    ]


def _deciding(command: Sequence[str], folder: Path) -> Iterator[str]:
    """The words that decide the files, so that the same work leaves the same card whoever does it and wherever to."""
    skipped = False
    for word in command:
        if skipped or word in _IDLE:
            skipped = word in _IDLE and word != "--overwrite"
        else:
            yield "OUT" if Path(word).absolute() == folder.absolute() else _last_name(word)


def _last_name(word: str) -> str:
    flag, equals, value = word.partition("=")
    return f"{flag}{equals}{Path(value).name}" if equals and "/" in value else Path(word).name if "/" in word else word


def _commands(path: Path) -> list[str]:
    """The commands of a card that stands there."""
    if path.is_symlink() or not path.is_file() or path.stat().st_size > _MOST_BYTES:
        return []
    text = read_bytes(path).decode("utf-8", "replace")
    return [line for line in text.splitlines() if line.startswith(_COMMAND)]
