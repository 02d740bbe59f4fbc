"""What a mapping file may say about a copy of Cirrus: one key for every fact that the release leaves uncertain.

The defaults are the documented public layout. A YAML file may change any of them; an unknown key is an error::

    layout:   {gaussian: "dataset{n}_gaussian/*.xyz", uniform: "dataset{n}_uniform/*.xyz"}
    xyz:      {delimiter: auto, intensity_scale: auto}
    labels:   {size_order: lwh, quat_order: xyzw, position_is: center, aliases: {big car: large_vehicle}}
    pairing:  {mode: nearest, max_dt_ms: 100}
    calib:    {file: calibration.yaml}
    segments: {gap_s: 1.0}
"""

from pathlib import Path
from typing import Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from farfield.errors import ConfigError, plain
from farfield.vocabulary.classes import CIRRUS_CLASSES


class _MappingModel(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class FolderLayout(_MappingModel):
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


class ColumnNames(_MappingModel):
    """Names of the columns of each pattern's files. Files may have more or fewer extra ones."""

    gaussian: tuple[str, ...] = ("x", "y", "z", "intensity", "extra0")
    uniform: tuple[str, ...] = ("x", "y", "z", "intensity", "extra0", "extra1", "extra2", "extra3")

    @field_validator("*")
    @classmethod
    def _has_the_basics(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        if not {"x", "y", "z", "intensity"} <= set(names) or len(set(names)) != len(names):
            raise ValueError(f"expected distinct names with x, y, z and intensity, got {names}")
        return names


class Xyz(_MappingModel):
    """How to read the ASCII clouds."""

    delimiter: str = "auto"
    columns: ColumnNames = ColumnNames()
    intensity_scale: Literal["auto"] | float = Field("auto", description="value that stands for full reflectance")
    on_extra_columns: Literal["keep", "drop"] = "keep"


class Labels(_MappingModel):
    """How to read the annotations."""

    root: str = "labels"
    class_: str = Field("label_class", alias="class")
    position: str = "position"
    size: str = "size"
    quaternion: str = "quaternion"
    size_order: Literal["lwh", "wlh", "lhw", "hlw", "whl", "hwl"] = "lwh"
    quat_order: Literal["xyzw", "wxyz"] = "xyzw"
    position_is: Literal["center", "bottom"] = "center"
    yaw_scale: float = Field(1.0, description="factor on the yaw read; 57.29577951308232 mends degrees taken twice")
    yaw_offset_deg: float = 0.0
    text_naming: Literal["authors", "kitti"] = "authors"
    aliases: dict[str, str] = {}

    @field_validator("aliases")
    @classmethod
    def _known_targets(cls, aliases: dict[str, str]) -> dict[str, str]:
        wrong = sorted(set(aliases.values()) - set(CIRRUS_CLASSES))
        if wrong:
            raise ValueError(f"expected aliases of {', '.join(CIRRUS_CLASSES)}; got {', '.join(wrong)}")
        return aliases


class Pairing(_MappingModel):
    """How the uniform sweep and the image of a Gaussian sweep are found."""

    mode: Literal["nearest", "order"] = "nearest"
    max_dt_ms: float = Field(100.0, gt=0)
    key: Literal["gaussian", "uniform"] = "gaussian"


class Calib(_MappingModel):
    """Where the camera's calibration stands; relative to the data set's root."""

    file: str | None = None
    convention: Literal["lidar_to_cam", "cam_to_lidar"] = "lidar_to_cam"


class Axes(_MappingModel):
    """Directions of the clouds' axes. Only the documented ones are read; others need ``Dataset.moved``."""

    x: Literal["forward"] = "forward"
    y: Literal["left"] = "left"
    z: Literal["up"] = "up"


class Splits(_MappingModel):
    """Unit and file of the split."""

    unit: Literal["segment"] = "segment"
    file: str = "splits/cirrus_v1.json"


class Segments(_MappingModel):
    """How drives are separated: a pause longer than ``gap_s`` begins a new segment."""

    gap_s: float = Field(1.0, gt=0)


class Mapping(_MappingModel):
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
        content = yaml.safe_load(Path(path).read_text("utf-8"))
        return Mapping.model_validate({} if content is None else content)
    except ValidationError as error:
        raise ConfigError(f"{path}: {plain(error)}") from error
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise ConfigError(f"{path}: expected a mapping file in YAML, found: {plain(error)}") from error
