"""Structural edits of clouds with named columns, and structured npy files in an own folder, without our writers.

The meaning of an edit is that of docs/own-data.md, docs/timing.md and docs/checks.md. PCD files, which take the same
edits, are in ``_structures_pcd``, bags in ``_structures_bags``, files without names of columns in ``_structures_rows``.
"""

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _structures import Case, Family, Oracle, Reading, apart

import farfield as ff

STRENGTHS = ("intensity", "intensities", "i", "reflectivity", "reflectance", "remission", "signal")
TIMES = ("t", "time", "times", "timestamp", "time_stamp", "stamp", "offset_time", "time_offset", "point_time")
UNITS_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
NO_SCALE = r"(?s)\A(?!.*--intensity-scale)"
"""Of an error that a scale would not cure."""
_WEIGHT: dict[Oracle, int] = {"same": 0, "said": 1, "either": 2, "refused": 3}


@dataclass
class Sweeps:
    """Some sweeps of one sensor: the columns of each file, and what has to come out.

    Args:
        columns: What is written, by column, of each sweep.
        points: Places, shape (n, 3), of each.
        strength: Intensities in [0, 1] of each; None: 0, or none in a bag.
        valid: Which rows are points, of each.
        stamps_ns: Time of each sweep since 1970; None where files have numbers for names.
        extra: What else has to come out, by column, of each.
        absent: Columns that must not come out.
        time_ns: How exact times of points have to be.
    """

    columns: list[dict[str, np.ndarray]]
    points: list[np.ndarray]
    strength: list[np.ndarray] | None
    valid: list[np.ndarray]
    stamps_ns: list[int] | None
    extra: list[dict[str, np.ndarray]]
    absent: list[str] = field(default_factory=list)
    edits: list[str] = field(default_factory=list)
    oracle: Oracle = "same"
    words: str = ""
    options: dict[str, Any] = field(default_factory=dict)
    layout: dict[str, Any] = field(default_factory=dict)
    time_ns: float = 2.0

    def edit(self, words: str, oracle: Oracle = "same", answer: str = "") -> None:
        """Say what was changed and what has to come of it."""
        self.edits.append(words)
        if _WEIGHT[oracle] > _WEIGHT[self.oracle]:
            self.oracle, self.words = oracle, answer
        elif oracle in (self.oracle, "either"):
            self.words = "" if answer != self.words else answer  # either of two errors may come first

    @property
    def one(self) -> int:
        """The sweep that a single edit goes to: the last with points, which decides nothing alone."""
        return max(row for row, valid in enumerate(self.valid) if valid.any())

    def name(self, candidates: Sequence[str]) -> str:
        """The first column of these names, whatever its case."""
        return next(name for name in self.columns[0] if name.lower() in candidates)


def make_sweeps(random: np.random.Generator, *, points: int | None = None) -> Sweeps:
    """Three sweeps ahead of a sensor, 100 ms or so apart, brightest 1."""
    count, period_ns = points or int(random.integers(100, 200)), int(random.choice([50, 100, 200])) * 10**6
    start_ns = int(random.integers(1_600_000_000, 1_750_000_000)) * 10**9 + int(random.integers(0, 10**6)) * 1000
    made = Sweeps([], [], [], [], [start_ns + step * period_ns for step in range(3)], [])
    for _ in range(3):
        low, high = (2.0, -40.0, -2.5), (80.0, 40.0, 1.5)
        places = np.round(random.uniform(low, high, (count, 3)), 3).astype(np.float32)
        strength = np.round(random.uniform(0, 1, count), 3).astype(np.float32)
        strength[0] = 1
        x, y, z = places.T
        made.columns.append({"x": x, "y": y, "z": z, "intensity": strength})
        made.points.append(places)
        made.strength.append(strength)  # type: ignore[union-attr]
        made.valid.append(np.full(count, True))
        made.extra.append({})
    return made


Edit = Callable[[np.random.Generator, Sweeps], None]


def other_places(random: np.random.Generator, sweeps: Sweeps) -> None:
    """x, y and z of another number type."""
    kind = str(random.choice(["f8", "f8", "i2", "i4", "i8"]))
    for columns, points in zip(sweeps.columns, sweeps.points, strict=True):
        places = np.rint(points) if kind[0] == "i" else points
        places[(places == 0).all(axis=1)] = 1
        points[:] = places
        columns |= {axis: places[:, row].astype(kind) for row, axis in enumerate("xyz")}
    sweeps.edit(f"places as {kind}")


def mixed_places(random: np.random.Generator, sweeps: Sweeps) -> None:
    """One axis in double precision."""
    axis = str(random.choice([*"xyz"]))
    for columns in sweeps.columns:
        columns[axis] = columns[axis].astype("f8")
    sweeps.edit(f"{axis} alone as f8")


def missing_returns(random: np.random.Generator, sweeps: Sweeps) -> None:
    """Rows of 0, 0, 0 or with a NaN."""
    kind = str(random.choice(["0 0 0", "-0 0 -0", "NaN NaN NaN", "NaN in one axis"]))
    if kind.startswith("NaN") and sweeps.columns[0]["x"].dtype.kind == "i":
        kind = "0 0 0"
    for columns, points, valid in zip(sweeps.columns, sweeps.points, sweeps.valid, strict=True):
        rows = 1 + random.choice(len(points) - 1, int(random.integers(1, len(points) // 3)), replace=False)
        value = {"0": 0.0, "-": -0.0, "N": np.nan}[kind[0]]
        for axis in [str(random.choice([*"xyz"]))] if kind == "NaN in one axis" else "xyz":
            changed = columns[axis].copy()
            changed[rows] = value
            columns[axis] = changed
        valid[rows] = False
        del points
    sweeps.edit(f"directions without return: {kind}")


def infinite_place(random: np.random.Generator, sweeps: Sweeps) -> None:
    """A coordinate that is infinite."""
    if sweeps.columns[0]["x"].dtype.kind == "i":
        return
    _put(random, sweeps, str(random.choice([*"xyz"])), float(random.choice([np.inf, -np.inf])))
    sweeps.edit("an infinite coordinate", "refused")


def on_a_map(random: np.random.Generator, sweeps: Sweeps) -> None:
    """Coordinates of a map."""
    east, north = random.uniform(3e5, 7e5), random.uniform(4e6, 6e6)
    for columns in sweeps.columns:
        columns |= {"x": columns["x"].astype("f8") + east, "y": columns["y"].astype("f8") + north}
    sweeps.edit("UTM coordinates", "refused", "map")


def named_strength(random: np.random.Generator, sweeps: Sweeps) -> None:
    """The intensity under another of its names."""
    name = str(random.choice(STRENGTHS))
    name = str(random.choice([name, name.upper(), name.capitalize()]))
    if name in {"intensity"} & {*sweeps.columns[0]}:
        return
    for row, columns in enumerate(sweeps.columns):
        sweeps.columns[row] = {name if key == "intensity" else key: values for key, values in columns.items()}
    sweeps.edit(f"intensity called {name}")


def scaled_strength(random: np.random.Generator, sweeps: Sweeps) -> None:
    """Intensities up to 255 or 65535, as integers or floating point."""
    scale, kind = [(255, "u1"), (255, "f4"), (255, "u2"), (255, "f8"), (65535, "u2"), (65535, "f4"), (65535, "i4")][
        random.integers(7)
    ]
    _set_strength(sweeps, scale, kind)
    sweeps.edit(f"intensity to {scale} as {kind}")


def own_scale(random: np.random.Generator, sweeps: Sweeps) -> None:
    """Intensities up to a full scale that is said."""
    scale = int(random.choice([100, 128, 1000, 1023, 4095]))
    _set_strength(sweeps, scale, str(random.choice(["u2", "f4", "f8"])))
    sweeps.options["intensity_scale"] = scale
    sweeps.edit(f"intensity to {scale} and --intensity-scale")


def _set_strength(sweeps: Sweeps, scale: int, kind: str) -> None:
    name = sweeps.name(STRENGTHS)
    for row, columns in enumerate(sweeps.columns):
        values = columns[name].astype(np.float64) * scale
        values = (values if kind[0] == "f" else np.rint(values)).astype(kind)
        columns[name] = values
        sweeps.strength[row] = (values.astype(np.float64) / scale).astype(np.float32)  # type: ignore[index]


def bad_strength(random: np.random.Generator, sweeps: Sweeps) -> None:
    """One intensity that is not finite, or negative."""
    kind, value = [("NaN", np.nan), ("infinite", np.inf), ("negative", -0.5)][random.integers(3)]
    _put(random, sweeps, sweeps.name(STRENGTHS), value)
    sweeps.edit(f"one intensity {kind}", "refused", NO_SCALE)


def bright_strength(random: np.random.Generator, sweeps: Sweeps) -> None:
    """One intensity beyond the scale of all others."""
    _put(random, sweeps, sweeps.name(STRENGTHS), 3.0)
    sweeps.edit("one intensity of 3, others to 1", "refused", "--intensity-scale 3")


def bright_strength_overruled(random: np.random.Generator, sweeps: Sweeps) -> None:
    """The same, with the flag that the error advises."""
    _put(random, sweeps, sweeps.name(STRENGTHS), 3.0)
    name = sweeps.name(STRENGTHS)
    sweeps.strength = [columns[name].astype(np.float32) / np.float32(3) for columns in sweeps.columns]
    sweeps.options["intensity_scale"] = 3
    sweeps.edit("one intensity of 3 and --intensity-scale 3")


def no_strength(random: np.random.Generator, sweeps: Sweeps) -> None:
    """No intensity at all."""
    del random
    name = sweeps.name(STRENGTHS)
    for columns in sweeps.columns:
        del columns[name]
    sweeps.strength = None
    sweeps.edit("column intensity dropped")


def _put(random: np.random.Generator, sweeps: Sweeps, name: str, value: float) -> None:
    """Put one value into a column of the last sweep, at a row that is a point."""
    columns = sweeps.columns[sweeps.one]
    rows = np.flatnonzero(sweeps.valid[sweeps.one])
    changed = columns[name].astype(columns[name].dtype if columns[name].dtype.kind == "f" else "f4")
    changed[int(random.choice(rows[1:]))] = value
    columns[name] = changed


def no_place(random: np.random.Generator, sweeps: Sweeps) -> None:
    """One axis is not there, or has another name."""
    axis = str(random.choice([*"xyz"]))
    name = random.choice(["", f"pos_{axis}", f"{axis}_m"])
    for row, columns in enumerate(sweeps.columns):
        sweeps.columns[row] = {str(name) if key == axis else key: values for key, values in columns.items()}
        sweeps.columns[row].pop("", None)
    sweeps.edit(f"column {axis} {f'called {name}' if name else 'dropped'}", "refused", axis)


def reordered(random: np.random.Generator, sweeps: Sweeps) -> None:
    """Columns in another order."""
    order = random.permutation(len(sweeps.columns[0]))
    for row, columns in enumerate(sweeps.columns):
        items = [*columns.items()]
        sweeps.columns[row] = dict(items[index] for index in order)
    sweeps.edit("columns reordered")


def capital_places(random: np.random.Generator, sweeps: Sweeps) -> None:
    """X, Y, Z."""
    del random
    for row, columns in enumerate(sweeps.columns):
        sweeps.columns[row] = {key.upper() if key in "xyz" else key: values for key, values in columns.items()}
    sweeps.edit("X, Y, Z")


def further_columns(random: np.random.Generator, sweeps: Sweeps) -> None:
    """Columns that stay as they are."""
    name, kind = [("ring", "u2"), ("ring", "u1"), ("line", "i4"), ("range", "f8"), ("ambient", "u4"), ("id", "i8")][
        random.integers(6)
    ]
    for row, columns in enumerate(sweeps.columns):
        values = random.integers(0, 100, len(sweeps.points[row])).astype(kind)
        sweeps.columns[row] = {name: values, **columns} if random.random() < 0.3 else {**columns, name: values}
        sweeps.extra[row][name] = values
    sweeps.edit(f"column {name} as {kind} added")


def counted_column(random: np.random.Generator, sweeps: Sweeps) -> None:
    """A field of several numbers a point."""
    count, kind = int(random.integers(2, 5)), str(random.choice(["f4", "u1", "f8", "i2"]))
    for row, columns in enumerate(sweeps.columns):
        values = random.integers(0, 100, (len(sweeps.points[row]), count)).astype(kind)
        columns["normal"] = values
        sweeps.extra[row] |= {f"normal_{element}": values[:, element] for element in range(count)}
    sweeps.edit(f"normal of COUNT {count} as {kind}")


def counted_place(random: np.random.Generator, sweeps: Sweeps) -> None:
    """A place or the intensity of several numbers a point."""
    names = [*"xyz", *(name for name in sweeps.columns[0] if name.lower() in STRENGTHS)]
    name = names[random.integers(len(names))]
    for columns in sweeps.columns:
        columns[name] = np.repeat(columns[name][:, None], 2, axis=1)
    sweeps.edit(f"{'place' if name in 'xyz' else 'intensity'} of COUNT 2", "refused")


def point_times(random: np.random.Generator, sweeps: Sweeps) -> None:
    """Times of points in a unit and number type that drivers write, since the stamp or since 1970."""
    since, unit, kind = [
        ("stamp", "s", "f4"), ("stamp", "s", "f8"), ("stamp", "ms", "f4"), ("stamp", "us", "f4"), ("stamp", "us", "u4"),
        ("stamp", "us", "i4"), ("stamp", "ns", "u4"), ("stamp", "ns", "i8"), ("stamp", "ns", "f4"),
        ("stamp", "ns", "f8"), ("1970", "s", "f8"), ("1970", "us", "u8"), ("1970", "us", "f8"), ("1970", "ns", "u8"),
        ("1970", "ns", "i8"), ("hour", "us", "u4"), ("hour", "ns", "i8"), ("hour", "s", "f8"),
    ][random.integers(18)]  # fmt: skip
    late = random.random() < 0.3  # stamped at the end: times run up to 0
    if late and kind[0] == "u" and since == "stamp":
        late = False
    _add_times(random, sweeps, since, unit, kind, late=late)
    sweeps.edit(f"times since {since} in {unit} as {kind}{', before the stamp' if late else ''}")


def _add_times(
    random: np.random.Generator,
    sweeps: Sweeps,
    since: str,
    unit: str,
    kind: str,
    *,
    late: bool = False,
    name: str | None = None,
) -> None:
    """Write a column of times, and expect ``offset_ns`` of what was written."""
    stamps = sweeps.stamps_ns
    name = name or str(random.choice([*TIMES, f"t_{unit}", f"time_{unit}", f"offset_{unit}"]))
    if stamps is None or len(sweeps.columns) < 2:
        return
    period_ns = stamps[1] - stamps[0]
    for row, columns in enumerate(sweeps.columns):
        count = len(sweeps.points[row])
        offsets = np.sort(random.integers(0, int(period_ns * 0.97) // 1000, count)) * 1000
        offsets[[0, -1]] = 0, int(period_ns * 0.97) // 1000 * 1000
        valid = sweeps.valid[row]
        if late:
            offsets -= period_ns
        origin = {"stamp": 0, "1970": stamps[row], "hour": stamps[row] % (3600 * 10**9)}[since]
        whole = (offsets + origin).astype(np.int64)
        if since == "hour":
            whole %= 3600 * 10**9
        stored = _stored(whole, unit, kind)
        columns[name] = stored
        back = _back(stored, unit)
        expected = back - origin
        if since == "hour":
            expected = (expected + 1800 * 10**9) % (3600 * 10**9) - 1800 * 10**9
        sweeps.extra[row]["offset_ns"] = expected
        del valid
    if name != "offset_ns":
        sweeps.absent.append(name)


def _stored(whole_ns: np.ndarray, unit: str, kind: str) -> np.ndarray:
    if kind[0] == "f":
        seconds = whole_ns // UNITS_NS[unit]
        return (seconds + (whole_ns - seconds * UNITS_NS[unit]) / UNITS_NS[unit]).astype(kind)
    return (whole_ns // UNITS_NS[unit]).astype(kind)


def _back(stored: np.ndarray, unit: str) -> np.ndarray:
    if stored.dtype.kind == "f":
        wide = stored.astype(np.longdouble) * UNITS_NS[unit]
        return np.rint(wide).astype(np.int64)
    return stored.astype(np.int64) * UNITS_NS[unit]


def coarse_times(random: np.random.Generator, sweeps: Sweeps) -> None:
    """Seconds since 1970 in float32: steps of 128 s."""
    _add_times(random, sweeps, "1970", str(random.choice(["s", "us", "ns"])), "f4")
    sweeps.edit("times since 1970 as f4", "refused", "point-times")


def other_clock(random: np.random.Generator, sweeps: Sweeps) -> None:
    """Times of another clock than the stamp's."""
    stamps = sweeps.stamps_ns or [0]
    shift = int(random.integers(10, 10**6)) * 10**9
    sweeps.stamps_ns = [stamp + shift for stamp in stamps]
    _add_times(random, sweeps, "1970", str(random.choice(["ns", "us"])), "i8")
    sweeps.stamps_ns = stamps
    sweeps.edit("times since 1970 of another clock", "refused", "point-times")


def wrong_unit_in_name(random: np.random.Generator, sweeps: Sweeps) -> None:
    """A name that says another unit than the numbers."""
    named, unit, kind = [("us", "ns", "u4"), ("ms", "us", "u4"), ("ns", "us", "i8"), ("ns", "s", "f8")][
        random.integers(4)
    ]
    _add_times(random, sweeps, "stamp", unit, kind, name=f"t_{named}")
    sweeps.edit(f"times in {unit} called t_{named}", "refused", "point-times")


def said_unit(random: np.random.Generator, sweeps: Sweeps) -> None:
    """The unit that the flag says, against the column's name."""
    named, unit, kind = [("us", "ns", "u4"), ("ms", "us", "u4"), ("ns", "us", "i8"), ("ns", "s", "f8")][
        random.integers(4)
    ]
    _add_times(random, sweeps, "stamp", unit, kind, name=f"t_{named}")
    sweeps.options["point_times"] = unit
    sweeps.edit(f"times in {unit} called t_{named} and --point-times {unit}")


def unread_times(random: np.random.Generator, sweeps: Sweeps) -> None:
    """A column of times that is left as it is."""
    _add_times(random, sweeps, "1970", str(random.choice(["ns", "us"])), "i8", name="stamp")
    for columns, extra in zip(sweeps.columns, sweeps.extra, strict=True):
        if "stamp" in columns:
            extra.pop("offset_ns")
            extra["stamp"] = columns["stamp"]
    sweeps.absent[:] = ["offset_ns"]
    sweeps.options["point_times"] = "none"
    sweeps.edit("times and --point-times none")


def bad_time(random: np.random.Generator, sweeps: Sweeps) -> None:
    """A time that is not finite."""
    _add_times(random, sweeps, "stamp", "s", "f8", name="time")
    _put(random, sweeps, "time", float(random.choice([np.nan, np.inf])))
    sweeps.edit("one time not finite", "refused", "point-times")


def one_point(random: np.random.Generator, sweeps: Sweeps) -> None:
    """Sweeps of one point."""
    del random
    for row, columns in enumerate(sweeps.columns):
        sweeps.columns[row] = {name: values[:1] for name, values in columns.items()}
        sweeps.points[row] = sweeps.points[row][:1]
        sweeps.valid[row] = sweeps.valid[row][:1]
    if sweeps.strength is not None:
        sweeps.strength = [strength[:1] for strength in sweeps.strength]
    sweeps.edit("one point")


def empty_sweep(random: np.random.Generator, sweeps: Sweeps) -> None:
    """One sweep without any point."""
    del random
    row = len(sweeps.columns) - 1
    sweeps.columns[row] = {name: values[:0] for name, values in sweeps.columns[row].items()}
    sweeps.points[row], sweeps.valid[row] = sweeps.points[row][:0], sweeps.valid[row][:0]
    if sweeps.strength is not None:
        sweeps.strength[row] = sweeps.strength[row][:0]
    sweeps.edit("a sweep without points")


def nothing_returned(random: np.random.Generator, sweeps: Sweeps) -> None:
    """One sweep in which nothing returned."""
    row, value = len(sweeps.columns) - 1, float(random.choice([0.0, np.nan]))
    if sweeps.columns[row]["x"].dtype.kind == "i":
        value = 0.0
    for axis in "xyz":
        sweeps.columns[row][axis] = np.full_like(sweeps.columns[row][axis], value)
    sweeps.valid[row][:] = False
    sweeps.edit("a sweep in which nothing returned")


def numbered(random: np.random.Generator, sweeps: Sweeps) -> None:
    """Names of files that are no times: times count from the first point where they are since 1970."""
    del random
    sweeps.stamps_ns = None
    sweeps.edit("files named by numbers")


GROUPS: dict[str, tuple[Edit, ...]] = {
    "places": (other_places, other_places, mixed_places),
    "missing": (missing_returns, missing_returns, missing_returns, infinite_place, on_a_map, nothing_returned),
    "strength": (
        *(scaled_strength, scaled_strength, own_scale, bad_strength, bright_strength, bright_strength_overruled),
        no_strength,
    ),
    "times": (
        *(point_times, point_times, point_times, point_times, coarse_times, other_clock, wrong_unit_in_name),
        *(said_unit, unread_times, bad_time),
    ),
    "name": (named_strength, named_strength),
    "columns": (further_columns, further_columns, counted_column, counted_place, no_place),
    "order": (reordered, capital_places),
    "size": (one_point, empty_sweep),
}
"""Edits of two groups go together, in this order."""
_UNFIT = [{"size", "missing"}, {"size", "times"}, {"size", "strength"}]
"""Groups that do not: one point spans no sweep and has no share of missing ones."""
_AFTER_NAME = {"order": 9, "columns": 8, "name": 7}


def chosen_edits(random: np.random.Generator, groups: Mapping[str, Sequence[Edit]] = GROUPS) -> list[Edit]:
    """One or two edits of different groups, renaming last."""
    names = [str(name) for name in random.choice([*groups], int(random.integers(1, 3)), replace=False)]
    if {*names} in _UNFIT:
        names = names[:1]
    names.sort(key=lambda name: (_AFTER_NAME.get(name, 0), [*groups].index(name)))
    return [groups[name][random.integers(len(groups[name]))] for name in names]


def differences(sweeps: Sweeps, clouds: Mapping[str, Any], names: Sequence[str]) -> str:
    """What of the clouds is not as it has to be."""
    if [*clouds] != [*names]:
        return f"frames {[*clouds]} in place of {[*names]}"
    for row, cloud in enumerate(clouds.values()):
        valid = sweeps.valid[row]
        expected = np.zeros(len(valid)) if sweeps.strength is None else sweeps.strength[row]
        strength = np.zeros(len(cloud)) if cloud.intensity is None and sweeps.strength is None else cloud.intensity
        wrong = (
            apart("missing", cloud.missing, int((~valid).sum()))
            or apart("points", cloud.points_m, sweeps.points[row][valid], tolerance=1e-4)
            or apart("intensity", strength, expected[valid], tolerance=2e-6)
        )
        for name, values in sweeps.extra[row].items():
            if name not in cloud.extra:
                return wrong or f"no column {name}"
            exact = {"tolerance": sweeps.time_ns, "relative": 0.0} if name == "offset_ns" else {}
            wrong = wrong or apart(name, cloud.extra[name], values[valid], **exact)
        unread = [name for name in sweeps.absent if name in cloud.extra]
        if wrong or unread:
            return wrong or f"column {unread[0]} is left unread"
    return ""


def read_folder(folder: Path, options: Mapping[str, Any]) -> Reading:
    """The clouds of a folder by frame."""
    return Reading({frame.frame_id: frame.cloud() for frame in ff.open_dataset(folder, **options)})


def stems(sweeps: Sweeps) -> list[str]:
    """Names of the files: their times, or numbers."""
    if sweeps.stamps_ns is None:
        return [f"{row:04d}" for row in range(len(sweeps.columns))]
    return [str(stamp) for stamp in sweeps.stamps_ns]


def case_of(sweeps: Sweeps, folder: Path) -> Case:
    """The case of sweeps that stand in a folder."""
    reader, difference = partial(read_folder, folder, sweeps.options), partial(differences, sweeps, names=stems(sweeps))
    return Case(tuple(sweeps.edits), sweeps.oracle, reader, difference, sweeps.words)


# Structured arrays.


def npy(random: np.random.Generator, folder: Path) -> Case:
    """Sweeps as structured arrays."""
    sweeps = make_sweeps(random)
    for edit in chosen_edits(random):
        edit(random, sweeps)
    how = str(random.choice(["", "", "", "big-endian", "padded", "organised", ".NPY", "version 2", "cut", "longer"]))
    if how == "organised" and any(len(points) % 2 for points in sweeps.points):
        how = ""
    for stem, columns in zip(stems(sweeps), sweeps.columns, strict=True):
        data = _npy_bytes(columns, how)
        (folder / f"{stem}{'.NPY' if how == '.NPY' else '.npy'}").write_bytes(data)
    if how:
        empty = any(not len(points) for points in sweeps.points)
        sweeps.edit(how, "refused" if how == "longer" or (how == "cut" and not empty) else "same")
    if how == "cut" and sweeps.oracle != "refused":
        sweeps.oracle = "refused"
    return case_of(sweeps, folder)


def _npy_bytes(columns: Mapping[str, np.ndarray], how: str) -> bytes:
    order = ">" if how == "big-endian" else "<"
    fields = [(name, values.dtype.newbyteorder(order), values.shape[1:]) for name, values in columns.items()]
    table = np.zeros(len(next(iter(columns.values()))), np.dtype(fields, align=how == "padded"))
    for name, values in columns.items():
        table[name] = values
    if how == "organised":
        table = table.reshape(2, -1)
    handle = io.BytesIO()
    np.lib.format.write_array(handle, table, version=(2, 0) if how == "version 2" else (1, 0))
    data = handle.getvalue()
    if how == "cut":
        return data[:-3]
    return data + data[-table.dtype.itemsize :] if how == "longer" else data


FAMILIES = (Family("npy structured", npy, 10),)
