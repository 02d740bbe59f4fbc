"""Custom sets of OpenPCDet and of mmdetection3d: ``points/``, ``labels/``, ``ImageSets/``, a file a frame.

``points/<frame>.npy`` (OpenPCDet) or ``.bin`` (mmdetection3d), ``labels/<frame>.txt``, ``ImageSets/train.txt``, ``val``
and ``test``; of mmdetection3d also ``images/images_<number>/<frame>.png``. Sources, both Apache-2.0:
https://github.com/open-mmlab/OpenPCDet/blob/master/docs/CUSTOM_DATASET_TUTORIAL.md and
https://github.com/open-mmlab/mmdetection3d/blob/main/docs/en/advanced_guides/customize_dataset.md.
No real set was seen.
"""

from collections import Counter
from collections.abc import Mapping, Sequence, Set
from contextlib import suppress
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from farfield.datasets.base import Dataset, Indices
from farfield.datasets.class_mapping import usual
from farfield.datasets.cloud_reading import CloudReading
from farfield.datasets.losses import Capacity
from farfield.errors import ConfigError, DatasetError, FarfieldError, FileFormatError
from farfield.files.atomic import readable, write_text
from farfield.files.clouds import bin_columns as columns_of_bin
from farfield.files.images import read_image
from farfield.files.npy import write_npy
from farfield.files.openpcdet import format_labels, read_frame_list, read_label_rows
from farfield.files.point_times import PointTimes
from farfield.files.remote_paths import as_path
from farfield.files.suffixes import any_case, existing
from farfield.frame import Annotation, Boxes, Frame, Key, Lazy, Sensor, camera_sensor
from farfield.geometry.boxes import wrap_angle_rad
from farfield.vocabulary.counts import count_of

PARTS = ("train", "val", "test")
AXES = ("lidar", "lidar-bottom")
_SUFFIXES = (".npy", ".bin")
_IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
_LOOKED_AT = 4  # frames whose points show what z is
_LEAST_POINTS, _CLEAR = 5, 0.8  # of a box that shows it, and the share of such boxes that must agree
_NAMED = 3  # frames in a message


def is_openpcdet(root: Path) -> bool:
    """Whether a folder holds clouds in ``points/`` with labels or lists beside them, in OpenPCDet's layout."""
    has_points = any(next(root.glob(f"points/*{any_case(suffix)}"), None) for suffix in _SUFFIXES)
    return has_points and any(next(root.glob(f"{name}/*{any_case('.txt')}"), None) for name in ("labels", "ImageSets"))


class OpenPcdet(Dataset):
    """OpenPCDet's or mmdetection3d's custom set: cloud ``"lidar"``, images, boxes; the frames are of no drive.

    Coordinates are the LiDAR's: x forward, y left, z up. The columns of a ``.bin`` file are decided by its numbers, and
    refused where these do not show them. OpenPCDet's boxes are at their centres; mmdetection3d's LiDAR boxes stand on
    z. Both write the same lines, so the points below and above z in the boxes decide, and without any the centre.

    Args:
        root: The folder that holds ``points`` and ``labels``.
        bin_columns: Columns of ``.bin`` files; None takes what the numbers show.
        label_axes: ``"lidar"``: z of a box is its centre's; ``"lidar-bottom"``: its bottom's; None decides.
        intensity_scale: Value that stands for full reflectance in all clouds; None decides by some of them.
        point_times: Unit of the points' times, where the files have any.

    Raises:
        DatasetError: If there is no cloud, or two of one frame.
        FileFormatError: If the columns of ``.bin`` files cannot be told, or a list is damaged.
        ConfigError: If ``label_axes`` is none of those possible.
    """

    name = "openpcdet"
    reading: CloudReading

    def __init__(
        self,
        root: Path | str,
        *,
        bin_columns: int | None = None,
        label_axes: str | None = None,
        intensity_scale: float | int | None = None,
        point_times: PointTimes = "auto",
    ) -> None:
        if label_axes not in (None, *AXES):
            raise ConfigError(f"label_axes: expected one of {', '.join(AXES)}, got {label_axes!r}")
        self.root, self.label_axes = as_path(root), label_axes
        folder = self.root / "points"
        named = sorted(folder.iterdir()) if folder.is_dir() else []
        self.clouds = [path for path in named if path.suffix.lower() in _SUFFIXES and not path.name.startswith(".")]
        if not self.clouds:
            raise DatasetError(f"{self.root}: expected clouds in points/*.npy or points/*.bin, found none")
        self.frame_ids = tuple(readable(path.stem) for path in self.clouds)
        twice = next((stem for stem, count in Counter(self.frame_ids).items() if count > 1), None)
        if twice is not None:
            raise DatasetError(f"{folder}: expected one cloud a frame, found several of {twice!r}")
        self.sequences = (readable(self.root.resolve().name),) * len(self.clouds)
        self.reading = CloudReading(
            self.clouds, bin_columns=bin_columns, intensity_scale=intensity_scale, point_times=point_times
        )
        self._check_columns()
        paths = {name: existing(self.root / "ImageSets" / f"{name}.txt") for name in PARTS}
        self._lists = {name: read_frame_list(path) for name, path in paths.items() if path is not None}

    def _check_columns(self) -> None:
        """Refuse ``.bin`` files whose numbers do not show how many a point has: nothing else says it."""
        files = [path for path in self.clouds if path.suffix.lower() == ".bin"]
        if not files or self.reading.bin_columns is not None:
            return
        largest = max(files[:8], key=_size)
        if not columns_of_bin(largest).likely:
            raise FileFormatError(
                largest,
                where="the columns",
                expected="numbers enough to show how many a point has, which neither name nor format says",
                got=f"{largest.stat().st_size} bytes",
                fix="Say how many with --columns, in Python bin_columns=.",
            )

    def drive_indices(self) -> Mapping[str, Indices]:
        """No drives: nothing says which frames follow each other."""
        return {}

    def split_parts(self) -> dict[str, list[str]]:
        """The frames of ``ImageSets/{train,val,test}.txt`` that have a cloud; no ``test`` where it repeats ``val``.

        Raises:
            DatasetError: If a frame to learn from stands in another list.
        """
        training = set(self._lists.get("train", ()))
        for part in ("val", "test"):
            twice = next((name for name in self._lists.get(part, ()) if name in training), None)
            if twice is not None:
                raise DatasetError(f"{self.root}/ImageSets: expected frame {twice!r} of train.txt in no other list")
        present = set(self.frame_ids)
        lists = {part: names for part, names in self._lists.items() if part != "test" or not self._repeated}
        parts = {part: [name for name in names if name in present] for part, names in lists.items()}
        return parts or super().split_parts()

    @property
    def _repeated(self) -> int:
        """How many frames of ``test`` stand in ``val`` too, as in sets whose test list is a copy."""
        return len(set(self._lists.get("test", ())) & set(self._lists.get("val", ())))

    def benchmark_keys(self, name: str) -> Set[Key]:
        """(sequence, frame) of the frames of ``ImageSets/<name>.txt`` that have a cloud.

        Raises:
            ConfigError: If there is no such list.
        """
        if name not in self._lists:
            raise ConfigError(f"benchmark_split: expected one of {', '.join(self._lists) or 'no list'}, got {name!r}")
        members = set(self._lists[name])
        return {key for key in self.keys if key[1] in members}

    @property
    def notes(self) -> tuple[str, ...]:
        """What does not fit together: frames of a list or labels without a cloud, frames without labels."""
        present, sentences = set(self.frame_ids), []
        for part, names in self._lists.items():
            if strange := [name for name in names if name not in present]:
                sentences.append(f"ImageSets/{part}.txt names {_some(strange)} without a cloud in points/")
        if self._repeated:
            frames = count_of(self._repeated, "frame")
            sentences.append(f"ImageSets/test.txt repeats {frames} of val.txt: it is no part; benchmark_split has both")
        labelled = {readable(path.stem) for path in (self.root / "labels").glob(f"*{any_case('.txt')}")}
        if strange := sorted(labelled - present):
            sentences.append(f"labels/ has {_some(strange)} without a cloud in points/")
        listed = [name for part in ("train", "val") for name in self._lists.get(part, ())]
        if bare := [name for name in listed if name in present and name not in labelled]:
            sentences.append(f"train or val name {_some(bare)} without a file in labels/: not annotated")
        if (self.root / "calibs").is_dir():
            sentences.append("calibs/ is not read: mmdetection3d's page does not say how its matrices are written")
        return tuple(sentences)

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What z of the boxes was taken for, where neither a flag nor the format says it."""
        if self.label_axes is not None or not any(self.has_annotation(index) for index in range(len(self))):
            return ()
        bottoms, centres = self._votes
        if self._axes == AXES[1]:
            shown = f"{bottoms} of {count_of(bottoms + centres, 'box', 'boxes')} with points show it"
            return (
                f"z of a box was taken for its bottom, as mmdetection3d has it ({shown}); --label-axes lidar: centre",
            )
        if not centres and any(path.suffix.lower() == ".bin" for path in self.clouds):
            return (
                "z of a box was taken for its centre, as OpenPCDet defines it; no box has points that show it, and "
                "mmdetection3d's boxes stand on z: --label-axes lidar-bottom",
            )
        return ()

    @cached_property
    def _votes(self) -> tuple[int, int]:
        """How many boxes of some frames hold points as if z were their bottom, and as if it were their centre."""
        labelled = [index for index in range(len(self)) if self.has_annotation(index)]
        rows = np.unique(np.linspace(0, max(len(labelled) - 1, 0), _LOOKED_AT).astype(int)).tolist()
        votes = np.zeros(2, dtype=np.int64)
        for index in [labelled[row] for row in rows] if labelled else []:
            with suppress(FarfieldError, OSError):  # reported when it is read
                numbers = read_label_rows(self._label(index)).numbers
                votes += height_votes(self.reading(self.clouds[index]).points_m, numbers)
        return int(votes[0]), int(votes[1])

    @cached_property
    def _axes(self) -> str:
        """Which of :data:`AXES` the labels have.

        Raises:
            DatasetError: If some boxes show the one and some the other.
        """
        if self.label_axes is not None:
            return self.label_axes
        bottoms, centres = self._votes
        if max(bottoms, centres) < _CLEAR * (bottoms + centres):
            raise DatasetError(
                f"{self.root}/labels: expected boxes whose points show whether z is their centre or their bottom, "
                f"found {centres} that show the centre and {bottoms} the bottom. Say which: --label-axes lidar "
                "(centre) or lidar-bottom, in Python label_axes=."
            )
        return AXES[1] if bottoms > centres else AXES[0]

    def _label(self, index: int) -> Path:
        path = self.root / "labels" / f"{self.clouds[index].stem}.txt"
        return existing(path) or path

    def has_annotation(self, index: int) -> bool:
        """Whether there is a label file of frame ``index``."""
        return self._label(index).is_file()

    def annotation(self, index: int) -> Annotation | None:
        """The boxes of frame ``index``."""
        return self._read_annotation(index) if self.has_annotation(index) else None

    def _read_annotation(self, index: int) -> Annotation:
        path = self._label(index)
        rows = read_label_rows(path)
        centre_m = rows.numbers[:, :3].copy()
        if len(rows.names) and self._axes == AXES[1]:
            centre_m[:, 2] += rows.numbers[:, 5] / 2
        boxes = Boxes(
            centre_m=centre_m,
            size_m=rows.numbers[:, 3:6].copy(),
            yaw_rad=rows.numbers[:, 6].copy(),
            label=list(rows.names),
        )
        return usual(Annotation(boxes=boxes, original_label=rows.names))

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``."""
        label = [self._label(index)] if self.has_annotation(index) else []
        return [self.clouds[index], *label, *self._images(index).values()]

    def _images(self, index: int) -> dict[str, Path]:
        folders = sorted(folder for folder in (self.root / "images").glob("*") if folder.is_dir())
        stem = self.clouds[index].stem
        return {
            readable(folder.name): path
            for folder in folders
            for suffix in reversed(_IMAGE_SUFFIXES)
            if (path := existing(folder / f"{stem}{suffix}")) is not None
        }

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        images = self._images(index)
        return Frame(
            sequence=self.sequences[index],
            frame_id=self.frame_ids[index],
            clouds=Lazy({"lidar": self.reading.loader(self.clouds[index])}),
            images=Lazy({name: partial(read_image, path) for name, path in images.items()}),
            sensors={
                "lidar": Sensor(kind="lidar", frame_T_sensor=np.eye(4)),
                **{name: camera_sensor(None) for name in images},
            },
            load_annotation=partial(self._read_annotation, index) if self.has_annotation(index) else None,
            metadata={"files": [str(path) for path in self.files(index)]},
        )


def height_votes(points_m: Float[np.ndarray, "n 3"], numbers: Float[np.ndarray, "m 7"]) -> tuple[int, int]:
    """How many boxes hold points as if z were their bottom, and how many as if it were their centre.

    A body's lower half lies below its centre and none of it below its bottom; its upper half ends half a height above
    its centre, and a whole height above its bottom.

    Args:
        points_m: x, y, z.
        numbers: x, y, z, length, width, height, yaw of each box.
    """
    bottoms = centres = 0
    for x, y, z, length, width, height, yaw_rad in numbers.tolist():
        near = points_m[_near(points_m, (x, y), 0.5 * np.hypot(length, width))].astype(np.float64)
        along = (near[:, 0] - x) * np.cos(yaw_rad) + (near[:, 1] - y) * np.sin(yaw_rad)
        across = (near[:, 1] - y) * np.cos(yaw_rad) - (near[:, 0] - x) * np.sin(yaw_rad)
        level = (near[(np.abs(along) < length / 2) & (np.abs(across) < width / 2), 2] - z) / height
        below, above = int(((level > -0.5) & (level < -0.15)).sum()), int(((level > 0.55) & (level < 0.95)).sum())
        if below + above >= _LEAST_POINTS:
            centres += below > 2 * above
            bottoms += above > 2 * below
    return bottoms, centres


def _near(points_m: Float[np.ndarray, "n 3"], centre_m: tuple[float, float], radius_m: float) -> Bool[np.ndarray, " n"]:
    near: np.ndarray = (np.abs(points_m[:, :2] - np.array(centre_m, dtype=np.float32)) < radius_m).all(axis=1)
    return near


def _some(names: Sequence[str]) -> str:
    shown = ", ".join(map(repr, names[:_NAMED])) + (", ..." if len(names) > _NAMED else "")
    return f"{count_of(len(names), 'frame')} ({shown})"


def _size(path: Path) -> int:
    return path.stat().st_size


def spelled_in_openpcdet(label: str) -> str:
    """A class as a word of a label file: ``traffic_cone``."""
    return "_".join(label.split())


OPENPCDET_HOLDS = Capacity(
    title="OpenPCDet's folders",
    read_by="openpcdet",
    holds=frozenset({"empty frames"}),
    spelled=spelled_in_openpcdet,
    aliases={},
    file_names=None,
    reasons={
        "names": "files are numbered; frames.csv tells which is which",
        "classes": "a class is one word",
    },
)
"""What :class:`OpenPcdetWriter` writes."""


class OpenPcdetWriter:
    """Write ``points/NNNNNN.npy`` (float32: x, y, z and the intensity in [0, 1]) and ``labels/NNNNNN.txt``.

    Boxes are written at their centres, as OpenPCDet defines them.

    Args:
        root: Folder to write into.
    """

    def __init__(self, root: Path | str) -> None:
        self.root = as_path(root)

    def write(self, number: int, frame: Frame, *, cloud: str | None, boxes: Boxes | None) -> dict[str, Path]:
        """Write one frame under a number.

        Args:
            number: 0 to 999999.
            frame: The frame.
            cloud: Which cloud; None takes the first.
            boxes: Boxes to label; None writes no label file.

        Returns:
            The files written, by kind.

        Raises:
            DatasetError: If the number has more than six digits, the cloud has no intensity, or a class is a number.
        """
        if not 0 <= number <= 999_999:
            raise DatasetError(f"frame {frame.key}: expected a number from 0 to 999999, got {number}")
        points = frame.cloud(cloud)
        if points.intensity is None:
            raise DatasetError(
                f"frame {frame.key}: OpenPCDet's points have an intensity, got a cloud of {', '.join(points.columns)}. "
                f"Choose by `cloud` one of {', '.join(frame.clouds)} that has it."
            )
        paths = {"points": self.root / "points" / f"{number:06d}.npy"}
        texts: dict[Path, str] = {}
        if boxes is not None:
            paths["labels"] = self.root / "labels" / f"{number:06d}.txt"
            numbers = np.column_stack([boxes.centre_m, boxes.size_m, wrap_angle_rad(boxes.yaw_rad)])
            try:
                names = [spelled_in_openpcdet(str(name)) for name in np.asarray(boxes.label)]
                texts[paths["labels"]] = format_labels(numbers, names)
            except ValueError as error:
                raise DatasetError(
                    f"frame {frame.key}: {error}, as OpenPCDet's label files have them. Rename it in a mapping "
                    "(--mapping)."
                ) from error
        for path in paths.values():
            path.parent.mkdir(parents=True, exist_ok=True)
        write_npy(paths["points"], np.column_stack([points.points_m, points.intensity]).astype(np.float32))
        for path, text in texts.items():
            write_text(path, text)
        return paths
