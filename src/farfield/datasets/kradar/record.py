"""What K-Radar's own files cannot hold of a frame: one JSON file a frame beside them, which other readers ignore.

``<sequence>/frame_record/00033_00001.json``. The files of a whole sequence (description, times, odometry,
calibrations, splits) are made from these records, whichever process wrote them in whatever order.
"""

import json
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from farfield.datasets.kradar.layout import CAMERAS, EYES, LIDARS, RADAR_PRODUCTS, label_stem
from farfield.datasets.kradar.products import first_shot_ns
from farfield.errors import FileFormatError, plain
from farfield.files.atomic import read_bytes, write_text
from farfield.frame import Camera, Frame

_MAX_BYTES = 1 << 20
_TIMED = (*LIDARS, *CAMERAS, *RADAR_PRODUCTS, "radar")  # what has a file of its own, and the radar
Number = Annotated[float, Field(allow_inf_nan=False, gt=-1e12, lt=1e12)]
Whole = Annotated[int, Field(ge=-(1 << 62), le=1 << 62)]
Row = tuple[Number, Number, Number, Number]
Pose = tuple[Row, Row, Row, Row]


class CameraRecord(BaseModel):
    """One eye's calibration."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    matrix: tuple[tuple[Number, Number, Number], tuple[Number, Number, Number], tuple[Number, Number, Number]]
    distortion: tuple[Number, Number, Number, Number, Number]
    camera_T_lidar: Pose
    width_px: Whole = 0
    height_px: Whole = 0

    @classmethod
    def of(cls, camera: Camera) -> "CameraRecord":
        """Record a camera."""
        arrays = {"matrix": camera.matrix, "distortion": camera.distortion, "camera_T_lidar": camera.camera_T_lidar}
        sizes = {"width_px": camera.width_px, "height_px": camera.height_px}
        return cls.model_validate({name: array.tolist() for name, array in arrays.items()} | sizes)

    def camera(self) -> Camera:
        """The camera."""
        return Camera(
            matrix=np.array(self.matrix, dtype=np.float64),
            distortion=np.array(self.distortion, dtype=np.float64),
            camera_T_lidar=np.array(self.camera_T_lidar, dtype=np.float64),
            width_px=self.width_px,
            height_px=self.height_px,
        )


class FrameRecord(BaseModel):
    """One frame: its sensors' indices and times, conditions, and the poses of the os2-64 and the os1-128.

    ``first_shot_ns`` is what must be added to a LiDAR file's ``t`` to get ``time_ns`` again.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    sequence: str
    indices: dict[str, Whole]
    time_ns: Whole
    times_ns: dict[str, Whole] = {}
    conditions: dict[str, str] = {}
    first_shot_ns: dict[str, Whole] = {}
    world_T_lidar: Pose | None = None
    os2_T_os1: Pose | None = None
    cameras: dict[str, CameraRecord] = {}

    @classmethod
    def of(cls, frame: Frame, indices: dict[str, int], time_ns: int) -> "FrameRecord":
        """Record a frame."""
        high = frame.sensors.get("os1-128")
        poses = {"world_T_lidar": frame.world_T_frame, "os2_T_os1": None if high is None else high.frame_T_sensor}
        times = {name: frame.sensors[name].time_ns for name in _TIMED if name in frame.sensors}
        return cls.model_validate(
            {
                "sequence": frame.sequence,
                "indices": dict(sorted(indices.items())),
                "time_ns": time_ns,
                "times_ns": {name: known for name, known in sorted(times.items()) if known is not None},
                "first_shot_ns": {name: first_shot_ns(frame.clouds[name]) for name in LIDARS if name in frame.clouds},
                "conditions": dict(sorted(frame.conditions.items())),
                "cameras": {name: CameraRecord.of(frame.cameras[name]) for name in EYES if name in frame.cameras},
                **{name: None if pose is None else np.asarray(pose).tolist() for name, pose in poses.items()},
            }
        )

    def pose(self, name: str) -> Float[np.ndarray, "4 4"] | None:
        """``"world_T_lidar"`` or ``"os2_T_os1"``."""
        rows = getattr(self, name)
        return None if rows is None else np.array(rows, dtype=np.float64)

    @property
    def stem(self) -> str:
        """Name of the frame."""
        return label_stem(self.indices["radar"], self.indices["os2-64"])


def record_path(sequence: str, stem: str) -> Path:
    """File of a record, relative to the root."""
    return Path(sequence) / "frame_record" / f"{stem}.json"


def write_record(path: Path, record: FrameRecord) -> None:
    """Write a record, all or nothing."""
    write_text(path, json.dumps(record.model_dump(mode="json", exclude_none=True), indent=1) + "\n")


def read_record(path: Path) -> FrameRecord:
    """Read a record.

    Raises:
        FileFormatError: If the file is damaged.
    """
    try:
        record = FrameRecord.model_validate_json(read_bytes(path, max_bytes=_MAX_BYTES))
        missing = {"radar", "os2-64"} - set(record.indices)
        if missing:
            raise ValueError(f"no index of {sorted(missing)[0]}")
    except (ValidationError, ValueError) as error:
        raise FileFormatError(path, where="the record", expected="a frame's record", found=plain(error)) from error
    return record
