"""Which verb has which flag, as a table of the parsers: what deviates stands here by name, with its reason."""

import pytest

from farfield.cli import VERBS
from farfield.cli._completion import flags_of

PICTURE, PAGE = "one picture", "a page and its figures, some hundred kilobytes, in seconds or as long as it reads"
READS_ONLY = "writes nothing unless --json or --out names a file"

NO_DRY_RUN = {
    "doctor": READS_ONLY,
    "formats": READS_ONLY,
    "detectors": READS_ONLY,
    "experiments": READS_ONLY,
    "bench": READS_ONLY,
    "compare-results": READS_ONLY,
    "score": READS_ONLY,
    "show": PICTURE,
    "radar": PICTURE,
    "stats": PAGE,
    "compare": PAGE,
    "calibrate": PAGE,
    "report": PAGE,
    "view": "writes nothing; the page exports what it is asked for",
    "annotate": "writes what is drawn, as it is drawn",
    "new-dataset": "an example of some kilobytes",
    "import-weights": "one file, of the checkpoint's size",
    "export": "one file of the weights' size, and a page",
}
NO_OUT = {
    "doctor": "--json is all it writes",
    "score": "--json is all it writes",
    "detectors": "--json is all it writes",
    "formats": "--json is all it writes",
    "experiments": "prints",
    "bench": "--json is all it writes",
    "compare-results": "prints",
    "view": "writes nothing",
    "new-dataset": "its folder is the one thing it asks for, so it comes without a flag",
    "simulate": "its folder comes without a flag",
    "convert": "its target comes without a flag",
    "anonymize": "its folder comes without a flag",
    "import-weights": "its file comes without a flag",
    "export": "its file comes without a flag",
}
RESULTS = {"doctor", "stats", "score", "evaluate", "compare", "detectors", "bench"}
"""Verbs whose result is figures."""
OPENS = {
    "doctor", "stats", "show", "view", "annotate", "convert", "adapt", "predict", "evaluate", "odometry", "depth",
    "compare", "radar", "calibrate", "sync", "track", "anonymize", "report",
}  # fmt: skip
NO_READING = {
    "sync": "reads stamps",
    "anonymize": "reads pictures",
}
NO_CLOUDS = {
    "doctor": "looks at all clouds",
    "stats": "counts all clouds",
    "view": "the page chooses",
    "annotate": "the page chooses",
    "radar": "shows the radar",
    "calibrate": "each kind has its own two sensors",
    "sync": "reads stamps",
    "track": "reads boxes",
    "anonymize": "reads pictures",
    "report": "draws what was evaluated",
}
NO_REPLICATES = {"compare-results": "shows the intervals that the results hold"}


def lacking(flag: str, among: set[str]) -> set[str]:
    return {verb for verb in among if flag not in flags_of(verb)}


@pytest.mark.parametrize(
    ("flag", "among", "without"),
    [
        ("--dry-run", set(VERBS), NO_DRY_RUN),
        ("--out", set(VERBS), NO_OUT),
        ("--columns", OPENS, NO_READING),
        ("--intensity-scale", OPENS, NO_READING),
        ("--point-times", OPENS, NO_READING),
        ("--mapping", OPENS, NO_READING),
        ("--tracklets", OPENS, NO_READING),
        ("--label-axes", OPENS, NO_READING),
        ("--cloud", OPENS, NO_CLOUDS),
        ("--clouds", OPENS, NO_CLOUDS),
        ("--json", RESULTS, {}),
        ("--replicates", {"score", "evaluate", "compare-results"}, NO_REPLICATES),
        ("--reference", {"predict", "convert", "score"}, {}),
        ("--verbose", set(VERBS), {}),
    ],
)
def test_a_verb_has_the_flag_or_a_reason_not_to(flag: str, among: set[str], without: dict[str, str]) -> None:
    assert lacking(flag, among) == set(without)


def test_who_works_is_said_by_the_same_two_flags() -> None:
    engines = set(VERBS) - lacking("--engine", set(VERBS))
    assert lacking("--workers", engines) == set()
    assert set(VERBS) - lacking("--workers", set(VERBS)) == engines
