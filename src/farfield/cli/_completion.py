"""Completion for shells: verbs, flags, the words that a flag takes, names of detectors; files elsewhere."""

import re
import warnings
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from farfield.registry import named

SHELLS = ("bash", "zsh", "fish")
GLOBAL = ("--help", "--version", "--verbose", "--completion")


@cache
def arguments_of(verb: str) -> tuple[Any, ...]:
    """The positional arguments and flags of a verb, in the order of its help."""
    import tyro

    run = import_module(f"farfield.cli.{verb.replace('-', '_')}").run
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of get_parser, which nothing replaces
        return tuple(tyro.extras.get_parser(run)._actions)


def _detectors() -> Iterable[str]:
    return named("farfield.detectors.weights:bundled_weights")() if find_spec("torch") else ()


def _formats() -> Iterable[str]:
    return named("farfield.datasets.formats:looked_for")()


def _protocols() -> Iterable[str]:
    return named("farfield.metrics:PROTOCOLS").names()


def _experiments() -> Iterable[str]:
    return named("farfield.experiments.catalogue:names")()


def _presets() -> Iterable[str]:
    return named("farfield.simulation.presets:PRESETS") if find_spec("embreex") else ()


def _columns() -> Iterable[str]:
    return named("farfield.frame.where:COLUMNS")


def _workloads() -> Iterable[str]:
    return ("35000-frames-kradar", "40h-cirrus", "cirrus", "kradar")


_WORDS: Mapping[tuple[str, str], Callable[[], Iterable[str]]] = {
    ("", "detector"): _detectors,
    ("", "experiment"): _experiments,
    ("", "protocol"): _protocols,
    ("", "where"): _columns,
    ("simulate", "preset"): _presets,
    ("doctor", "format"): _formats,
    ("stats", "format"): _formats,
    ("view", "format"): _formats,
    ("experiments", "name"): _experiments,
    ("detectors", "name"): _detectors,
    ("bench", "workload"): _workloads,
}
"""Words that an argument takes, by verb (all where it is empty) and the argument's name."""


@cache
def _words_of(verb: str, name: str) -> tuple[str, ...]:
    give = _WORDS.get((verb, name)) or _WORDS.get(("", name))
    return tuple(sorted(give())) if give is not None else ()


def positional_words(verb: str) -> tuple[str, ...]:
    """The words that may stand where a verb takes no flag, beside names of files."""
    words: list[str] = []
    for action in arguments_of(verb):
        if not action.option_strings:
            words += [*_choices(action), *_words_of(verb, action.dest.rpartition(".")[2])]
    return tuple(dict.fromkeys(words))


def _choices(action: Any) -> list[str]:
    """The words that an argument is one of, without the ``None`` that leaves it out; sorted where that was one."""
    words = [*map(str, action.choices or ())]  # with None the parser's words are a set, in any order
    return sorted(word for word in words if word != "None") if "None" in words else words


def flags_of(verb: str) -> dict[str, tuple[str, ...]]:
    """The flags of a verb and the words that each takes; no words where it takes files or anything."""
    words: dict[str, tuple[str, ...]] = {}
    for action in arguments_of(verb):
        listed = re.match(r"\{([\w.-]+(?:,[\w.-]+)+)\}", str(action.metavar or ""))  # such as {day,night}|STR
        choices = tuple(sorted(_choices(action) or (listed.group(1).split(",") if listed else ())))
        choices = choices or _words_of(verb, action.dest.rpartition(".")[2])
        words |= {flag: choices for flag in action.option_strings if flag.startswith("--")}
    return words | {"--verbose": (), "--help": (), "--help-all": ()}


def script(shell: str, verbs: Mapping[str, str]) -> str:
    """What the shell is to read, such as by ``source <(farfield --completion bash)``.

    Args:
        shell: One of :data:`SHELLS`.
        verbs: What each verb does.
    """
    if shell == "fish":
        return _fish(verbs)
    before = "autoload -U +X bashcompinit && bashcompinit\n" if shell == "zsh" else ""
    return before + _bash(verbs)


def _bash(verbs: Mapping[str, str]) -> str:
    cases = []
    for verb in verbs:
        flags = flags_of(verb)
        values = "".join(f'        {flag}) words="{" ".join(words)}" ;;\n' for flag, words in flags.items() if words)
        cases.append(
            f'    {verb})\n      flags="{" ".join(flags)}" names="{" ".join(positional_words(verb))}"\n'
            + (f'      case "$before" in\n{values}      esac ;;\n' if values else "      ;;\n")
        )
    return (
        "_farfield() {\n"
        '  local typed="${COMP_WORDS[COMP_CWORD]}" before="${COMP_WORDS[COMP_CWORD-1]}" flags="" words="" names=""\n'
        '  if [ "$COMP_CWORD" -eq 1 ]; then\n'
        f'    COMPREPLY=($(compgen -W "{" ".join((*verbs, *GLOBAL))}" -- "$typed"))\n'
        "    return\n  fi\n"
        f'  if [ "$before" = "--completion" ]; then words="{" ".join(SHELLS)}"; fi\n'
        '  case "${COMP_WORDS[1]}" in\n'
        f"{''.join(cases)}  esac\n"
        '  if [ -n "$words" ]; then COMPREPLY=($(compgen -W "$words" -- "$typed"))\n'
        '  elif [ "${typed#-}" != "$typed" ]; then COMPREPLY=($(compgen -W "$flags" -- "$typed"))\n'
        '  else COMPREPLY=($(compgen -W "$names" -- "$typed") $(compgen -f -- "$typed")); fi\n'
        "}\n"
        "complete -o filenames -F _farfield farfield\n"
    )


def _fish(verbs: Mapping[str, str]) -> str:
    lines = [f"complete -c farfield -n __fish_use_subcommand -a {verb} -d '{what}'" for verb, what in verbs.items()]
    lines += [f"complete -c farfield -n __fish_use_subcommand -l {flag[2:]}" for flag in GLOBAL]
    for verb in verbs:
        names = positional_words(verb)
        if names:
            lines.append(f"complete -c farfield -n '__fish_seen_subcommand_from {verb}' -a '{' '.join(names)}'")
        for flag, words in flags_of(verb).items():
            values = f" -x -a '{' '.join(words)}'" if words else ""
            lines.append(f"complete -c farfield -n '__fish_seen_subcommand_from {verb}' -l {flag[2:]}{values}")
    return "\n".join(lines) + "\n"
