"""Write frames in the public layout of Cirrus, so that simulated data travels every path that real data does."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from farfield.datasets.calibration import write_calibration
from farfield.datasets.losses import Capacity
from farfield.errors import DatasetError
from farfield.files.atomic import write_text
from farfield.files.images import write_image
from farfield.files.xyz import write_xyz
from farfield.frame import Annotation, Boxes, Cloud, Frame
from farfield.geometry.poses import quaternion_from_yaw

_EXTRA_COLUMNS = {"gaussian": 1, "uniform": 4}
_DECIMALS = (4, 4, 4, 6)

CIRRUS_HOLDS = Capacity(
    title="Cirrus' layout",
    read_by="cirrus",
    holds=frozenset(
        {"times", "poses", "conditions", "distortion", "tracks", "point counts", "empty frames", "other boxes"}
    ),
    together=("gaussian", "uniform"),
    columns=frozenset(f"extra{number}" for number in range(_EXTRA_COLUMNS["uniform"])),
    pictures="first",
    attributes=frozenset({"point_count_uniform"}),
    aliases={},
    extent="visible",
    file_names=None,
    annotated_only=frozenset({"poses", "conditions"}),
    rounding="points to 0.1 mm, intensities to 1e-6, further columns to whole numbers",
    jpeg=True,
    reasons={
        "names": "frames are named by their times, drives are counted",
        "times": "made up, 0.1 s apart: not all are known, or drives lie less than a second apart",
        "extent": "boxes are taken for those of the visible part",
    },
)


class CirrusWriter:
    """Write ``Cirrus_dataset<N>``: one file a sweep, annotation and image; the same bytes for the same frame.

    Clouds get 5 columns (Gaussian) or 8 (uniform): x, y, z with 4 decimals, intensity in 0..1 with 6, then the cloud's
    ``extra0``... or 0. Readers recover sequences from pauses, so frames of different sequences must lie more than a
    second apart in time.

    Args:
        root: Folder in which ``Cirrus_dataset<N>`` is made.
        number: N.
    """

    def __init__(self, root: Path | str, *, number: int = 1) -> None:
        self.root = Path(root) / f"Cirrus_dataset{number}"
        self.number = number
        self._written: dict[str, str] = {}
        self._has_calibration = False

    def paths(self, frame: Frame) -> dict[str, Path]:
        """Name the files of a frame by kind: gaussian, uniform, annotation, camera.

        Raises:
            DatasetError: If the frame has no time.
        """
        times = {name: self._time_ns(frame, name) for name in ("gaussian", "uniform", "camera")}
        paths = {name: self._folder(name) / f"{times[name]}.xyz" for name in _EXTRA_COLUMNS if name in frame.clouds}
        if frame.has_annotation:
            paths["annotation"] = self._folder("annotation") / f"{times['gaussian']}.json"
        if "camera" in frame.images:
            paths["camera"] = self._folder("camera") / f"{times['camera']}.jpg"
        return paths

    def write(self, frame: Frame, *, box_label_source: Literal["boxes", "full_boxes"] = "boxes") -> dict[str, Path]:
        """Write one frame.

        Args:
            frame: Clouds ``gaussian`` and ``uniform``, boxes, image and calibration ``camera``: what there is.
            box_label_source: ``"boxes"`` labels the frame's boxes (Cirrus: the visible part) and adds the annotation's
                ``full_boxes`` as extra keys; ``"full_boxes"`` labels those instead.

        Returns:
            The files written, by kind.

        Raises:
            DatasetError: If the frame has no time, no cloud, or the time of a frame of another sequence.
        """
        paths = self.paths(frame)
        if not paths.keys() & _EXTRA_COLUMNS.keys():
            raise DatasetError(f"frame {frame.key}: expected a cloud 'gaussian' or 'uniform', got {list(frame.clouds)}")
        stem = next(iter(paths.values())).stem
        if self._written.setdefault(stem, frame.sequence) != frame.sequence:
            raise DatasetError(f"frame {frame.key}: its time {stem} was written for sequence {self._written[stem]!r}")
        for path in paths.values():
            path.parent.mkdir(parents=True, exist_ok=True)
        for name in _EXTRA_COLUMNS.keys() & paths.keys():
            rows = cloud_rows(frame.clouds[name], _EXTRA_COLUMNS[name])
            write_xyz(paths[name], rows, decimals=(*_DECIMALS, *[0] * _EXTRA_COLUMNS[name]))
        if "annotation" in paths:
            content = annotation(frame, box_label_source)
            write_text(paths["annotation"], json.dumps(content, indent=1) + "\n")
        if "camera" in paths:
            write_image(paths["camera"], frame.images["camera"])
        if frame.cameras and not self._has_calibration:
            write_calibration(self.root / "calibration.json", frame.cameras)
            self._has_calibration = True
        return paths

    def _folder(self, kind: str) -> Path:
        return self.root / f"dataset{self.number}_{kind}"

    @staticmethod
    def _time_ns(frame: Frame, name: str) -> int:
        time_ns = frame.time_ns_of(name)
        if time_ns is not None:
            return time_ns
        raise DatasetError(f"frame {frame.key}: expected time_ns, which names the files of Cirrus; got None")


def cloud_rows(cloud: Cloud, extra_columns: int) -> Float[np.ndarray, "n c"]:
    """Rows x, y, z, intensity and the extra columns ``extra0``..., 0 where the cloud has none."""
    if cloud.intensity is None:
        raise DatasetError(
            "Cirrus holds LiDAR clouds with intensity: expected one, got a radar's. Choose it by `cloud`."
        )
    zero = np.zeros(len(cloud))
    extra = [cloud.extra.get(f"extra{number}", zero) for number in range(extra_columns)]
    return np.column_stack([cloud.points_m.astype(np.float64), cloud.intensity.astype(np.float64), *extra])


def annotation(frame: Frame, source: str = "boxes") -> dict[str, Any]:
    """Build the annotation file's content for a frame; lengths to a micrometre."""
    recorded = frame.annotation or Annotation(boxes=Boxes.empty())
    boxes, full = recorded.boxes, recorded.full_boxes
    if source == "full_boxes":
        if full is None:
            raise DatasetError(
                f"frame {frame.key}: expected full_boxes in its annotation, which box_label_source takes"
            )
        boxes, full = full, None
    columns: dict[str, list[Any]] = {
        "label_class": np.asarray(boxes.label).tolist(),
        "position": _rounded(boxes.centre_m),
        "size": _rounded(np.maximum(boxes.size_m, 1e-6)),
        "quaternion": np.round(quaternion_from_yaw(boxes.yaw_rad), 12).tolist(),
    }
    if full is not None:
        columns |= {"full_position": _rounded(full.centre_m), "full_size": _rounded(np.maximum(full.size_m, 1e-6))}
    if boxes.track_id is not None:
        columns["track_id"] = boxes.track_id.tolist()
    columns |= _point_counts(recorded, boxes)
    content: dict[str, Any] = {"label_type": "cuboid"}
    if frame.world_T_frame is not None:
        content["world_T_lidar"] = np.round(frame.world_T_frame, 12).tolist()
    if frame.conditions:
        content["conditions"] = dict(sorted(frame.conditions.items()))
    content["labels"] = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    return content


def _point_counts(annotation: Annotation, boxes: Boxes) -> Mapping[str, list[int]]:
    counts: dict[str, list[int]] = {}
    if boxes.point_count is not None:
        counts["point_count_gaussian"] = boxes.point_count.tolist()
    if "point_count_uniform" in annotation.details:
        counts["point_count_uniform"] = annotation.details["point_count_uniform"].tolist()
    return counts


def _rounded(values: Float[np.ndarray, "n 3"]) -> list[list[float]]:
    return np.round(values, 6).tolist()
