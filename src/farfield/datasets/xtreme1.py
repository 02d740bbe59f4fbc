"""Read data sets of Xtreme1: clouds, camera images and parameters, results.

A root is a scene, or holds scenes::

    lidar_point_cloud_0/*.pcd (as exported by older versions point_cloud/), result/<cloud>.json,
    camera_config/<cloud>.json, camera_image_<number>/<cloud>.jpg (older: image<number>/)

Described in https://docs.xtreme1.io/xtreme1-docs/product-guides/upload-dataset.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from farfield.datasets.labelled_clouds import LabelledCloud, LabelledClouds, clouds_in, folders_with, names_of_folders
from farfield.datasets.labels.tool_labels import Xtreme1Labels
from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes
from farfield.files.images import image_size, read_image
from farfield.files.suffixes import existing
from farfield.files.xtreme1 import MAX_BYTES, parse_cameras, parse_xtreme1
from farfield.frame import Camera
from farfield.geometry.poses import unrigid

_CLOUDS = ("lidar_point_cloud_0", "point_cloud")
_BESIDE = ("result", "camera_config", "data")
_IMAGES = (".jpg", ".jpeg", ".png")
_IMAGE_FOLDER = re.compile(r"(?:camera_image_|image_?)([0-9]{1,3})")


def is_xtreme1(root: Path) -> bool:
    """Whether a folder is a data set of Xtreme1, or holds scenes of one."""
    return bool(folders_with(root, _is_scene))


def _is_scene(folder: Path) -> bool:
    own = clouds_in(folder / _CLOUDS[0])
    older = clouds_in(folder / _CLOUDS[1]) and any((folder / name).is_dir() for name in _BESIDE)
    return bool(own or older)


class Xtreme1(LabelledClouds):
    """Xtreme1's data sets: point cloud ``"lidar"``, cameras, boxes with tracks; each scene is a sequence.

    Args: as of :class:`~farfield.datasets.labelled_clouds.LabelledClouds`.
    """

    name = "xtreme1"
    looked_at = "scenes of Xtreme1 (lidar_point_cloud_0/*.pcd, result/*.json)"
    parser = parse_xtreme1

    def find(self) -> Sequence[LabelledCloud]:
        """The clouds of all scenes, those of the root itself before those of scenes in it."""
        folders = folders_with(self.root, _is_scene)
        if folders == [self.root]:
            folders += sorted(path for path in self.root.iterdir() if path.is_dir() and _is_scene(path))
        names = names_of_folders(self.root, folders)
        return [
            LabelledCloud(cloud=cloud, sequence=names[folder], labels=folder / "result" / f"{cloud.stem}.json")
            for folder in folders
            for cloud in next(filter(None, (clouds_in(folder / name) for name in _CLOUDS)), [])
        ]

    def pictures(self, index: int) -> tuple[Mapping[str, Callable[[], Any]], Mapping[str, Camera], Sequence[Path]]:
        """Images by their folder's name, and those cameras that have parameters."""
        member = self.members[index]
        scene, stem = member.labels.parents[1], member.cloud.stem
        folders = {
            int(match[1]): folder
            for folder in sorted(scene.iterdir())
            if folder.is_dir() and (match := _IMAGE_FOLDER.fullmatch(folder.name))
        }
        paths = {
            number: path
            for number, folder in sorted(folders.items())
            if (path := next(filter(None, (existing(folder / f"{stem}{suffix}") for suffix in _IMAGES)), None))
        }
        images = {folders[number].name: partial(read_image, path) for number, path in paths.items()}
        config = existing(scene / "camera_config" / f"{stem}.json")
        cameras = {} if config is None else _cameras(config, folders, paths)
        return images, cameras, [*paths.values(), *([] if config is None else [config])]


def _cameras(path: Path, folders: Mapping[int, Path], images: Mapping[int, Path]) -> dict[str, Camera]:
    cameras = {}
    for number, (matrix, pose, width, height) in enumerate(parse_cameras(read_bytes(path, max_bytes=MAX_BYTES), path)):
        if fault := unrigid(pose):
            expected = "cameraExternal that brings the cloud's points into the camera, its order as rowMajor says"
            raise FileFormatError(path, where=f"camera {number}", expected=expected, got=fault)
        if not (width and height) and number in images:
            width, height = image_size(images[number])
        name = folders[number].name if number in folders else f"camera_image_{number}"
        cameras[name] = Camera(matrix=matrix, camera_T_lidar=pose, width_px=width, height_px=height)
    return cameras


def label_format(data: Xtreme1) -> Xtreme1Labels:
    """The label files of a data set, to edit them."""
    return Xtreme1Labels(
        data.root, paths={key: member.labels for key, member in zip(data.keys, data.members, strict=True)}
    )
