"""Write docs/flags.md: every verb with its arguments and flags, read from the functions and classes that define them.

python tools/flags.py            print the page
python tools/flags.py --write    write it
"""

import sys
from pathlib import Path

from farfield.cli import VERBS
from farfield.cli._completion import arguments_of
from farfield.cli._help import default_and_help, plain_metavar

PAGE = Path(__file__).resolve().parents[1] / "docs" / "flags.md"
HEAD = """# Verbs and flags

Printed by `tools/flags.py` from the functions and frozen classes that define the flags; `farfield VERB --help` says the
same with examples. A flag is the keyword of the same name in Python.
"""


def cell(text: str) -> str:
    """A text that stands in one cell of a table."""
    return " ".join(text.split()).replace("|", "\\|").replace("*", "\\*").replace("_", "\\_")


def rows_of(verb: str) -> list[str]:
    """A row of the table for each argument of a verb."""
    rows = []
    for argument in arguments_of(verb):
        if argument.dest == "help":
            continue
        default, text = default_and_help(argument)
        metavar = plain_metavar(argument)
        flags = " ".join(f"`{flag}`" for flag in argument.option_strings)
        name = f"{flags} `{metavar}`" if flags and metavar else flags or f"`{argument.dest.rpartition('.')[2]}`"
        rows.append(f"| {name.replace('|', chr(92) + '|')} | {f'`{default}`' if default else ''} | {cell(text)} |")
    return rows


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    for verb, what in VERBS.items():
        parts += [f"## farfield {verb}", f"{what[0].upper()}{what[1:]}.".replace("..", ".")]
        parts += ["\n".join(["| argument | unless given | what it does |", "|---|---|---|", *rows_of(verb)])]
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    if "--write" in sys.argv[1:]:
        PAGE.write_text(page(), encoding="utf-8")
    else:
        print(page(), end="")
