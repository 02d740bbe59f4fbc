"""Logs of linuxptp: what ``ptp4l`` and ``phc2sys`` print of two-way exchanges (IEEE 1588, gPTP: IEEE 802.1AS).

A line holds the seconds since the machine started, the offset from the master and the path delay in nanoseconds, and
the frequency correction in parts per billion; a summary (``rms ... max ...``) holds a root mean square instead of an
offset. Other lines, such as changes of state, are counted and passed over.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int64

from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes
from farfield.files.limits import open_file
from farfield.files.remote_paths import as_path

_LONGEST_LINE = 1000
_HEAD = r"\b(?P<program>ptp4l|phc2sys)(?:\[\d{1,9}\])?:?\s*\[(?P<s>\d{1,12})\.(?P<fraction>\d{1,9})\]:?\s"
_OFFSET = re.compile(
    _HEAD + r".{0,200}?\b(?:master |phc |sys )?offset\s+(?P<offset>[+-]?\d{1,19})\s+s(?P<state>[0-3])"
    r"(?:\s+freq\s+(?P<freq>[+-]?\d{1,10}))?(?:\s+(?:path )?delay\s+(?P<delay>[+-]?\d{1,19}))?\s*$"
)
_SUMMARY = re.compile(
    _HEAD
    + r".{0,200}?\brms\s+(?P<rms>\d{1,19})\s+max\s+(?P<max>\d{1,19})\s+freq\s+(?P<freq>[+-]?\d{1,10})\s+\+/-\s+\d+"
    r"(?:\s+delay\s+(?P<delay>[+-]?\d{1,19})\s+\+/-\s+\d+)?\s*$"
)
_LIMIT_NS = 9_000_000_000_000_000_000


@dataclass(frozen=True, eq=False, kw_only=True)
class ClockLog:
    """What a log says, a row an exchange or a summary.

    Args:
        path: Where it was read.
        program: ``ptp4l`` or ``phc2sys``.
        time_ns: By the machine's own clock since its start, shape (n,).
        offset_ns: Clock minus master; of a summary its root mean square, shape (n,).
        summary: Whether the rows are summaries.
        delay_ns: Path delay, NaN where it is not printed, shape (n,).
        freq_ppb: Correction applied to the clock, NaN where it is not printed, shape (n,).
        locked: Whether the servo was locked (state s2 or s3), shape (n,); summaries do not say: True.
        others: Lines of another form.
    """

    path: Path
    program: Literal["ptp4l", "phc2sys"]
    time_ns: Int64[np.ndarray, " n"]
    offset_ns: Int64[np.ndarray, " n"]
    summary: bool
    delay_ns: Float[np.ndarray, " n"]
    freq_ppb: Float[np.ndarray, " n"]
    locked: np.ndarray
    others: int

    def __len__(self) -> int:
        return len(self.time_ns)


def is_clock_log(path: Path) -> bool:
    """Whether a line among the first few kilobytes names one of the programs in the form that they print."""
    with open_file(path, max_bytes=None) as handle:
        return re.search(_HEAD, handle.read(8192).decode("utf-8", "replace")) is not None


def read_clock_log(path: Path | str) -> ClockLog:
    """Read a log of ``ptp4l`` or ``phc2sys``, also one that ``journalctl`` put its own words before.

    Raises:
        FileFormatError: If no line says an offset, if both programs or both kinds of lines stand in it, if a line is
            longer than 1,000 characters, or if a number does not fit.
    """
    path = as_path(path)
    rows, others, kinds = [], 0, set()
    for number, line in enumerate(read_bytes(path).splitlines(), start=1):
        if len(line) > _LONGEST_LINE:
            raise _wrong(path, number, f"at most {_LONGEST_LINE} characters", f"{len(line)}")
        text = line.decode("utf-8", "replace")
        match = _OFFSET.search(text) or _SUMMARY.search(text)
        if match is None:
            others += 1
            continue
        fields = match.groupdict()
        kinds.add((fields["program"], "rms" in fields))
        rows.append(_row(path, number, fields))
    if len(kinds) != 1:
        quoted = (
            "none" if not kinds else " and ".join(sorted(f"{p} ({'summaries' if s else 'offsets'})" for p, s in kinds))
        )
        raise FileFormatError(
            path, where="the file", expected="offsets of one program, ptp4l or phc2sys, in one form", got=quoted,
            fix="Give each program a file of its own.",
        )  # fmt: skip
    ((program, summary),) = kinds
    return ClockLog(
        path=path,
        program="ptp4l" if program == "ptp4l" else "phc2sys",
        time_ns=np.array([row[0] for row in rows], dtype=np.int64),
        offset_ns=np.array([row[1] for row in rows], dtype=np.int64),
        summary=summary,
        delay_ns=np.array([row[2] for row in rows], dtype=np.float64),
        freq_ppb=np.array([row[3] for row in rows], dtype=np.float64),
        locked=np.array([row[4] for row in rows], dtype=np.bool_),
        others=others,
    )


def _row(path: Path, number: int, fields: dict[str, str]) -> tuple[int, int, float, float, bool]:
    time_ns = int(fields["s"]) * 1_000_000_000 + int(fields["fraction"].ljust(9, "0"))
    offset = int(fields["rms"] if "rms" in fields else fields["offset"])
    if max(time_ns, abs(offset)) > _LIMIT_NS:
        raise _wrong(path, number, "an offset and a time within 9e18 ns", f"{max(time_ns, abs(offset))}")
    delay, freq = (float(fields[key]) if fields.get(key) else float("nan") for key in ("delay", "freq"))
    return time_ns, offset, delay, freq, fields.get("state", "2") in "23"


def _wrong(path: Path, number: int, expected: str, actual: str) -> FileFormatError:
    return FileFormatError(path, where=f"line {number}", expected=expected, got=actual)
