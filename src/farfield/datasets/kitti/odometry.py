"""KITTI's odometry benchmark (Geiger, Lenz, Urtasun, CVPR 2012) and SemanticKITTI (Behley et al., ICCV 2019).

``[dataset/]sequences/NN/{velodyne/NNNNNN.bin,calib.txt,times.txt,image_2}`` with poses in ``[dataset/]poses/NN.txt``,
or in ``sequences/NN/poses.txt`` where SemanticKITTI was unpacked: 12 numbers a line, the left grey camera seen from
where it stood first (``readme.txt`` of https://www.cvlibs.net/datasets/kitti/eval_odometry.php,
http://www.semantic-kitti.org/dataset.html). Neither has boxes.
"""

from collections.abc import Sequence
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from farfield.datasets.base import Dataset, Indices, Poses, all_known, all_poses
from farfield.datasets.cloud_reading import CloudReading
from farfield.datasets.kitti.boxes import sized_camera
from farfield.datasets.kitti.object import mounted
from farfield.errors import DatasetError, FileFormatError
from farfield.files.images import read_image
from farfield.files.kitti import read_calib, read_rows
from farfield.files.point_times import PointTimes
from farfield.files.remote_paths import as_path
from farfield.files.suffixes import any_case, existing
from farfield.frame import Frame, Lazy
from farfield.geometry.poses import invert, unrigid

_CLOUDS, _COLUMNS = f"velodyne/*{any_case('.bin')}", 4
_BASES = ("sequences", "dataset/sequences")
_IMAGES = (".png", ".jpg")
_SECONDS = 1e6  # no drive is longer


def drives_in(root: Path) -> list[Path]:
    """The sequences of a folder: those in ``sequences``, the folder's own, or itself, in the order of their names."""
    named = [path.parent for base in _BASES for path in root.glob(f"{base}/*/velodyne") if path.is_dir()]
    if not named:
        folders = [root, *sorted(path for path in root.iterdir() if path.is_dir())] if root.is_dir() else []
        named = [path for path in folders if (path / "calib.txt").is_file() and (path / "velodyne").is_dir()]
    return sorted(path for path in named if next(path.glob(_CLOUDS), None) is not None)


def is_kitti_odometry(root: Path) -> bool:
    """Whether a folder holds sequences of KITTI's odometry benchmark or of SemanticKITTI."""
    return bool(drives_in(root))


class KittiOdometry(Dataset):
    """Sequences of sweeps with poses: cloud ``"lidar"``, image ``"camera"`` (image_2); nothing is annotated.

    ``world_T_frame`` is the LiDAR's pose, seen from where it stood first (x ahead, z up). Times are seconds since a
    sequence began. Classes of points (SemanticKITTI's ``labels``) are no boxes and are not read.

    Args:
        root: The folder with ``sequences``, that folder, or one sequence.
        bin_columns: Columns of the clouds; None takes what the first show, and KITTI's four where they show none.
        intensity_scale: Value that stands for full reflectance in all clouds; None is KITTI's 1 for four columns, else
            decides by some of them.
        point_times: Unit of the points' times, where the files have any.

    Raises:
        DatasetError: If there is no sequence.
    """

    name = "kitti_odometry"
    reading: CloudReading

    def __init__(
        self,
        root: Path | str,
        *,
        bin_columns: int | None = None,
        intensity_scale: float | int | None = None,
        point_times: PointTimes = "auto",
    ) -> None:
        self.root = as_path(root)
        self._drives = {path.resolve().name: _Drive(path) for path in drives_in(self.root)}
        self.clouds = [
            path for drive in self._drives.values() for path in sorted(drive.root.glob(_CLOUDS)) if path.stem.isdigit()
        ]
        if not self.clouds:
            raise DatasetError(f"{self.root}: expected sequences/NN/velodyne/NNNNNN.bin, found none")
        self.sequences = tuple(path.parents[1].resolve().name for path in self.clouds)
        self.frame_ids = tuple(path.stem for path in self.clouds)
        self.reading = CloudReading(
            self.clouds,
            bin_columns=bin_columns,
            intensity_scale=intensity_scale,
            point_times=point_times,
            usual_columns=_COLUMNS,
            usual_scale=1.0,  # KITTI's reflectance reaches 1
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Classes of points, which are no boxes; sequences without poses."""
        labelled = [name for name, drive in self._drives.items() if next(drive.root.glob("labels/*.label"), None)]
        unposed = [name for name, drive in self._drives.items() if drive.poses_file is None]
        texts = []
        if labelled:
            texts.append(
                f"labels/*.label of {', '.join(labelled)} are not read: SemanticKITTI gives each point a class, and no "
                "boxes. The frames count as not annotated: predict, odometry and annotate take them, training does not"
            )
        if unposed:
            texts.append(
                f"no poses of {', '.join(unposed)}: expected poses/NN.txt beside sequences, or poses.txt in it, with "
                "Tr in calib.txt. farfield odometry makes poses"
            )
        return tuple(texts)

    def _drive(self, index: int) -> "_Drive":
        return self._drives[self.sequences[index]]

    def _image(self, index: int) -> Path | None:
        folder = self._drive(index).root / "image_2"
        return next((path for end in _IMAGES if (path := existing(folder / f"{self.frame_ids[index]}{end}"))), None)

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``; calibration, times and poses are shared by the sequence."""
        drive, image = self._drive(index), self._image(index)
        shared = (drive.root / "calib.txt", drive.root / "times.txt", drive.poses_file)
        beside = [path for path in shared if path is not None and path.is_file()]
        return [self.clouds[index], *([] if image is None else [image]), *beside]

    def _times_of(self, indices: Indices) -> Indices | None:
        return all_known(self._drive(index).time_ns(int(self.frame_ids[index])) for index in indices.tolist())

    def _poses_of(self, indices: Indices) -> Poses | None:
        return all_poses(self._drive(index).pose(int(self.frame_ids[index])) for index in indices.tolist())

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        drive, image, number = self._drive(index), self._image(index), int(self.frame_ids[index])
        calib = drive.calib
        has_camera = "P2" in calib and "Tr_velo_to_cam" in calib
        cameras = {"camera": sized_camera(calib, image)} if has_camera else {}
        return Frame(
            sequence=self.sequences[index],
            frame_id=self.frame_ids[index],
            time_ns=drive.time_ns(number),
            clouds=Lazy({"lidar": self.reading.loader(self.clouds[index])}),
            images=Lazy({} if image is None else {"camera": partial(read_image, image)}),
            cameras=cameras,
            sensors=mounted(cameras, image is not None),
            world_T_frame=drive.pose(number),
            metadata={"files": [str(path) for path in self.files(index)]},
        )


class _Drive:
    """One sequence: its calibration, times and poses, each read once."""

    def __init__(self, root: Path) -> None:
        self.root = root
        name = root.resolve().name
        candidates = [root / "poses.txt", root.resolve().parent.parent / "poses" / f"{name}.txt"]
        self.poses_file = next((path for path in candidates if path.is_file() and "Tr_velo_to_cam" in self.calib), None)

    @cached_property
    def calib(self) -> dict[str, Float[np.ndarray, "rows columns"]]:
        """The calibration by the names of the object benchmark: the odometry's pictures are rectified."""
        path = self.root / "calib.txt"
        calib = read_calib(path) if path.is_file() else {}
        motion = calib.get("Tr", calib.get("Tr_velo_to_cam"))
        if motion is None:
            return calib
        if motion.shape != (3, 4) or unrigid(_square(motion)):
            raise FileFormatError(path, where="Tr", expected="a rotation and a translation", got=str(motion.tolist()))
        return {**calib, "R0_rect": np.eye(3), "Tr_velo_to_cam": motion}

    @cached_property
    def _times_s(self) -> Float[np.ndarray, " n"]:
        path = self.root / "times.txt"
        return read_rows(path, 1, largest=_SECONDS)[:, 0] if path.is_file() else np.zeros(0)

    def time_ns(self, number: int) -> int | None:
        """When a frame was taken since the sequence began; None without a list or so many lines."""
        return round(1e9 * float(self._times_s[number])) if number < len(self._times_s) else None

    @cached_property
    def _world_T_lidar(self) -> Float[np.ndarray, "n 4 4"]:
        if self.poses_file is None:
            return np.zeros((0, 4, 4))
        camera_T_lidar = _square(self.calib["Tr_velo_to_cam"])
        rows = read_rows(self.poses_file, 12)
        first_T_camera = np.stack([_square(row.reshape(3, 4)) for row in rows])
        wrong = next((row for row, matrix in enumerate(first_T_camera) if unrigid(matrix)), None)
        if wrong is not None:
            got = unrigid(first_T_camera[wrong])
            raise FileFormatError(self.poses_file, where=f"pose {wrong}", expected="a rotation, a place", got=got)
        return np.asarray(invert(camera_T_lidar) @ first_T_camera @ camera_T_lidar)

    def pose(self, number: int) -> Float[np.ndarray, "4 4"] | None:
        """Where the LiDAR stood, seen from its first place; None where no line says it."""
        return self._world_T_lidar[number] if number < len(self._world_T_lidar) else None


def _square(matrix: Float[np.ndarray, "3 4"]) -> Float[np.ndarray, "4 4"]:
    """A motion of three rows with the fourth; its turn made exact, as six digits leave it inexact."""
    square = np.eye(4)
    left, stretch, right = np.linalg.svd(matrix[:, :3])
    near = bool(np.abs(stretch - 1).max() < 1e-3)
    square[:3, :3], square[:3, 3] = left @ right if near else matrix[:, :3], matrix[:, 3]
    return square
