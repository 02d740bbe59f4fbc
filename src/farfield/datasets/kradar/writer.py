"""Write frames in the layout of K-Radar, so that simulated data travels every path that real data does."""

from pathlib import Path
from typing import Any

import numpy as np

from farfield.datasets.kradar.labels import format_labels
from farfield.datasets.kradar.layout import (
    CAMERAS,
    COLUMNS,
    LABEL_TREES,
    LIDARS,
    RADAR_PRODUCTS,
    RIGHT_EYE,
    index_name,
    is_sequence,
    label_stem,
    product_path,
)
from farfield.datasets.kradar.products import write_lidar, write_radar, write_stereo
from farfield.datasets.kradar.record import FrameRecord, record_path, write_record
from farfield.datasets.kradar.sequence_files import write_sequence_files
from farfield.errors import ConfigError, DatasetError
from farfield.files.atomic import write_text
from farfield.frame import Annotation, Boxes, Frame

VERSIONS = ("v1.0", "v2.1")


class KRadarWriter:
    """Write K-Radar: radar products, LiDAR sweeps, stereo images, annotations; the same bytes for the same frame.

    A frame's coordinates are the os2-64's: x forward, y left, z up. It brings what there is of

    - ``sequence``: a number from 1 to 999 without zeros before it; ``conditions``: ``road``, ``time``, ``weather``;
    - ``indices``: index of ``radar`` and ``os2-64``, and of ``cam-front``, ``os1-128`` and ``cam-lrr`` (the
      other three cameras) where there are such files;
    - clouds ``os2-64`` and ``os1-128``, the latter on its own sensor's axes, which its ``frame_T_sensor`` places; their
      columns are described at :func:`~farfield.datasets.kradar.products.write_lidar`;
    - radar products ``tesseract``, ``cube``, ``polar3d``, ``sparse``, ``cells`` in the radar's frame, described at
      :func:`~farfield.datasets.kradar.products.write_radar`;
    - images ``cam-front`` (left eye) and ``cam-front-right``, likewise ``cam-left``, ``cam-right`` and ``cam-rear``,
      and cameras of the same names;
    - an annotation: full boxes, with ``visibility`` (``R``, ``L`` or ``L1`` of each); ``time_ns``, ``world_T_frame``.

    A frame is complete when its record (``<sequence>/frame_record``) is there: it goes last. :meth:`finish` then writes
    the files of whole sequences.

    Args:
        root: Folder of the data set; made when a frame is written.
        labels: Versions of the annotations to write.
        tesseract_dtype: Dtype of the ``.mat`` arrays, tesseract and cube: ``"float32"``, or ``"float64"`` as in the
            real files, which are twice as large.
        compress: Pack the ``.mat`` files: smaller and much slower.
        columns: Columns of the LiDARs' grids.

    Raises:
        ConfigError: If an argument is not one of those possible.
    """

    def __init__(
        self,
        root: Path | str,
        labels: tuple[str, ...] = VERSIONS,
        tesseract_dtype: str = "float32",
        compress: bool = False,
        columns: int = COLUMNS,
    ) -> None:
        if not set(labels) <= set(VERSIONS):
            raise ConfigError(f"KRadarWriter: expected labels from {', '.join(VERSIONS)}; got {labels!r}")
        if tesseract_dtype not in ("float32", "float64"):
            raise ConfigError(f"KRadarWriter: expected tesseract_dtype float32 or float64, got {tesseract_dtype!r}")
        self.root = Path(root)
        self.labels, self.tesseract_dtype, self.compress, self.columns = labels, tesseract_dtype, compress, columns

    def paths(self, frame: Frame) -> dict[str, Path]:
        """Name the files of a frame by product, in the order in which they are written; nothing is loaded.

        Keys are the names of radar products, clouds and (left) images, ``label_v1.0``, ``label_v2.1`` and ``record``.

        Raises:
            DatasetError: If the sequence is no number, or an index or the time is missing.
        """
        indices, _ = self._indices(frame), self._time_ns(frame)
        products = [name for name in RADAR_PRODUCTS if name in frame.radar]
        products += [name for name in LIDARS if name in frame.clouds]
        products += [name for name in CAMERAS if name in frame.images or name + RIGHT_EYE in frame.images]
        found: dict[str, Path] = {}
        for product in products:
            index = indices.get(index_name(product))
            if index is None:
                missing = f"indices[{index_name(product)!r}], which numbers its {product} file"
                raise DatasetError(f"frame {frame.key}: expected {missing}")
            found[product] = self.root / product_path(product, frame.sequence, index)
        stem = label_stem(indices["radar"], indices["os2-64"])
        if frame.has_annotation:
            folders = {version: LABEL_TREES[version][0].format(seq=frame.sequence) for version in self.labels}
            found |= {f"label_{version}": self.root / folder / f"{stem}.txt" for version, folder in folders.items()}
        return found | {"record": self.root / record_path(frame.sequence, stem)}

    def write(self, frame: Frame) -> dict[str, Path]:
        """Write one frame, every file whole or not at all, the annotations and the record last.

        Returns:
            The files by product, as :meth:`paths` names them.

        Raises:
            DatasetError: If the frame lacks what names its files, or a product has another shape.
        """
        paths = self.paths(frame)
        for product, path in paths.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            self._write_one(frame, product, path)
        return paths

    def finish(self) -> list[Path]:
        """Write the files of whole sequences, from the records of all frames that stand in the root.

        That is description.txt, info_calib, time_info, camera calibrations, odometry, K-Radar's train and test lists,
        and a split that keeps sequences whole. Call it once, when all frames are written.

        Returns:
            The files written.
        """
        return write_sequence_files(self.root)

    def _write_one(self, frame: Frame, product: str, path: Path) -> None:
        if product in RADAR_PRODUCTS:
            options: dict[str, Any] = {"dtype": self.tesseract_dtype, "compress": self.compress}
            values = frame.radar[product]
            write_radar(path, product, values if product == "cells" else np.asarray(values), **options)
        elif product in LIDARS:
            write_lidar(path, frame.clouds[product], lines=LIDARS[product], columns=self.columns)
        elif product in CAMERAS:
            write_stereo(path, *(frame.images.get(name) for name in (product, product + RIGHT_EYE)))
        elif product == "record":
            write_record(path, FrameRecord.of(frame, self._indices(frame), self._time_ns(frame)))
        else:
            write_text(path, self._labels(frame, product.removeprefix("label_")))

    def _labels(self, frame: Frame, version: str) -> str:
        annotation = frame.annotation or Annotation(boxes=Boxes.empty())
        boxes, availability = annotation.boxes, list(annotation.visibility or ())
        if not set(availability) <= {"R", "L", "L1"}:
            found = ", ".join(sorted(set(availability)))
            raise DatasetError(f"frame {frame.key}: expected visibility R, L or L1 of each box, got {found}")
        indices, time_ns = self._indices(frame), self._time_ns(frame)
        return format_labels(boxes, indices, time_ns, version=version, availability=availability)

    @staticmethod
    def _indices(frame: Frame) -> dict[str, int]:
        indices = frame.indices
        if not is_sequence(frame.sequence) or not {"radar", "os2-64"} <= set(indices):
            raise DatasetError(
                f"frame {frame.key}: expected a sequence such as '1' and indices with 'radar' and "
                "'os2-64', which name the files of K-Radar"
            )
        return {name: int(index) for name, index in indices.items()}

    @staticmethod
    def _time_ns(frame: Frame) -> int:
        time_ns = frame.time_ns_of("os2-64")
        if time_ns is None:
            raise DatasetError(f"frame {frame.key}: expected time_ns, which the annotation's header gives; got None")
        return time_ns
