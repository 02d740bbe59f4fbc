"""Where the files of K-Radar stand, and its fixed figures (K-Radar, NeurIPS 2022, and its development kit).

A tree is often partial: every modality is a download of its own, and big ones lie under other roots.
"""

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from farfield.vocabulary.kradar import KRADAR_ORIGIN_M, OUSTER_LINES, STEREO_CAMERAS

LIDARS = OUSTER_LINES
COLUMNS = 2048
CAMERAS = STEREO_CAMERAS
IMAGE_WIDTH_PX, IMAGE_HEIGHT_PX = 1280, 720  # of one eye
RIGHT_EYE = "-right"  # image "cam-front" is the left eye, "cam-front-right" the right one
INDEX_NAMES = ("radar", "os2-64", "cam-front", "os1-128", "cam-lrr")

LABEL_TREES = {
    "v2.1": ("kradar_revised_label_v2_1/KRadar_revised_visibility/{seq}", "KRadar_revised_visibility/{seq}"),
    "v2.0": ("kradar_revised_label_v2_0/KRadar_refined_label_by_UWIPL/{seq}", "KRadar_refined_label_by_UWIPL/{seq}"),
    "v1.1": ("kradar_revised_label_v1_1/{seq}_info_label_revised", "{seq}_info_label_revised"),
    "v1.0": ("{seq}/info_label",),
}

_PRODUCTS = {
    "tesseract": "{seq}/radar_tesseract/tesseract_{index:05d}.mat",
    "cube": "{seq}/radar_zyx_cube/cube_{index:05d}.mat",
    "polar3d": "rdr_polar_3d/{seq}/polar3d_{index:05d}.npy",
    "sparse": "rtnh_wider_10p_1/{seq}/sprdr_{index:05d}.npy",
    "sparse_1p": "rtnh_wider_1p_1/{seq}/sprdr_{index:05d}.npy",
    "corridor": "sp_rdr_cube/{seq}/spcube_{index:05d}.npy",
    "polar_cloud": "pc10p/{seq}/rpc_{index:05d}.npy",
    "polar_cloud_1p": "pc1p/{seq}/rpc_{index:05d}.npy",
    "polar_cloud_5p": "pc5p/{seq}/rpc_{index:05d}.npy",
    "polar_cloud_15p": "pc15p/{seq}/rpc_{index:05d}.npy",
    "polar_cloud_20p": "pc20p/{seq}/rpc_{index:05d}.npy",
    "polar_cloud_30p": "pc30p/{seq}/rpc_{index:05d}.npy",
    "cells": "radar_cells/{seq}/cells_{index:05d}.h5",
}
RADAR_PRODUCTS = tuple(_PRODUCTS)
POLAR_RATES = {
    "polar_cloud": 0.1,
    "polar_cloud_1p": 0.01,
    "polar_cloud_5p": 0.05,
    "polar_cloud_15p": 0.15,
    "polar_cloud_20p": 0.2,
    "polar_cloud_30p": 0.3,
}
"""Share of the polar grid's cells that each published cloud of it holds: ``pc1p`` to ``pc30p`` in the kit's loader."""
UNREAD = {
    "radar_ra": "arrays of (192, 64, 20) on some disks, which nothing describes (github.com/TUMFTM/DPFT issue 8)",
    "filtered_1": "clouds of RTNH+, which were never published",
}
"""Folders of disks that are not read, and why: what the tensors give can be made of ``radar_tesseract``."""
SPARSE_COLUMNS = {
    "sparse": (4, 5),
    "sparse_1p": (4, 5),
    "corridor": (4, 5),
    **{name: (5, 11) for name in _PRODUCTS if name.startswith("polar_cloud")},
}
"""Columns of the published clouds: x, y, z, power / 1e13, Doppler; and range, azimuth, elevation with their indices."""
RESOURCES = Path("resources")
SPLIT_FOLDER = RESOURCES / "split"
SEQUENCE_SPLIT = Path("splits") / "kradar_v1.json"

_STEM = re.compile(r"\d{5,}_\d{5,}")
_SEQUENCE = re.compile(r"[1-9]\d{0,2}")


def product_path(product: str, sequence: str, index: int) -> Path:
    """File of a radar product, LiDAR or camera, relative to the root.

    >>> product_path("cube", "1", 33).as_posix(), product_path("os2-64", "1", 1).as_posix()
    ('1/radar_zyx_cube/cube_00033.mat', '1/os2-64/os2-64_00001.pcd')
    """
    suffix = "pcd" if product in LIDARS else "png"
    pattern = _PRODUCTS.get(product, f"{{seq}}/{product}/{product}_{{index:05d}}.{suffix}")
    return Path(pattern.format(seq=sequence, index=index))


def index_name(product: str) -> str:
    """Which of a frame's indices numbers a product's files."""
    if product in _PRODUCTS:
        return "radar"
    return product if product in INDEX_NAMES else "cam-lrr"


def camera_number(image: str) -> int:
    """Number of an eye's calibration file: 1, 2 front; 3, 4 right; 5, 6 rear; 7, 8 left; the left eye first.

    >>> camera_number("cam-front"), camera_number("cam-left-right")
    (1, 8)
    """
    right = image not in CAMERAS
    return 2 * CAMERAS.index(image.removesuffix(RIGHT_EYE) if right else image) + 1 + right


EYES = {name: camera_number(name) for camera in CAMERAS for name in (camera, camera + RIGHT_EYE)}


def label_stem(radar: int, lidar: int) -> str:
    """Name of a frame: ``<radar>_<os2-64>``.

    >>> label_stem(33, 1)
    '00033_00001'
    """
    return f"{radar:05d}_{lidar:05d}"


def is_stem(name: str) -> bool:
    """Whether a name is a frame's."""
    return _STEM.fullmatch(name) is not None


def is_sequence(name: str) -> bool:
    """Whether a name is a sequence's: its number without zeros before it."""
    return _SEQUENCE.fullmatch(name) is not None


def os2_T_radar(x_m: float = KRADAR_ORIGIN_M[0], y_m: float = KRADAR_ORIGIN_M[1]) -> Float[np.ndarray, "4 4"]:
    """Pose of the radar in the os2-64's frame: a translation."""
    pose = np.eye(4)
    pose[:3, 3] = x_m, y_m, KRADAR_ORIGIN_M[2]
    return pose
