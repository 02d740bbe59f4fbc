"""Dual-Radar (Zhang et al., arXiv:2310.07602): a LiDAR, two 4D radars and a camera; no real file was seen.

``[training|testing]/{robosense,arbe,ars548,calib,image,label}/NNNNNN.*``, or by KITTI's names ``velodyne``, ``image_2``
and ``label_2``, with ``ImageSets/*.txt`` above. In the LiDAR's own axes x is right and y forward: all is turned.
Source: the authors' code, Apache-2.0, https://github.com/adept-thu/Dual-Radar.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from farfield.datasets.base import Dataset, Indices
from farfield.errors import ConfigError, DatasetError, FileFormatError, plain
from farfield.files.ascii_table import whole_numbers
from farfield.files.atomic import read_bytes
from farfield.files.clouds import read_bin
from farfield.files.dual_radar import LIDAR_T_RADAR, read_track_labels
from farfield.files.images import image_size, read_image
from farfield.files.intensities import intensity_scale_of, scaled_intensity
from farfield.files.kitti import read_calib
from farfield.files.limits import MAX_RINGS
from farfield.files.remote_paths import as_path
from farfield.files.suffixes import existing, pattern_in_any_case
from farfield.frame import Annotation, Boxes, Camera, CameraField, Cloud, Frame, Lazy, Sensor, camera_sensor
from farfield.frame.cloud import read_radar_rows
from farfield.frame.cloud_columns import points_of
from farfield.geometry.boxes import points_in_boxes
from farfield.geometry.poses import invert, pose_from_yaw, transform_points, unrigid
from farfield.vocabulary.classes import CIRRUS_FROM_KITTI, normalised_class
from farfield.vocabulary.counts import count_of

LABEL_AXES = ("auto", "camera", "lidar", "lidar-bottom")
FRAME_T_LIDAR = pose_from_yaw(-np.pi / 2)
"""The LiDAR's x is right, y is forward; the frame's x is forward."""
RADARS = {"arbe": ("power", "doppler_m_s"), "ars548": ("strength", "doppler_m_s")}
"""Columns of the radars' clouds behind x, y, z."""
_LIDAR_COLUMNS, _LISTS_BYTES = 6, 64 << 20
_FRAMES_LOOKED_AT, _LEAST_SHARE = 20, 0.6
_NO_CLASS = ("DontCare", "DonCare")
_FOLDERS = {"lidar": ("robosense", "velodyne"), "image": ("image", "image_2"), "label": ("label", "label_2")}


def is_dual_radar(root: Path) -> bool:
    """Whether a folder holds clouds of one of the two radars or of the Robosense, under the set's own names."""
    return _folder_of(root, "training") is not None or _folder_of(root, "testing") is not None


def _folder_of(root: Path, part: str) -> Path | None:
    for folder in (root / part, root):
        if any(_clouds(folder / name) for name in ("robosense", "arbe", "ars548")):
            return folder
    return None


def _clouds(folder: Path) -> bool:
    return next(folder.glob(pattern_in_any_case("*.bin")), None) is not None


class DualRadar(Dataset):
    """Dual-Radar's frames: clouds ``"lidar"``, ``"arbe"``, ``"ars548"``, image ``"camera"``, boxes with tracks.

    The LiDAR's cloud has ``ring`` and ``timestamp`` as the file has it; the radars' ``doppler_m_s``, and ``power``
    (Arbe) or ``strength`` (ARS 548) in units that are not published. Boxes are said to stand in the camera's
    coordinates, and elsewhere in those of the label: which is decided by the points in the boxes of up to 20 frames,
    and refused below 60 %. Which frames follow one another is not told.

    Args:
        root: The folder with ``training`` or ``testing``, or one of those itself.
        part: ``"training"`` or ``"testing"``.
        classes: ``"cirrus"`` translates class names, ``"dual_radar"`` keeps them.
        label_axes: ``"camera"`` (the centre of a box's bottom in the camera's coordinates), ``"lidar"`` (its centre in
            the LiDAR's own axes, rotation_y its yaw from x), ``"lidar-bottom"``, or ``"auto"``.
        intensity_scale: Value that stands for full reflectance; None decides by some of the clouds.

    Raises:
        DatasetError: If there is no cloud.
        ConfigError: If an option is none of those possible.
    """

    name = "dual_radar"

    def __init__(
        self,
        root: Path | str,
        *,
        part: Literal["training", "testing"] = "training",
        classes: str = "cirrus",
        label_axes: str = "auto",
        intensity_scale: float | int | None = None,
    ) -> None:
        if classes not in ("cirrus", "dual_radar"):
            raise ConfigError(f"dual_radar: expected classes to be one of 'cirrus', 'dual_radar', got {classes!r}")
        if label_axes not in LABEL_AXES:
            raise ConfigError(
                f"dual_radar: expected label_axes to be one of {', '.join(LABEL_AXES)}; got {label_axes!r}"
            )
        if intensity_scale is not None and not 0 < intensity_scale < np.inf:
            raise ConfigError(f"intensity_scale: expected a positive number, got {intensity_scale!r}")
        self.root, self.classes, self.chosen_axes, self.own_scale = as_path(root), classes, label_axes, intensity_scale
        folder = _folder_of(self.root, part)
        if folder is None:
            raise DatasetError(f"{self.root}: expected {part}/robosense, arbe or ars548 with *.bin, found none")
        self.folder = folder
        kinds = ("lidar", *RADARS)
        paths = {kind: _files(folder, kind, ".bin") for kind in kinds}
        self.frame_ids = tuple(sorted({stem for stems in paths.values() for stem in stems}))
        self.sequences = (part,) * len(self.frame_ids)
        self._clouds = paths
        self._labels = _files(folder, "label", ".txt")

    def drive_indices(self) -> Mapping[str, Indices]:
        """No drives: nothing tells which frames follow one another."""
        return {}

    def split_parts(self) -> dict[str, list[str]]:
        """The lists ``ImageSets/{train,val,test}.txt`` where they stand above the frames."""
        parts: dict[str, list[str]] = {}
        for name in ("train", "val", "test"):
            path = next((p for p in (self.root / "ImageSets", self.folder.parent / "ImageSets") if p.is_dir()), None)
            path = None if path is None else path / f"{name}.txt"
            if path is not None and path.is_file():
                try:
                    parts[name] = read_bytes(path, max_bytes=_LISTS_BYTES).decode("ascii").split()
                except UnicodeDecodeError as error:
                    expected = "numbers of frames, one a line"
                    raise FileFormatError(path, where="the list", expected=expected, got=plain(error)) from error
        return parts or super().split_parts()

    @cached_property
    def scale(self) -> float:
        """Value that stands for full reflectance, as given or as some of the LiDAR's clouds show it."""
        if self.own_scale is not None:
            return float(self.own_scale)
        paths = [self._clouds["lidar"][stem] for stem in _spread(sorted(self._clouds["lidar"]), 8)]
        return intensity_scale_of([_lidar_rows(path)[0][:, 3] for path in paths])

    @cached_property
    def label_axes(self) -> tuple[str, str]:
        """In which axes the labels stand, and by what that was decided; "" where it was said.

        Raises:
            DatasetError: If it cannot be told.
        """
        if self.chosen_axes != "auto":
            return self.chosen_axes, ""
        stems = _spread(sorted(self._labels.keys() & self._clouds["lidar"].keys()), _FRAMES_LOOKED_AT)
        if not stems:
            raise DatasetError(
                f"{self.folder}: expected clouds of the LiDAR (robosense) beside the labels, which show in which axes "
                "these stand; found none of the same frames. Say which: --label-axes camera, lidar or lidar-bottom (in "
                "Python label_axes=)"
            )
        hits, boxes = Counter[str](), 0
        for stem in stems:
            places = _lidar_rows(self._clouds["lidar"][stem])[0][:, :3].astype(np.float64)
            points_m = transform_points(FRAME_T_LIDAR, places)
            for axes in LABEL_AXES[1:]:
                annotation = self._annotated(stem, axes)
                hits[axes] += sum(len(rows) > 0 for rows in points_in_boxes(points_m, annotation.boxes))
            boxes += len(annotation.boxes)
        shares = {axes: hits[axes] / max(boxes, 1) for axes in LABEL_AXES[1:]}
        words = ", ".join(f"{axes} {share:.0%}" for axes, share in shares.items())
        basis = f"boxes that hold points, of {count_of(boxes, 'box')} in {count_of(len(stems), 'frame')}: {words}"
        if not boxes:  # nothing stands anywhere
            return "camera", ""
        if shares["camera"] < _LEAST_SHARE or shares["camera"] < max(shares.values()):
            raise DatasetError(
                f"{self.folder}: expected boxes in the camera's coordinates, {_LEAST_SHARE:.0%} of which hold points; "
                f"{basis}. The set's description names two frames: say which with --label-axes camera, lidar or "
                "lidar-bottom (in Python label_axes=)"
            )
        return "camera", f"labels stand in the camera's coordinates ({basis}); --label-axes overrules"

    @property
    def assumptions(self) -> tuple[str, ...]:
        """By what the labels' axes were decided."""
        sentence = self.label_axes[1] if self._labels else ""
        return (sentence,) if sentence else ()

    def _file(self, stem: str, kind: str, suffix: str) -> Path | None:
        folders = (self.folder / name for name in _FOLDERS.get(kind, (kind,)))
        return next((path for folder in folders if (path := existing(folder / f"{stem}{suffix}"))), None)

    def _image(self, stem: str) -> Path | None:
        return self._file(stem, "image", ".png") or self._file(stem, "image", ".jpg")

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``."""
        stem = self.frame_ids[index]
        clouds = [paths[stem] for paths in self._clouds.values() if stem in paths]
        beside = (self._labels.get(stem), self._file(stem, "calib", ".txt"), self._image(stem))
        return [*clouds, *(path for path in beside if path is not None)]

    def has_annotation(self, index: int) -> bool:
        """Whether there are labels of frame ``index``."""
        return self.frame_ids[index] in self._labels

    def _annotated(self, stem: str, axes: str, region: CameraField | None = None) -> Annotation:
        calib = self._file(stem, "calib", ".txt")
        return _read_annotation(self._labels[stem], calib, axes, self.classes, region)

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        stem = self.frame_ids[index]
        calib, image = self._file(stem, "calib", ".txt"), self._image(stem)
        clouds, sensors = {}, {}
        if stem in self._clouds["lidar"]:
            clouds["lidar"] = partial(_read_lidar, self._clouds["lidar"][stem], self.scale)
            sensors["lidar"] = Sensor(kind="lidar", frame_T_sensor=FRAME_T_LIDAR)
        for name in RADARS:
            if stem in self._clouds[name]:
                pose = FRAME_T_LIDAR @ LIDAR_T_RADAR[name]
                clouds[name] = partial(_read_radar, self._clouds[name][stem], name)
                sensors[name] = Sensor(kind="radar", frame_T_sensor=pose)
        cameras = {} if calib is None or image is None else {"camera": _camera(calib, image)}
        if cameras or image is not None:
            sensors["camera"] = camera_sensor(cameras.get("camera"))
        region = CameraField(camera=cameras["camera"], name="the camera") if cameras else None
        load = partial(self._annotated, stem, self.label_axes[0], region) if stem in self._labels else None
        return Frame(
            sequence=self.sequences[index],
            frame_id=stem,
            clouds=Lazy(clouds),
            images=Lazy({} if image is None else {"camera": partial(read_image, image)}),
            cameras=cameras,
            sensors=sensors,
            reference="lidar'",  # turned: x is forward
            load_annotation=load,
            metadata={"files": [str(path) for path in self.files(index)]},
        )


def _files(folder: Path, kind: str, suffix: str) -> dict[str, Path]:
    """Files of a kind by their stems."""
    for name in _FOLDERS.get(kind, (kind,)):
        paths = sorted((folder / name).glob(pattern_in_any_case(f"*{suffix}")))
        if paths:
            return {path.stem: path for path in paths if not path.name.startswith(".")}
    return {}


def _spread(stems: Sequence[str], most: int) -> list[str]:
    rows = np.unique(np.linspace(0, max(len(stems) - 1, 0), most).astype(int)).tolist()
    return [stems[row] for row in rows] if stems else []


def _lidar_rows(path: Path) -> tuple[Float[np.ndarray, "n 6"], int]:
    """The points, and how many rows are none."""
    rows = read_bin(path, columns=_LIDAR_COLUMNS, on_nan="keep")
    points = points_of(path, rows)
    if not np.isfinite(points).all():
        row = int(np.argmin(np.isfinite(points).all(axis=1)))
        actual = str(points[row].tolist())
        raise FileFormatError(path, where=f"point {row}", expected="six finite columns", got=actual)
    return points, len(rows) - len(points)


def _read_lidar(path: Path, scale: float) -> Cloud:
    rows, missing = _lidar_rows(path)
    ring = whole_numbers(rows[:, 4].astype(np.float64), largest=MAX_RINGS - 1, path=path, where="the ring")
    points = transform_points(FRAME_T_LIDAR, rows[:, :3].astype(np.float64)).astype(np.float32)
    strength = scaled_intensity(path, rows[:, 3], scale)
    return Cloud(points, strength, {"ring": ring, "timestamp": np.ascontiguousarray(rows[:, 5])}, missing)


def _read_radar(path: Path, name: str) -> Cloud:
    rows, missing = read_radar_rows(path, 3 + len(RADARS[name]))
    frame_T_radar = FRAME_T_LIDAR @ LIDAR_T_RADAR[name]
    points = transform_points(frame_T_radar, rows[:, :3].astype(np.float64)).astype(np.float32)
    extra = dict(zip(RADARS[name], np.ascontiguousarray(rows[:, 3:].T), strict=True))
    return Cloud(points, None, extra, missing)


def _camera_T_lidar(path: Path) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "3 4"]]:
    """The rectified camera's pose, and its projection."""
    matrices = read_calib(path)
    lidar = next((matrices[name] for name in ("Tr_velo_to_cam", "Tr_velo2cam") if name in matrices), None)
    turn = next((matrices[name] for name in ("R0_rect", "R0") if name in matrices), None)
    projection = matrices.get("P2")
    shapes = [None if matrix is None else matrix.shape for matrix in (projection, turn, lidar)]
    if projection is None or turn is None or lidar is None or shapes != [(3, 4), (3, 3), (3, 4)]:
        expected, actual = "P2, R0_rect and Tr_velo_to_cam", ", ".join(matrices)[:120]
        raise FileFormatError(path, where="the file", expected=expected, got=actual)
    pose = np.eye(4)
    pose[:3] = turn @ lidar
    if fault := unrigid(pose):
        raise FileFormatError(path, where="Tr_velo_to_cam", expected="a rigid motion", got=fault)
    return pose, projection


def _camera(path: Path, image: Path) -> Camera:
    camera_T_lidar, projection = _camera_T_lidar(path)
    shift = np.eye(4)
    try:
        shift[:3, 3] = np.linalg.solve(projection[:, :3], projection[:, 3])
    except np.linalg.LinAlgError as error:
        actual = str(projection.tolist())[:120]
        raise FileFormatError(path, where="P2", expected="a camera's projection", got=actual) from error
    width, height = image_size(image)
    pose = shift @ camera_T_lidar @ invert(FRAME_T_LIDAR)
    return Camera(matrix=projection[:, :3], camera_T_lidar=pose, width_px=width, height_px=height)


def _read_annotation(path: Path, calib: Path | None, axes: str, classes: str, region: CameraField | None) -> Annotation:
    labels = read_track_labels(path)
    cared = ~np.isin(labels.objects.type, _NO_CLASS)
    objects, tracks = labels.objects[cared], labels.track_id[cared]
    if not objects.has_box.all():
        line = int(objects.line[np.argmin(objects.has_box)])
        raise FileFormatError(path, where=f"line {line}", expected="positive sizes", got="others")
    centre = objects.bottom_m.copy()
    if axes == "camera":
        if calib is None:
            raise DatasetError(f"{path}: expected calib/{path.name}: its boxes stand in the camera's coordinates")
        centre = transform_points(invert(_camera_T_lidar(calib)[0]), centre)
    if axes != "lidar":
        centre[:, 2] += objects.size_m[:, 0] / 2  # height, width, length: the bottom's centre becomes the box's
    yaw = objects.rotation_y_rad if axes != "camera" else -objects.rotation_y_rad
    names = [str(name) for name in objects.type]
    boxes = Boxes(
        centre_m=centre,
        size_m=objects.size_m[:, ::-1].copy(),
        yaw_rad=yaw,
        label=names if classes == "dual_radar" else [normalised_class(name, CIRRUS_FROM_KITTI) for name in names],
        track_id=tracks,
    ).transform(FRAME_T_LIDAR)
    details = {"truncation": objects.truncation, "occlusion": objects.occlusion, "box_px": objects.box_px}
    return Annotation(
        boxes=boxes,
        original_label=tuple(names),
        details=details,
        unboxed={"dontcare_px": labels.objects[~cared].box_px},
        region=region,
    )
