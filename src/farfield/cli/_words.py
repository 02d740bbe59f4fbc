"""Words that a command does not know: what was meant, in a sentence."""

import re
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches

from farfield.cli._help import positional_name
from farfield.errors import did_you_mean

_OTHER_WORDS = {
    "benchmark": "evaluate", "check": "doctor", "detect": "predict", "draw": "show", "eval": "evaluate",
    "export": "convert", "finetune": "adapt", "generate": "simulate", "infer": "predict", "inference": "predict",
    "info": "doctor", "label": "annotate", "metrics": "score", "mot": "track", "plot": "show", "poses": "odometry",
    "slam": "odometry", "statistics": "stats", "test": "evaluate", "val": "evaluate", "validate": "doctor",
    "visualise": "view", "visualize": "view",
}  # fmt: skip
"""What other toolkits call our verbs."""
_NUMBERS = (
    (re.compile(r"Error parsing (\S+): invalid literal for int\(\) with base 10: (.+)"), "a whole number"),
    (re.compile(r"Error parsing (\S+): could not convert string to float: (.+)"), "a number"),
)


def meant_verbs(words: Sequence[str], verbs: Mapping[str, str]) -> list[str]:
    """Verbs that may have been meant, the likeliest first: of a like name, or whose sentence has the words.

    Args:
        words: What stands in the place of the verb, and what follows it.
        verbs: What each verb does.

    >>> meant_verbs(["evalute"], {"evaluate": "run a detector", "train": "train a detector"})
    ['evaluate']
    """
    first = words[0].lower().replace("_", "-")
    looked_for = {word for text in words for word in re.findall(r"[a-z0-9]{4,}", text.lower())}
    hits = {verb: len(looked_for & set(re.findall(r"[a-z0-9]+", what.lower()))) for verb, what in verbs.items()}
    close = [*([_OTHER_WORDS[first]] if first in _OTHER_WORDS else []), *get_close_matches(first, verbs, n=2)]
    if close and (first in _OTHER_WORDS or max(hits.values()) < 2):  # not a sentence, such as "how to count frames"
        return [verb for verb in dict.fromkeys(close) if verb in verbs]
    named = [verb for verb in verbs if verb in looked_for]
    best = sorted((verb for verb, count in hits.items() if count), key=lambda verb: -hits[verb])
    return list(dict.fromkeys([*named, *best]))[:3]


def no_verb(words: Sequence[str], verbs: Mapping[str, str]) -> str:
    """The sentence on a word that is no verb."""
    meant = "".join(f"\n  farfield {verb:<16}{verbs[verb]}" for verb in meant_verbs(words, verbs))
    advice = f". Did you mean{meant}\n" if meant else ". "
    return f"farfield: expected a verb, got {words[0]!r}{advice}farfield --help lists all verbs"


def no_flag(verb: str, word: str, flags: Iterable[str]) -> str:
    """The sentence on a flag that a verb does not have."""
    meant = did_you_mean(word.partition("=")[0].replace("_", "-"), flags)
    return f"no flag {word}.{meant} farfield {verb} --help-all"


def refused_words(verb: str, printed: str, flags: Mapping[str, Sequence[str]], required: Sequence[object]) -> str:
    """What a parser printed as it refused words, in one sentence.

    Args:
        verb: The verb.
        printed: The parser's box.
        flags: The verb's flags, with the words that each takes.
        required: The arguments without a flag that must stand there, in their order.
    """
    lines = [line for line in (line.strip("│|╭╮╰╯+ \t") for line in printed.splitlines()) if line]
    if len(lines) > 1 and re.fullmatch(r"[-─]+", lines[1]):
        lines = lines[1:]  # the title, where the terminal has no borders
    lines = [line for line in lines if not re.fullmatch(r"[-─]+( .* [-─]+)?", line)]  # borders, and the title in one
    text = " ".join(lines).replace("{None}|", "").replace("{None,", "{")
    text = re.split(r"For full helptext|Argument helptext|Perhaps you meant|Similar arguments", text)[0].strip()
    for pattern, expected in _NUMBERS:
        match = pattern.search(text)
        if match:
            return f"{match.group(1)}: expected {expected}, got {match.group(2)}"
    unknown = re.match(r"Unrecognized (?:options|arguments): (.*)", text)
    if unknown:
        words = unknown.group(1).split(", ")
        flag = next((word for word in words if word.startswith("-")), None)
        if flag is not None:
            return no_flag(verb, flag, flags)
        return f"expected nothing more, got {' '.join(words)}. farfield {verb} --help"
    if "Missing from" in text:
        entries = [line for line in lines if re.fullmatch(r"(-\S+ )?[A-Z{][^.]*", line) and "Missing" not in line]
        missing = [entry.split()[0] for entry in entries if entry.startswith("-")]
        bare = sum(not entry.startswith("-") and entry == entry.upper() for entry in entries)
        names = [positional_name(argument) for argument in required][len(required) - bare :] if bare else []
        return f"expected {', '.join([*names, *missing])} too. farfield {verb} --help"
    choice = re.match(r"invalid choice '(.*)' for argument '(.*)'\. Expected one of \((.*)\)", text)
    if choice:
        choices = re.findall(r"'([^']*)'", choice.group(3))
        if "None" in choices:  # one that may be left out: the parser's words are a set, in any order
            choices = sorted(word for word in choices if word != "None")
        listed, meant = ", ".join(filter(None, choices)), did_you_mean(choice.group(1), choices)
        return f"{choice.group(2)}: expected one of {listed}, got {choice.group(1)!r}.{meant}"
    return text or f"what follows was not understood. farfield {verb} --help"
