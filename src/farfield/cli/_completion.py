"""Completion for shells: verbs, each verb's flags and the words that a flag takes; files elsewhere."""

import re
import warnings
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from typing import Any

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


def flags_of(verb: str) -> dict[str, tuple[str, ...]]:
    """The flags of a verb and the words that each takes; no words where it takes files or anything."""
    words: dict[str, tuple[str, ...]] = {}
    for action in arguments_of(verb):
        listed = re.match(r"\{([\w.-]+(?:,[\w.-]+)+)\}", str(action.metavar or ""))  # such as {day,night}|STR
        choices = tuple(sorted(map(str, action.choices or (listed.group(1).split(",") if listed else ()))))
        words |= {flag: choices for flag in action.option_strings if flag.startswith("--")}
    return words | {"--verbose": ()}


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
            f'    {verb})\n      flags="{" ".join(flags)}"\n'
            + (f'      case "$before" in\n{values}      esac ;;\n' if values else "      ;;\n")
        )
    return (
        "_farfield() {\n"
        '  local typed="${COMP_WORDS[COMP_CWORD]}" before="${COMP_WORDS[COMP_CWORD-1]}" flags="" words=""\n'
        '  if [ "$COMP_CWORD" -eq 1 ]; then\n'
        f'    COMPREPLY=($(compgen -W "{" ".join((*verbs, *GLOBAL))}" -- "$typed"))\n'
        "    return\n  fi\n"
        f'  if [ "$before" = "--completion" ]; then words="{" ".join(SHELLS)}"; fi\n'
        '  case "${COMP_WORDS[1]}" in\n'
        f"{''.join(cases)}  esac\n"
        '  if [ -n "$words" ]; then COMPREPLY=($(compgen -W "$words" -- "$typed"))\n'
        '  elif [ "${typed#-}" != "$typed" ]; then COMPREPLY=($(compgen -W "$flags" -- "$typed"))\n'
        '  else COMPREPLY=($(compgen -f -- "$typed")); fi\n'
        "}\n"
        "complete -o filenames -F _farfield farfield\n"
    )


def _fish(verbs: Mapping[str, str]) -> str:
    lines = [f"complete -c farfield -n __fish_use_subcommand -a {verb} -d '{what}'" for verb, what in verbs.items()]
    lines += [f"complete -c farfield -n __fish_use_subcommand -l {flag[2:]}" for flag in GLOBAL]
    for verb in verbs:
        for flag, words in flags_of(verb).items():
            values = f" -x -a '{' '.join(words)}'" if words else ""
            lines.append(f"complete -c farfield -n '__fish_seen_subcommand_from {verb}' -l {flag[2:]}{values}")
    return "\n".join(lines) + "\n"
