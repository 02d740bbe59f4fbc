"""What ``farfield VERB --help`` prints: a screen of what is used most; ``--help-all`` prints every flag in full."""

import inspect
import re
import shutil
import textwrap
from collections.abc import Callable, Iterator, Sequence
from typing import Any

HELP, HELP_ALL = ("-h", "--help"), "--help-all"
SCREEN_LINES = 38
"""Lines of the short help at most."""
_EXAMPLES = 4
_NARROWEST, _WIDEST, _INDENT = 72, 100, 26
_SHARED = {
    "reading": "reading the files",
    "files": "reading the files",
    "scoring": "scoring",
    "boxes": "the detector's boxes",
    "jobs": "processes",
}
"""Groups of flags that many verbs have, by the first part of a flag's dest: the short help lists them by name alone."""
_NESTED = r"(?:[^()]|\([^()]*\))*"
_FIRST = ("out", "json", "protocol", "where")
"""Flags that the short help explains where few fit."""


def plain_metavar(argument: Any) -> str:
    """What stands for a flag's value: ``PATH``, ``{day,night}``; without the ``None`` that leaves it out.

    Args:
        argument: An action of the verb's parser.
    """
    text = "" if argument.metavar is None else str(argument.metavar)
    text = text.replace("{None}|", "").replace("{None,", "{").replace("{,", "{")
    many = re.fullmatch(r"\[(\S+) \[\1 \.\.\.\]\]", text)
    return f"{many.group(1)} ..." if many else text


def default_and_help(argument: Any) -> tuple[str, str]:
    """The parser's default of an argument, empty where that says nothing, and what the argument does.

    What the docstring calls a default stays in its text.
    """
    match = re.fullmatch(
        rf"(.*) ?\((default: ?({_NESTED})|required|optional|repeatable)\)", argument.help or "", re.DOTALL
    )
    if match is None:
        return "", " ".join((argument.help or "").split())
    default = match.group(3) or ""
    return ("" if default in ("None", "''", "False", "True") else default), " ".join(match.group(1).split())


def flag_names(argument: Any) -> str:
    """How a flag is written: ``--out PATH``, ``--dry-run``, ``--[no-]report`` where it is on by default."""
    own = f"--{_own_name(argument)}".replace("_", "-")
    options = [word for word in argument.option_strings if word.startswith("--")]
    name = own if own in options else options[0]
    if f"--no-{name[2:]}" in options:
        return f"--[no-]{name[2:]}" if (argument.help or "").endswith("(default: True)") else name
    short = next((f"{word}, " for word in argument.option_strings if not word.startswith("--")), "")
    return f"{short}{name} {plain_metavar(argument)}".rstrip()


def positional_name(argument: Any) -> str:
    """How the usage line and errors call an argument without a flag: ``DETECTOR``."""
    return _own_name(argument).upper() + (" ..." if argument.nargs in ("*", "+") else "")


def help_text(verb: str, run: Callable[..., Any], arguments: Sequence[Any], *, everything: bool = False) -> str:
    """The help of a verb.

    Args:
        verb: Its name.
        run: Its function, whose docstring says what it does, with examples.
        arguments: The actions of its parser.
        everything: All flags in full, and all that the docstring says.
    """
    width = min(max(shutil.get_terminal_size((_WIDEST, 40)).columns, _NARROWEST), _WIDEST)
    paragraphs = inspect.getdoc(run).partition("\nArgs:")[0].strip().split("\n\n")  # type: ignore[union-attr]
    shown = [argument for argument in arguments if argument.dest != "help"]
    positional = [argument for argument in shown if not argument.option_strings]
    flags = [argument for argument in shown if argument.option_strings]
    lines = [f"usage: farfield {' '.join((verb, *map(positional_name, positional), *(['[flags]'] * bool(flags))))}"]
    for number, paragraph in enumerate(paragraphs):
        if paragraph.startswith("examples:"):
            examples = paragraph.split("\n")
            lines += ["", *(examples if everything else examples[: 1 + _EXAMPLES])]
        elif everything or not number:
            lines += ["", *textwrap.wrap(" ".join(paragraph.split()), width)]
    if positional:
        lines += ["", "arguments:"]
        for argument in positional:
            lines += _entry(positional_name(argument), argument, width, everything=everything)
    if everything:
        lines += ["", "flags:"]
        for argument in flags:
            lines += _entry(_all_names(argument), argument, width, everything=True)
        return "\n".join(lines) + "\n"
    return "\n".join([*lines, *_short_flags(verb, flags, width, SCREEN_LINES - len(lines))]) + "\n"


def _short_flags(verb: str, flags: Sequence[Any], width: int, room: int) -> list[str]:
    """As many of the verb's own flags as fit, explained; the others by name."""
    if not flags:
        return []
    own = [argument for argument in flags if argument.dest.partition(".")[0] not in _SHARED]
    explained = list(own)
    while True:
        lines = ["", "flags:"] if explained else []
        for argument in explained:
            lines += _entry(flag_names(argument), argument, width, everything=False)
        lines += _named(verb, [argument for argument in flags if argument not in explained], width)
        if len(lines) <= room or not explained:
            return lines
        less = [argument for argument in explained if _own_name(argument) not in _FIRST and not argument.required]
        explained.remove((less or explained)[-1])


def _named(verb: str, flags: Sequence[Any], width: int) -> list[str]:
    groups: dict[str, list[str]] = {}
    for argument in flags:
        group = _SHARED.get(argument.dest.partition(".")[0], "others")
        name = next(word for word in flag_names(argument).split() if word.startswith("--"))
        groups.setdefault(group, []).append(name)
    if not groups:
        return []
    lines = ["", f"more flags, which farfield {verb} {HELP_ALL} explains:"]
    for group, names in groups.items():
        text = f"{group}: {' '.join(names)}"
        lines += textwrap.wrap(
            text, width, initial_indent="  ", subsequent_indent="    ", break_on_hyphens=False, break_long_words=False
        )
    return lines


def _entry(names: str, argument: Any, width: int, *, everything: bool) -> Iterator[str]:
    """The lines of one argument."""
    default, text = default_and_help(argument)
    choices = re.search(r"\{([^}]*)\}", names)
    if not everything:
        text = _first_clause(text)
        if choices:
            words = choices.group(1).split(",")
            names = names.replace(choices.group(), "NAME")
            text += "" if all(word in text for word in words) else f" [{'|'.join(words)}]"
    if default:
        text += f" (default: {default})"
    wrapped = textwrap.wrap(text, width - _INDENT, break_on_hyphens=False) or [""]
    if len(names) > _INDENT - 4:
        yield f"  {names}"
        names = ""
    else:
        first, *wrapped = wrapped
        yield f"  {names:<{_INDENT - 2}}{first}".rstrip()
    for line in wrapped:
        yield " " * _INDENT + line


def _first_clause(text: str) -> str:
    """The first sentence, or what stands before its semicolon, with the default that the text names."""
    clause = re.split(r"(?<=[\w)`'])[.;](?= )", text, maxsplit=1)[0].rstrip(".")
    default = re.search(rf"\(default: {_NESTED}\)", text)
    return clause if default is None or default.group() in clause else f"{clause} {default.group()}"


def _all_names(argument: Any) -> str:
    names = [word for word in argument.option_strings if not word.startswith("--no-")] or argument.option_strings
    if (argument.help or "").endswith("(default: True)") and plain_metavar(argument) == "":
        names = argument.option_strings
    return f"{', '.join(names)} {plain_metavar(argument)}".rstrip()


def _own_name(argument: Any) -> str:
    return str(argument.dest).rpartition(".")[2]
