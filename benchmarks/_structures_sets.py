"""Structural edits of the sensors' files of data sets: radars' and LiDARs' points as each set documents them."""

import importlib.util
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _structures import Case, Family, Oracle, Reading, apart

import farfield as ff
from farfield.datasets.radiate import RADAR_T_LIDAR_M, lidar_cloud


@dataclass
class Rows:
    """One cloud as a table: its columns by the set's names, which rows are points, and what has to come out.

    Args:
        columns: What is written.
        valid: Which rows are points.
        known: What has to come out by our names; ``points`` and perhaps ``intensity``, further columns.
    """

    columns: dict[str, np.ndarray]
    valid: np.ndarray
    known: Callable[["Rows"], Mapping[str, np.ndarray]]
    edits: list[str] = field(default_factory=list)
    oracle: Oracle = "same"

    def edit(self, words: str, oracle: Oracle = "same") -> None:
        """Say what was changed and what has to come of it."""
        self.edits.append(words)
        if ["same", "said", "either", "refused"].index(oracle) > ["same", "said", "either", "refused"].index(
            self.oracle
        ):
            self.oracle = oracle


def made(random: np.random.Generator, ranges: Mapping[str, tuple[float, float]], count: int | None = None) -> Any:
    """Columns of random numbers, three digits each; names that end in # hold whole numbers."""
    number = count or int(random.integers(30, 120))
    columns = {}
    for name, (low, high) in ranges.items():
        values = np.round(random.uniform(low, high, number), 3)
        columns[name.rstrip("#")] = np.floor(values) if name.endswith("#") else values
    return columns, np.full(number, True)


def no_returns(random: np.random.Generator, rows: Rows) -> None:
    """Rows of 0, 0, 0."""
    chosen = random.choice(len(rows.valid), int(random.integers(1, len(rows.valid) // 3)), replace=False)
    for name in [*rows.columns][:3]:
        rows.columns[name][chosen] = 0
    rows.valid[chosen] = False
    rows.edit("rows of 0, 0, 0")


def nan_returns(random: np.random.Generator, rows: Rows) -> None:
    """Rows whose place is NaN."""
    no_returns(random, rows)
    for name in [*rows.columns][:3]:
        rows.columns[name][~rows.valid] = np.nan
    rows.edits[-1] = "rows of NaN"


def bad_number(random: np.random.Generator, rows: Rows) -> None:
    """A number of a point that is not finite, in one of the further columns."""
    names = [*rows.columns][3:]
    name = names[random.integers(len(names))]
    value = float(random.choice([np.nan, np.inf, -np.inf]))
    rows.columns[name][int(random.choice(np.flatnonzero(rows.valid)))] = value
    rows.edit(f"{name} {value}", "refused")


def infinite_place(random: np.random.Generator, rows: Rows) -> None:
    """An infinite coordinate."""
    rows.columns[[*rows.columns][random.integers(3)]][int(random.choice(np.flatnonzero(rows.valid)))] = np.inf
    rows.edit("an infinite coordinate", "refused")


def far_place(random: np.random.Generator, rows: Rows) -> None:
    """Coordinates of a map."""
    first, second = [*rows.columns][:2]
    rows.columns[first] = rows.columns[first] + 5e5
    rows.columns[second] = rows.columns[second] + 5.4e6
    del random
    rows.edit("UTM coordinates", "refused")


def differ(rows: Rows, cloud: Any) -> str:
    """What of a cloud is not as it has to be."""
    wrong = apart("missing", cloud.missing, int((~rows.valid).sum()))
    for name, values in rows.known(rows).items():
        actual = {"points": cloud.points_m, "intensity": cloud.intensity}.get(name, cloud.extra.get(name))
        if actual is None:
            return wrong or f"no {name}"
        tolerance = 2.0 if name == "offset_ns" else 2e-3
        wrong = wrong or apart(name, actual, values[rows.valid], tolerance=tolerance, relative=2e-6)
    return wrong


def case(rows: Rows, read: Callable[[], Any]) -> Case:
    """The case of one cloud."""
    return Case(tuple(rows.edits), rows.oracle, lambda: Reading(read()), partial(differ, rows))


def cloud_of(folder: Path, name: str, **options: Any) -> Any:
    """A cloud of the first frame of a folder."""
    return ff.open_dataset(folder, **options)[0].clouds[name]


def points_of(rows: Rows, names: Sequence[str]) -> np.ndarray:
    """Some columns side by side."""
    return np.column_stack([rows.columns[name] for name in names])


# Text with a header: Astyx HiRes2019.


def _text_table(rows: Rows, how: str, digits: str = "%.6g") -> bytes:
    lines = [
        " ".join(rows.columns),
        *(" ".join(digits % value for value in line) for line in zip(*rows.columns.values(), strict=True)),
    ]
    if how == "an empty line above":
        lines.insert(0, "")
    if how == "no header":
        lines = lines[1:]
    if how == "a short line":
        lines[-1] = lines[-1].rsplit(" ", 1)[0]
    if how == "header alone":
        lines = lines[:1]
    if how == "blank line within":
        lines.insert(5, "")
    if how == "decimal commas":
        lines = [lines[0], *(line.replace(".", ",") for line in lines[1:])]
    return (("\r\n" if how == "CR LF" else "\n").join(lines) + "\n").encode()


def _edit_columns(random: np.random.Generator, rows: Rows) -> None:
    """A column dropped, renamed, doubled or exchanged."""
    names = [*rows.columns]
    kind = str(random.choice(["dropped", "renamed", "reordered"]))
    index = int(random.integers(len(names)))
    if kind == "dropped":
        del rows.columns[names[index]]
    elif kind == "renamed":
        rows.columns = {("Other" if name == names[index] else name): values for name, values in rows.columns.items()}
    else:
        order = [*names[1:], names[0]]
        rows.columns = {name: rows.columns[name] for name in order}
    rows.edit(f"column {kind}", "refused" if kind != "reordered" else "either")


TEXT_EDITS: tuple[tuple[str, Oracle], ...] = (
    *(("an empty line above", "same"), ("CR LF", "same"), ("no header", "refused"), ("a short line", "refused")),
    *(("header alone", "refused"), ("blank line within", "refused"), ("decimal commas", "refused")),
)


def astyx_radar(random: np.random.Generator, folder: Path) -> Case:
    """Astyx' radar: X Y Z V_r Mag."""
    columns, valid = made(random, {"X": (1, 90), "Y": (-40, 40), "Z": (-2, 3), "V_r": (-20, 20), "Mag": (40, 90)})
    rows = Rows(columns, valid, _astyx_radar)
    how = _edited(random, rows, (no_returns, bad_number, infinite_place, far_place, nan_refused))
    (folder / "radar_6455").mkdir()
    (folder / "radar_6455" / f"000001{'.TXT' if random.random() < 0.2 else '.txt'}").write_bytes(
        _text_table(rows, how, "%.9g")
    )
    return case(rows, partial(cloud_of, folder, "radar"))


def _edited(
    random: np.random.Generator, rows: Rows, edits: Sequence[Callable[[np.random.Generator, Rows], None]]
) -> str:
    """One edit of the numbers, then perhaps one of the columns or of the text."""
    if random.random() < 0.7:
        edits[random.integers(len(edits))](random, rows)
    if random.random() < 0.2:
        _edit_columns(random, rows)
        return ""
    how, oracle = TEXT_EDITS[random.integers(len(TEXT_EDITS))] if random.random() < 0.6 else ("", "same")
    if how:
        rows.edit(how, oracle)
    return how


def nan_refused(random: np.random.Generator, rows: Rows) -> None:
    """NaN where a radar has no return: left out and counted, or refused."""
    nan_returns(random, rows)
    rows.oracle = "either"


def _astyx_radar(rows: Rows) -> Mapping[str, np.ndarray]:
    speed = rows.columns["V_r"]
    return {
        "points": points_of(rows, "XYZ"),
        "v_r_m_s": speed,
        "doppler_m_s": speed,
        "magnitude_db": rows.columns["Mag"],
    }


ASTYX_LIDAR = {"X": (1, 90), "Y": (-40, 40), "Z": (-2, 3), "Reflectivity#": (0, 256), "LaserID#": (0, 16)}


def astyx_lidar(random: np.random.Generator, folder: Path) -> Case:
    """Astyx' VLP-16: X Y Z Reflectivity LaserID Timestamp (microseconds of the hour)."""
    columns, valid = made(random, ASTYX_LIDAR)
    start_us = int(random.choice([random.integers(0, 3_500_000_000), 3_600_000_000 - 40_000]))
    late_us = np.linspace(0, 99_000, len(valid)).round()
    columns["Timestamp"] = (start_us + late_us) % 3_600_000_000
    rows = Rows(columns, valid, partial(_astyx_lidar, late_us))
    if start_us > 3_599_000_000:
        rows.edit("over the full hour")
    how = _edited(random, rows, (no_returns, bad_number, infinite_place, far_place, beyond_255, nan_refused))
    for name in ("radar_6455", "lidar_vlp16", "calibration"):
        (folder / name).mkdir()
    (folder / "radar_6455" / "000001.txt").write_text("X Y Z V_r Mag\n1 2 3 4 5\n")
    (folder / "lidar_vlp16" / "000001.txt").write_bytes(_text_table(rows, how, "%.12g"))
    poses = [[1, 0, 0, 2], [0, 1, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 1]]
    sensor = f'{{"sensor_uid": "lidar_vlp16", "calib_data": {{"T_to_ref_COS": {poses}}}}}'
    (folder / "calibration" / "000001.json").write_text(f'{{"sensors": [{sensor}]}}')
    return case(rows, partial(cloud_of, folder, "lidar"))


def beyond_255(random: np.random.Generator, rows: Rows) -> None:
    """A reflectivity that one byte does not hold."""
    name = [*rows.columns][3]
    rows.columns[name][int(random.choice(np.flatnonzero(rows.valid)))] = float(random.choice([-1, 300, 4000]))
    rows.edit(f"{name} out of 0 to 255", "refused")


def _astyx_lidar(late_us: np.ndarray, rows: Rows) -> Mapping[str, np.ndarray]:
    first = late_us[rows.valid].min() if rows.valid.any() else 0
    return {
        "points": points_of(rows, "XYZ") + np.array([2, 0, 0.5]),
        "intensity": rows.columns["Reflectivity"] / 255,
        "ring": rows.columns["LaserID"],
        "time_us": rows.columns["Timestamp"],
        "offset_ns": (late_us - first) * 1000,
    }


# float32 without a header: View-of-Delft (7 columns), TJ4DRadSet (8).

DELFT = {
    "x": (1, 60),
    "y": (-30, 30),
    "z": (-2, 3),
    "rcs": (-30, 20),
    "v_r": (-15, 15),
    "v_c": (-15, 15),
    "time#": (-4, 1),
}
TJ4D = {
    "x": (1, 60),
    "y": (-30, 30),
    "z": (-2, 3),
    "v_r": (-15, 15),
    "range": (1, 80),
    "power": (5, 60),
    "az": (-60, 60),
    "el": (-20, 20),
}


def binary_radar(name: str, random: np.random.Generator, folder: Path) -> Case:
    """A radar's float32 rows."""
    columns, valid = made(random, DELFT if name == "delft" else TJ4D, int(random.integers(10, 100)) * 4)
    if name == "tj4d":
        columns["range"] = np.linalg.norm(np.column_stack([columns[axis] for axis in "xyz"]), axis=1)
    rows = Rows(columns, valid, _delft if name == "delft" else _tj4d)
    edits = (no_returns, nan_returns, bad_number, infinite_place, far_place)
    if random.random() < 0.8:
        edits[random.integers(len(edits))](random, rows)
    how = str(random.choice(["", "", "", "", "cut", "a column more", "big-endian", "empty", "float64"]))
    table = np.column_stack([*columns.values()])
    data = table.astype({"big-endian": ">f4", "float64": "<f8"}.get(how, "<f4")).tobytes()
    if how == "a column more":
        data = np.column_stack([table, np.full(len(table), 7.5)]).astype("<f4").tobytes()
    if how:
        rows.edit(how, "refused")
    data = {"cut": data[:-5], "empty": b""}.get(how, data)
    target = folder / ("radar/training/velodyne/00001.bin" if name == "delft" else "training/velodyne/000001.bin")
    target.parent.mkdir(parents=True)
    target.write_bytes(data)
    options = {"format": "tj4dradset"} if name == "tj4d" else {"format": "view_of_delft"}
    return case(rows, partial(cloud_of, folder, "radar", **options))


def _delft(rows: Rows) -> Mapping[str, np.ndarray]:
    columns = rows.columns
    names = {"rcs_dbsm": "rcs", "v_r_m_s": "v_r", "doppler_m_s": "v_r", "v_r_compensated_m_s": "v_c", "scan": "time"}
    return {"points": points_of(rows, "xyz"), **{ours: columns[name] for ours, name in names.items()}}


def _tj4d(rows: Rows) -> Mapping[str, np.ndarray]:
    names = {"v_r_m_s": "v_r", "doppler_m_s": "v_r", "range_m": "range", "power_db": "power", "azimuth_deg": "az"}
    return {"points": points_of(rows, "xyz"), **{ours: rows.columns[name] for ours, name in names.items()}}


# RADIATE's LiDAR: x right, y forward, z up, intensity, ring between commas.

RADIATE = {"x": (-40, 40), "y": (1, 90), "z": (-2, 3), "intensity#": (0, 256), "ring#": (0, 32)}


def radiate_lidar(random: np.random.Generator, folder: Path) -> Case:
    """RADIATE's sweeps."""
    columns, valid = made(random, RADIATE)
    rows = Rows(columns, valid, _radiate)
    edits = (no_returns, nan_returns, bad_number, infinite_place, far_place, beyond_255)
    if random.random() < 0.8:
        edits[random.integers(len(edits))](random, rows)
    how = str(
        random.choice(["", "", "", "a column less", "a column more", "a short line", "blanks", "header", "CR LF"])
    )
    table = np.column_stack([*rows.columns.values()])
    table = {"a column less": table[:, :4], "a column more": np.column_stack([table, table[:, 4]])}.get(how, table)
    lines = [(" " if how == "blanks" else ",").join(f"{value:.9g}" for value in line) for line in table]
    if how == "a short line":
        lines[3] = lines[3].rsplit(",", 1)[0]
    if how == "header":
        lines.insert(0, "x,y,z,intensity,ring")
    if how:
        rows.edit(how, "same" if how == "CR LF" else "refused")
    (folder / "000001.csv").write_bytes(("\r\n" if how == "CR LF" else "\n").join([*lines, ""]).encode())
    return case(rows, partial(lidar_cloud, folder / "000001.csv"))


def _radiate(rows: Rows) -> Mapping[str, np.ndarray]:
    x, y, z = (rows.columns[axis] for axis in "xyz")
    points = np.column_stack([y, -x, z]) + np.array(RADAR_T_LIDAR_M)
    return {"points": points, "intensity": rows.columns["intensity"] / 255, "ring": rows.columns["ring"]}


# Argoverse 2's sweeps.

ARGOVERSE = {
    "x": (-90, 90),
    "y": (1, 90),
    "z": (-2, 3),
    "intensity#": (0, 256),
    "laser_number#": (0, 64),
    "offset_ns#": (0, 1e8),
}
ARGOVERSE_TYPES = dict(zip((name.rstrip("#") for name in ARGOVERSE), ("f2", "f2", "f2", "u1", "u1", "i4"), strict=True))


def argoverse(random: np.random.Generator, folder: Path) -> Case:
    """Argoverse 2's feather tables."""
    import pyarrow
    from pyarrow import feather

    columns, valid = made(random, ARGOVERSE)
    for axis in "xyz":
        columns[axis] = columns[axis].astype("f2").astype("f8")
    rows = Rows(columns, valid, _argoverse)
    types = dict(ARGOVERSE_TYPES)
    how = str(
        random.choice(
            [
                "",
                "",
                "reordered",
                "dropped",
                "intensity as f4",
                "f4",
                "f8",
                "text",
                "a null",
                "more columns",
                "cut",
                "empty",
                "packed",
                "named by a word",
            ]
        )
    )
    edits = (no_returns, nan_returns, infinite_place, beyond_255, nan_intensity)
    if random.random() < 0.7:
        edit = edits[random.integers(len(edits))]
        edit(random, rows)
        if edit in (beyond_255, nan_intensity):
            types["intensity"] = "f4"
    if how in ("f4", "f8"):
        types |= dict.fromkeys("xyz", how)
    if how == "intensity as f4":
        types["intensity"] = "f4"
    arrays: dict[str, Any] = {name: pyarrow.array(values.astype(types[name])) for name, values in rows.columns.items()}
    name = [*arrays][random.integers(6)]
    if how == "dropped":
        del arrays[name]
    if how == "text":
        arrays[name] = pyarrow.array([str(value) for value in rows.columns[name]])
    if how == "a null":
        arrays[name] = pyarrow.array([None, *arrays[name].to_pylist()[1:]], arrays[name].type)
    if how == "more columns":
        arrays["distance"] = arrays["x"]
    if how == "reordered":
        arrays = dict(reversed([*arrays.items()]))
    if how == "empty":
        arrays = {name: array[:0] for name, array in arrays.items()}
        rows.valid, rows.columns = rows.valid[:0], {name: values[:0] for name, values in rows.columns.items()}
        rows.oracle = "either"
    sensors = folder / "sensors" / "lidar"
    sensors.mkdir(parents=True)
    path = sensors / ("315966265659927216.feather")
    feather.write_feather(pyarrow.table(arrays), path, compression="zstd" if how == "packed" else "uncompressed")
    if how == "cut":
        path.write_bytes(path.read_bytes()[:-20])
    if how and how != "empty":
        rows.edit(how, "refused" if how in ("dropped", "text", "a null", "cut") else "same")
    return case(rows, partial(cloud_of, folder, "lidar", format="argoverse2"))


def nan_intensity(random: np.random.Generator, rows: Rows) -> None:
    """An intensity of NaN."""
    rows.columns["intensity"][int(random.choice(np.flatnonzero(rows.valid)))] = np.nan
    rows.edit("intensity NaN", "refused")


def _argoverse(rows: Rows) -> Mapping[str, np.ndarray]:
    columns = rows.columns
    rest = {"ring": columns["laser_number"], "offset_ns": columns["offset_ns"]}
    return {"points": points_of(rows, "xyz"), "intensity": columns["intensity"] / 255, **rest}


FAMILIES = (
    Family("astyx radar", astyx_radar, 3),
    Family("astyx lidar", astyx_lidar, 3),
    Family("view-of-delft radar", partial(binary_radar, "delft"), 3),
    Family("tj4dradset radar", partial(binary_radar, "tj4d"), 3),
    Family("radiate lidar", radiate_lidar, 3),
    *((Family("argoverse 2 sweeps", argoverse, 4),) if importlib.util.find_spec("pyarrow") else ()),
)
