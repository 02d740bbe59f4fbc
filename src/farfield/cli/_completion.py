"""Completion for shells: verbs, each verb's flags and the words that a flag takes; files elsewhere."""

import warnings
from functools import cache
from importlib import import_module

from farfield.cli import VERBS

SHELLS = ("bash", "zsh", "fish")
GLOBAL = ("--help", "--version", "--verbose", "--completion")


@cache
def flags_of(verb: str) -> dict[str, tuple[str, ...]]:
    """The flags of a verb and the words that each takes; no words where it takes others, or files."""
    import tyro

    run = import_module(f"farfield.cli.{verb.replace('-', '_')}").run
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of get_parser, which nothing replaces
        actions = tyro.extras.get_parser(run)._actions
    return {
        flag: tuple(map(str, action.choices or ()))
        for action in actions
        for flag in action.option_strings
        if flag.startswith("--")
    } | {"--verbose": ()}


def script(shell: str) -> str:
    """What the shell is to read, such as by ``source <(farfield --completion bash)``."""
    if shell == "fish":
        return _fish()
    before = "autoload -U +X bashcompinit && bashcompinit\n" if shell == "zsh" else ""
    return before + _bash()


def _bash() -> str:
    cases = []
    for verb in VERBS:
        flags = flags_of(verb)
        values = "".join(f'        {flag}) words="{" ".join(of)}" ;;\n' for flag, of in flags.items() if of)
        cases.append(
            f'    {verb})\n      flags="{" ".join(flags)}"\n'
            + (f'      case "$before" in\n{values}      esac ;;\n' if values else "      ;;\n")
        )
    return (
        "_farfield() {\n"
        '  local typed="${COMP_WORDS[COMP_CWORD]}" before="${COMP_WORDS[COMP_CWORD-1]}" flags="" words=""\n'
        '  if [ "$COMP_CWORD" -eq 1 ]; then\n'
        f'    COMPREPLY=($(compgen -W "{" ".join((*VERBS, *GLOBAL))}" -- "$typed"))\n'
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


def _fish() -> str:
    lines = [f"complete -c farfield -n __fish_use_subcommand -a {verb} -d '{what}'" for verb, what in VERBS.items()]
    lines += [f"complete -c farfield -n __fish_use_subcommand -l {flag[2:]}" for flag in GLOBAL]
    for verb in VERBS:
        for flag, words in flags_of(verb).items():
            values = f" -x -a '{' '.join(words)}'" if words else ""
            lines.append(f"complete -c farfield -n '__fish_seen_subcommand_from {verb}' -l {flag[2:]}{values}")
    return "\n".join(lines) + "\n"
