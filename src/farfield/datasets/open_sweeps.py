"""Open Sweeps: real sweeps of streets that ship with the package, with their licences, boxes and a card.

``sweeps.json`` lists them; ``NAME.sweep`` holds the points of one, ``NAME.json`` its boxes as
:func:`farfield.datasets.folder.read_boxes` reads them. A ``.sweep`` is one zlib stream of int16, little-endian, a row
a column (x, y, z in steps, and where the sensor gives them reflectivity and ring), each number less the one before it,
modulo 2^16. Boxes of the class ``unknown`` are what nobody could tell for sure, or the measuring car itself.

``labels/first`` and ``labels/second`` hold the two passes of the annotation, made without sight of each other.
"""

import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float, Float32, Int16, Real
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from farfield.datasets.base import Dataset
from farfield.datasets.folder import read_boxes
from farfield.datasets.joined import Joined
from farfield.errors import FileFormatError, plain
from farfield.files.atomic import read_bytes
from farfield.files.json_text import parse_json
from farfield.files.limits import MAX_NAME
from farfield.files.remote_paths import as_path
from farfield.frame import Annotation, Cloud, Frame, Lazy, Sensor
from farfield.geometry.poses import pose_from_yaw, transform_points

NAME = "open-sweeps"
ROOT = Path(__file__).parent / NAME
"""Where those of the package stand."""
INDEX, SUFFIX, CLOUD = "sweeps.json", ".sweep", "lidar"
ALL_OTHERS = "not-"
"""Before a place's name in that of the part which holds all others."""
DIRECTIONS = ("", "-back")
DIRECTIONS_RAD = {"": 0.0, "-back": np.pi}
"""What follows a sweep's name in its frames' names, and by how much they are turned."""
PASSES = ("first", "second")
"""Folders of the annotation's two passes, in ``labels``."""
STEP_M = 1 / 128
"""Coordinates are whole numbers of these, 7.8 mm: less than the sensors' own scatter of one to eight centimetres."""
_FARTHEST_M = 32767 * STEP_M
MAX_POINTS = 1 << 21
_FULL_REFLECTIVITY = 255.0

_Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]*$", max_length=MAX_NAME)]


class OpenSweep(BaseModel):
    """One sweep, as ``sweeps.json`` has it."""

    model_config = ConfigDict(extra="forbid")

    name: _Name
    location: _Name = Field(
        description="Where it was measured; a score on a place that the weights learnt from says so."
    )
    sensor: str = Field(max_length=MAX_NAME)
    points: int = Field(gt=0, le=MAX_POINTS)
    columns: list[Literal["reflectivity", "ring"]] = Field(default=[], max_length=2, description="Beside x, y and z.")
    source: str = Field(max_length=500)
    licence: str = Field(max_length=100)

    @model_validator(mode="after")
    def _unambiguous(self) -> "OpenSweep":
        if len(set(self.columns)) < len(self.columns):
            raise ValueError(f"columns: expected each once, got {', '.join(self.columns)}")
        if self.location.startswith(ALL_OTHERS):
            raise ValueError(f"location: expected no {ALL_OTHERS!r}, by which parts are called, got {self.location!r}")
        return self


class _Index(BaseModel):
    model_config = ConfigDict(extra="forbid")

    open_sweeps: list[OpenSweep] = Field(min_length=1, max_length=1000)

    @model_validator(mode="after")
    def _unique(self) -> "_Index":
        frames = [f"{sweep.name}{direction}" for sweep in self.open_sweeps for direction in DIRECTIONS]
        if repeated := next((name for name, count in Counter(frames).items() if count > 1), None):
            raise ValueError(f"name: expected different frames, got {repeated!r} twice")
        return self


def is_open_sweeps(root: Path) -> bool:
    """Whether a folder holds Open Sweeps."""
    return (root / INDEX).is_file() and next(root.glob(f"*{SUFFIX}"), None) is not None


class OpenSweeps(Dataset):
    """Real sweeps of streets with boxes around whole bodies, to 70 m all around; a sequence is a place.

    Each sweep is two frames: as it is, and turned by half a turn about z (``NAME-back``), for detectors that look
    ahead. A frame has one cloud ``"lidar"``: x ahead, y left, z up from the sensor. Its intensity is the reflectivity
    over 255; the VLS-128's points came without. Places are parts: ``split("corner")`` is one, ``split("not-corner")``
    all others.

    Args:
        root: Folder with ``sweeps.json``; the package's own is :data:`ROOT`.

    Raises:
        FileFormatError: If the index is damaged.
    """

    name = "open_sweeps"
    protocol = "open-sweeps"

    def __init__(self, root: Path | str = ROOT) -> None:
        self.root = as_path(root)
        path = self.root / INDEX
        try:
            index = _Index.model_validate(parse_json(read_bytes(path, max_bytes=1 << 20), path))
        except ValidationError as error:
            raise FileFormatError(path, where="keys", expected="open_sweeps", got=plain(error)) from error
        self.sweeps = tuple(sorted(index.open_sweeps, key=attrgetter("location", "name")))
        self.sequences = tuple(sweep.location for sweep in self.sweeps for _ in DIRECTIONS)
        self.frame_ids = tuple(f"{sweep.name}{direction}" for sweep in self.sweeps for direction in DIRECTIONS)

    @property
    def places(self) -> tuple[str, ...]:
        """Names of the places."""
        return tuple(dict.fromkeys(self.sequences))

    def drive_indices(self) -> dict[str, np.ndarray]:
        """None: the sweeps of a place are of different sensors, one moment each."""
        return {}

    def split_units(self) -> tuple[str, ...]:
        """Their places, which are not torn apart."""
        return self.sequences

    def split_parts(self) -> dict[str, list[str]]:
        """The places, one alone or all others."""
        alone = {name: [name] for name in self.places}
        return alone | {
            f"{ALL_OTHERS}{name}": [other for other in self.places if other != name] for name in self.places
        }

    def files(self, index: int) -> Sequence[Path]:
        """The sweep and its boxes."""
        name = self.sweeps[index // len(DIRECTIONS)].name
        return [path for path in (self.root / f"{name}{SUFFIX}", self.root / f"{name}.json") if path.is_file()]

    def measurement(self, index: int) -> int:
        """Both directions of a sweep are one measurement."""
        return index // len(DIRECTIONS)

    def has_annotation(self, index: int) -> bool:
        """Whether boxes stand beside a sweep."""
        return (self.root / f"{self.sweeps[index // len(DIRECTIONS)].name}.json").is_file()

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        sweep, direction = self.sweeps[index // len(DIRECTIONS)], DIRECTIONS[index % len(DIRECTIONS)]
        frame_T_sensor = pose_from_yaw(DIRECTIONS_RAD[direction])
        labels = self.root / f"{sweep.name}.json"
        return Frame(
            sequence=sweep.location,
            frame_id=self.frame_ids[index],
            clouds=Lazy({CLOUD: partial(_cloud, self.root / f"{sweep.name}{SUFFIX}", sweep, frame_T_sensor)}),
            sensors={CLOUD: Sensor(kind="lidar", frame_T_sensor=frame_T_sensor)},
            reference=CLOUD,
            load_annotation=partial(_annotation, labels, frame_T_sensor) if labels.is_file() else None,
            metadata={"files": [str(path) for path in self.files(index)], "source": sweep.source},
        )


def package_places(data: Dataset) -> tuple[str, ...]:
    """Places of the package's own Open Sweeps from which frames are, through maps and selections; () for others.

    A user's folder of this format may call another place by the same name: its places are not among them.
    """
    reader, names = data.unwrapped, set(data.sequences)
    if isinstance(reader, Joined):
        return tuple(sorted(names & {name for part in reader.parts for name in package_places(part)}))
    own = isinstance(reader, OpenSweeps) and reader.root.resolve() == ROOT.resolve()
    return tuple(sorted(names)) if own else ()


def _cloud(path: Path, sweep: OpenSweep, frame_T_sensor: Float[np.ndarray, "4 4"]) -> Cloud:
    cloud = read_sweep(path, sweep)
    return replace(cloud, points_m=transform_points(frame_T_sensor, cloud.points_m).astype(np.float32))


def _annotation(path: Path, frame_T_sensor: Float[np.ndarray, "4 4"]) -> Annotation:
    return Annotation(boxes=read_boxes(path).transform(frame_T_sensor), version="1")


def read_sweep(path: Path, sweep: OpenSweep) -> Cloud:
    """Read the points of one sweep.

    Args:
        path: The file.
        sweep: Its entry of the index, by which its size is known before it is unpacked.

    Raises:
        FileFormatError: If it does not unpack to just so many points.
    """
    shape = (3 + len(sweep.columns), sweep.points)
    size = 2 * shape[0] * shape[1]
    unpacker = zlib.decompressobj()
    try:
        data = unpacker.decompress(read_bytes(path, max_bytes=size + 4096), size + 1)
    except zlib.error as error:
        raise FileFormatError(path, where="byte 0", expected="a zlib stream", got=str(error)) from error
    if len(data) != size or not unpacker.eof:
        more = "more" if len(data) > size else str(len(data))
        raise FileFormatError(path, where="unpacked", expected=f"{size} bytes, as {INDEX} says", got=more)
    steps = np.cumsum(np.frombuffer(data, dtype="<i2").reshape(shape), axis=1, dtype=np.int16)
    columns = dict(zip(sweep.columns, steps[3:], strict=True))
    reflectivity = columns.get("reflectivity")
    extra: dict[str, np.ndarray] = {} if "ring" not in columns else {"ring": columns["ring"].astype(np.int32)}
    if reflectivity is not None:
        extra["reflectivity"] = reflectivity.astype(np.float32)
    intensity = None if reflectivity is None else _checked(path, reflectivity) / np.float32(_FULL_REFLECTIVITY)
    return Cloud(np.ascontiguousarray(steps[:3].T).astype(np.float32) * np.float32(STEP_M), intensity, extra)


def _checked(path: Path, reflectivity: Int16[np.ndarray, " n"]) -> Float32[np.ndarray, " n"]:
    if reflectivity.min() < 0 or reflectivity.max() > _FULL_REFLECTIVITY:
        raise FileFormatError(path, where="reflectivity", expected="0 to 255", got=str(reflectivity.max()))
    return reflectivity.astype(np.float32)


def pack_sweep(points_m: Float32[np.ndarray, "n 3"], columns: Sequence[Real[np.ndarray, " n"]]) -> bytes:
    """What :func:`read_sweep` reads.

    Args:
        points_m: The points, at most 255 m away along an axis.
        columns: Further columns of whole numbers.

    Raises:
        ValueError: If a point lies farther away.
    """
    if np.abs(points_m).max() > _FARTHEST_M:
        raise ValueError(f"pack_sweep: expected points within {_FARTHEST_M:.0f} m, got {np.abs(points_m).max():.0f}")
    rows = [*np.round(points_m / STEP_M).T.astype(np.int32), *(column.astype(np.int32) for column in columns)]
    differences = np.diff(np.stack(rows), axis=1, prepend=0)
    return zlib.compress(np.ascontiguousarray(differences.astype("<i2")).tobytes(), 9)
