"""Blocks of code of the documentation's pages: the commands and the Python in them."""

import re
import shlex
from functools import cache, wraps
from importlib import import_module
from typing import Any

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", flags=re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
ENDS = {"|", "||", "&&", ";", ">", ">>", "<"}


def blocks_of(text: str, *languages: str) -> list[tuple[str, str]]:
    """Language and code of a page's blocks, in order; all of them unless languages are named."""
    return [block for block in BLOCK.findall(text) if not languages or block[0] in languages]


def inline_code(text: str) -> list[str]:
    """The code within the sentences and tables of a page, a bar of a table's cell as it is meant."""
    return [code.replace("\\|", "|") for code in INLINE.findall(BLOCK.sub("", text))]


def commands_in(code: str) -> list[list[str]]:
    """The words behind ``farfield`` of each command of a shell's code."""
    commands: list[list[str]] = []
    open_command = begins = False
    for word in _words(code):
        if word in ENDS:
            open_command, begins = False, word in {"|", "||", "&&", ";"}
        elif open_command:
            commands[-1].append(word)
        elif begins and word == "farfield":
            commands.append([])
            open_command = True
        else:
            begins = False
    return commands


def _words(code: str) -> list[str]:
    """The words of a shell's code without its comments, a ``;`` at each end of a line."""
    words = [";"]
    for line in code.replace("\\\n", " ").splitlines():
        lexer = shlex.shlex(line, posix=True, punctuation_chars="|&;<>")
        lexer.whitespace_split, lexer.commenters = True, "#"
        words += [*lexer, ";"]
    return words


@cache
def _parser_only(verb: str) -> Any:
    """A function of a verb's signature and help that does nothing."""
    run = import_module(f"farfield.cli.{verb.replace('-', '_')}").run

    @wraps(run)
    def nothing(*_: Any, **__: Any) -> int:
        return 0

    return nothing


def refusal(words: list[str]) -> str:
    """What the command line's own parser says against a command; empty where it takes it."""
    import contextlib
    import io

    import tyro

    from farfield.cli import VERBS

    if not words or words[0].startswith("-"):
        return ""
    if words[0] not in VERBS:
        return f"no verb {words[0]!r}"
    shown = io.StringIO()
    arguments = [word for word in words[1:] if word not in ("-v", "--verbose")]
    try:
        with contextlib.redirect_stderr(shown), contextlib.redirect_stdout(shown):
            tyro.cli(_parser_only(words[0]), prog=f"farfield {words[0]}", args=arguments)
    except SystemExit as ended:
        return "" if ended.code in (0, None) else shown.getvalue()
    return ""
