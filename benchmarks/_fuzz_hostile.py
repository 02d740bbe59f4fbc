"""Small files that would fill the memory, read other files or never end, for fuzz_readers.py: each must be refused.

An attack writes its files into an empty folder and reads them as a verb does. It runs in a process of its own whose
address space may grow by 6 GB, for at most a minute of the processor; what counts is the memory beyond that before it,
and the processor's time.
"""

import gc
import hashlib
import io
import json
import os
import resource
import signal
import struct
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from farfield.datasets.class_mapping import read_class_mapping
from farfield.datasets.folder import read_boxes
from farfield.datasets.kradar.index import KRadarFiles
from farfield.datasets.kradar.label_table import read_label_table
from farfield.datasets.kradar.labels import read_labels as read_kradar_labels
from farfield.datasets.kradar.products import read_radar
from farfield.datasets.memory import CloudFiles
from farfield.errors import FarfieldError
from farfield.files import boxes_csv, depth_png, images, kitti, mat, npy
from farfield.files.nuscenes import read_results

LIMIT_BYTES, LIMIT_S = 1 << 30, 20.0
"""Beyond the data that was asked for, and of the processor from the call to its one clear error."""
_ROOM_BYTES, _ALARM_S, _WAIT_S = 6 << 30, 60, 180


@dataclass(frozen=True)
class Attack:
    """Hostile files, and how they are read.

    Args:
        write: Writes them into a folder.
        read: Reads them from there.
        asked_bytes: Of the data that was asked for, where they are whole and may be read.
    """

    write: Callable[[Path], None]
    read: Callable[[Path], Any]
    asked_bytes: int = 0


@dataclass(frozen=True)
class Outcome:
    """What an attack came to.

    Args:
        words: The error's first line, or what else came.
        refused: Whether one clear error came, or the data that were asked for.
        peak_bytes: Resident memory at most, beyond that before and the data that was asked for.
        time_s: Of the processor, from the call on.
        disk_bytes: Of the files, holes not counted.
    """

    words: str
    refused: bool
    peak_bytes: int
    time_s: float
    disk_bytes: int

    @property
    def held(self) -> bool:
        """Whether it was refused within the limits."""
        return self.refused and self.peak_bytes < LIMIT_BYTES and self.time_s < LIMIT_S


def attempt(attack: Attack, folder: Path) -> Outcome:
    """Run one attack in a process of its own, forked from this one, which has the libraries already."""
    attack.write(folder)
    disk_bytes = sum(512 * path.lstat().st_blocks for path in folder.rglob("*"))
    reader, writer = os.pipe()
    start = time.perf_counter()
    child = os.fork()
    if child == 0:
        os.close(reader)
        _attacked(attack, folder, writer)
    os.close(writer)
    with os.fdopen(reader, "rb") as pipe:
        said = pipe.read()
    _, status = os.waitpid(child, 0)
    elapsed_s = time.perf_counter() - start
    if not said:
        name = signal.Signals(os.WTERMSIG(status)).name if os.WIFSIGNALED(status) else f"exit status {status}"
        return Outcome(f"the process died: {name}", False, 0, elapsed_s, disk_bytes)
    words, refused, peak_bytes, time_s = json.loads(said)
    return Outcome(words, refused, peak_bytes, time_s, disk_bytes)


def _attacked(attack: Attack, folder: Path, writer: int) -> None:
    """In the child: read, say what came, end."""
    gc.freeze()  # what the parent holds is neither walked nor copied on behalf of the attack
    signal.setitimer(signal.ITIMER_PROF, _ALARM_S)
    signal.alarm(_WAIT_S)  # others may be using the processor
    before = _resident("VmRSS")
    used = _resident("VmSize")
    resource.setrlimit(resource.RLIMIT_AS, (used + _ROOM_BYTES, used + _ROOM_BYTES))
    Path("/proc/self/clear_refs").write_text("5")  # the peak is counted from here
    refused, start = False, time.process_time()
    try:
        words, refused = f"read: {type(attack.read(folder)).__name__}", attack.asked_bytes > 0
    except FarfieldError as error:
        words, refused = str(error).splitlines()[0][:300].replace(str(folder), ""), True
    except BaseException as error:
        words = f"{type(error).__name__}: {error}"[:300]
    time_s = time.process_time() - start
    peak_bytes = max(_resident("VmHWM") - before - attack.asked_bytes, 0)
    os.write(writer, json.dumps([words, refused, peak_bytes, time_s]).encode())
    os.kill(os.getpid(), signal.SIGKILL)  # without what a process does at its end


def _resident(name: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(f"{name}:"))


def hostile_files() -> dict[str, Attack]:
    """Every attack by its name: the kind of file, then what is hostile in it."""
    from _fuzz_hostile_bags import archives, bags, feathers

    parts: dict[str, Attack] = {}
    if all(find_spec(name) is not None for name in ("rosbags", "pyarrow", "torch")):
        from _fuzz_hostile_parts import parts as hostile_parts

        parts = hostile_parts()
    attacks = {**radar_stores(), **arrays(), **pictures(), **tables()}
    if find_spec("rosbags") is not None:
        attacks |= bags()
    if find_spec("pyarrow") is not None:
        attacks |= feathers()
    if find_spec("torch") is not None:
        attacks |= archives()
    return attacks | parts


# Files with holes, and bytes that unpack to many


def _sparse(path: Path, head: bytes, size: int) -> None:
    with path.open("wb") as handle:
        handle.write(head)
        handle.truncate(size)


def _zeros(size: int) -> bytes:
    """So many zeros, packed by zlib: a thousandth."""
    return _packed(b"", size)


def _packed(head: bytes, size: int) -> bytes:
    """A head and so many zeros, packed by zlib."""
    packer = zlib.compressobj(9)
    parts = [packer.compress(head), *(packer.compress(bytes(1 << 24)) for _ in range(size >> 24))]
    return b"".join([*parts, packer.compress(bytes(size & 0xFFFFFF)), packer.flush()])


# Radar stores: HDF5


def radar_stores() -> dict[str, Attack]:
    """HDF5 that reads other files, waits for a pipe, or unpacks to much."""
    read = lambda folder: read_radar(folder / "cells_00033.h5", "cells")  # noqa: E731
    return {
        f"radar store, {name}": Attack(partial(_store, change), read)
        for name, change in {
            "external storage": _external,
            "external storage in a pipe": _external_pipe,
            "an external link": _external_link,
            "an external link to a pipe": _external_link_pipe,
            "a soft link": _soft_link,
            "a virtual dataset": _virtual,
            "columns of zeros": _many_zeros,
            "a chunk that unpacks beyond itself": _beyond_chunk,
            "a chunk larger than its column": _huge_chunk,
            "quantiles without end": _many_quantiles,
            "a filter of a plug-in": _plugin,
        }.items()
    }


def _store(change: Callable[[Any, Path], None], folder: Path) -> None:
    """A store of one frame with its seal, one thing in it changed."""
    import h5py

    packed = io.BytesIO()
    with h5py.File(packed, "w", userblock_size=512, libver=("v110", "v110")) as file:
        columns = {"gap": np.arange(10, dtype="u4"), "code": np.arange(10, dtype="u2")}
        columns["quantiles"] = np.zeros((2, 13), dtype="i4")
        for name, values in columns.items():
            file.create_dataset(name, data=values)
        change(file, folder)
    body = packed.getvalue()[512:]
    seal = b"Farfield radar cells 1\n" + hashlib.sha256(body).hexdigest().encode() + b"\n"
    (folder / "cells_00033.h5").write_bytes(seal.ljust(512, b"\0") + body)


def _external(file: Any, folder: Path) -> None:
    del file["code"]
    (folder / "secret").write_bytes(bytes(range(20)))
    file.create_dataset("code", (10,), "u2", external=[(str(folder / "secret"), 0, 20)])


def _external_pipe(file: Any, folder: Path) -> None:
    os.mkfifo(folder / "pipe")
    del file["code"]
    file.create_dataset("code", (10,), "u2", external=[(str(folder / "pipe"), 0, 20)])


def _external_link(file: Any, folder: Path) -> None:
    import h5py

    with h5py.File(folder / "other.h5", "w") as other:
        other["code"] = np.arange(10, dtype="u2")
    del file["code"]
    file["code"] = h5py.ExternalLink(str(folder / "other.h5"), "/code")


def _external_link_pipe(file: Any, folder: Path) -> None:
    import h5py

    os.mkfifo(folder / "pipe")
    del file["code"]
    file["code"] = h5py.ExternalLink(str(folder / "pipe"), "/code")


def _soft_link(file: Any, _: Path) -> None:
    import h5py

    file["elsewhere"] = file["code"]
    del file["code"]
    file["code"] = h5py.SoftLink("/elsewhere")


def _virtual(file: Any, folder: Path) -> None:
    import h5py

    with h5py.File(folder / "other.h5", "w") as other:
        other["code"] = np.arange(10, dtype="u2")
    layout = h5py.VirtualLayout((10,), "u2")
    layout[:] = h5py.VirtualSource(str(folder / "other.h5"), "code", (10,))
    del file["code"]
    file.create_virtual_dataset("code", layout)


def _many_zeros(file: Any, _: Path) -> None:
    for name, kind in (("gap", "u8"), ("code", "u8"), ("quantiles", "u8"), ("doppler", "u8")):
        if name in file:
            del file[name]
        file.create_dataset(name, (15_000_000,), kind, chunks=(5_000_000,), compression="gzip", compression_opts=9)
        file[name].id.write_direct_chunk((0,), zlib.compress(bytes(40_000_000), 9))
        file[name].id.write_direct_chunk((5_000_000,), zlib.compress(bytes(40_000_000), 9))
        file[name].id.write_direct_chunk((10_000_000,), zlib.compress(bytes(40_000_000), 9))


def _beyond_chunk(file: Any, _: Path) -> None:
    del file["code"]
    file.create_dataset("code", (10,), "u2", chunks=(10,), compression="gzip")
    file["code"].id.write_direct_chunk((0,), _zeros(2 << 30))


def _huge_chunk(file: Any, _: Path) -> None:
    del file["code"]
    file.create_dataset("code", (10,), "u2", maxshape=(None,), chunks=(1 << 30,), compression="gzip")
    file["code"].id.write_direct_chunk((0,), _zeros(2 << 30))


def _many_quantiles(file: Any, _: Path) -> None:
    del file["quantiles"]
    file.create_dataset("quantiles", (2, 7_500_000), "i4", chunks=(2, 7_500_000), compression="gzip")
    file["quantiles"].id.write_direct_chunk((0, 0), zlib.compress(bytes(15_000_000), 9))


def _plugin(file: Any, _: Path) -> None:
    import h5py

    del file["code"]
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_chunk((10,))
    properties.set_filter(h5py.h5z.FILTER_SCALEOFFSET, h5py.h5z.FLAG_MANDATORY, (2, 0))
    space = h5py.h5s.create_simple((10,))
    h5py.h5d.create(file.id, b"code", h5py.h5t.STD_U16LE, space, properties).write_direct_chunk((0,), b"x" * 20)


# Arrays and clouds


def arrays() -> dict[str, Attack]:
    """Arrays of MATLAB and NumPy, and clouds."""
    cloud = lambda folder: CloudFiles([next(folder.iterdir())])[0].cloud()  # noqa: E731
    tesseract = lambda folder: read_radar(folder / "a.mat", "tesseract")  # noqa: E731
    return {
        "mat, arrays of other names": Attack(_other_names, tesseract),
        "mat, an array that unpacks to a gigabyte": Attack(_mat_zeros, tesseract),
        "mat with holes": Attack(_mat_holes, lambda folder: mat.read_mat(folder / "a.mat", "arrDREA")),
        "npy with holes": Attack(_npy_holes, lambda folder: npy.read_npy(folder / "a.npy")),
        "polar map with holes": Attack(_npy_holes, lambda folder: read_radar(folder / "a.npy", "polar3d")),
        "cloud npy with holes": Attack(_npy_holes, cloud),
        "cloud npy of many fields": Attack(_npy_fields, cloud),
        "cloud npy, a field of 2^30 numbers": Attack(_npy_wide, cloud),
        "bin with holes": Attack(lambda folder: _sparse(folder / "a.bin", b"", 1 << 30), cloud),
        "xyz with holes": Attack(lambda folder: _sparse(folder / "a.xyz", b"1 2 3\n", 1 << 30), cloud),
        "xyz, one line": Attack(lambda folder: (folder / "a.xyz").write_bytes(b"1 " * (16 << 20)), cloud),
        "pcd with holes": Attack(_pcd_holes, cloud),
        "pcd, LZF": Attack(_pcd_lzf, cloud),
        "pcd, fields of many numbers": Attack(_pcd_fields, cloud),
        "ffcloud with holes": Attack(_cache_holes, cloud),
        "ffcloud, a column of 2^40 numbers": Attack(_cache_wide, cloud),
    }


def _mat_file(folder: Path, elements: list[bytes]) -> None:
    head = b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + b"\x00\x01IM"
    (folder / "a.mat").write_bytes(head + b"".join(elements))


def _mat_array(name: bytes, count: int) -> tuple[bytes, int]:
    """The bytes before an array's numbers, and how many its element claims."""
    flags = struct.pack("<IIII", 6, 8, 6, 0)
    sides = struct.pack("<IIii", 5, 8, count, 1)
    called = struct.pack("<II", 1, len(name)) + name + bytes(-len(name) % 8)
    body = flags + sides + called + struct.pack("<II", 9, 8 * count)
    return struct.pack("<II", 14, len(body) + 8 * count) + body, len(body) + 8 * count


def _packed_mat(name: bytes, size: int) -> bytes:
    packed = _packed(_mat_array(name, size // 8)[0], size)
    return struct.pack("<II", 15, len(packed)) + packed


def _other_names(folder: Path) -> None:
    _mat_file(folder, [_packed_mat(b"other", 600 << 20)] * 12)


def _mat_zeros(folder: Path) -> None:
    _mat_file(folder, [_packed_mat(b"arrDREA", 1000 << 20)])


def _mat_holes(folder: Path) -> None:
    head, size = _mat_array(b"arrDREA", (1000 << 20) // 8)
    text = b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + b"\x00\x01IM"
    _sparse(folder / "a.mat", text + head, 128 + 8 + size)


def _npy_head(header: str) -> bytes:
    text = header.encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


def _npy_holes(folder: Path) -> None:
    rows = (1 << 30) // 16 - 64
    head = _npy_head(str({"descr": "<f4", "fortran_order": False, "shape": (rows, 4)}))
    _sparse(folder / "a.npy", head, len(head) + 16 * rows)


def _npy_fields(folder: Path) -> None:
    rows = 20_000
    names = [(name, "<f4") for name in "xyz"] + [(f"c{number}", "|u1") for number in range(2_500)]
    head = _npy_head(str({"descr": names, "fortran_order": False, "shape": (rows,)}))
    _sparse(folder / "a.npy", head, len(head) + (12 + 2_500) * rows)


def _npy_wide(folder: Path) -> None:
    fields = [(name, "<f4") for name in "xyz"] + [("c", "|u1", (1 << 30,))]
    (folder / "a.npy").write_bytes(_npy_head(str({"descr": fields, "fortran_order": False, "shape": (0,)})))


def _pcd(fields: str, sizes: str, types: str, counts: str, points: int, data: str) -> bytes:
    lines = [f"FIELDS {fields}", f"SIZE {sizes}", f"TYPE {types}", f"COUNT {counts}"]
    lines += [f"WIDTH {points}", "HEIGHT 1", f"POINTS {points}", f"DATA {data}", ""]
    return "\n".join(lines).encode()


def _pcd_holes(folder: Path) -> None:
    points = (1 << 30) // 16 - 64
    head = _pcd("x y z intensity", "4 4 4 4", "F F F F", "1 1 1 1", points, "binary")
    _sparse(folder / "a.pcd", head, len(head) + 16 * points)


def _pcd_lzf(folder: Path) -> None:
    points = (1000 << 20) // 264 * 264 // 16
    size = 16 * points
    tokens = b"\x00\x00" + b"\xe0\xff\x00" * (size // 264)
    head = _pcd("x y z intensity", "4 4 4 4", "F F F F", "1 1 1 1", points, "binary_compressed")
    (folder / "a.pcd").write_bytes(head + struct.pack("<II", len(tokens), size) + tokens)


def _pcd_fields(folder: Path) -> None:
    more = 4000
    names = " ".join(["x y z", *(f"c{number}" for number in range(more))])
    counts = " ".join(["1 1 1", *["65536"] * more])
    ones, kinds = " ".join(["4 4 4", *["1"] * more]), " ".join(["F F F", *["U"] * more])
    (folder / "a.pcd").write_bytes(_pcd(names, ones, kinds, counts, 0, "binary"))


def _cache(columns: list[dict[str, Any]], crc: int) -> bytes:
    header = json.dumps({"columns": columns, "crc32": crc}).encode()
    return b"FFCLOUD1" + struct.pack("<I", len(header)) + header


def _cache_holes(folder: Path) -> None:
    points, crc = (1000 << 20) // 12, 0
    for _ in range(1000):
        crc = zlib.crc32(bytes(12 * points // 1000 // 12 * 12), crc)
    points = 12 * points // 1000 // 12 * 1000
    head = _cache([{"name": name, "dtype": "<f4", "shape": [points]} for name in "xyz"], crc)
    _sparse(folder / "a.ffcloud", head, len(head) + 12 * points)


def _cache_wide(folder: Path) -> None:
    columns = [{"name": name, "dtype": "<f4", "shape": [0]} for name in "xyz"]
    columns += [{"name": "c", "dtype": "|u1", "shape": [0, 1 << 40]}]
    (folder / "a.ffcloud").write_bytes(_cache(columns, 0))


# Pictures


def pictures() -> dict[str, Attack]:
    """PNG and JPEG that unpack to much, or are drawn over and over."""
    read = lambda folder: images.read_image(folder / "a.png")  # noqa: E731
    upright = lambda folder: images.read_image(folder / "a.png", upright=True)  # noqa: E731
    depth = lambda folder: depth_png.read_depth(folder / "a.png")  # noqa: E731
    return {
        "png of 4 gigapixels": Attack(partial(_png, 65_500, 65_500, 8, 2, 0), read),
        "png of 99 megapixels in 16 bits": Attack(partial(_png, 9_950, 9_950, 16, 6, 0), read, 297_000_000),
        "png of 99 megapixels in 16 bits of grey": Attack(partial(_png, 9_950, 9_950, 16, 0, 0), read, 297_000_000),
        "png of 99 megapixels, turned": Attack(partial(_png_turned, 9_950), upright, 297_000_000),
        "png of 99 megapixels, interlaced and cut": Attack(partial(_png, 9_950, 9_950, 16, 6, 1), read),
        "png with a profile that unpacks": Attack(_png_profile, read),
        "png with texts that unpack": Attack(_png_texts, depth),
        "depth png of 99 megapixels": Attack(partial(_png, 9_950, 9_950, 16, 0, 0), depth, 396_000_000),
        "jpeg of many scans": Attack(_jpeg_scans, read),
    }


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _png(width: int, height: int, bits: int, colour: int, interlaced: int, folder: Path, more: bytes = b"") -> None:
    channels = {0: 1, 2: 3, 6: 4}[colour]
    size = min(height * (1 + width * channels * bits // 8), 1 << 30)
    head = _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, interlaced))
    data = _chunk(b"IDAT", _zeros(size)) + _chunk(b"IEND", b"")
    (folder / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + head + more + data)


def _png_turned(side: int, folder: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    _png(side, side, 8, 6, 0, folder, _chunk(b"eXIf", exif.tobytes().removeprefix(b"Exif\0\0")))


def _png_profile(folder: Path) -> None:
    _png(64, 64, 8, 2, 0, folder, _chunk(b"iCCP", b"a\0\0" + _zeros(2 << 30)))


def _png_texts(folder: Path) -> None:
    packed = zlib.compress(b"x" * 1_000_000, 9)
    texts = b"".join(_chunk(b"zTXt", b"t%d\0\0" % number + packed) for number in range(4_000))
    _png(64, 64, 16, 0, 0, folder, texts)


def _jpeg_scans(folder: Path) -> None:
    """A progressive JPEG whose last scan, of a few kilobytes, stands there thousands of times."""
    packed = io.BytesIO()
    Image.new("L", (9_900, 9_900)).save(packed, "JPEG", progressive=True)
    data = packed.getvalue()
    begin, end = data.rindex(b"\xff\xda"), data.rindex(b"\xff\xd9")
    (folder / "a.png").write_bytes(data[:end] + data[begin:end] * 2_000 + data[end:])


# Tables with long names


def tables() -> dict[str, Attack]:
    """Names of 130,000 characters among 20,000 boxes: an array of names is as wide as the longest in every row."""
    readers: dict[str, tuple[Callable[[str], str], Callable[[Path], Any]]] = {
        "boxes csv, a label": (lambda name: _csv({"label": name}), boxes_csv.read_boxes_csv),
        "boxes csv, a frame": (lambda name: _csv({"frame": name}), boxes_csv.read_boxes_csv),
        "boxes csv, a sequence": (lambda name: _csv({"sequence": name}), boxes_csv.read_boxes_csv),
        "kitti labels, a type": (_kitti, kitti.read_labels),
        "K-Radar labels, a class": (_kradar, read_kradar_labels),
        "K-Radar labels together, a class": (_kradar, _kradar_table),
        "box file, a label": (_boxes_json, read_boxes),
        "nuScenes results, a name": (_nuscenes, read_results),
        "class mapping, a class": (lambda name: f"classes: {{Car: {name}}}\n", read_class_mapping),
    }
    return {
        f"{name} of 130,000 characters": Attack(partial(_named, text), partial(_first, read))
        for name, (text, read) in readers.items()
    }


def _named(text: Callable[[str], str], folder: Path) -> None:
    (folder / "a.txt").write_text(text("x" * 130_000))


def _first(read: Callable[[Path], Any], folder: Path) -> Any:
    return read(next(folder.iterdir()))


def _csv(names: dict[str, str]) -> str:
    row = {"sequence": "a", "frame": "0", "label": "vehicle"}
    lines = [",".join(row.values()) + ",1,2,0,4,2,1.5,0"] * 20_000
    lines[7] = ",".join((row | names).values()) + ",1,2,0,4,2,1.5,0"
    return "\n".join(["sequence,frame,label,x,y,z,l,w,h,yaw_rad", *lines, ""])


def _kitti(name: str) -> str:
    line = " 0.00 0 -1.57 599.41 156.40 629.75 189.25 2.85 2.63 12.34 0.47 1.49 69.44 -1.56\n"
    return f"Car{line}" * 20_000 + f"{name}{line}"


def _kradar(name: str) -> str:
    head = "* idx(tesseract_os2-64_cam-front_os1-128_cam-lrr)=00033_00001_00002_00001_00004, timestamp=1643292946.71\n"
    return (
        head
        + "*, 0, 0, Sedan, 24.0, -3.8, -0.3, 0.6, 1.7, 0.8, 0.6\n" * 20_000
        + (f"*, 0, 0, {name}, 24.0, -3.8, -0.3, 0.6, 1.7, 0.8, 0.6\n")
    )


def _kradar_table(path: Path) -> Any:
    table = read_label_table([KRadarFiles(sequence="1", radar=33, lidar=1, label=path, version="v2.1")])
    if table.damaged:
        raise FarfieldError(table.damaged[0])
    return table


def _boxes_json(name: str) -> str:
    box = {"label": "vehicle", "centre_m": [9, 0, 0], "size_m": [4, 2, 1.5], "yaw_rad": 0}
    return json.dumps({"boxes": [box] * 20_000 + [box | {"label": name}]})


def _nuscenes(name: str) -> str:
    box = {"translation": [9, 0, 0], "size": [2, 4, 1.5], "rotation": [1, 0, 0, 0], "velocity": [0, 0]}
    box |= {"detection_score": 0.5, "attribute_name": "", "sample_token": "a", "detection_name": "car"}
    return json.dumps({"meta": {}, "results": {"a": [box] * 20_000 + [box | {"detection_name": name}]}})
