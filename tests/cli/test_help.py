"""Help fits a screen, verbs stand in groups, and what a command does not know it answers with what was meant."""

from importlib import import_module

import pytest

from farfield.cli import GROUPS, VERBS, main, overview
from farfield.cli._completion import arguments_of, flags_of
from farfield.cli._help import HELP_ALL, help_text
from farfield.cli._words import meant_verbs


@pytest.mark.parametrize("verb", VERBS)
def test_help_fits_a_screen_and_all_of_it_is_one_flag_away(verb: str) -> None:
    run = import_module(f"farfield.cli.{verb.replace('-', '_')}").run
    short = help_text(verb, run, arguments_of(verb))
    everything = help_text(verb, run, arguments_of(verb), everything=True)
    assert len(short.splitlines()) <= 40, short
    assert max(map(len, short.splitlines())) <= 120
    for text in (short, everything):
        assert "{None}" not in text
        assert "(default: )" not in text
        assert "None" not in text.replace("NoneT", "")
    flags = {flag for flag in flags_of(verb) if not flag.startswith("--no-")} - {"--verbose", "--help", HELP_ALL}
    assert all(flag in everything or flag.replace("--", "--[no-]") in everything for flag in flags)
    for argument in arguments_of(verb):  # by one of its names: others are aliases
        names = [name for name in argument.option_strings if name in flags]
        assert not names or any(name in short or name.replace("--", "--[no-]") in short for name in names), names


def test_verbs_stand_in_groups() -> None:
    text = overview()
    assert len(text.splitlines()) <= 60
    assert sum(map(len, GROUPS.values())) == len(VERBS)
    assert all(f"\n{title}:\n" in text for title in GROUPS)


@pytest.mark.parametrize(
    ("words", "status", "told"),
    [
        (["evalute"], 2, "farfield evaluate"),
        (["detect", "cars"], 2, "farfield predict"),
        (["how", "to", "count", "frames"], 2, "farfield stats"),
        (["formats", "--jsn", "-"], 2, "no flag --jsn. Did you mean --json?"),
        (["formats", "a", "b"], 2, "expected nothing more, got b"),
        (["import-weights"], 2, "expected CHECKPOINT, OUT too"),
        (["compare-results", "a.json", "--digits"], 2, "--digits"),
    ],
)
def test_a_wrong_word_is_answered_in_a_sentence(
    words: list[str], status: int, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == status
    error = capsys.readouterr().err
    assert told in error
    assert not set("│╭╰") & set(error)


def test_what_is_like_nothing_names_no_verb() -> None:
    assert meant_verbs(["xyzzy"], VERBS) == []
    assert meant_verbs(["eval"], VERBS)[0] == "evaluate"


def test_help_of_a_verb_is_printed_by_either_word(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help", "formats"]) == main(["formats", "-h"]) == 0
    one, other = capsys.readouterr().out.split("usage:")[1:]
    assert one == other


def test_completion_knows_names() -> None:
    from farfield.cli._completion import positional_words

    assert "pointpillars-cirrus-sim" in positional_words("evaluate")
    assert "second-cirrus-sim" in positional_words("train")
    assert "cirrus-sim-mini" in positional_words("simulate")
    assert "lidar-camera" in positional_words("calibrate")
    assert "waymo-let" in flags_of("evaluate")["--protocol"]
    assert "range_m" in flags_of("evaluate")["--where"]
