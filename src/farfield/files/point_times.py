"""When each point of a sweep was measured: columns of every number type and unit, as offsets in nanoseconds.

Drivers write seconds, milliseconds, microseconds or nanoseconds, since the sweep's stamp, since 1970 or since the full
hour, and the fields do not say which. The sweep's own period decides: the units lie a factor of 1000 apart, so a turn
of 100 ms fits one of them alone. What fits none is refused, and the unit can be given. Counters that begin anew within
a sweep, of 32 bits or at the full hour, are carried on.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float, Int64, Num

from farfield.errors import ConfigError, FileFormatError

PointTimes = Literal["auto", "s", "ms", "us", "ns", "none"]
"""Unit of the points' times: ``auto`` decides by the sweep's period, ``none`` leaves the column as it is."""
POINT_TIMES: tuple[PointTimes, ...] = get_args(PointTimes)
OFFSET_COLUMN = "offset_ns"
"""Column of a cloud: nanoseconds since the frame's time, int64."""

UNITS_NS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
_NAMES = (
    "t", "time", "times", "timestamp", "time_stamp", "timestamps", "stamp", "offset_time", "timeoffset", "time_offset",
    "point_time_offset", "point_time", "offset", "toffset", "t_offset", "curvature_time", "relative_time", "delta_time",
)  # fmt: skip
_SUFFIX = re.compile(r"_?(?P<unit>s|sec|secs|ms|msec|us|usec|ns|nsec)$")
_UNIT_OF_SUFFIX = {"sec": "s", "secs": "s", "msec": "ms", "usec": "us", "nsec": "ns"}
_LEAST_NS, _MOST_NS = 2e6, 5e8  # of sweeps whose period is not known: half a thousand apart
_LEAST_SHARE, _MOST_SHARE = 0.01, 3.0  # of a known period that the points' times span: sectors, and overlapping turns
_NEAR_NS = 1_000_000_000  # how far a point may lie from its sweep's stamp
_HOUR_NS = 3600 * 1_000_000_000
_STEPS, _FINE_NS = 20, 1_000_000  # steps of a number type are fine: so short, or so many in a sweep
_MANY = 100  # no sensor measures so many points in a thousandth of a sweep
_NO_TIME = 1e20  # beyond nanoseconds since 1970, by a thousand years
_EDGE = 0.1  # of a counter's range: where all points lie when it begins anew
_FIX = (
    "Say the unit with --point-times s, ms, us or ns, or none to leave the column as it is; in Python and experiments "
    "it is point_times=."
)


def check_point_times(unit: str) -> None:
    """Refuse what is no unit of points' times.

    Raises:
        ConfigError: If it is none of :data:`POINT_TIMES`.
    """
    if unit not in POINT_TIMES:
        raise ConfigError(f"point_times: expected one of {', '.join(POINT_TIMES)}, got {unit!r}")


def point_time_column(names: Iterable[str]) -> str | None:
    """The column that tells when each point was measured, or None.

    Several may be there, as Ouster's ``t`` beside a ``timestamp``: the one whose name has a unit is taken, else the
    first.

    >>> point_time_column(["x", "y", "z", "Timestamp"]), point_time_column(["x", "range"]), point_time_column(["t_us"])
    ('Timestamp', None, 't_us')
    """
    columns = [name for name in names if name.lower() in _NAMES or _named_unit(name) is not None]
    return min(columns, key=lambda name: (name != OFFSET_COLUMN, _named_unit(name) is None), default=None)


def _named_unit(name: str) -> str | None:
    """The unit that a column's name says: ``time_ns``, ``t_us``, ``offset_ns``."""
    suffix = _SUFFIX.search(name.lower())
    if suffix is None or name.lower() in _NAMES or name.lower()[: suffix.start()] not in _NAMES:  # times: a plural
        return None
    return _UNIT_OF_SUFFIX.get(suffix["unit"], suffix["unit"])


@dataclass(frozen=True)
class PointTimeColumn:
    """One cloud's column of times.

    Args:
        name: Its name in the file.
        values: The numbers, shape (n,).
        path: The file, for messages.
        stamp_ns: The sweep's time since 1970; None where it is not known.
        period_ns: From one sweep to the next; None where it is not known.
        usual_unit: What the other sweeps of the data set show; None where that is not known.
    """

    name: str
    values: Num[np.ndarray, " n"]
    path: Path | str
    stamp_ns: int | None = None
    period_ns: float | int | None = None
    usual_unit: str | None = None

    def are_times(self) -> bool:
        """Whether there can be times at all: memory that a writer never filled holds 1e300, which no unit makes one."""
        if self.values.dtype.kind != "f" or not len(self.values):
            return True
        finite = self.values[np.isfinite(self.values)]
        return float(np.abs(finite).max(initial=0.0)) < _NO_TIME

    def unit(self) -> str | None:
        """The unit in which the times span a sweep; None where they do not differ, or there are none.

        A few points need not span a sweep: they have the unit of the column's name, or of the other sweeps.

        Raises:
            FileFormatError: If no unit fits, or another than that of the column's name or of the other sweeps.
        """
        likely = _named_unit(self.name) or self.usual_unit
        if not len(self.values):
            return likely
        span = float(self._since_first().max(initial=0.0))
        if span == 0:
            return likely
        low, high = self._bounds_ns()
        fitting = [unit for unit, scale in UNITS_NS.items() if low < span * scale <= high]
        unit = fitting[0] if len(fitting) == 1 else None
        if likely is not None and span * UNITS_NS[likely] <= high and (not fitting or len(self.values) < _MANY):
            unit = likely
        if unit is None or likely not in (None, unit):
            carried_on = self._carried_on()
            if carried_on is not self:
                return carried_on.unit()
            period = "" if self.period_ns is None else f" of {self.period_ns / 1e6:.4g} ms"
            raise self._fault(
                f"times that span a sweep{period} in {likely or 's, ms, us or ns'}: {low / 1e6:.4g} to "
                f"{high / 1e6:.4g} ms",
                f"{self.values.dtype} from {self.values.min()} to {self.values.max()}, a span of {span:.6g}"
                + (f", which fits {', '.join(fitting)}" if fitting else ""),
            )
        self._check_steps(unit, span)
        return unit

    def offsets_ns(self, unit: str | None = None) -> Int64[np.ndarray, " n"]:
        """Nanoseconds of each point since the sweep's stamp; since its first point where no stamp is known.

        Args:
            unit: ``s``, ``ms``, ``us`` or ``ns``; None decides.

        Raises:
            FileFormatError: If the unit, or what the times count from, cannot be decided.
        """
        if not len(self.values):
            return np.zeros(0, dtype=np.int64)
        since_first, first = self._since_first(), self._first()
        chosen = unit or self.unit() or self._unit_of_one(first)
        if chosen is None:
            return np.zeros(len(self.values), dtype=np.int64)
        scale = UNITS_NS[chosen]
        if since_first.max() * scale > 2 * _NEAR_NS:
            carried_on = self._carried_on()
            if carried_on is not self:
                return carried_on.offsets_ns(chosen)
            raise self._fault(f"times within {2 * _NEAR_NS / 1e9:g} s", f"{since_first.max() * scale / 1e9:.6g} s")
        self._check_steps(chosen, float(since_first.max()))
        return np.rint(since_first * scale).astype(np.int64) + self._start_ns(first * scale)

    def _carried_on(self) -> "PointTimeColumn":
        """The column with its later part carried on, if a counter began anew within it; else itself."""
        moduli = [_HOUR_NS // scale for scale in UNITS_NS.values()]
        if self.values.dtype == np.uint32:
            moduli.append(1 << 32)
        least, largest = self.values.min(), self.values.max()
        for modulus in moduli:
            if least < 0 or not (1 - _EDGE) * modulus <= largest <= modulus:
                continue
            before = self.values > modulus / 2
            gap = (self.values > _EDGE * modulus) & (self.values < (1 - _EDGE) * modulus)
            if not before.all() and not gap.any():
                values = self.values.astype(np.int64 if self.values.dtype.kind in "iu" else np.float64)
                values[before] -= modulus
                return replace(self, values=values)
        return self

    def _start_ns(self, first_ns: Fraction) -> int:
        """The first point's time since the stamp: times count from the stamp, from 1970 or from the full hour."""
        if self.stamp_ns is None:
            return round(first_ns) if abs(first_ns) <= _NEAR_NS else 0
        candidates = [first_ns, first_ns - self.stamp_ns]
        if 0 < first_ns < _HOUR_NS:
            since_hour = first_ns - self.stamp_ns % _HOUR_NS
            candidates.append((since_hour + _HOUR_NS // 2) % _HOUR_NS - _HOUR_NS // 2)
        nearest = min(candidates, key=abs)
        if abs(nearest) <= _NEAR_NS:
            return round(nearest)
        raise self._fault(
            f"times within {_NEAR_NS / 1e9:g} s of 0, of the sweep's stamp {self.stamp_ns} ns or of its time since the "
            "full hour",
            f"a first point at {float(first_ns) / 1e9:.9g} s: another clock's",
        )

    def _unit_of_one(self, first: Fraction) -> str | None:
        """The unit of times that are all one: by the stamp that they repeat; None where they are 0 or there is none."""
        if first == 0:
            return None
        if self.values.dtype.kind == "f" and self.values.dtype.itemsize <= 4 and float(np.spacing(self.values[0])) >= 1:
            raise self._fault("times that tell points apart", f"{self.values.dtype}, {self.values[0]} for all")
        if self.stamp_ns is None:
            return None
        near = [unit for unit, scale in UNITS_NS.items() if abs(first * scale - self.stamp_ns) <= _NEAR_NS]
        if not near:
            raise self._fault(
                "times that differ from point to point, or the sweep's stamp", f"{self.values[0]} for all"
            )
        return near[0]

    def _first(self) -> Fraction:
        """The least time, exactly."""
        least = self.values.min()
        return Fraction(int(least)) if self.values.dtype.kind in "iu" else Fraction(float(least))

    @np.errstate(invalid="ignore", over="ignore")
    def _since_first(self) -> Float[np.ndarray, " n"]:
        """Times since the least of them, in the column's unit, without overflow of any number type."""
        if self.values.dtype.kind in "iu":
            wide = self.values.astype(np.int64 if self.values.dtype.kind == "i" else np.uint64).view(np.uint64)
            least = np.array(self.values.min()).astype(np.int64 if self.values.dtype.kind == "i" else np.uint64)
            with np.errstate(over="ignore"):  # the difference modulo 2^64 is the difference
                return (wide - least.view(np.uint64)).astype(np.float64)
        if not np.isfinite(self.values).all():
            raise self._fault("finite times", "some that are not")
        values = self.values.astype(np.float64)
        return values - values.min(initial=np.inf) if len(values) else values

    def _bounds_ns(self) -> tuple[float, float]:
        """Least and largest span of a sweep's times."""
        if self.period_ns is None or not _LEAST_NS < self.period_ns < _MOST_NS:  # keyframes tell no turn
            return _LEAST_NS, _MOST_NS
        return float(_LEAST_SHARE * self.period_ns), float(_MOST_SHARE * self.period_ns)

    def _check_steps(self, unit: str, span: float) -> None:
        """Refuse numbers whose steps are too wide, such as seconds since 1970 in float32: 128 s."""
        if self.values.dtype.kind != "f":
            return
        step_ns = float(np.spacing(np.abs(self.values).max())) * UNITS_NS[unit]
        if step_ns > max(_FINE_NS, span * UNITS_NS[unit] / _STEPS):
            raise self._fault(
                "times that tell points apart", f"{self.values.dtype} in steps of {step_ns / 1e9:.3g} s ({unit})"
            )

    def _fault(self, expected: str, actual: str) -> FileFormatError:
        return FileFormatError(
            self.path, where=f"the points' times, column {self.name!r}", expected=expected, got=actual, fix=_FIX
        )
