"""K-Radar's tesseracts reduced while they are read: 519 MB of numbers pass through a few, and never stand in memory."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32

from farfield.datasets.kradar.products import TESSERACT_SHAPE
from farfield.errors import FileFormatError
from farfield.files.mat_stream import open_mat
from farfield.radar.axes import KRADAR_AXES, RadarAxes
from farfield.radar.grid import cube_gather
from farfield.radar.products import Moments, moments_of_columns, polar3d_from_moments, sparse_clouds, zyx_cube
from farfield.radar.selection import Population

_BLOCK_CELLS = 256 * 37  # one azimuth: 4.8 MB in double precision


def read_moments(path: Path | str, axes: RadarAxes = KRADAR_AXES) -> Moments:
    """Reduce a tesseract over Doppler while it is read, in our orientation: angles rise to the left and upwards.

    Args:
        path: A MATLAB v5 file with the array ``arrDREA`` (64, 256, 37, 107) of single or double precision.
        axes: The tensor's axes in our orientation.

    Raises:
        FileFormatError: If the file is damaged or its array is another.
    """
    with open_mat(path, "arrDREA") as stream:
        if stream.shape != TESSERACT_SHAPE or stream.dtype.kind != "f":
            expected, found = f"floating-point numbers of shape {TESSERACT_SHAPE}", f"{stream.dtype} of {stream.shape}"
            raise FileFormatError(path, where="the array", expected=expected, found=found)
        reduced = moments_of_columns(stream.blocks(_BLOCK_CELLS), axes)
    return Moments(*(np.ascontiguousarray(values[:, ::-1, ::-1]) for values in reduced))


def read_polar3d(path: Path | str, axes: RadarAxes = KRADAR_AXES) -> Float32[np.ndarray, "2 r a e"]:
    """The polar map of a tesseract, see :func:`~farfield.radar.products.polar3d`.

    Raises:
        FileFormatError: If the file is damaged or its array is another.
    """
    reduced = read_moments(path, axes)
    return polar3d_from_moments(reduced.mean_power_63, reduced.velocity_moment)


class RadarProducts(NamedTuple):
    """What is made of one tesseract.

    Args:
        polar3d: See :func:`~farfield.radar.products.polar3d`.
        cube: See :func:`~farfield.radar.products.zyx_cube`.
        clouds: By rate, see :func:`~farfield.radar.products.sparse_cloud`.
    """

    polar3d: Float32[np.ndarray, "2 256 107 37"]
    cube: Float32[np.ndarray, "150 400 250"]
    clouds: Mapping[float, Float32[np.ndarray, "n 4"]]


def read_products(
    path: Path | str,
    rates: Sequence[float] = (0.01, 0.05, 0.1),
    *,
    over: Population = "all",
    axes: RadarAxes = KRADAR_AXES,
) -> RadarProducts:
    """Polar map, cube and sparse clouds of a tesseract, from one look at the file.

    Args:
        path: The file.
        rates: Densities of the clouds.
        over: Which cells their quantiles count, see :func:`~farfield.radar.products.sparse_cloud`.
        axes: The tensor's axes in our orientation.

    Raises:
        FileFormatError: If the file is damaged or its array is another.
    """
    with ThreadPoolExecutor(1) as beside:  # the first cube of a process needs its table, which is made meanwhile
        table = beside.submit(cube_gather, axes)
        reduced = read_moments(path, axes)
        table.result()
    cube = zyx_cube(reduced.mean_power, axes)
    polar = polar3d_from_moments(reduced.mean_power_63, reduced.velocity_moment)
    return RadarProducts(polar, cube, sparse_clouds(cube, rates, over=over))
