"""The tables of one data set of the nuScenes schema, joined by row numbers and checked against one another."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int64, Shaped

from farfield.datasets.nuscenes.dialects import Dialect, TableFolder
from farfield.datasets.nuscenes.table_cache import cached_table
from farfield.errors import DatasetError, FileFormatError
from farfield.files.nuscenes_tables import TableColumns, TableField, TokenLists

_TOKEN, _LINK, _NAME, _WHOLE = TableField("token"), TableField("link"), TableField("name"), TableField("whole")
_PLACE, _TURN = TableField("numbers", 3), TableField("numbers", 4)
_CHAIN = {"prev": _LINK, "next": _LINK}
_POSED = {"token": _TOKEN, "translation": _PLACE, "rotation": _TURN}
FIELDS: Mapping[str, Mapping[str, TableField]] = {
    "attribute": {"token": _TOKEN, "name": _NAME},
    "calibrated_sensor": {
        **_POSED,
        "sensor_token": _TOKEN,
        "camera_intrinsic": TableField("any"),
        "camera_distortion": TableField("any", optional=True),
    },
    "category": {"token": _TOKEN, "name": _NAME},
    "ego_pose": {**_POSED, "timestamp": _WHOLE},
    "instance": {
        "token": _TOKEN,
        "category_token": _TOKEN,
        "nbr_annotations": _WHOLE,
        "first_annotation_token": _TOKEN,
        "last_annotation_token": _TOKEN,
    },
    "sample": {"token": _TOKEN, "timestamp": _WHOLE, "scene_token": _TOKEN, **_CHAIN},
    "sample_annotation": {
        **_POSED,
        **_CHAIN,
        "sample_token": _TOKEN,
        "instance_token": _TOKEN,
        "attribute_tokens": TableField("tokens"),
        "visibility_token": _LINK,
        "size": _PLACE,
        "num_lidar_pts": _WHOLE,
        "num_radar_pts": _WHOLE,
        "velocity": TableField("numbers", 3, optional=True),
    },
    "sample_data": {
        "token": _TOKEN,
        **_CHAIN,
        "sample_token": _LINK,
        "ego_pose_token": _TOKEN,
        "calibrated_sensor_token": _TOKEN,
        "filename": TableField("path"),
        "width": TableField("whole", optional=True),
        "height": TableField("whole", optional=True),
        "timestamp": _WHOLE,
        "is_key_frame": TableField("flag"),
        "is_valid": TableField("any", optional=True),
        "info_filename": TableField("path", optional=True),
    },
    "scene": {
        "token": _TOKEN,
        "name": _NAME,
        "description": TableField("text", optional=True),
        "nbr_samples": _WHOLE,
        "first_sample_token": _TOKEN,
        "last_sample_token": _TOKEN,
    },
    "sensor": {"token": _TOKEN, "channel": _NAME, "modality": _NAME},
    "visibility": {"token": _TOKEN, "level": TableField("any")},
}
_LINKS = {  # column: the table whose token it is
    "calibrated_sensor": {"sensor_token": "sensor"},
    "instance": {"category_token": "category"},
    "sample": {"scene_token": "scene", "prev": "sample", "next": "sample"},
    "sample_annotation": {
        "sample_token": "sample",
        "instance_token": "instance",
        "visibility_token": "visibility",
        "prev": "sample_annotation",
        "next": "sample_annotation",
    },
    "sample_data": {
        "sample_token": "sample",
        "ego_pose_token": "ego_pose",
        "calibrated_sensor_token": "calibrated_sensor",
        "prev": "sample_data",
        "next": "sample_data",
    },
    "scene": {"first_sample_token": "sample", "last_sample_token": "sample"},
}
_NOT_UNIT = 1e-3
_LATEST_US = 1 << 52
_MODALITIES = ("camera", "lidar", "radar")
_VELOCITY_WITHIN_S = 1.5

Rows = Int64[np.ndarray, " _"]


class RowGroups(NamedTuple):
    """Rows of a table by those of another: of row i they are ``rows[starts[i]:starts[i + 1]]``."""

    rows: Rows
    starts: Rows

    def of(self, row: int) -> Rows:
        """The rows that belong to one."""
        return self.rows[self.starts[row] : self.starts[row + 1]]


@dataclass(eq=False)
class SchemaTables:
    """The tables of one data set; links are numbers of rows, -1 where there is none.

    Args:
        folder: Where they stand.
        dialect: What they hold.
        size_order: ``"wlh"``, as the schema says, or ``"lwh"``.

    Raises:
        DatasetError: If a table is missing, or two disagree: a token twice or of no record, chains that lead in a
            circle or into another scene, two key frames of one sensor in a sample, an object twice in one, a rotation
            that is not of length 1, a size that is not positive.
    """

    folder: TableFolder
    dialect: Dialect
    size_order: str = "wlh"
    columns: dict[str, TableColumns] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        missing = [name for name in self.dialect.tables if not self.path(name).is_file()]
        if missing:
            raise DatasetError(
                f"{self.folder.tables}: expected the tables of {self.dialect.title}, found no {missing[0]}.json. "
                "Unpack the archive of its metadata whole."
            )
        self.columns |= {name: cached_table(self.path(name), fields) for name, fields in FIELDS.items()}
        indices = {name: _TokenRows(columns["token"]) for name, columns in self.columns.items()}
        for name, index in indices.items():
            self._refuse(name, index.repeated, "a token of its own", "the token {} a second time")
        for name, links in _LINKS.items():
            for column, other in links.items():
                self._link(name, column, other, indices[other])
        self._link_lists(indices["attribute"])
        self._check_numbers()
        self._check_sensors()
        self._check_chains()
        self._check_objects(indices["sample_annotation"])
        self._check_scenes()
        self._check_groups()

    def path(self, table: str) -> Path:
        """The file of a table."""
        return self.folder.tables / f"{table}.json"

    def __getitem__(self, table: str) -> TableColumns:
        """The columns of a table."""
        return self.columns[table]

    def _refuse(self, table: str, wrong: Rows, expected: str, got: str, column: str = "token") -> None:
        """Refuse the first record of those named, if there is one."""
        for row in wrong[:1].tolist():
            value = self.columns[table][column][row]
            text = value.decode() if isinstance(value, bytes) else str(value)
            actual = got.replace("{}", text)[:160]
            raise FileFormatError(self.path(table), where=f"record {row}", expected=expected, got=actual)

    def _link(self, table: str, column: str, other: str, index: "_TokenRows") -> None:
        values = self.columns[table][column]
        rows = index.rows(values)
        expected = f"{column} to be a token of {other}.json"
        self._refuse(table, np.flatnonzero((rows < 0) & (values != b"")), expected, "{}", column)
        if column == "sample_token" and self.dialect.name != "t4":
            self._refuse(table, np.flatnonzero(rows < 0), expected, "none")
        self.columns[table][column] = rows

    def _link_lists(self, attributes: "_TokenRows") -> None:
        lists: TokenLists = self.columns["sample_annotation"]["attribute_tokens"]
        rows = attributes.rows(lists.tokens)
        for position in np.flatnonzero(rows < 0)[:1].tolist():
            row = int(np.searchsorted(lists.starts, position, "right")) - 1
            raise FileFormatError(
                self.path("sample_annotation"),
                where=f"record {row}",
                expected="attribute_tokens to be tokens of attribute.json",
                got=lists.tokens[position].decode(),
            )
        self.columns["sample_annotation"]["attribute_tokens"] = TokenLists(rows, lists.starts)

    def _check_numbers(self) -> None:
        for table in ("calibrated_sensor", "ego_pose", "sample_annotation"):
            norm = np.linalg.norm(self.columns[table]["rotation"], axis=1)
            wrong = np.flatnonzero(np.abs(norm - 1) > _NOT_UNIT)
            self._refuse(table, wrong, "a rotation w x y z of length 1", "{}", "rotation")
        for table in ("ego_pose", "sample", "sample_data"):
            times = self.columns[table]["timestamp"]
            wrong = np.flatnonzero((times < 0) | (times > _LATEST_US))
            self._refuse(table, wrong, "a timestamp in microseconds since 1970", "{}", "timestamp")
        annotations = self.columns["sample_annotation"]
        wrong = np.flatnonzero((annotations["size"] <= 0).any(axis=1))
        self._refuse("sample_annotation", wrong, "positive sizes", "{}", "size")
        for name in ("num_lidar_pts", "num_radar_pts"):
            wrong = np.flatnonzero(annotations[name] < 0)
            self._refuse("sample_annotation", wrong, f"{name} of 0 or more", "{}", name)

    def _check_sensors(self) -> None:
        sensors, calibrations = self.columns["sensor"], self.columns["calibrated_sensor"]
        wrong = [row for row, kind in enumerate(sensors["modality"]) if kind not in _MODALITIES]
        self._refuse("sensor", _rows(wrong), f"a modality of {', '.join(_MODALITIES)}", "{}", "modality")
        pairs = zip(calibrations["camera_intrinsic"], calibrations["sensor_token"], strict=True)
        wrong = [
            row
            for row, (matrix, sensor) in enumerate(pairs)
            if not _is_intrinsic(matrix, of_camera=sensors["modality"][sensor] == "camera")
        ]
        expected = "camera_intrinsic of a camera 3 x 3, of other sensors []"
        self._refuse("calibrated_sensor", _rows(wrong), expected, "{}", "camera_intrinsic")
        levels = self.columns["visibility"]["level"]
        wrong = [row for row, level in enumerate(levels) if type(level) not in (int, str) or len(str(level)) > 60]
        self._refuse("visibility", _rows(wrong), "level to be a word or a whole number", "{}", "level")

    def _check_chains(self) -> None:
        """Chains by prev and next: both ways the same, within one scene, sensor or object, forward in time, no circle.

        Sweeps may lie in any order of time.
        """
        sample, annotation = self.columns["sample"], self.columns["sample_annotation"]
        times = sample["timestamp"]
        members = {
            "sample": ("scene", sample["scene_token"], times),
            "sample_data": ("sensor", self.sensor_of, None),
            "sample_annotation": ("instance", annotation["instance_token"], times[annotation["sample_token"]]),
        }
        for table, (what, member, seconds) in members.items():
            columns = self.columns[table]
            for one, other in (("next", "prev"), ("prev", "next")):
                linked = np.flatnonzero(columns[one] >= 0)
                target = columns[one][linked]
                back = linked[columns[other][target] != linked]
                self._refuse(table, back, f"the record that {one} names to have this one as its {other}", "{}")
                strange = linked[member[target] != member[linked]]
                self._refuse(table, strange, f"{one} to be of the same {what}", "another's in {}")
            self._refuse(table, _in_circles(columns["next"]), "chains that end", "a circle through {}")
            if seconds is not None:
                linked = np.flatnonzero(columns["next"] >= 0)
                late = linked[seconds[columns["next"][linked]] <= seconds[linked]]
                self._refuse(table, late, "a next that is later in time", "an earlier one in {}")

    def _check_objects(self, annotations: "_TokenRows") -> None:
        instance, annotation = self.columns["instance"], self.columns["sample_annotation"]
        for end, other in (("first", "prev"), ("last", "next")):
            column = f"{end}_annotation_token"
            rows = annotations.rows(instance[column])
            expected = f"{column} to be the {end} annotation of this object"
            self._refuse("instance", np.flatnonzero(rows < 0), expected, "{}, of no record", column)
            own = annotation["instance_token"][rows] == np.arange(len(rows))
            self._refuse("instance", np.flatnonzero(~own | (annotation[other][rows] >= 0)), expected, "{}", column)
        count = np.bincount(annotation["instance_token"], minlength=len(instance["token"]))
        self._note_counts("instance", "nbr_annotations", count)
        ends = np.bincount(annotation["instance_token"][annotation["prev"] < 0], minlength=len(count))
        self._refuse("instance", np.flatnonzero(ends > 1), "annotations in one chain", "several chains of {}")

    def _check_scenes(self) -> None:
        scene, sample = self.columns["scene"], self.columns["sample"]
        count = np.bincount(sample["scene_token"], minlength=len(scene["token"]))
        self._note_counts("scene", "nbr_samples", count)
        for end, other in (("first", "prev"), ("last", "next")):
            rows = scene[f"{end}_sample_token"]
            wrong = np.flatnonzero((sample["scene_token"][rows] != np.arange(len(rows))) | (sample[other][rows] >= 0))
            self._refuse("scene", wrong, f"{end}_sample_token to be the {end} sample of this scene", "another in {}")
        ends = np.bincount(sample["scene_token"][sample["prev"] < 0], minlength=len(count))
        self._refuse("scene", np.flatnonzero(ends > 1), "samples in one chain", "several chains of {}")
        names: dict[str, int] = {}
        again = [row for row, name in enumerate(scene["name"]) if names.setdefault(name, row) != row]
        self._refuse("scene", _rows(again), "a name of its own", "{} a second time", "name")

    def _note_counts(self, table: str, column: str, count: Rows) -> None:
        wrong = np.flatnonzero(self.columns[table][column] != count)
        if len(wrong):
            row = int(wrong[0])
            self.notes.append(
                f"{self.path(table)}: {column} is not the number that there is in {len(wrong)} records, such as "
                f"{self.columns[table][column][row]} for {count[row]} in record {row}; what there is counts"
            )

    def _check_groups(self) -> None:
        data, annotation = self.columns["sample_data"], self.columns["sample_annotation"]
        key = np.flatnonzero(data["is_key_frame"] & (data["sample_token"] >= 0))
        again = key[_again(np.stack([data["sample_token"][key], self.sensor_of[key]]))]
        self._refuse("sample_data", again, "one key frame of a sensor in a sample", "{}, a second one")
        again = _again(np.stack([annotation["sample_token"], annotation["instance_token"]]))
        self._refuse("sample_annotation", again, "an object once in a sample", "{}, a second one")

    @cached_property
    def sensor_of(self) -> Rows:
        """Sensor of each record of sample_data."""
        rows = self.columns["sample_data"]["calibrated_sensor_token"]
        return np.asarray(self.columns["calibrated_sensor"]["sensor_token"][rows])

    @cached_property
    def key_data(self) -> RowGroups:
        """Key frames of each sample; those that are marked as not valid are left out."""
        data = self.columns["sample_data"]
        valid = np.array([value is not False for value in data["is_valid"]], dtype=bool)
        key = np.flatnonzero(data["is_key_frame"] & (data["sample_token"] >= 0) & valid)
        return _grouped(key, data["sample_token"][key], len(self.columns["sample"]["token"]))

    @cached_property
    def annotations(self) -> RowGroups:
        """Annotations of each sample."""
        owner = self.columns["sample_annotation"]["sample_token"]
        return _grouped(np.arange(len(owner)), owner, len(self.columns["sample"]["token"]))

    @cached_property
    def samples(self) -> Rows:
        """Samples by scene, in the order of the table of scenes, and by time."""
        sample = self.columns["sample"]
        return np.lexsort((sample["timestamp"], sample["scene_token"])).astype(np.int64)

    @cached_property
    def poses(self) -> RowGroups:
        """Poses that the records of each scene name, by time."""
        data, sample = self.columns["sample_data"], self.columns["sample"]
        owned = np.flatnonzero(data["sample_token"] >= 0)
        scenes = sample["scene_token"][data["sample_token"][owned]]
        pairs = np.unique(np.stack([scenes, data["ego_pose_token"][owned]]), axis=1)
        pairs = pairs[:, np.lexsort((self.columns["ego_pose"]["timestamp"][pairs[1]], pairs[0]))]
        return _grouped(pairs[1], pairs[0], len(self.columns["scene"]["token"]))

    def pose_at(self, scene: int, time_us: int) -> int:
        """The pose that is nearest in time: of those that the scene's own records name, else of all."""
        times = self.columns["ego_pose"]["timestamp"]
        rows = self.poses.of(scene)
        if not len(rows):
            return int(np.abs(times - time_us).argmin())
        after = int(np.searchsorted(times[rows], time_us))
        near = rows[max(after - 1, 0) : after + 1]
        return int(near[np.abs(times[near] - time_us).argmin()])

    def size_m(self, rows: Rows) -> Float[np.ndarray, "n 3"]:
        """Length, width and height of some annotations."""
        size: Float[np.ndarray, "n 3"] = self.columns["sample_annotation"]["size"][rows]
        return size if self.size_order == "lwh" else size[:, [1, 0, 2]]

    def velocities(self, rows: Rows) -> Float[np.ndarray, "n 3"]:
        """Velocities over ground in the world of some annotations: those given, else by the neighbours in time.

        The way from the previous place to the next one, or from or to the own one, over the time; NaN where there is
        no neighbour, or more than 1.5 s lie between, 3 s between previous and next.
        """
        annotation = self.columns["sample_annotation"]
        before, after = annotation["prev"][rows], annotation["next"][rows]
        first, last = np.where(before >= 0, before, rows), np.where(after >= 0, after, rows)
        times = self.columns["sample"]["timestamp"]
        first_s, last_s = (1e-6 * times[annotation["sample_token"][end]].astype(np.float64) for end in (first, last))
        elapsed_s = last_s - first_s
        most_s = np.where((before >= 0) & (after >= 0), 2 * _VELOCITY_WITHIN_S, _VELOCITY_WITHIN_S)
        is_known = (elapsed_s > 0) & (elapsed_s <= most_s)
        way_m = annotation["translation"][last] - annotation["translation"][first]
        velocity = np.full((len(rows), 3), np.nan)
        velocity[is_known] = way_m[is_known] / elapsed_s[is_known, None]
        measured = annotation["velocity"][rows]
        return np.where(np.isfinite(measured).all(axis=1)[:, None], measured, velocity)


class _TokenRows:
    """Rows of a table by their tokens."""

    def __init__(self, tokens: Shaped[np.ndarray, " n"]) -> None:
        self.order = np.argsort(tokens, kind="stable")
        self.sorted = tokens[self.order]

    @property
    def repeated(self) -> Rows:
        """Rows whose token an earlier one has."""
        return np.sort(self.order[1:][self.sorted[1:] == self.sorted[:-1]])

    def rows(self, tokens: Shaped[np.ndarray, " n"]) -> Rows:
        """The row of each token, -1 where there is none."""
        if not len(self.sorted):
            return np.full(len(tokens), -1, dtype=np.int64)
        position = np.minimum(np.searchsorted(self.sorted, tokens), len(self.sorted) - 1)
        return np.where(self.sorted[position] == tokens, self.order[position], -1).astype(np.int64)


def _rows(numbers: list[int]) -> Rows:
    return np.array(numbers, dtype=np.int64)


def _grouped(rows: Rows, owner: Rows, count: int) -> RowGroups:
    order = np.argsort(owner, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=count))])
    return RowGroups(rows[order].astype(np.int64), starts.astype(np.int64))


def _again(pairs: Int64[np.ndarray, "2 n"]) -> Int64[np.ndarray, " _"]:
    """Positions of pairs of numbers that stand there a second time."""
    order = np.lexsort(pairs)
    same = (pairs[:, order[1:]] == pairs[:, order[:-1]]).all(axis=0)
    return np.sort(order[1:][same]).astype(np.int64)


def _in_circles(following: Rows) -> Int64[np.ndarray, " _"]:
    """Rows from which the chain never ends: each round doubles the steps."""
    end = len(following)
    jump = np.append(np.where(following >= 0, following, end), end)
    for _ in range(max(end, 1).bit_length()):
        jump = jump[jump]
    return np.flatnonzero(jump[:end] != end).astype(np.int64)


def _is_intrinsic(value: Any, *, of_camera: bool) -> bool:
    if not of_camera:
        return bool(value == [])
    rows = isinstance(value, list) and len(value) == 3 and all(isinstance(row, list) and len(row) == 3 for row in value)
    if not rows or not all(type(number) in (int, float) and abs(number) < 1e6 for row in value for number in row):
        return False
    matrix = np.array(value, dtype=np.float64)
    return bool((matrix[2] == [0, 0, 1]).all() and matrix[0, 0] > 0 and matrix[1, 1] > 0)
