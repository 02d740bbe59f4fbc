"""Blocks of code of the documentation's pages: the commands and the Python in them."""

import ast
import contextlib
import inspect
import io
import os
import re
import shlex
import sys
from collections.abc import Mapping
from functools import cache, wraps
from importlib import import_module
from types import ModuleType
from typing import Any

import tyro

from farfield.cli import VERBS, main

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


def unknown_names(code: str) -> list[str]:
    """What a piece of Python names of Farfield that is not there: imports, attributes of ``ff``, keywords."""
    tree = ast.parse(code)
    imported: dict[str, Any] = {"ff": import_module("farfield")}
    absent = []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "farfield":
            for alias in node.names:
                thing = _member(str(node.module), alias.name)
                imported[alias.asname or alias.name] = thing
                absent += [f"{node.module}.{alias.name}"] if thing is None else []
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and _is_absent(node, imported):
            absent.append(ast.unparse(node))
        if isinstance(node, ast.Call) and (called := _resolved(node.func, imported)) is not None:
            absent += [f"{ast.unparse(node.func)}({word}=)" for word in _strange_keywords(node, called)]
    return absent


def _member(module: str, name: str) -> Any:
    """A member of a module, or a part of it that nothing has imported yet; None where there is neither."""
    try:
        home = import_module(module)
        return getattr(home, name) if hasattr(home, name) else import_module(f"{module}.{name}")
    except ModuleNotFoundError:
        return None


def _resolved(node: ast.expr, imported: Mapping[str, Any]) -> Any:
    """What a dotted name of an import stands for; None of others."""
    if isinstance(node, ast.Name):
        return imported.get(node.id)
    if isinstance(node, ast.Attribute) and (owner := _resolved(node.value, imported)) is not None:
        return getattr(owner, node.attr, None)
    return None


def _is_absent(node: ast.Attribute, imported: Mapping[str, Any]) -> bool:
    owner = _resolved(node.value, imported)
    return owner is not None and not hasattr(owner, node.attr)


def _strange_keywords(node: ast.Call, called: Any) -> list[str]:
    """Keywords of a call that its signature does not have."""
    try:
        parameters = inspect.signature(called).parameters.values()
    except (TypeError, ValueError):
        return []
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        return []
    known = {parameter.name for parameter in parameters}
    return [word.arg for word in node.keywords if word.arg is not None and word.arg not in known]


def run_block(language: str, code: str, page: str) -> None:
    """Run a page's block in the working folder, commands of Farfield in this process.

    Raises:
        AssertionError: If a command ends with another status than 0.
    """
    if language == "python":
        module = sys.modules["page"] = ModuleType("page")  # so that what it defines can be pickled
        exec(compile(code, page, "exec"), module.__dict__)
        return
    commands = iter(commands_in(code))
    for line in code.replace("\\\n", " ").splitlines():
        if line.startswith("farfield "):
            words = next(commands)
            status = main(words)
            assert status == 0, f"{page}: farfield {' '.join(words)}: {status}"
        elif line.strip():
            assert os.system(line) == 0, line  # such as printf
