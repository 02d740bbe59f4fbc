"""Flags that several verbs share, a frozen class a group: how files are read, who works, which boxes, which score."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from farfield.cli._output import bar
from farfield.errors import ConfigError

if TYPE_CHECKING:
    from farfield.datasets import Dataset
    from farfield.jobs import JobOptions
    from farfield.metrics import Protocol

_UNNAMED = tyro.conf.arg(name="")
"""The fields of a group are flags without the group's name before them."""
PointTimes = Literal["auto", "s", "ms", "us", "ns", "none"]  # as in farfield.files.point_times, which waits
_UNSET = (None, (), "", "auto")
_OPTION_OF = {"tables": "version"}
_OF_CLOUDS = ("bin_columns", "column_names", "intensity_scale", "point_times", "radars")


@dataclass(frozen=True, kw_only=True)
class FileFlags:
    """How a data set's files are read, where they do not say it and their numbers do not show it.

    Args:
        mapping: Mapping YAML of the classes of data in any format, classes: {Auto: vehicle}; or of a Cirrus copy that
            deviates from the documented layout.
        columns: Columns per point in .bin files, or their names there and in .npy and .xyz files, such as
            x,y,z,intensity,time (default: detected).
        intensity_scale: Value of full reflectance in all clouds (default: detected: 1, 255 or 65535).
        point_times: Unit of the points' times; auto decides by the sweeps' period, none leaves the column as it is.
        radars: Topics of a bag's clouds that come from radars, or none (default: detected from names and columns).
        tracklets: What the numbers in tracklet_labels.xml stand for: kitti, cvat or datumaro (default: decided by the
            list beside the file, the writer's marks and the points in the boxes).
        size_order: Order in which nuScenes, TruckScenes and T4 store sizes; lwh for data sets that store the length
            first (default: wlh, as their schema says).
        tables: Folder of nuScenes' or TruckScenes' tables, such as v1.0-mini, where there are several.
        label_axes: Axes of labels in KITTI's columns: camera (the default), lidar (x y z is a box's centre in the
            LiDAR's axes, rotation_y its yaw about z) or lidar-bottom (x y z is the bottom's centre). Of OpenPCDet's and
            mmdetection3d's labels lidar or lidar-bottom (default: decided by the points in the boxes). Of Supervisely's
            point clouds supervisely (a box's width is x) or cvat (its length is) (default: decided by the longer sides
            of vehicles and bicycles).
        label_angles: Unit of rotations in labelCloud's files: radians or degrees (default: detected).
        reader: Change one option of the format's reader that has no flag, as name=value, such as whole_scenes=true or
            sweeps=5 of nuScenes; may be given several times. `farfield formats NAME` lists them.
    """

    mapping: Path | None = None
    columns: str | None = None
    intensity_scale: float | None = None
    point_times: PointTimes = "auto"
    radars: tuple[str, ...] = ()
    tracklets: Literal["kitti", "cvat", "datumaro"] | None = None
    label_axes: Literal["camera", "lidar", "lidar-bottom", "supervisely", "cvat"] | None = None
    label_angles: Literal["radians", "degrees"] | None = None
    size_order: Literal["wlh", "lwh"] | None = None
    tables: str | None = None
    reader: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME=VALUE")] = ()

    @property
    def options(self) -> dict[str, Any]:
        """What :func:`farfield.open_dataset` takes of the flags that are set.

        Raises:
            ConfigError: If an option of ``reader`` is no name=value, comes twice, or its flag is set too.
        """
        own = {
            _OPTION_OF.get(name, name): value
            for name, value in vars(self).items()
            if value not in _UNSET and name not in ("columns", "reader")
        }
        if self.columns:
            is_count = self.columns.isdecimal()
            own |= {"bin_columns": int(self.columns)} if is_count else {"column_names": self.columns.split(",")}
        if not self.reader:
            return own
        from farfield.datasets.reader_options import parsed_options

        further = parsed_options(self.reader)
        double = next((name for name in further if name in own), None)
        if double is not None:
            raise ConfigError(f"--reader: {double} is given by its own flag too")
        return own | further

    @property
    def paths(self) -> tuple[Path, ...]:
        """Files and folders that the flags name, which are read."""
        return () if self.mapping is None else (self.mapping,)

    @property
    def cloud_options(self) -> dict[str, Any]:
        """Those of cloud files, as any reader of such takes them.

        Raises:
            ConfigError: If options of a reader are given.
        """
        if self.reader:
            raise ConfigError(
                f"--reader {self.reader[0]}: expected a data set, got single clouds, which have no reader"
            )
        return {name: value for name, value in self.options.items() if name in _OF_CLOUDS}

    def open(self, path: Path, **options: Any) -> "Dataset":
        """Open a data set; what its reader left out is a warning, what it assumed a note.

        Args:
            path: Its folder.
            **options: Those of :func:`farfield.open_dataset`, left out where empty.
        """
        return _opened(path, self.options | {name: value for name, value in options.items() if value})


@dataclass(frozen=True, kw_only=True)
class ReadingFlags(FileFlags):
    """How a data set's files are read, K-Radar's among them; other flags as of :class:`FileFlags`.

    Args:
        labels: Version of K-Radar's annotations, such as v2.0 (default: the newest that each sequence has).
        roots: Further folders of a K-Radar that is spread over several disks.
    """

    labels: str | None = None
    roots: tuple[Path, ...] = ()

    @property
    def paths(self) -> tuple[Path, ...]:
        """Files and folders that the flags name, which are read."""
        return (*super().paths, *self.roots)

    def open_both(self, paths: Sequence[Path], sides: "Sequence[ReadingFlags]") -> "list[Dataset]":
        """Open data sets that are set side by side: a flag that one reader does not know counts for the others.

        Args:
            paths: Their folders.
            sides: The flags of each alone, which win.

        Raises:
            ConfigError: If no reader knows a flag.
        """
        from farfield.datasets.opening import known_options

        known_by_path = [known_options(path, self.options) for path in paths]
        if any(all(name not in names for names in known_by_path) for name in self.options):
            self.open(paths[0])  # its error names what the reader knows
        return [
            _opened(path, {name: value for name, value in self.options.items() if name in names} | side.options)
            for path, side, names in zip(paths, sides, known_by_path, strict=True)
        ]

    def check_unused(self, what: str) -> None:
        """Refuse flags that would read nothing.

        Args:
            what: What is lacking.

        Raises:
            ConfigError: If one is set.
        """
        flag = next((name.replace("_", "-") for name, value in vars(self).items() if value not in _UNSET), None)
        if flag is not None:
            raise ConfigError(f"--{flag}: expected {what}, whose files it says how to read")


def _opened(path: Path, options: Mapping[str, Any]) -> "Dataset":
    from farfield.datasets import open_dataset

    data = open_dataset(path, **options)
    for kind, sentence in data.remarks:
        print(f"{kind}: {sentence}", file=sys.stderr)
    return data


@dataclass(frozen=True, kw_only=True)
class JobFlags:
    """Who does the work.

    Args:
        workers: Processes; 0 takes as many as there are cores, units of work and memory for, one on a GPU.
        engine: Where the work is done: local, ray, or an installed engine's name.
        address: Ray's cluster: auto for the one that this machine is a node of, or HOST:PORT (default: a Ray of this
            machine alone, started for the command).
    """

    workers: int = 0
    engine: str = "local"
    address: str = ""

    def options(self, what: str, *, workers: int | None = None) -> "JobOptions":
        """What :func:`farfield.jobs.run` takes, with one progress bar over all workers.

        Args:
            what: The bar's name.
            workers: Number of processes where the flag is 0.
        """
        from farfield.jobs import JobOptions

        return JobOptions(
            workers=self.workers or (workers or 0),
            engine=self.engine,
            address=self.address,
            progress=partial(bar, what=what, transient=True),
        )


@dataclass(frozen=True, kw_only=True)
class BoxFlags:
    """Which of a detector's boxes count; what is not given is the weights' own.

    Args:
        score_threshold: Boxes below this score are left out (default: the weights' own threshold).
        nms_iou: Boxes that overlap a better one by more are left out (default: the weights' own).
        max_boxes: Boxes in a frame at most (default: the weights' own number).
        classes: Classes to give, comma-separated, such as vehicle,pedestrian; OLD:NEW renames, such as
            vehicle:Car,bicycle.
    """

    score_threshold: float | None = None
    nms_iou: float | None = None
    max_boxes: int | None = None
    classes: str = ""

    @property
    def options(self) -> dict[str, Any]:
        """What :func:`farfield.load_detector` takes."""
        return {
            "score_threshold": self.score_threshold,
            "nms_iou": self.nms_iou,
            "max_boxes": self.max_boxes,
            "classes": parse_classes(self.classes, "--classes") if self.classes else None,
        }

    @property
    def changed(self) -> dict[str, Any]:
        """The flags that are set, by name."""
        return {name: value for name, value in vars(self).items() if value not in (None, "")}


@dataclass(frozen=True, kw_only=True)
class ScoringFlags:
    """How boxes are scored: settings of a protocol.

    Args:
        label: The class that is scored by range (default: the most frequent one; with K-Radar's protocols every one).
        range_bins_m: Edges of the range bins (default: the protocol's own: 0,70,150,250; for kradar 0,20,40,60,80).
        epsilons: Values of epsilon in wDDS' omega = exp(epsilon d), where 0 is DDS (default: 0,0.003,0.006,0.009 for
            dds, 0 for nuscenes).
        epsilon: The old name of epsilons.
        region: window: x 0..250, |y| <= 50 m and the outermost bin edges; range: the outermost bin edges; none: all.
            Default: window for dds, but none for score's files in KITTI's and nuScenes' formats, and none for the
            others. For kradar: wide (the default), narrow, none or six bounds x,x,y,y,z,z in the radar's frame.
        iou: For tracking: the overlap that a match needs at least (default: 0.25).
        least_track_score: For tracking: tracks whose mean score is lower are left out.
        label_version: For kradar: the annotation's version, which stands beside the result (default: the data set's
            own).
        options: Further settings of the protocol, such as ap=area distance=bev relabel=truck:vehicle,bus:vehicle
            (added to the protocol's own; relabel= alone is none), for kradar boxes_in=os2-64
            classes=vehicle,pedestrian score_cut=0.3.
        replicates: Bootstrap replicates of the 95 % intervals; 0 for none.
        seed: Seed of the bootstrap.
    """

    label: str | None = None
    range_bins_m: str | None = None
    epsilons: str = ""
    epsilon: str = ""
    region: str | None = None
    iou: float | None = None
    least_track_score: float | None = None
    label_version: str | None = None
    options: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE ...")] = ()
    replicates: int = 200
    seed: int = 0

    def settings(self, protocol: "Protocol") -> dict[str, Any]:
        """The protocol's settings that are set here, without the label.

        Raises:
            ConfigError: If a value cannot be read, or the protocol has no such setting.
        """
        from farfield.metrics import Bootstrap
        from farfield.metrics.options import numbers

        own_flags = {*vars(self), "bootstrap"}
        settings = parse_options(protocol, self.options, tuple(own_flags))
        if "bootstrap" in protocol.options():
            settings["bootstrap"] = Bootstrap(replicates=self.replicates, seed=self.seed)
        epsilons = deprecated("--epsilon", self.epsilon, "--epsilons", self.epsilons)
        for name, text in (("range_bins_m", self.range_bins_m), ("epsilons", epsilons)):
            if text:
                settings[name] = numbers(text, f"--{name.replace('_', '-')}")
        for name in ("region", "iou", "least_track_score", "label_version"):
            value = getattr(self, name)
            if value not in (None, ""):
                settings[name] = value
        return settings


Reading = Annotated[ReadingFlags, _UNNAMED]
Files = Annotated[FileFlags, _UNNAMED]
Jobs = Annotated[JobFlags, _UNNAMED]
ShownBoxes = Annotated[BoxFlags, _UNNAMED]
Scoring = Annotated[ScoringFlags, _UNNAMED]

AS_THEY_ARE = ReadingFlags()
AS_FILES_SAY = FileFlags()
ALL_CORES = JobFlags()
OWN_BOXES = BoxFlags()
OWN_SCORING = ScoringFlags()


def names(text: str) -> list[str]:
    """Comma-separated names; none for an empty text."""
    return [word.strip() for word in text.split(",") if word.strip()]


def parse_pairs(text: str, flag: str) -> dict[str, str]:
    """Comma-separated pairs ``a:b``.

    Raises:
        ConfigError: If a word is no such pair, or a name stands twice on one side.
    """
    pairs: dict[str, str] = {}
    for word in names(text):
        first, colon, second = (part.strip() for part in word.partition(":"))
        if not (first and colon and second) or first in pairs or second in pairs.values():
            raise ConfigError(f"{flag}: expected pairs A:B, each name once, got {word!r}")
        pairs[first] = second
    return pairs


def parse_classes(text: str, flag: str) -> Mapping[str, str]:
    """Comma-separated words ``name`` or ``old:new`` as a mapping.

    Raises:
        ConfigError: If a word is neither, or a name stands twice.
    """
    classes: dict[str, str] = {}
    for word in names(text):
        old, colon, new = (part.strip() for part in word.partition(":"))
        if not old or (colon and not new) or old in classes:
            raise ConfigError(f"{flag}: expected each name once, as name or old:new, got {word!r}")
        classes[old] = new or old
    return classes


def deprecated(old: str, old_value: str, new: str, new_value: str) -> str:
    """The value of a flag that had another name, with a warning where the old one is used.

    Raises:
        ConfigError: If both are given.
    """
    if not old_value:
        return new_value
    if new_value:
        raise ConfigError(f"{old} is the old name of {new}: give one of them")
    print(f"warning: {old} is called {new} now; the old name goes with the next version", file=sys.stderr)
    return old_value


def parse_options(protocol: "Protocol", options: Sequence[str], flags: Sequence[str]) -> dict[str, Any]:
    """Turn ``name=value`` words into settings: numbers, comma lists and ``a:b`` pairs as the setting asks.

    Args:
        protocol: Whose settings.
        options: The words.
        flags: Settings that have a flag of their own.

    Raises:
        ConfigError: If a word is none of these, or a setting has a flag of its own.
    """
    from farfield.metrics.options import read_option

    parsed: dict[str, Any] = {}
    for option in options:
        name, equals, text = option.partition("=")
        if not equals or name in parsed:
            raise ConfigError(f"--options: expected each name=value once, got {option!r}")
        if name in flags:
            raise ConfigError(f"--options: {name} has a flag of its own")
        parsed[name] = read_option(protocol.Settings, name, text)
    return parsed
