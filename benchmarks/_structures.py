"""Cases of structural edits whose meaning is known, and what a reader makes of them.

A case is a model (points, boxes, stamps...) that a small writer of its own puts into files, with one or two edits
that the format's documentation or docs/checks.md gives a meaning. So what has to come out is known:

- ``same``: the model after the edits;
- ``said``: the model after the edits, and words about it;
- ``refused``: a FarfieldError, whose words may be asked for;
- ``either``: the model after the edits or a FarfieldError, but no other numbers.

A module ``_structures_NAME.py`` has ``FAMILIES``; this is all that makes it part of the script.
"""

import re
import resource
import shutil
import sys
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from farfield.errors import FarfieldError

Oracle = Literal["same", "said", "refused", "either"]
LIMIT_S, LIMIT_BYTES = 2.0, 1 << 30
_EXAMPLES = 4


@dataclass(frozen=True)
class Reading:
    """What came out of a reader, and what it said."""

    values: Any
    words: str = ""


@dataclass(frozen=True)
class Case:
    """Files in a folder, and what has to come out of them.

    Args:
        edits: What was changed, in words.
        oracle: What has to happen.
        read: Reads the files.
        difference: What in the values differs from the model after the edits; empty where nothing does.
        words: What has to be said: a regular expression for ``said``, and for ``refused`` one for the error.
    """

    edits: tuple[str, ...]
    oracle: Oracle
    read: Callable[[], Reading]
    difference: Callable[[Any], str]
    words: str = ""


@dataclass(frozen=True)
class Family:
    """Cases of one format.

    Args:
        name: The format, as the table names it.
        make: Writes the files of a case into an empty folder.
        share: How many of the cases, compared with other families.
    """

    name: str
    make: Callable[[np.random.Generator, Path], Case]
    share: float = 1.0


@dataclass
class Tally:
    """What came of the cases of one family."""

    cases: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    oracles: Counter[str] = field(default_factory=Counter)
    slowest_s: float = 0.0
    peak_bytes: int = 0
    faults: list[str] = field(default_factory=list)

    def add(self, other: "Tally") -> None:
        """Take the cases of another part of the family."""
        self.cases += other.cases
        self.outcomes += other.outcomes
        self.oracles += other.oracles
        self.slowest_s = max(self.slowest_s, other.slowest_s)
        self.peak_bytes = max(self.peak_bytes, other.peak_bytes)
        self.faults += other.faults


def generator(family: str, number: int) -> np.random.Generator:
    """The random numbers of a case: its family's name and its number are all that it depends on."""
    return np.random.default_rng([number, zlib.crc32(family.encode())])


def make_case(family: Family, number: int, folder: Path) -> Case:
    """Write the files of a case into a folder, which is emptied."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return family.make(generator(family.name, number), folder)


def outcome(case: Case) -> tuple[str, str]:
    """What happens to a case, and what is wrong with it: ``same``, ``said`` and ``refused`` are right."""
    try:
        reading = case.read()
        difference = case.difference(reading.values)
    except FarfieldError as error:
        if case.oracle not in ("refused", "either"):
            return "overrefused", str(error)[:300]
        lacks_words = bool(case.words) and not re.search(case.words, str(error))
        return ("silent", f"no {case.words!r} in the error: {error}"[:300]) if lacks_words else ("refused", "")
    except MemoryError:
        return "foreign", f"more than {LIMIT_BYTES >> 20} MB"
    except Exception as error:
        return "foreign", f"{type(error).__name__}: {error}"[:300]
    if case.oracle == "refused":
        return "silent", f"read, not refused{f'; {difference}' if difference else ''}"[:300]
    if difference:
        return "silent", difference[:300]
    if case.oracle == "said" and not re.search(case.words, reading.words):
        return "silent", f"no {case.words!r} in what is said: {reading.words!r}"[:300]
    return ("said" if case.oracle == "said" else "same"), ""


def run_cases(family: Family, numbers: Iterable[int], folder: Path, at: Path | None = None) -> Tally:
    """Try cases of a family.

    Args:
        family: The family.
        numbers: The cases.
        folder: A folder for their files.
        at: A file that gets the number of the case that runs, to be read if the process dies.
    """
    tally, faults = Tally(), Counter[tuple[str, str]]()
    for number in numbers:
        if at is not None:
            at.write_text(str(number))
        case = make_case(family, number, folder)
        start = time.process_time()  # not the clock on the wall: others may be using the processor
        result, fault = outcome(case)
        elapsed = time.process_time() - start
        if not fault and elapsed > LIMIT_S:
            result, fault = "slow", f"took {elapsed:.1f} s"
        tally.cases += 1
        tally.outcomes[result] += 1
        tally.oracles[case.oracle] += 1
        tally.slowest_s = max(tally.slowest_s, elapsed)
        if fault:
            kind = (result, re.sub(r"\S*/\S*|[\d.]+", "", fault)[:80])
            faults[kind] += 1
            if faults[kind] <= _EXAMPLES:
                tally.faults.append(f"{family.name} {number}: {result}: {' + '.join(case.edits)}: {fault}")
    scale = 1 if sys.platform == "darwin" else 1024
    tally.peak_bytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * scale
    return tally


def apart(name: str, actual: Any, expected: Any, *, tolerance: float = 1e-6, relative: float = 1e-6) -> str:
    """What of an array differs from the expected one, in words; empty where nothing does. NaN equals NaN.

    >>> apart("x", np.array([1.0, 2.0]), np.array([1.0, 2.5]))
    'x: 1 of 2 differ, such as 2.0 in place of 2.5'
    """
    actual, expected = np.asarray(actual), np.asarray(expected)
    if actual.shape != expected.shape:
        return f"{name}: shape {actual.shape} in place of {expected.shape}"
    if expected.dtype.kind in "fiub" and actual.dtype.kind in "fiub":
        wide = (actual.astype(np.float64), expected.astype(np.float64))
        alike = np.isclose(*wide, rtol=relative, atol=tolerance, equal_nan=True)
    else:
        alike = np.asarray(actual == expected)
    if alike.all():
        return ""
    row = tuple(np.argwhere(~alike)[0]) if alike.ndim else ()
    count = f"{int((~alike).sum())} of {alike.size} differ"
    return f"{name}: {count}, such as {actual[row]!s} in place of {expected[row]!s}"
