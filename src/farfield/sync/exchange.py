"""Two-way exchanges: what they tell of a clock that one-way stamps cannot, its offset apart from the delay.

IEEE 1588-2019, 11.3: a message leaves the master at ``t1`` and arrives at ``t2``, another leaves at ``t3`` and arrives
at ``t4``. With equal delays both ways the clock is ahead by ``((t2 - t1) - (t4 - t3)) / 2`` and the delay is
``((t2 - t1) + (t4 - t3)) / 2``. What stays unknown is half the difference of the two delays.
"""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int64

from farfield.errors import ConfigError
from farfield.files.clock_logs import ClockLog


@dataclass(frozen=True, kw_only=True)
class ExchangeClock:
    """A clock against its master, from exchanges.

    Args:
        exchanges: How many, of a locked servo.
        unlocked: How many before the servo was locked; they are left out.
        offset_ns: Median offset; None where only summaries stand in the log.
        spread_ns: Robust deviation of the offset, of summaries the median root mean square.
        worst_ns: Largest offset either way.
        delay_ns: Median path delay; None where it is not known.
        asymmetry_limit_ns: The offset cannot be wrong by more: half of both delays together, since neither is negative.
        drift_ppm: What the servo takes off the clock's rate, median; None where it is not known.
    """

    exchanges: int
    unlocked: int
    offset_ns: float | None
    spread_ns: float
    worst_ns: float
    delay_ns: float | None
    asymmetry_limit_ns: float | None
    drift_ppm: float | None

    def to_json(self) -> dict[str, Any]:
        """All of it."""
        return asdict(self)


def two_way(
    t1_ns: Int64[np.ndarray, " n"],
    t2_ns: Int64[np.ndarray, " n"],
    t3_ns: Int64[np.ndarray, " n"],
    t4_ns: Int64[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Offset and delay of each exchange, in nanoseconds, for equal delays both ways.

    Args:
        t1_ns: The master sends, by its clock.
        t2_ns: The other receives, by its own clock.
        t3_ns: The other sends, by its own clock.
        t4_ns: The master receives, by its clock.
    """
    there, back = t2_ns - t1_ns, t4_ns - t3_ns
    return (there - back) / 2, (there + back) / 2


def summarised(log: ClockLog) -> ExchangeClock:
    """What a log of ``ptp4l`` or ``phc2sys`` says of its clock.

    Raises:
        ConfigError: If the servo was never locked.
    """
    rows = np.flatnonzero(log.locked)
    if not len(rows):
        raise ConfigError(f"{log.path}: expected a clock that was locked to its master, got {len(log)} rows before")
    offset = log.offset_ns[rows].astype(np.float64)
    median = float(np.median(offset))
    spread = median if log.summary else 1.4826 * float(np.median(np.abs(offset - median)))
    delay = _median(log.delay_ns[rows])
    freq = _median(log.freq_ppb[rows])
    return ExchangeClock(
        exchanges=len(rows),
        unlocked=len(log) - len(rows),
        offset_ns=None if log.summary else median,
        spread_ns=spread,
        worst_ns=float(np.abs(offset).max()),
        delay_ns=delay,
        asymmetry_limit_ns=None if delay is None else max(delay, 0.0),
        drift_ppm=None if freq is None else -freq / 1e3,
    )


def _median(values: Float[np.ndarray, " n"]) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None
