"""Where the files of Cirrus stand, and which belong together: parts, times, segments, pairs; and the mapping file.

The mapping's defaults are the documented public layout. A YAML file may change any; an unknown key is an error::

    layout:   {gaussian: "dataset{n}_gaussian/*.xyz", uniform: "dataset{n}_uniform/*.xyz"}
    xyz:      {delimiter: auto, intensity_scale: auto}
    labels:   {size_order: lwh, quat_order: xyzw, position_is: center, aliases: {big car: large_vehicle}}
    pairing:  {mode: nearest, max_dt_ms: 100}
    calib:    {file: calibration.yaml}
    segments: {gap_s: 1.0}
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import yaml
from pydantic import Field, ValidationError, field_validator

from farfield.errors import ConfigError, DatasetError, plain
from farfield.files.atomic import read_bytes
from farfield.files.stamps import name_time_ns
from farfield.files.suffixes import pattern_in_any_case
from farfield.files.yaml_text import MAX_BYTES, PlainSettings, plain_yaml
from farfield.vocabulary.classes import CIRRUS_CLASSES

# The mapping file: one key for every fact that the release leaves uncertain.


class FolderLayout(PlainSettings):
    """Glob patterns of the four folders within one ``Cirrus_dataset<N>``; ``{n}`` is its number."""

    gaussian: str = "dataset{n}_gaussian/*.xyz"
    uniform: str = "dataset{n}_uniform/*.xyz"
    camera: str = "dataset{n}_camera/*.jpg"
    labels: str = "dataset{n}_annotation/*.json"

    @field_validator("*")
    @classmethod
    def _stays_inside(cls, pattern: str) -> str:
        if Path(pattern).is_absolute() or ".." in Path(pattern).parts or len(Path(pattern).parts) < 2:
            raise ValueError(f"expected folder/pattern below the data set's root, got {pattern!r}")
        return pattern


AUTHORS_LAYOUT = FolderLayout(
    gaussian="raw_data/lidar/*.xyz",
    uniform="raw_data/lidar_u/*.xyz",
    camera="raw_data/camera/*.jpg",
    labels="json_files/*.json",
)


class ColumnNames(PlainSettings):
    """Names of the columns of each pattern's files. Files may have more or fewer extra ones."""

    gaussian: tuple[str, ...] = ("x", "y", "z", "intensity", "extra0")
    uniform: tuple[str, ...] = ("x", "y", "z", "intensity", "extra0", "extra1", "extra2", "extra3")

    @field_validator("*")
    @classmethod
    def _has_the_basics(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        if not {"x", "y", "z", "intensity"} <= set(names) or len(set(names)) != len(names):
            raise ValueError(f"expected distinct names with x, y, z and intensity, got {names}")
        return names


class Xyz(PlainSettings):
    """How to read the ASCII clouds."""

    delimiter: str = "auto"
    columns: ColumnNames = ColumnNames()
    intensity_scale: Literal["auto"] | float = Field("auto", description="value that stands for full reflectance")
    on_extra_columns: Literal["keep", "drop"] = "keep"


class Labels(PlainSettings):
    """How to read the annotations."""

    root: str = "labels"
    class_: str = Field("label_class", alias="class")
    position: str = "position"
    size: str = "size"
    quaternion: str = "quaternion"
    size_order: Literal["lwh", "wlh", "lhw", "hlw", "whl", "hwl"] = "lwh"
    quat_order: Literal["xyzw", "wxyz"] = "xyzw"
    position_is: Literal["center", "bottom"] = "center"
    yaw_scale: float = Field(1.0, description="factor on the yaw read; 57.29577951308232 fixes degrees taken twice")
    yaw_offset_deg: float = 0.0
    text_naming: Literal["authors", "kitti"] = "authors"
    aliases: dict[str, str] = Field(default_factory=dict)

    @field_validator("aliases")
    @classmethod
    def _known_targets(cls, aliases: dict[str, str]) -> dict[str, str]:
        wrong = sorted(set(aliases.values()) - set(CIRRUS_CLASSES))
        if wrong:
            raise ValueError(f"expected aliases of {', '.join(CIRRUS_CLASSES)}; got {', '.join(wrong)}")
        return aliases


class Pairing(PlainSettings):
    """How the uniform sweep and the image of a Gaussian sweep are found."""

    mode: Literal["nearest", "order"] = "nearest"
    max_dt_ms: float = Field(100.0, gt=0)
    key: Literal["gaussian", "uniform"] = "gaussian"


class Calib(PlainSettings):
    """Where the camera's calibration stands; relative to the data set's root."""

    file: str | None = None
    convention: Literal["lidar_to_cam", "cam_to_lidar"] = "lidar_to_cam"


class Axes(PlainSettings):
    """Directions of the clouds' axes. Only the documented ones are read; others need ``Dataset.moved``."""

    x: Literal["forward"] = "forward"
    y: Literal["left"] = "left"
    z: Literal["up"] = "up"


class Splits(PlainSettings):
    """Unit and file of the split."""

    unit: Literal["segment"] = "segment"
    file: str = "splits/cirrus_v1.json"


class Segments(PlainSettings):
    """How drives are separated: a pause longer than ``gap_s`` begins a new segment."""

    gap_s: float = Field(1.0, gt=0)


class Mapping(PlainSettings):
    """Everything a mapping file may say."""

    layout: FolderLayout | None = None
    xyz: Xyz = Xyz()
    labels: Labels = Labels()
    pairing: Pairing = Pairing()
    calib: Calib = Calib()
    frame: Axes = Axes()
    splits: Splits = Splits()
    segments: Segments = Segments()


def read_mapping(path: Path | str) -> Mapping:
    """Read a mapping file.

    Raises:
        ConfigError: If it cannot be read, is no YAML, or has an unknown key or an impossible value.
    """
    try:
        content = plain_yaml(read_bytes(path, max_bytes=MAX_BYTES))
        return Mapping.model_validate({} if content is None else content)
    except ValidationError as error:
        raise ConfigError(f"{path}: {plain(error)}") from error
    except (OSError, yaml.YAMLError) as error:
        raise ConfigError(f"{path}: expected a mapping file in YAML, found: {plain(error)}") from error


KINDS = ("gaussian", "uniform", "camera", "labels")


@dataclass(frozen=True, kw_only=True)
class CirrusPart:
    """One ``Cirrus_dataset<N>`` or one authors' batch: its folder, number and files by kind, in time order."""

    root: Path
    number: int
    layout: FolderLayout
    files: dict[str, tuple[Path, ...]]


@dataclass(frozen=True, kw_only=True)
class CirrusFiles:
    """The files of one frame. ``pair_dt_ms`` is uniform minus Gaussian, ``camera_dt_ms`` camera minus key."""

    part: CirrusPart
    sequence: str
    gaussian: Path | None = None
    uniform: Path | None = None
    camera: Path | None = None
    labels: Path | None = None
    pair_dt_ms: float | None = None
    camera_dt_ms: float | None = None

    @property
    def key(self) -> Path:
        """The file that names the frame: the Gaussian sweep, or the uniform one where there is no Gaussian."""
        path = self.gaussian or self.uniform
        assert path is not None
        return path


def time_of(path: Path) -> int | None:
    """Unix time in nanoseconds that a file name gives, or None.

    >>> time_of(Path("1558131117608556768.xyz")), time_of(Path("000001.xyz"))
    (1558131117608556768, None)
    """
    return name_time_ns(path.stem)


def find_parts(root: Path, mapping: Mapping) -> list[CirrusPart]:
    """Find the parts below ``root``: itself, its ``dataset`` folder, or its children.

    Returns:
        Parts by number; empty if there is nothing in this layout.
    """
    folders = [root, root / "dataset"]
    if root.is_dir():
        children = sorted((path for path in root.iterdir() if path.is_dir()), key=_natural)
        folders += [folder for child in children for folder in (child, child / "dataset")]
    parts: list[CirrusPart] = []
    for folder in folders:
        layouts = [mapping.layout] if mapping.layout else [FolderLayout(), AUTHORS_LAYOUT]
        matching = [part for layout in layouts for part in _parts_at(folder, layout)]
        if folder in (root, root / "dataset") and matching:
            return matching
        parts += matching
    return parts


def _parts_at(folder: Path, layout: FolderLayout) -> list[CirrusPart]:
    if not folder.is_dir():
        return []
    parts = []
    for number in _numbers(folder, layout):
        files = {kind: _files(folder, getattr(layout, kind), number) for kind in KINDS}
        if files["gaussian"] or files["uniform"]:
            parts.append(CirrusPart(root=folder, number=number, layout=layout, files=files))
    return parts


def _numbers(folder: Path, layout: FolderLayout) -> list[int]:
    folders = [Path(getattr(layout, kind)).parts[0] for kind in KINDS[:2]]
    if not any("{n}" in folder for folder in folders):
        return [1]
    names = [path.name for path in folder.iterdir() if path.is_dir()]
    patterns = [re.compile(re.escape(folder).replace(r"\{n\}", r"(\d{1,6})")) for folder in folders if "{n}" in folder]
    return sorted({int(match[1]) for name in names for pattern in patterns if (match := pattern.fullmatch(name))})


def _files(folder: Path, pattern: str, number: int) -> tuple[Path, ...]:
    glob = pattern_in_any_case(pattern.replace("{n}", str(number)))
    paths = [path for path in folder.glob(glob) if not path.name.startswith(".")]
    if not paths and pattern.endswith(".json"):  # the authors' text labels stand in for missing JSON
        texts = pattern.replace("json_files", "txt_files").removesuffix(".json") + ".txt"
        paths = list(folder.glob(pattern_in_any_case(texts.replace("{n}", str(number)))))
    timed = all(time_of(path) is not None for path in paths)
    return tuple(sorted(paths, key=lambda path: (time_of(path) or 0) if timed else _natural(path)))


def _natural(path: Path) -> list[tuple[int, str]]:
    return [(int(text), "") if text.isdigit() else (-1, text) for text in re.split(r"(\d+)", path.name)]


def pair(
    keys: Sequence[Path], others: Sequence[Path], pairing: Pairing
) -> tuple[list[Path | None], list[float | None]]:
    """Find each key file's partner and the time from the key to it.

    Args:
        keys: Files in time order.
        others: Files of the other sensor in time order.
        pairing: ``nearest`` in time or by ``order``; partners farther off than ``max_dt_ms`` are not paired. Without
            times in the names only the order is left.

    Returns:
        Partner, and its time minus the key's in milliseconds, one each a key; None where there is none.
    """
    key_ns, other_ns = [time_of(path) for path in keys], [time_of(path) for path in others]
    timed = None not in key_ns and None not in other_ns
    count = min(len(keys), len(others))
    if not timed or not others:
        return [*others[:count], *[None] * (len(keys) - count)], [None] * len(keys)
    key_times, other_times = np.array(key_ns, dtype=np.int64), np.array(other_ns, dtype=np.int64)
    if pairing.mode == "order":
        choice = np.minimum(np.arange(len(keys)), len(others) - 1)
    else:
        after = np.clip(np.searchsorted(other_times, key_times), 1, max(len(other_times) - 1, 1))
        before = after - 1
        after = np.minimum(after, len(other_times) - 1)
        choice = np.where(
            np.abs(other_times[before] - key_times) <= np.abs(other_times[after] - key_times), before, after
        )
    dt_ms = (other_times[choice] - key_times) / 1e6
    good = np.abs(dt_ms) <= pairing.max_dt_ms
    good &= (np.arange(len(keys)) < len(others)) | (pairing.mode == "nearest")
    partners = [others[index] if ok else None for index, ok in zip(choice, good, strict=True)]
    return partners, [float(dt) if ok else None for dt, ok in zip(dt_ms, good, strict=True)]


def segment_numbers(times_ns: Sequence[int | None], gap_s: float) -> list[int]:
    """Number the segments of one part: a pause longer than ``gap_s`` begins the next; without times there is one."""
    if not times_ns or None in times_ns:
        return [0] * len(times_ns)
    pauses = np.diff(np.array(times_ns, dtype=np.float64)) > gap_s * 1e9  # exact to 256 ns, far below a pause
    return [0, *np.cumsum(pauses).tolist()]


def index_frames(root: Path, parts: Sequence[CirrusPart], mapping: Mapping) -> list[CirrusFiles]:
    """List the frames of all parts with their files and segments.

    Raises:
        DatasetError: If there is no cloud at all.
    """
    entries: list[CirrusFiles] = []
    first_segment = 0
    for part in parts:
        has_key = bool(part.files[mapping.pairing.key])
        key = mapping.pairing.key if has_key else ("uniform" if mapping.pairing.key == "gaussian" else "gaussian")
        other = "uniform" if key == "gaussian" else "gaussian"
        keys = part.files[key]
        partners, pair_dt = pair(keys, part.files[other], mapping.pairing)
        cameras, camera_dt = pair(keys, part.files["camera"], mapping.pairing)
        by_stem = {path.stem: path for path in part.files["labels"]}
        segments = segment_numbers([time_of(path) for path in keys], mapping.segments.gap_s)
        sign = 1.0 if key == "gaussian" else -1.0
        for index, path in enumerate(keys):
            sweeps = {key: path, other: partners[index]}
            gaussian, dt = sweeps["gaussian"], pair_dt[index]
            entries.append(
                CirrusFiles(
                    part=part,
                    sequence=f"segment_{first_segment + segments[index]:02d}",
                    **sweeps,
                    camera=cameras[index],
                    labels=None if gaussian is None else by_stem.get(gaussian.stem),
                    pair_dt_ms=None if dt is None else sign * dt,
                    camera_dt_ms=camera_dt[index],
                )
            )
        first_segment += max(segments, default=-1) + 1
    if not entries:
        raise DatasetError(f"{root}: expected Cirrus clouds, found none. {expectation(mapping)}")
    return entries


def expectation(mapping: Mapping) -> str:
    """Say what was looked for."""
    layout = mapping.layout or FolderLayout()
    looked = f"{layout.gaussian} or {layout.uniform} in the folder or its children"
    authors = "" if mapping.layout else f"; or the authors' {AUTHORS_LAYOUT.gaussian} in it or its folder 'dataset'"
    return f"Looked for {looked}{authors}. Another layout is described by a mapping file (layout: ...)."
