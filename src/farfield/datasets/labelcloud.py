"""Read projects of labelCloud: ``pointclouds/`` and ``labels/*.json``, or clouds with such files beside them.

Which form the files have is told file by file: ``vertices`` by their keys, radians by negative rotations, degrees by
those beyond a turn of radians. A file whose angles may be either follows the others, or :attr:`label_angles`.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

from farfield.datasets.labelled_clouds import LabelledCloud, LabelledClouds, clouds_in, folders_with, names_of_folders
from farfield.datasets.labels.tool_labels import LabelCloudLabels
from farfield.errors import ConfigError, FarfieldError
from farfield.files.atomic import read_bytes
from farfield.files.labelcloud import ANGLES, MAX_BYTES, Angles, angles_in, parse_labelcloud
from farfield.files.point_times import PointTimes

_CLASSES = "_classes.json"
_LOOKED_AT, _HEAD_BYTES = 200, 4096  # label files, spread; bytes of one that recognition looks at
_SENTENCE = (
    "rotations about z are taken counter-clockwise, as labelCloud's conventions say, and {unit}; its README also names "
    "the other direction: look at some boxes, or export vertices. --label-angles overrules radians or degrees"
)


def is_labelcloud(root: Path) -> bool:
    """Whether a folder is a project of labelCloud, holds some, or has its label files beside clouds."""
    return bool(folders_with(root, _is_project, deep=1)) or _has_files_beside(root)


def _is_project(folder: Path) -> bool:
    return bool(clouds_in(folder / "pointclouds")) and (folder / "labels").is_dir() and _is_of_it(folder / "labels")


def _is_of_it(labels: Path) -> bool:
    """Whether a folder of labels is empty or holds JSON."""
    names = [path.suffix.lower() for path in labels.iterdir() if path.is_file() and not path.name.startswith(".")]
    return not names or ".json" in names


def _has_files_beside(folder: Path) -> bool:
    return any(_is_label_file(folder / f"{cloud.stem}.json") for cloud in islice(clouds_in(folder), _LOOKED_AT))


def _is_label_file(path: Path) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    return b'"objects"' in head and any(word in head for word in (b'"centroid"', b'"vertices"', b'"filename"'))


class LabelCloud(LabelledClouds):
    """Clouds labelled in labelCloud: point cloud ``"lidar"``, boxes without tracks; each project is a sequence.

    Args:
        root: A project, a folder of projects, or a folder of clouds with the label files beside them.
        label_angles: What rotations count, ``"radians"`` or ``"degrees"``, where a file does not show it.
        bin_columns: Columns of ``.bin`` files; None takes what the largest of the first ones shows.
        intensity_scale: Value that stands for full reflectance in all clouds; None decides by some of them.
        point_times: Unit of the points' times, where the files have any.

    Raises:
        DatasetError: If there is none.
        ConfigError: If there is no such unit of angles.
    """

    name = "labelcloud"
    looked_at = "a project of labelCloud (pointclouds/ and labels/*.json), or clouds with its JSON beside them"
    parser = parse_labelcloud

    def __init__(
        self,
        root: Path | str,
        *,
        label_angles: str | None = None,
        bin_columns: int | None = None,
        intensity_scale: float | int | None = None,
        point_times: PointTimes = "auto",
    ) -> None:
        if label_angles not in (None, *ANGLES):
            raise ConfigError(f"label_angles: expected one of {', '.join(ANGLES)}, got {label_angles!r}")
        self.label_angles = label_angles
        super().__init__(root, bin_columns=bin_columns, intensity_scale=intensity_scale, point_times=point_times)

    def find(self) -> Sequence[LabelledCloud]:
        """The clouds of all projects."""
        folders = folders_with(self.root, _is_project, deep=1)
        places = [(folder, folder / "pointclouds", folder / "labels") for folder in folders]
        places = places or [(self.root, self.root, self.root)]
        names = names_of_folders(self.root, [folder for folder, _, _ in places])
        return [
            LabelledCloud(cloud=cloud, sequence=names[folder], labels=labels / f"{cloud.stem}.json")
            for folder, clouds, labels in places
            for cloud in clouds_in(clouds)
        ]

    def parsing(self, path: Path) -> Mapping[str, Any]:
        """What a file's rotations count where it does not show it."""
        del path
        return {"angles": self.label_angles or self._shown}

    @cached_property
    def _shown(self) -> Angles | None:
        """What the files that show it agree on."""
        units = set(self._units.values()) & set(ANGLES)
        unit: Any = next(iter(units)) if len(units) == 1 else None
        return unit

    @cached_property
    def _units(self) -> Mapping[Path, str | None]:
        paths = [member.labels for member in self.members if member.labels.is_file()]
        units: dict[Path, str | None] = {}
        for path in paths[:: max(1, len(paths) // _LOOKED_AT)]:
            try:
                units[path] = angles_in(read_bytes(path, max_bytes=MAX_BYTES), path)
            except (FarfieldError, OSError):  # said when the file is read
                continue
        return units

    @property
    def assumptions(self) -> tuple[str, ...]:
        """How rotations are taken, where some files have any."""
        turned = [unit for unit in self._units.values() if unit != "either"]
        if not turned:
            return ()
        unit = self.label_angles or self._shown
        words = f"count {unit} where a file shows neither" if unit else "count what each file shows"
        return (_SENTENCE.format(unit=words),)


def label_format(data: LabelCloud) -> LabelCloudLabels:
    """The label files of a data set, to edit them."""
    paths = {key: member.labels for key, member in zip(data.keys, data.members, strict=True)}
    clouds = {member.labels: member.cloud.name for member in data.members}
    unit: Any = data.parsing(data.root)["angles"]
    return LabelCloudLabels(data.root, paths=paths, clouds=clouds, angles=unit)
