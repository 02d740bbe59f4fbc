"""Radar products, LiDAR clouds and stereo images of K-Radar: from our orientation to the files' and back.

In Farfield azimuth rises to the left, elevation and z rise upwards. The radar's files have them the other way round:
the development kit negates both angles of the stored axes and flips the cube's z.
"""

import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int64, Num, Shaped, UInt8
from PIL import Image

from farfield.datasets.kradar.layout import LIDARS, SPARSE_COLUMNS
from farfield.errors import DatasetError, FileFormatError
from farfield.files.atomic import write_bytes
from farfield.files.images import read_image
from farfield.files.mat import open_mat, read_mat, write_mat
from farfield.files.npy import read_npy, write_npy
from farfield.files.pcd import read_pcd, write_pcd
from farfield.files.point_times import PointTimeColumn
from farfield.files.radar_cells import read_radar_cells, write_radar_cells
from farfield.frame import Cloud
from farfield.frame.cloud_columns import returned
from farfield.radar.axes import KRADAR_AXES, OUTSIDE, RadarAxes, cube_gather
from farfield.radar.cells import RATES, RadarCells
from farfield.radar.products import (
    Moments,
    Population,
    moments_of_columns,
    polar3d_from_moments,
    sparse_clouds,
    zyx_cube,
)

TESSERACT_SHAPE = (64, 256, 37, 107)  # Doppler, range, elevation, azimuth
CUBE_SHAPE = (150, 400, 250)  # z, y, x
POLAR_SHAPE = (2, 256, 107, 37)  # power and Doppler; range, azimuth, elevation
_TURN_NS, _FAR_NS = 100_000_000, 1 << 62
INTENSITY_COUNTS = 1024.0  # signal counts that stand for intensity 1; a power of two, so that scaling loses no bit
_FIELDS = ("x", "y", "z", "intensity", "t", "reflectivity", "ring", "ambient", "range")
_DTYPES = dict(zip(_FIELDS, ("f4", "f4", "f4", "f4", "u4", "u2", "u1", "u2", "u4"), strict=True))


def write_radar(
    path: Path,
    product: str,
    values: Shaped[np.ndarray, "..."] | RadarCells,
    *,
    dtype: str = "float32",
    compress: bool = False,
) -> None:
    """Write one radar product.

    Args:
        path: The file.
        product: ``"tesseract"``: linear power, Doppler x range x elevation x azimuth (64, 256, 37, 107);
            ``"cube"``: z x y x x (150, 400, 250), -1 outside the field of view; ``"polar3d"``: power / 1e13 and Doppler
            in m/s, each range x azimuth x elevation, (2, 256, 107, 37); ``"sparse"``, ``"sparse_1p"``,
            ``"corridor"``: x, y, z, power / 1e13 (and Doppler) in the radar's frame, shape (n, 4 or 5);
            ``"polar_cloud"``, ``"polar_cloud_1p"``, ``_5p``, ``_15p``, ``_20p``, ``_30p``: the same with Doppler, or 11
            columns; ``"cells"``: the cells of a region, Farfield's own store. Angles, z and y rise in our sense: to the
            left and up.
        values: The product.
        dtype: Dtype of the tesseract and the cube in the file; the real ones have float64. The others get float64.
        compress: Pack the ``.mat`` files.

    Raises:
        DatasetError: If the shape is another.
    """
    if isinstance(values, RadarCells):
        write_radar_cells(
            path, index=values.index, code=values.code, quantiles=values.quantiles, doppler=values.doppler
        )
    elif product == "tesseract":
        write_mat(
            path, "arrDREA", _shaped(product, values, TESSERACT_SHAPE, dtype)[:, :, ::-1, ::-1], compress=compress
        )
    elif product == "cube":
        write_mat(path, "arr_zyx", _shaped(product, values, CUBE_SHAPE, dtype)[::-1], compress=compress)
    elif product == "polar3d":
        write_npy(path, _shaped(product, values, POLAR_SHAPE, "float64")[:, :, ::-1, ::-1])
    else:
        write_npy(path, _shaped(product, values, (len(values), _columns(product, values)), "float64"))


def read_radar(path: Path, product: str) -> Shaped[np.ndarray, "..."] | RadarCells:
    """Read one radar product in our orientation, with the file's dtype; see :func:`write_radar`.

    Raises:
        FileFormatError: If the file is damaged or its array has another shape.
    """
    if product == "cells":
        return read_cells(path)
    if product == "tesseract":
        tensor = _checked(path, read_mat(path, "arrDREA"), TESSERACT_SHAPE)
        check_power(path, tensor)
        return tensor[:, :, ::-1, ::-1]
    if product == "cube":
        cube = _checked(path, read_mat(path, "arr_zyx"), CUBE_SHAPE)
        check_power(path, cube, outside=OUTSIDE)
        return cube[::-1]
    if product == "polar3d":
        polar = _checked(path, read_npy(path), POLAR_SHAPE)
        check_power(path, polar[0])
        _check_finite(path, polar[1])
        return polar[:, :, ::-1, ::-1]
    points = read_npy(path)
    points = _checked(path, points, (len(points) if points.ndim else 0, _columns(product, points)))
    check_power(path, points[:, 3])
    _check_finite(path, points)
    return points


def check_power(
    path: Path | str, power: Float[np.ndarray, "..."], *, outside: float | None = None, name: str = "power"
) -> None:
    """Refuse power that cannot be measured: a damaged file must not become cells that look sound.

    Args:
        path: The file.
        power: Linear power.
        outside: What stands for a cell outside the field of view, besides.
        name: What it is called in the error.

    Raises:
        FileFormatError: If a cell is not finite or negative.
    """
    if not power.size:
        return
    least, largest = power.min(), power.max()  # both are NaN where a cell is
    if np.isfinite(largest) and (least >= 0 or (least == outside and not _impossible(power, outside).any())):
        return
    wrong = _impossible(power, outside)
    raise FileFormatError(
        path,
        where=f"the {name}",
        expected=f"finite {name} of 0 or more"
        + ("" if outside is None else f", or {outside:g} outside the field of view"),
        got=f"{int(wrong.sum())} cell(s) such as {power[wrong][0]:g}",
        fix="The file is damaged: fetch it again, or leave the frame out.",
    )


def _impossible(power: Float[np.ndarray, "..."], outside: float | None) -> Bool[np.ndarray, "..."]:
    """Cells whose power is not finite or negative."""
    with np.errstate(invalid="ignore"):
        wrong: np.ndarray = ~((power >= 0) & (power < np.inf)) & (power != (np.nan if outside is None else outside))
    return wrong


def _check_finite(path: Path, values: Float[np.ndarray, "..."]) -> None:
    if not np.isfinite(values).all():
        got = f"{int((~np.isfinite(values)).sum())} that are not"
        raise FileFormatError(path, where="the array", expected="finite numbers", got=got, fix="The file is damaged.")


def _sound_blocks(path: Path | str, blocks: Iterable[Float[np.ndarray, "n d"]]) -> Iterator[Float[np.ndarray, "n d"]]:
    for block in blocks:
        check_power(path, block)
        yield block


def _columns(product: str, values: Shaped[np.ndarray, "..."]) -> int:
    """How many columns a cloud should have: as many as it has, if that is possible."""
    possible = SPARSE_COLUMNS[product]
    return values.shape[1] if values.ndim == 2 and values.shape[1] in possible else possible[0]


def read_cells(path: Path) -> RadarCells:
    """Read the store of one frame.

    Raises:
        FileFormatError: If the file is damaged, or its quantiles are not those that this version knows.
    """
    columns = read_radar_cells(path)
    if columns["quantiles"].shape != (2, len(RATES)):
        expected, actual = f"quantiles of shape {(2, len(RATES))}", f"{columns['quantiles'].shape}"
        raise FileFormatError(path, where="column 'quantiles'", expected=expected, got=actual)
    return RadarCells(columns["index"], columns["code"], columns.get("doppler"), columns["quantiles"])


def _shaped(product: str, values: Shaped[np.ndarray, "..."], shape: tuple[int, ...], dtype: str) -> np.ndarray:
    if values.shape != shape:
        raise DatasetError(f"{product}: expected an array of shape {shape}, got {values.shape}")
    return values.astype(dtype, copy=False)


def _checked(path: Path, values: Shaped[np.ndarray, "..."], shape: tuple[int, ...]) -> np.ndarray:
    if values.shape != shape or values.dtype.kind != "f":
        expected, actual = f"floating-point numbers of shape {shape}", f"{values.dtype} of shape {values.shape}"
        raise FileFormatError(path, where="the array", expected=expected, got=actual)
    return values


def write_lidar(path: Path, cloud: Cloud, *, lines: int, columns: int) -> None:
    """Write an Ouster's sweep as the Point Cloud Library writes its driver's clouds: 9 ASCII fields, row by row.

    A cloud with extra columns ``ring`` and ``column`` is written organised, ``columns`` wide and ``lines`` high, with
    rows of zeros where nothing returned; any other as a plain list. The file's intensity is the extra column
    ``signal`` (photon counts) or, without it, 1024 times the cloud's intensity; ``t`` is ``time_ns``, moved to
    begin at 0 if it begins earlier; ``range`` is ``range_mm``, or the distance; what is missing is 0.

    Raises:
        DatasetError: If two points have the same place, or one lies outside the grid.
    """
    fields = {name: np.asarray(values).astype("<" + _DTYPES[name]) for name, values in _fields(cloud).items()}
    if not {"ring", "column"} <= set(cloud.extra):
        write_pcd(path, fields, encoding="ascii")
        return
    ring, column = (cloud.extra[name].astype(np.int64) for name in ("ring", "column"))
    cell = ring * columns + column
    if len(cloud) and (min(ring.min(), column.min()) < 0 or ring.max() >= lines or column.max() >= columns):
        actual = f"rings {ring.min()} to {ring.max()}, columns {column.min()} to {column.max()}"
        raise DatasetError(
            f"{path.name}: expected points on a grid of {lines} rings and {columns} columns, got {actual}"
        )
    if len(cloud) and np.bincount(cell).max() > 1:
        raise DatasetError(f"{path.name}: expected one point a ring and column, got several in the same place")
    grid = {name: np.zeros(lines * columns, dtype=values.dtype) for name, values in fields.items()}
    for name, values in fields.items():
        grid[name][cell] = values
    write_pcd(path, grid, encoding="ascii", height=lines)


def first_shot_ns(cloud: Cloud) -> int:
    """How far a cloud's ``time_ns`` must be moved so that none is negative, as ``t`` cannot be: 0 or below."""
    return min(int(np.min(cloud.extra.get("time_ns", 0), initial=0)), 0)


def _fields(cloud: Cloud) -> dict[str, Shaped[np.ndarray, " n"]]:
    extra: Mapping[str, np.ndarray] = cloud.extra
    zero = np.zeros(len(cloud))
    intensity = zero if cloud.intensity is None else cloud.intensity
    signal = extra.get("signal", intensity * np.float32(INTENSITY_COUNTS))
    distance_mm = np.rint(np.linalg.norm(cloud.points_m.astype(np.float64), axis=1) * 1000)
    rest = {name: extra.get(name, zero) for name in ("reflectivity", "ring", "ambient")}
    x, y, z = cloud.points_m.T
    time_ns = extra.get("time_ns", zero) - np.int64(first_shot_ns(cloud))
    named = {"x": x, "y": y, "z": z, "intensity": signal, "t": time_ns, **rest}
    return {name: (named | {"range": extra.get("range_mm", distance_mm)})[name] for name in _FIELDS}


def read_lidar(path: Path, lidar: str, *, first_ns: int = 0) -> Cloud:
    """Read an Ouster's sweep without its missing returns, in the sensor's own frame.

    Extra columns: ``signal`` (the file's intensity; the cloud's is that over 1024, at most 1), ``time_ns``,
    ``reflectivity``, ``ring``, ``ambient``, ``range_mm``, and ``column`` where the file is a full grid.

    Args:
        path: The file.
        lidar: ``"os2-64"`` or ``"os1-128"``.
        first_ns: Added to ``t``.

    Raises:
        FileFormatError: If the file is damaged or lacks a field.
    """
    fields = read_pcd(path)
    lacking = [name for name in _FIELDS if name not in fields or fields[name].ndim != 1]
    if lacking:
        expected, actual = f"fields {' '.join(_FIELDS)}", f"no single {lacking[0]!r} a point"
        raise FileFormatError(path, where="FIELDS", expected=expected, got=actual)
    points = np.stack([fields[axis].astype(np.float32) for axis in "xyz"], axis=1)
    valid = returned(path, points)
    columns, rest = divmod(len(points), LIDARS[lidar])
    signal = fields["intensity"].astype(np.float32)
    check_power(path, signal[valid], name="intensities")
    time_ns = _times_ns(path, fields["t"], valid) + first_ns
    extra = {"signal": signal, "time_ns": time_ns, "range_mm": fields["range"]}
    extra |= {name: fields[name] for name in ("reflectivity", "ring", "ambient")}
    if columns and not rest and (fields["ring"] == np.arange(len(points)) // columns)[valid].all():
        extra["column"] = (np.arange(len(points)) % columns).astype(np.uint16)
    strength = np.clip(signal[valid] / np.float32(INTENSITY_COUNTS), 0, 1)
    return Cloud(points[valid], strength, {name: values[valid] for name, values in extra.items()}, int((~valid).sum()))


def _times_ns(path: Path, times: Num[np.ndarray, " n"], valid: Bool[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """The driver's ``t`` in nanoseconds, in the unit that a turn of 0.1 s shows; nanoseconds where it shows none."""
    is_integer = times.dtype.kind in "iu"
    column = PointTimeColumn("t", times[valid], path, None, _TURN_NS, usual_unit="ns" if is_integer else None)
    if is_integer and column.unit() == "ns" and int(times.max(initial=0)) < _FAR_NS:
        return times.astype(np.int64)  # of points without return too, as they are
    times_ns = np.zeros(len(times), dtype=np.int64)
    times_ns[valid] = column.offsets_ns()
    return times_ns


Image3 = UInt8[np.ndarray, "_ _ 3"]


def write_stereo(path: Path, left: Image3 | None, right: Image3 | None) -> None:
    """Write both eyes' images side by side as one PNG; an eye that is missing is black.

    Raises:
        DatasetError: If there is no image, or the two differ in size.
    """
    images = [image for image in (left, right) if image is not None]
    if not images or any(image.shape != images[0].shape for image in images):
        raise DatasetError(f"{path.name}: expected one or two images of one size, got {[i.shape for i in images]}")
    black = np.zeros_like(images[0])
    both = np.concatenate([black if image is None else image for image in (left, right)], axis=1)
    encoded = io.BytesIO()
    Image.fromarray(both).save(encoded, format="PNG", compress_level=1)
    write_bytes(path, encoded.getvalue())


def read_eye(path: Path, right: bool) -> Image3:
    """Read one eye's half of a stereo image."""
    both = read_image(path)
    half = both.shape[1] // 2
    return np.ascontiguousarray(both[:, half:] if right else both[:, :half])


# Tesseracts reduced while they are read: 519 MB pass through a few, and never stand in memory.

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
            expected, actual = f"floating-point numbers of shape {TESSERACT_SHAPE}", f"{stream.dtype} of {stream.shape}"
            raise FileFormatError(path, where="the array", expected=expected, got=actual)
        reduced = moments_of_columns(_sound_blocks(path, stream.blocks(_BLOCK_CELLS)), axes)
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
