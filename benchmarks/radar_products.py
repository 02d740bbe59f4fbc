"""A full-size radar tensor to polar map, cube and clouds; the store beside other formats."""

import argparse
import json
import resource
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from _report import Part, child_output, part_parser, run_parts

RATES = (0.01, 0.05, 0.1)
STEPS = {  # name: (file, what is done, seconds allowed, megabytes allowed)
    "inflate": ("packed.mat", "inflate alone (zlib)", None, None),
    "loadmat": ("packed.mat", "scipy.io.loadmat, then polar map in numpy", None, None),
    "polar3d-packed": ("packed.mat", "polar map", 2.5, 600),
    "products-packed": ("packed.mat", "polar map, cube, clouds of 1, 5, 10 %", 3.3, 900),
    "loadmat-plain": ("plain.mat", "scipy.io.loadmat, then polar map in numpy", None, None),
    "polar3d-plain": ("plain.mat", "polar map", 0.6, 600),
    "products-plain": ("plain.mat", "polar map, cube, clouds of 1, 5, 10 %", 1.2, 900),
}
TOLERANCE = 1e-6


def write_tensor(folder: Path) -> None:
    """Exponential noise at the real floor and 20,000 echoes up to 40 dB above, single values stored as double."""
    from farfield.files.mat import write_mat

    rng = np.random.default_rng(0)
    cells = rng.standard_exponential((107, 37, 256, 64), dtype=np.float32)
    cells *= np.float32(10**10.91)
    spectra = cells.reshape(-1, 64)
    at = rng.integers(0, len(spectra), 20_000), rng.integers(0, 64, 20_000)
    spectra[at] *= rng.exponential(1000, 20_000).astype(np.float32)
    tensor = cells.astype(np.float64).T
    write_mat(folder / "plain.mat", "arrDREA", tensor)
    write_mat(folder / "packed.mat", "arrDREA", tensor, compress=True)


def peak_mb() -> float:
    """Highest resident memory of this program, in MB (a parent's does not count)."""
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) * 1024 / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def inflate(path: Path) -> int:
    with path.open("rb") as handle:
        handle.seek(136)
        stream, count = zlib.decompressobj(), 0
        while chunk := handle.read(1 << 20):
            count += len(stream.decompress(chunk))
    return count


def plain_tensor(path: Path) -> np.ndarray:
    from scipy.io import loadmat

    return loadmat(path)["arrDREA"][:, :, ::-1, ::-1]


def plain_polar3d(tensor: np.ndarray) -> np.ndarray:
    """The v2 loader's definition: mean and power-weighted mean velocity of all Doppler bins but the first."""
    from farfield.radar.axes import KRADAR_AXES, POWER_UNIT

    kept = tensor[1:]
    power = kept.mean(axis=0)
    velocity = np.tensordot(KRADAR_AXES.doppler_m_s[1:] / 63, kept, 1) / power
    return np.stack([power / POWER_UNIT, velocity]).transpose(0, 1, 3, 2)


def step(name: str, path: Path) -> dict[str, float]:
    """One measurement; runs in a process of its own."""
    from farfield.datasets.kradar.products import read_polar3d, read_products

    actions: dict[str, Callable[[Path], Any]] = {
        "inflate": inflate,
        "loadmat": lambda file: plain_polar3d(plain_tensor(file)),
        "polar3d": read_polar3d,
        "products": lambda file: read_products(file, RATES),
    }
    action = actions[name.split("-")[0]]
    if name.startswith("loadmat"):
        import scipy.io  # noqa: F401
    start, used = time.perf_counter(), time.process_time()
    action(path)
    first, worked = time.perf_counter() - start, time.process_time() - used
    return {"seconds": first, "processor": worked, "megabytes": peak_mb()}


def differences(path: Path) -> dict[str, float]:
    """Largest relative difference of each product from its plain definition."""
    from farfield.datasets.kradar.products import read_products
    from farfield.radar.axes import KRADAR_AXES, POWER_UNIT
    from farfield.radar.products import CUBE_X_M, CUBE_Y_M, CUBE_Z_M, polar_cloud, sparse_clouds, thresholds

    got, tensor = read_products(path, RATES), plain_tensor(path)
    polar, mean = plain_polar3d(tensor), np.ascontiguousarray(tensor.mean(axis=0))
    del tensor
    found = {"polar map, power": far(got.polar3d[0], polar[0]), "polar map, velocity": far(got.polar3d[1], polar[1])}
    cube = plain_cube(mean, (CUBE_Z_M, CUBE_Y_M, CUBE_X_M), KRADAR_AXES)
    if not np.array_equal(cube < 0, got.cube < 0):
        raise SystemExit("the cubes' fields of view differ")
    found["cube"] = far(got.cube, cube)
    for over in ("all", "valid"):
        counted = cube.ravel() if over == "all" else cube[cube > -1]
        clouds = got.clouds if over == "all" else sparse_clouds(got.cube, RATES, over="valid")
        for rate, level in zip(RATES, thresholds(got.cube, RATES, over=over), strict=True):
            quantile = np.quantile(counted, 1 - rate)
            found[f"{rate:.0%} of {over} cells: quantile"] = abs(level / quantile - 1)
            wanted, chosen = np.flatnonzero(cube > quantile), cells_of(clouds[rate])
            other = cube.ravel()[np.setxor1d(wanted, chosen, assume_unique=True)]
            found[f"{rate:.0%} of {over} cells: cells chosen otherwise, from the quantile"] = far(other, quantile)
            power = (cube.ravel()[chosen] / POWER_UNIT).astype(np.float32)
            found[f"{rate:.0%} of {over} cells: power"] = far(clouds[rate][:, 3], power)
    level = np.quantile(polar[0], 0.9)
    found["10 % of the polar grid: number of points"] = abs(
        len(polar_cloud(got.polar3d)) / np.count_nonzero(polar[0] > level) - 1
    )
    return found


def cells_of(cloud: np.ndarray) -> np.ndarray:
    """Place in the flat cube of each point of a cloud."""
    x, y, z = np.rint((cloud[:, :3].astype(np.float64) + 0.2 + (0, 80, 30)) / 0.4).astype(np.int64).T
    return (z * 400 + y) * 250 + x


def far(got: np.ndarray, wanted: Any) -> float:
    return float(np.max(np.abs(got - wanted) / np.maximum(np.abs(wanted), 1e-300), initial=0.0))


def plain_cube(mean: np.ndarray, grid: tuple[np.ndarray, ...], axes: Any) -> np.ndarray:
    """SciPy's trilinear interpolation in double precision, -1 outside."""
    from scipy.interpolate import RegularGridInterpolator

    polar = (axes.range_m, axes.elevation_deg, axes.azimuth_deg)
    field = RegularGridInterpolator(polar, mean, bounds_error=False, fill_value=-1.0)
    y, x = np.meshgrid(grid[1], grid[2], indexing="ij")
    flat = np.hypot(x, y)
    layers = []
    for z in grid[0]:
        at = [np.hypot(flat, z), np.degrees(np.arctan2(z, flat)), np.degrees(np.arctan2(y, x))]
        at = [near(value, axis) for value, axis in zip(at, polar, strict=True)]
        layers.append(np.where(flat > 0, field(np.stack(at, axis=-1)), -1.0))
    return np.stack(layers)


def near(value: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Put what rounding moved off the axis's ends back onto them."""
    for end in (axis[0], axis[-1]):
        value = np.where(np.abs(value - end) < 1e-9 * (axis[-1] - axis[0]), end, value)
    return value


def frames(count: int) -> list[Any]:
    """Cells of frames: noise averaged over Doppler, 3,000 echoes of vehicle size, a velocity for each cell."""
    from farfield.radar.axes import KRADAR_AXES
    from farfield.radar.cells import cells_of_cube
    from farfield.radar.products import doppler_cube, zyx_cube

    made = []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        power = rng.gamma(64, 10**10.91 / 64, KRADAR_AXES.shape[1:]).astype(np.float32)
        at = [rng.integers(0, size, 3000) for size in power.shape]
        power[tuple(at)] *= rng.exponential(30, 3000).astype(np.float32)
        velocity = np.clip(rng.normal(-0.03, 0.14, power.shape), -1.9, 1.85).astype(np.float32)
        doppler = doppler_cube(power, power * velocity)
        made.append(cells_of_cube(zyx_cube(power), "cube", doppler_m_s=doppler))
    return made


def cloud_of(cells: Any) -> np.ndarray:
    """x, y, z, power, velocity in single precision: what every format must give back."""
    return np.column_stack([cells.points_m(), cells.power, cells.doppler_m_s]).astype(np.float32)


Format = tuple[str, Callable[[Path, Any], None], Callable[[Path], np.ndarray]]


def formats() -> list[Format]:
    """Name, writer of one frame and reader to a cloud, of every format that is installed."""
    from farfield.datasets.kradar.products import read_cells, write_radar
    from farfield.files.mat import read_mat, write_mat
    from farfield.files.npy import read_npy, write_npy

    found: list[Format] = [
        ("store (HDF5, coded, checksum)", lambda p, c: write_radar(p, "cells", c), lambda p: cloud_of(read_cells(p))),
        (".npy, five float64, as published", lambda p, c: write_npy(p, cloud_of(c).astype("f8")), as_float32(read_npy)),
        (".npy, five float32", lambda p, c: write_npy(p, cloud_of(c)), read_npy),
        (".mat packed, five float32", *mat_format(write_mat, read_mat)),
    ]
    for add in (zarr_format, parquet_format):
        try:
            found.append(add())
        except ImportError as error:
            print(f"skipped: {error}", file=sys.stderr)
    return found


def as_float32(read: Callable[[Path], np.ndarray]) -> Callable[[Path], np.ndarray]:
    return lambda path: read(path).astype(np.float32)


def mat_format(write: Callable, read: Callable) -> tuple[Callable[[Path, Any], None], Callable[[Path], np.ndarray]]:
    return (
        lambda path, cells: write(path, "points", cloud_of(cells), compress=True),
        lambda path: np.ascontiguousarray(read(path, "points")),
    )


def decoded(columns: dict[str, np.ndarray]) -> np.ndarray:
    from farfield.radar.cells import RadarCells

    none = np.zeros((2, 13), dtype=np.int32)
    return cloud_of(RadarCells(columns["index"], columns["code"], columns["doppler"], none))


def zarr_format() -> Format:
    import zarr

    def write(path: Path, cells: Any) -> None:
        group = zarr.open_group(str(path), mode="w")
        for name in ("index", "code", "doppler"):
            values = getattr(cells, name)
            array = group.create_array(name, shape=values.shape, chunks=values.shape, dtype=values.dtype)
            array[:] = values

    def read(path: Path) -> np.ndarray:
        group = zarr.open_group(str(path), mode="r")
        return decoded({name: np.asarray(group[name][:]) for name in ("index", "code", "doppler")})

    return f"Zarr {zarr.__version__}, coded, zstd", write, read


def parquet_format() -> Format:
    import pyarrow
    from pyarrow import parquet

    def write(path: Path, cells: Any) -> None:
        table = pyarrow.table({name: getattr(cells, name) for name in ("index", "code", "doppler")})
        options = {"index": "DELTA_BINARY_PACKED"}
        parquet.write_table(table, path, compression="zstd", use_dictionary=False, column_encoding=options)

    def read(path: Path) -> np.ndarray:
        table = parquet.read_table(path)
        return decoded({name: table[name].to_numpy() for name in ("index", "code", "doppler")})

    return f"Parquet (pyarrow {pyarrow.__version__}), coded, zstd", write, read


def bytes_of(path: Path) -> int:
    files = [file for file in path.rglob("*") if file.is_file()] if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files)


def store_table(folder: Path, count: int, repeats: int) -> list[str]:
    """Bytes a frame and milliseconds a random read, for clouds of three densities over the whole cube."""
    whole = frames(count)
    lines = [
        f"{'':<40}" + "".join(f"{rate:>11.0%}        " for rate in RATES),
        f"{'':<40}" + "   kB/frame  ms/read" * 3,
    ]
    rng = np.random.default_rng(0)
    for name, write, read in formats():
        cells = ""
        for rate in RATES:
            paths = [folder / f"{number}_{rate}_{len(lines)}" for number in range(count)]
            for path, frame in zip(paths, whole, strict=True):
                write(path, frame.select("cube", rate))
            best = np.full(count, np.inf)
            for _ in range(repeats):
                for number in rng.permutation(count):
                    start = time.perf_counter()
                    got = read(paths[number])
                    best[number] = min(best[number], time.perf_counter() - start)
            if not np.allclose(got, cloud_of(whole[number].select("cube", rate)), rtol=1e-6, atol=1e-6):
                raise SystemExit(f"{name}: the cloud that comes back is another")
            cells += f"{np.mean([bytes_of(path) for path in paths]) / 1e3:11,.0f}{1e3 * best.mean():9.1f}"
        lines.append(f"{name:<40}{cells}")
    return lines + region_table(folder, whole, repeats)


def region_table(folder: Path, whole: list[Any], repeats: int) -> list[str]:
    """What `farfield convert --to radar-store` writes by default: every cell of a region, read at a density."""
    from farfield.datasets.kradar.products import read_cells, write_radar

    lines = []
    for region in ("wide", "narrow"):
        paths = [folder / f"{number}_{region}" for number in range(len(whole))]
        for path, frame in zip(paths, whole, strict=True):
            write_radar(path, "cells", frame.select(region))
        size = np.mean([bytes_of(path) for path in paths]) / 1e3
        best = np.full((len(RATES), len(paths)), np.inf)
        for _ in range(repeats):
            for number, path in enumerate(paths):
                for place, rate in enumerate(RATES):
                    start = time.perf_counter()
                    cloud_of(read_cells(path).select(region, rate))
                    best[place, number] = min(best[place, number], time.perf_counter() - start)
        times = "".join(f"{size:11,.0f}{1e3 * value:9.1f}" for value in best.mean(axis=1))
        lines.append(f"{f'store, every cell of the {region} region':<40}{times}")
    return lines


def child(*arguments: str) -> Any:
    """Run one step in a process of its own and read its answer."""
    return json.loads(child_output(*arguments).splitlines()[-1])


def speed_table(folder: Path, repeats: int, only: Sequence[str]) -> tuple[list[str], bool]:
    lines = [f"{'':<54}{'seconds':>9}{'allowed':>9}{'CPU s':>9}{'MB':>8}{'allowed':>9}"]
    good = True
    for name in only:
        file, what, seconds, megabytes = STEPS[name]
        runs = [child("--step", name, "--path", str(folder / file)) for _ in range(repeats)]
        best, used = (min(run[key] for run in runs) for key in ("seconds", "processor"))
        peak = max(run["megabytes"] for run in runs)
        limits = ["" if limit is None else f"{limit:g}" for limit in (seconds, megabytes)]
        text = f"{file.removesuffix('.mat'):<8}{what:<46}{best:9.2f}{limits[0]:>9}{used:9.2f}{peak:8.0f}{limits[1]:>9}"
        lines.append(text.rstrip())
        good &= seconds is None or (best <= seconds and peak <= megabytes)
    return lines, good


def report(options: argparse.Namespace) -> tuple[str, bool]:
    lines = []
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        folder = Path(name)
        child("--step", "write", "--path", str(folder))
        sizes = ", ".join(f"{file.stem} {file.stat().st_size / 1e6:.0f} MB" for file in sorted(folder.glob("*.mat")))
        lines.append(
            f"a tensor of 64 x 256 x 37 x 107 doubles: {sizes}; first call in a fresh process, best of repeats"
        )
        table, good = speed_table(folder, options.repeats, options.only)
        lines += table
        if not options.without_differences:
            lines += ["", "largest relative difference from the plain definition in double precision"]
            found = child("--step", "differences", "--path", str(folder / "plain.mat"))
            lines += [f"  {what:<60}{value:9.1e}" for what, value in found.items()]
            good &= max(found.values()) <= TOLERANCE
        (folder / "packed.mat").unlink()
        (folder / "plain.mat").unlink()
        lines += ["", f"clouds with Doppler of {options.frames} frames, warm page cache, read to (n, 5) float32"]
        lines += child("--step", "store", "--path", str(folder), "--frames", str(options.frames))
    return "\n".join(lines), good


def run_products(arguments: Sequence[str]) -> int:
    """A full-size radar tensor to polar map, cube and clouds: time, memory, equality; the store beside other formats.

        python benchmarks/radar_products.py [--repeats 3] [--frames 6]

    Writes K-Radar's array (64, 256, 37, 107) in double precision, plain and packed, into a temporary folder (0.9 GB),
    and measures each step in a process of its own: the time of the first call after the imports, and the highest memory
    of the whole process. Plain definitions (the whole file by scipy.io.loadmat, numpy and SciPy in double precision)
    stand beside the streamed products. Zarr and Parquet are measured where they are installed (PYTHONPATH may name a
    folder made by ``pip install --target``). Exit status 1 where a limit of time or memory is passed or a product
    differs by more than 1e-6.
    """
    parser = part_parser(run_products.__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--only", nargs="+", choices=list(STEPS), default=list(STEPS))
    parser.add_argument("--without-differences", action="store_true")
    parser.add_argument("--folder", type=Path, help="where the temporary files stand")
    parser.add_argument("--step", help=argparse.SUPPRESS)
    parser.add_argument("--path", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.step == "write":
        print(json.dumps(write_tensor(options.path)))
    elif options.step == "differences":
        print(json.dumps(differences(options.path)))
    elif options.step == "store":
        print(json.dumps(store_table(options.path, options.frames, options.repeats)))
    elif options.step:
        print(json.dumps(step(options.step, options.path)))
    if options.step:
        return 0
    text, good = report(options)
    print(text)
    return int(not good)


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "products": Part(run_products, "--repeats 1 --frames 1 --only polar3d-plain --without-differences"),
            },
        )
    )
