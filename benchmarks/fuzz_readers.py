"""Damaged files to every reader: each must give a clear error or a valid result, quickly and in little memory."""

import io
import json
import multiprocessing
import re
import resource
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _fuzz_clouds import cloud_targets
from _fuzz_formats import exchange_targets, radar_targets, time_targets
from _fuzz_forms import forms
from _fuzz_hostile import attempt, hostile_files
from _fuzz_sets import set_targets
from _fuzz_weights import weights_targets
from _report import Part, part_parser, run_parts
from PIL import Image

from farfield.datasets.cirrus.labels import boxes_from_labels
from farfield.datasets.cirrus.labels import read_labels as read_cirrus_labels
from farfield.datasets.cirrus.layout import Labels
from farfield.errors import FarfieldError
from farfield.files import boxes_csv, clouds, depth_png, images, kitti, pcd, xyz

LIMIT_S, LIMIT_BYTES = 2.0, 1 << 30
NASTY = (*b'nan -inf 1e999 -1 0x1 1_0 , { "'.split(), b"\0", b"\xff\xff\xff\xff", b"\r", b"\n\n", b" ")
LARGE_SHARE = 0.02  # of the files come from seeds of real size
MUTATIONS = ("truncated", "bit-flipped", "spliced", "inflated digits", "nasty bytes", "repeated")


@dataclass(frozen=True)
class Target:
    """A reader, good files for it, what a valid result is, and files that it must refuse as they are."""

    suffix: str
    read: Callable[[Path], Any]
    seeds: tuple[bytes, ...]
    valid: Callable[[Any], bool] = lambda found: len(found) >= 0
    large: tuple[bytes, ...] = ()
    hostile: tuple[bytes, ...] = ()
    grown: Callable[[np.random.Generator], bytes] | None = None  # a file that is changed in its structure


@dataclass
class Tally:
    """What came out of one reader."""

    errors: int = 0
    results: int = 0
    slowest_s: float = 0.0
    peak_bytes: int = 0
    faults: tuple[str, ...] = ()


def mutate(rng: np.random.Generator, seeds: Sequence[bytes], kind: str) -> bytes:
    """Damage one of the seeds in one way."""
    data = bytearray(seeds[rng.integers(len(seeds))])
    at, length = int(rng.integers(len(data) + 1)), int(2 ** rng.uniform(0, 9))
    if kind == "truncated":
        return bytes(data[:at])
    if kind == "bit-flipped":
        reach = len(data) if rng.random() < 0.5 else min(len(data), 400)  # half of them within the header
        for position in rng.integers(8 * reach, size=int(2 ** rng.uniform(0, 6))):
            data[position // 8] ^= 1 << position % 8
    elif kind == "spliced":
        other = seeds[rng.integers(len(seeds))]
        start = int(rng.integers(len(other) + 1))
        data[at : at + length * int(rng.integers(2))] = other[start : start + length]
    elif kind == "inflated digits":
        runs = list(re.finditer(rb"\d+", bytes(data[:2000]))) or list(re.finditer(rb"[\x01-\xff]", bytes(data[:64])))
        for run in rng.permutation(len(runs))[: int(rng.integers(1, 4))]:
            grown = rng.choice([b"0", b"-1", b"9" * int(rng.integers(1, 25)), b"4294967295", b"1e9", b"99999999"])
            data[slice(*runs[run].span())] = bytes(grown) if runs[run].group().isdigit() else b"\xff"
    elif kind == "nasty bytes":
        for position in rng.integers(len(data) + 1, size=int(rng.integers(1, 5))):
            nasty = NASTY[rng.integers(len(NASTY))]
            data[position : position + len(nasty) * int(rng.integers(2))] = nasty
    else:
        data[at:at] = data[at : at + length] * int(rng.integers(1, 50))
    return bytes(data)


def damaged_files(rng: np.random.Generator, target: Target, count: int) -> Iterator[tuple[str, bytes]]:
    """``count`` files: the seeds as they are, then every mutation in turn, one in four of them damaged twice."""
    whole = [("none", seed) for seed in target.seeds + target.large] + [("hostile", seed) for seed in target.hostile]
    yield from whole[:count]
    for index in range(count - len(whole)):
        if target.grown is not None and index % 4:
            yield "grown", target.grown(rng)
            continue
        kind = MUTATIONS[index % len(MUTATIONS)]
        seeds = target.seeds + target.hostile
        data = mutate(rng, target.large if target.large and rng.random() < LARGE_SHARE else seeds, kind)
        if data and rng.random() < 0.25:
            data = mutate(rng, [data], MUTATIONS[rng.integers(len(MUTATIONS))])
        yield kind, data


def fuzz(target: Target, count: int, folder: Path, *, seed: int = 0) -> Tally:
    """Feed damaged files to a reader, and count what came of them."""
    tally, path, faults = Tally(), folder / f"damaged{target.suffix}", Counter[str]()
    pickles = watch_pickles()
    for index, (kind, data) in enumerate(damaged_files(np.random.default_rng(seed), target, count)):
        path.write_bytes(data)
        start = time.process_time()  # not the clock on the wall: others may be using the processor
        try:
            good = target.valid(target.read(path))
            tally.results += 1
            fault = None if good else "a result that is not valid"
            fault = "a hostile file was read" if kind == "hostile" else fault
        except FarfieldError:
            tally.errors += 1
            fault = "a good file was refused" if kind == "none" else None
        except Exception as error:
            fault = f"{type(error).__name__}: {error}"[:160]
        elapsed = time.process_time() - start
        if elapsed > LIMIT_S:  # the first file that needs a module pays for its import
            elapsed = min(elapsed, processor_s(target, path))
        tally.slowest_s = max(tally.slowest_s, elapsed)
        fault = fault or (f"took {elapsed:.1f} s" if elapsed > LIMIT_S else None)
        if fault:
            faults[fault] += 1
            if faults[fault] == 1:
                (folder / f"fault_{index}{target.suffix}").write_bytes(data)
    tally.peak_bytes = peak_bytes()
    if pickles:
        faults[f"a pickle was loaded: {pickles[0]}"] += len(pickles)
    tally.faults = tuple(f"{number} x {fault}" for fault, number in faults.most_common(5))
    return tally


def processor_s(target: Target, path: Path) -> float:
    """How long reading a file takes of the processor, whatever comes of it."""
    start = time.process_time()
    with suppress(Exception):
        target.valid(target.read(path))
    return time.process_time() - start


def watch_pickles() -> list[str]:
    """A list that grows whenever anything in this process unpickles an object, whichever module does it."""
    seen: list[str] = []
    sys.addaudithook(lambda event, arguments: seen.append(str(arguments)) if event == "pickle.find_class" else None)
    return seen


def peak_bytes() -> int:
    """Largest resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def finite_rows(rows: np.ndarray) -> bool:
    return rows.ndim == 2 and len(rows) > 0 and bool(np.isfinite(rows).all())


def equal_lengths(fields: dict[str, np.ndarray]) -> bool:
    return len({len(array) for array in fields.values()}) <= 1


def rgb(image: np.ndarray) -> bool:
    return image.dtype == np.uint8 and image.ndim == 3 and image.shape[2] == 3


def targets(folder: Path) -> dict[str, Target]:
    """Every reader of files and annotations, with seeds made by our own writers."""
    rng = np.random.default_rng(5)
    rows = np.round(rng.normal(size=(60, 8)) * [80, 20, 2, 0.3, 1, 9, 9, 9], 4)
    many = np.tile(rows, (300, 1)) + np.arange(18_000)[:, None] / 100
    label = "Car 0.00 0 -1.57 599.41 156.40 629.75 189.25 2.85 2.63 12.34 0.47 1.49 69.44 -1.56"
    track = "1 Pedestrian 0 0 -0.2 1106.1 166.6 1204.5 323.9 1.8 0.7 1.2 6.4 1.4 9.1 0.4"
    calib = "P2: " + " ".join(["7.2e+02"] * 12) + "\nR0_rect: " + " ".join(["1.0"] * 9) + "\n"
    detection = "0,2,296.7,161.8,452.3,292.9,12.2,1.51,1.69,4.09,-5.85,1.77,13.02,-1.6,-1.2"
    table = "sequence,frame,label,x,y,z,l,w,h,yaw_rad,score\n" + "a,000001,vehicle,1.5,2,3,4,2,1.5,-0.3,0.9\n" * 8
    more = exchange_targets() | radar_targets(folder) | time_targets(folder)
    more |= cloud_targets(folder) | set_targets() | weights_targets(folder)
    return {
        "xyz": Target(".xyz", xyz.read_xyz, xyz_seeds(folder, rows), finite_rows, xyz_seeds(folder, many)),
        "pcd": Target(".pcd", pcd.read_pcd, pcd_seeds(folder, rows), equal_lengths, pcd_seeds(folder, many)),
        "velodyne bin": Target(".bin", clouds.read_bin, (rows[:, :4].astype("<f4").tobytes(),), finite_rows),
        "ffcloud": Target(".ffcloud", clouds.read_cache, cache_seeds(folder, rows)),
        "images": Target(".jpg", images.read_image, image_seeds(folder, rng), rgb),
        "upright images": Target(".jpg", partial(images.read_image, upright=True), exif_seeds(rng), rgb),
        "depth png": Target(".png", depth_png.read_depth, depth_seeds(folder, rng), depths),
        "kitti calib": Target(".txt", kitti.read_calib, (calib.encode(),)),
        "kitti label": Target(".txt", kitti.read_labels, ((f"{label}\n" * 6).encode(),)),
        "kitti tracking": Target(".txt", kitti.read_tracking, ((f"3 {track}\n" * 6).encode(),)),
        "kitti detections": Target(".txt", kitti.read_detections, ((f"{detection}\n" * 6).encode(),)),
        "boxes csv": Target(".csv", boxes_csv.read_boxes_csv, (table.encode(),)),
        "cirrus json": Target(".json", read_cirrus, cirrus_seeds(rng)),
        **{
            name: Target(suffix, read, seeds, valid, hostile=hostile)
            for name, (suffix, read, seeds, valid, hostile) in more.items()
        },
    }


def form_targets(folder: Path) -> dict[str, Target]:
    """Every form of settings, records, journals and bags, changed in their structure where that is more than bytes."""
    made = {
        name: Target(form.suffix, form.read, form.seeds, lambda _: True, hostile=form.hostile, grown=form.grown)
        for name, form in forms(folder).items()
    }
    bags = {name: parts for name, parts in time_targets(folder).items() if name.startswith("bag")}
    return made | {
        f"form of {name}": Target(suffix, read, seeds, valid, hostile=hostile)
        for name, (suffix, read, seeds, valid, hostile) in bags.items()
    }


def read_cirrus(path: Path) -> Any:
    settings = Labels()
    return boxes_from_labels(read_cirrus_labels(path, settings), settings)


def xyz_seeds(folder: Path, rows: np.ndarray) -> tuple[bytes, ...]:
    for columns in (5, 8):
        xyz.write_xyz(folder / f"{columns}.xyz", rows[:, :columns])
    return tuple((folder / f"{columns}.xyz").read_bytes() for columns in (5, 8))


def pcd_seeds(folder: Path, rows: np.ndarray) -> tuple[bytes, ...]:
    fields = dict(zip("xyz", np.float32(rows[:, :3]).T, strict=True))
    index = np.arange(len(rows))
    fields |= {"ring": np.uint16(index // 8), "stamp": index + 2**60, "normal": rows[:, 3:6]}
    for encoding in ("ascii", "binary", "binary_compressed"):
        pcd.write_pcd(folder / f"{encoding}.pcd", fields, encoding=encoding)
    return tuple((folder / f"{name}.pcd").read_bytes() for name in ("ascii", "binary", "binary_compressed"))


def cache_seeds(folder: Path, rows: np.ndarray) -> tuple[bytes, ...]:
    clouds.write_cache(folder / "a.ffcloud", {"points_m": np.float32(rows[:, :3]), "mask": rows[:, 3] > 0})
    return ((folder / "a.ffcloud").read_bytes(),)


def depth_seeds(folder: Path, rng: np.random.Generator) -> tuple[bytes, ...]:
    depth = np.repeat(rng.uniform(1, 300, (12, 16)).astype(np.float32), 3, axis=0)
    depth[:5] = np.nan
    for scale in (256, 128):
        depth_png.write_depth(folder / f"{scale}.png", depth, scale=scale, notes={"method": "rings"})
    return tuple((folder / f"{scale}.png").read_bytes() for scale in (256, 128))


def depths(found: depth_png.DepthImage) -> bool:
    """Every depth is positive or there is none, and the scale is one that files have."""
    depth = found.depth_m
    return depth.ndim == 2 and 1 <= found.scale <= 65535 and bool(((depth > 0) | np.isnan(depth)).all())


def image_seeds(folder: Path, rng: np.random.Generator) -> tuple[bytes, ...]:
    picture = np.repeat(np.repeat(rng.integers(0, 255, (6, 8, 3), dtype=np.uint8), 8, axis=0), 8, axis=1)
    for name in ("a.png", "a.jpg"):
        images.write_image(folder / name, picture)
    return (folder / "a.png").read_bytes(), (folder / "a.jpg").read_bytes()


def exif_seeds(rng: np.random.Generator) -> tuple[bytes, ...]:
    """A JPEG that lies on its side, with position and a second picture, and a PNG with EXIF."""
    picture = Image.fromarray(rng.integers(0, 255, (12, 16, 3), dtype=np.uint8))
    exif = Image.Exif()
    exif[0x0112], exif[0x010F] = 6, "maker"
    exif.get_ifd(0x8825).update({1: "N", 2: (48.0, 7.0, 12.0)})
    made = []
    for kind, more in (("JPEG", {}), ("PNG", {}), ("MPO", {"save_all": True, "append_images": [picture]})):
        file = io.BytesIO()
        picture.save(file, format=kind, exif=exif, **more)
        made.append(file.getvalue())
    return tuple(made)


def cirrus_seeds(rng: np.random.Generator) -> tuple[bytes, ...]:
    labels = [
        {
            "label_class": "vehicle",
            "position": rng.normal(size=3).round(3).tolist(),
            "quaternion": [0.0, 0.0, 0.6, 0.8],
            "size": [4.5, 1.9, 1.6],
            "track_id": index,
        }
        for index in range(6)
    ]
    return (json.dumps({"label_type": "3d", "labels": labels}).encode(),)


MakesTargets = Callable[[Path], Mapping[str, Target]]


def worker(made: MakesTargets, name: str, count: int, folder: str, sender: Any) -> None:
    """Fuzz one reader with an address space that may grow by 1 GB from here."""
    place = Path(folder)
    target = made(place)[name]
    target.read(write_seed(place, target))  # imports and tables that come with the first use
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + LIMIT_BYTES, used + LIMIT_BYTES))
    sender.send(fuzz(target, count, place))


def write_seed(folder: Path, target: Target) -> Path:
    path = folder / f"seed{target.suffix}"
    path.write_bytes(target.seeds[0])
    return path


def fuzz_in_process(made: MakesTargets, name: str, count: int, keep: Path) -> Tally:
    receiver, sender = multiprocessing.Pipe(duplex=False)
    with tempfile.TemporaryDirectory() as folder:
        arguments = (made, name, count, folder, sender)
        process = multiprocessing.get_context("forkserver").Process(target=worker, args=arguments)
        process.start()
        sender.close()
        try:
            hangs = not receiver.poll(60 + count * LIMIT_S / 4)
            tally = Tally(faults=("the process hangs",)) if hangs else receiver.recv()
        except EOFError:
            tally = Tally(faults=("the process died",))
        process.kill()
        process.join()
        for fault in Path(folder).glob("fault_*"):
            keep.mkdir(parents=True, exist_ok=True)
            (keep / f"{name.replace(' ', '_')}_{fault.name}").write_bytes(fault.read_bytes())
    return tally


def run_fuzz(arguments: Sequence[str]) -> int:
    """Feed damaged files to every reader: each must give a clear error or a valid result, quickly and in little memory.

        python benchmarks/fuzz_readers.py [--files 20000] [--only pcd xyz]

    Good files are truncated, bit-flipped, spliced with others, filled with bytes that parsers dislike, and the digits
    in their headers are inflated. Each reader runs in a process of its own whose address space may grow by 1 GB. Exit
    status 1 where anything but a FarfieldError came out, a file took more than 2 s of processor time, memory ran out,
    or a pickle was loaded.
    """
    return _run(run_fuzz.__doc__, arguments, targets, 20_000)


def run_forms(arguments: Sequence[str]) -> int:
    """Change settings, records and journals in their structure: each must give a clear error or a valid result.

        python benchmarks/fuzz_readers.py forms [--files 500] [--only edits "yaml experiment"]

    YAML, JSON, weights, checkpoints, edits, journals and bags. Values become other kinds of values, keys go or are
    called otherwise, groups are doubled or buried, checksums are right; one file in four is damaged by bytes instead.
    Limits and exit status are those of the part ``fuzz``.
    """
    return _run(run_forms.__doc__, arguments, form_targets, 500)


def _run(documentation: str | None, arguments: Sequence[str], made: MakesTargets, files: int) -> int:
    parser = part_parser(documentation)
    parser.add_argument("--files", type=int, default=files)
    parser.add_argument("--only", nargs="+", help="names of readers")
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "farfield-fuzz")
    options = parser.parse_args(arguments)
    before = set(sys.modules)
    with tempfile.TemporaryDirectory() as folder:
        names = [name for name in made(Path(folder)) if options.only is None or name in options.only]
    # each reader's process begins as a copy of one that has imported what the targets need
    multiprocessing.set_forkserver_preload(["__main__", *sorted(set(sys.modules) - before - {"__mp_main__"})])
    print(f"{'reader':20}{'files':>8}{'errors':>8}{'results':>8}{'slowest':>12}{'memory':>10}  faults")
    failed = False
    for name in names:
        tally = fuzz_in_process(made, name, options.files, options.keep)
        failed |= bool(tally.faults)
        counts = f"{name:20}{options.files:8}{tally.errors:8}{tally.results:8}"
        figures = f"{tally.slowest_s * 1e3:9.1f} ms{tally.peak_bytes / 2**20:7.0f} MB"
        print(f"{counts}{figures}  {'; '.join(tally.faults) or 'none'}", flush=True)
    print(f"\nmutations: {', '.join(MUTATIONS)}")
    print("memory: peak of the whole process, interpreter and seeds included")
    return int(failed)


def run_hostile(arguments: Sequence[str]) -> int:
    """Read hostile files of every kind, each in a process of its own: memory, time and what came of it.

        python benchmarks/fuzz_readers.py hostile [--only mcap png]

    Memory is what comes on top of the process before and of the data that was asked for, time that of the processor.
    Exit status 1 where a file was neither refused nor may be read, took 1 GB or 20 s.
    """
    parser = part_parser(run_hostile.__doc__)
    parser.add_argument("--only", nargs="+", help="parts of names")
    options = parser.parse_args(arguments)
    held = True
    for name, attack in hostile_files().items():
        if options.only is not None and not any(part in name for part in options.only):
            continue
        with tempfile.TemporaryDirectory() as folder:
            outcome = attempt(attack, Path(folder))
        held &= outcome.held
        figures = f"{outcome.disk_bytes / 1e6:8.2f} MB on disk{outcome.peak_bytes / 1e6:7.0f} MB{outcome.time_s:7.2f} s"
        print(f"{name:58}{figures}  {'' if outcome.held else 'MISSED '}{outcome.words[:100]}", flush=True)
    return int(not held)


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "fuzz": Part(run_fuzz, "--files 50 --only xyz 'kradar labels' openlabel", exact=True),
                "forms": Part(run_forms, "--files 40", exact=True),
                "hostile": Part(run_hostile, "--only 'radar store, a soft'"),
            },
        )
    )
