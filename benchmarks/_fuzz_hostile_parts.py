"""Hostile parts of sound files, for _fuzz_hostile.py: types, texts, links and members that a reader does not expect."""

import hashlib
import io
import os
import pickle
import sqlite3
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _fuzz_hostile import (
    Attack,
    _chunk,
    _first,
    _npy_head,
    _packed,
    _pcd,
    _png,
    _store,
    _zeros,
)
from _fuzz_hostile_bags import _bag, _cloud, _mcap, _mcap_file, _message, _record, _table_file, _text
from PIL import Image

from farfield.datasets.calibration import read_calibration_file
from farfield.datasets.class_mapping import read_class_mapping
from farfield.datasets.kradar.products import read_radar
from farfield.datasets.memory import CloudFiles
from farfield.detectors.checkpoints import read_checkpoint
from farfield.files import boxes_csv, images, npy
from farfield.files.captures import datagrams
from farfield.files.feather import read_feather
from farfield.files.json_text import read_json
from farfield.files.xml_tree import parse_xml
from farfield.training.checkpoints import load_checkpoint


def parts() -> dict[str, Attack]:
    """Every attack of this file by its name."""
    return {**stores(), **tables(), **clouds(), **pictures(), **texts(), **bags(), **checkpoints(), **links()}


# HDF5


def stores() -> dict[str, Attack]:
    """Radar stores whose columns are of other types, or packed in other ways."""
    read = lambda folder: read_radar(folder / "cells_00033.h5", "cells")  # noqa: E731
    return {
        f"radar store, {name}": Attack(partial(_store, change), read, int("beside" in name))
        for name, change in {
            "a compound type": partial(_typed, [("a", "u4"), ("b", "u8", (1 << 20,))]),
            "lists of any length": partial(_typed, "vlen"),
            "references": partial(_typed, "ref"),
            "opaque bytes": partial(_typed, "V4096"),
            "a group in a column's place": _group,
            "a chain of 30 filters": _filters,
            "no space": _null_space,
            "a fill value of a column without data": _unwritten,
            "100,000 groups beside": _groups,
        }.items()
    }


def _typed(kind: Any, file: Any, _: Path) -> None:
    import h5py

    special = {"vlen": h5py.vlen_dtype(np.dtype("u2")), "ref": h5py.ref_dtype}
    del file["code"]
    file.create_dataset("code", (10,), special.get(kind, kind) if isinstance(kind, str) else np.dtype(kind))


def _group(file: Any, _: Path) -> None:
    del file["code"]
    file.create_group("code")


def _filters(file: Any, _: Path) -> None:
    import h5py

    del file["code"]
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_chunk((10,))
    for _ in range(30):
        properties.set_deflate(9)
    space = h5py.h5s.create_simple((10,))
    packed = bytes(20)
    for _ in range(30):
        packed = zlib.compress(packed, 9)
    h5py.h5d.create(file.id, b"code", h5py.h5t.STD_U16LE, space, properties).write_direct_chunk((0,), packed)


def _null_space(file: Any, _: Path) -> None:
    import h5py

    del file["code"]
    file["code"] = h5py.Empty("u2")


def _unwritten(file: Any, _: Path) -> None:
    del file["code"]
    file.create_dataset("code", (14_000_000,), "u2", chunks=(14_000_000,), compression="gzip", fillvalue=7)


def _groups(file: Any, _: Path) -> None:
    for number in range(100_000):
        file.create_group(f"g{number}")


# Feather


def tables() -> dict[str, Attack]:
    """Feather tables with nested, many or strange columns."""
    read = partial(_first, lambda path: read_feather(path, ["x", "name"]))
    makers: dict[str, Callable[[], Any]] = {
        "lists in lists": _nested_table,
        "lists of nothing": _empty_lists,
        "100,000 columns": _wide_table,
        "a text of a megabyte": _long_text,
        "views of texts": _views,
        "metadata of 100 MB": _metadata,
    }
    whole = ("a text of a megabyte", "metadata of 100 MB")
    return {
        f"feather, {name}": Attack(partial(_table, make), read, int(name in whole)) for name, make in makers.items()
    }


def _table(make: Callable[[], Any], folder: Path) -> None:
    import pyarrow.ipc

    table = make()
    with pyarrow.ipc.new_file(folder / "a.feather", table.schema) as file:
        file.write_table(table)


def _with(column: Any) -> Any:
    import pyarrow

    return pyarrow.table({"x": column, "name": column})


def _nested_table() -> Any:
    import pyarrow

    column = pyarrow.array([1, 2, 3])
    for _ in range(40):
        column = pyarrow.ListArray.from_arrays(pyarrow.array([0, len(column)]).cast("i4"), column)
    return _with(column)


def _empty_lists() -> Any:
    import pyarrow

    offsets = pyarrow.array(np.zeros(20_000_001, np.int32))
    return _with(pyarrow.ListArray.from_arrays(offsets, pyarrow.array([], "i4")))


def _wide_table() -> Any:
    import pyarrow

    return pyarrow.table({f"c{number}": pyarrow.array([1]) for number in range(100_000)})


def _long_text() -> Any:
    import pyarrow

    names = pyarrow.array(["a" * (1 << 20)])
    return _with(pyarrow.DictionaryArray.from_arrays(pyarrow.array(np.zeros(1_000_000, np.int8)), names))


def _views() -> Any:
    import pyarrow

    return _with(pyarrow.array(["x" * 100] * 100_000).cast(pyarrow.string_view()))


def _metadata() -> Any:
    import pyarrow

    return _with(pyarrow.array([1.0])).replace_schema_metadata({"a": "x" * 100_000_000})


# Clouds, arrays, captures


def clouds() -> dict[str, Attack]:
    """Clouds and arrays whose headers are absurd, captures without end."""
    cloud = lambda folder: CloudFiles([next(folder.iterdir())])[0].cloud()  # noqa: E731
    array = lambda folder: npy.read_npy(folder / "a.npy")  # noqa: E731
    ones = ("4 4 4", "F F F", "1 1 1")
    shapes = {"(2**62, 0)": (1 << 62, 0), "32 axes of 2^61 and a 0": (*[1 << 61] * 31, 0), "true": (True, 3)}
    return {
        "pcd of 2^64 points": Attack(_written("a.pcd", _pcd("x y z", *ones, 1 << 64, "binary")), cloud),
        "pcd of 10^18 points": Attack(_written("a.pcd", _pcd("x y z", *ones, 10**17, "binary_compressed")), cloud),
        "pcd, a number of 30 million digits": Attack(
            _written("a.pcd", _pcd("x y z", *ones, 1, "ascii") + b"1" * 30_000_000 + b" 1 1\n"), cloud
        ),
        "pcd, one text line of 100 MB": Attack(
            _written("a.pcd", _pcd("x y z", *ones, 1, "ascii") + b"1 " * 50_000_000), cloud
        ),
        **{
            f"npy of shape {name}": Attack(
                _written("a.npy", _npy_head(str({"descr": "<f4", "fortran_order": False, "shape": shape}))), array
            )
            for name, shape in shapes.items()
        },
        "npy, a header of brackets": Attack(_written("a.npy", _npy_head("(" * 4000)), array),
        "npy, a header that computes": Attack(
            _written("a.npy", _npy_head("{'descr': '<f4', 'fortran_order': False, 'shape': (9**9**9,)}")), array
        ),
        "npy, types within types": Attack(_npy_types, array),
        "pcap, tags without end": Attack(_pcap_tags, lambda folder: list(datagrams(folder / "a.pcap")), 1),
        "pcap, fragments without end": Attack(_pcap_fragments, lambda folder: list(datagrams(folder / "a.pcap")), 1),
    }


def _written(name: str, data: bytes) -> Callable[[Path], None]:
    return partial(_write, name, data)


def _write(name: str, data: bytes, folder: Path) -> None:
    (folder / name).write_bytes(data)


def _npy_types(folder: Path) -> None:
    kind: Any = "'<f4'"
    for _ in range(60):
        kind = f"[('a', {kind})]"
    _write("a.npy", _npy_head(f"{{'descr': {kind}, 'fortran_order': False, 'shape': (1,)}}") + bytes(4), folder)


def _pcap(packets: list[bytes]) -> bytes:
    head = struct.pack("<IHHIIII", 0xA1B2C3D4, 2, 4, 0, 0, 1 << 18, 1)
    return head + b"".join(struct.pack("<IIII", 1, 0, len(one), len(one)) + one for one in packets)


def _pcap_tags(folder: Path) -> None:
    _write("a.pcap", _pcap([bytes(12) + b"\x81\x00\x00\x01" * 65_000] * 40), folder)


def _pcap_fragments(folder: Path) -> None:
    packets = []
    for number in range(600_000):
        first = struct.pack(">BBHHHBBH", 0x45, 0, 28, number >> 12, 0x2001 | number & 0xFFF, 64, 17, 0)
        packets.append(bytes(12) + b"\x08\x00" + first + bytes(8) + bytes(8))
    _write("a.pcap", _pcap(packets), folder)


# Pictures


def pictures() -> dict[str, Attack]:
    """PNG and JPEG with very many or very large parts."""
    read = lambda folder: images.read_image(folder / "a.png")  # noqa: E731
    upright = lambda folder: images.read_image(folder / "a.png", upright=True)  # noqa: E731
    plain = partial(_png, 64, 64, 8, 2, 0)
    return {
        "png, a text of 200 MB": Attack(lambda folder: plain(folder, _chunk(b"tEXt", b"a\0" + bytes(200 << 20))), read),
        "png, international texts": Attack(
            lambda folder: plain(folder, _chunk(b"iTXt", b"a\0\1\0\0\0" + _zeros(1 << 20)) * 4_000), read
        ),
        "png, 2,000,000 empty chunks": Attack(
            lambda folder: plain(folder, _chunk(b"IDAT", b"") * 2_000_000), read, 12_288
        ),
        "png, 1,000,000 texts": Attack(
            lambda folder: plain(folder, b"".join(_chunk(b"tEXt", b"k%d\0x" % n) for n in range(1_000_000))),
            read,
            12_288,
        ),
        "png, data that go on": Attack(
            lambda folder: plain(folder, _chunk(b"IDAT", _packed(bytes(64 * 193), 2 << 30))), read, 12_288
        ),
        "jpeg, 100,000 comments": Attack(_jpeg_segments, read, 12_288),
        "jpeg, EXIF whose directories lead in a circle": Attack(_jpeg_circle, upright, 12_288),
        "jpeg of many pictures": Attack(_jpeg_pictures, read, 12_288),
    }


def _jpeg(**more: Any) -> bytes:
    packed = io.BytesIO()
    Image.new("RGB", (64, 64)).save(packed, "JPEG", **more)
    return packed.getvalue()


def _jpeg_segments(folder: Path) -> None:
    data = _jpeg()
    comments = (b"\xff\xfe" + struct.pack(">H", 2_000) + bytes(1_998)) * 100_000
    _write("a.png", data[:2] + comments + data[2:], folder)


def _jpeg_circle(folder: Path) -> None:
    """Each entry of the directory is one of EXIF, GPS or a maker's, and leads to the directory itself."""
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, 8) for tag in (0x0112, 0x8769, 0x8825, 0xA005, 0x014A))
    tiff = b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", 5) + entries + struct.pack("<I", 8)
    _write("a.png", _jpeg(exif=b"Exif\0\0" + tiff), folder)


def _jpeg_pictures(folder: Path) -> None:
    packed = io.BytesIO()
    Image.new("RGB", (64, 64)).save(packed, "MPO", save_all=True, append_images=[Image.new("RGB", (64, 64))] * 3_000)
    _write("a.png", packed.getvalue(), folder)


# Texts


def texts() -> dict[str, Attack]:
    """JSON, YAML, XML and CSV that nest, merge or repeat without bounds."""
    json = partial(_first, read_json)
    mapping = partial(_first, read_class_mapping)
    calibration = partial(_first, read_calibration_file)
    xml = partial(_first, lambda path: parse_xml(path.read_bytes(), path))
    table = partial(_first, boxes_csv.read_boxes_csv)
    head = b"sequence,frame,label,x,y,z,l,w,h,yaw_rad\n"
    return {
        "json, 1,000,000 brackets": Attack(_written("a.json", b"[" * 1_000_000), json),
        "json, a number of 5 million digits": Attack(_written("a.json", b"[" + b"7" * 5_000_000 + b"]"), json),
        "json, a power of 10^9": Attack(_written("a.json", b"[1e999999999]"), json),
        "json, 40 million empty lists": Attack(_written("a.json", b"[" + b"[]," * 40_000_000 + b"[]]"), json),
        "json, one key a million times": Attack(
            _written("a.json", b'{"a":1,' * 1 + b'"a":1,' * 1_000_000 + b'"b":1}'), json
        ),
        "yaml, groups that merge": Attack(_written("a.yaml", merged().encode()), mapping),
        "yaml, calibration that merges": Attack(_written("a.yaml", merged().encode()), calibration),
        "yaml, a million brackets": Attack(_written("a.yaml", b"[" * 1_000_000), calibration),
        "yaml, a million question marks": Attack(_written("a.yaml", b"? " * 500_000), calibration),
        "yaml, one text of a megabyte": Attack(_written("a.yaml", b"classes: " + b"a\n " * 330_000), mapping),
        "yaml, a number of a million digits": Attack(_written("a.yaml", b"matrix: 1." + b"1" * 1_000_000), calibration),
        "xml, 14 million elements": Attack(_written("a.xml", b"<a>" + b"<b/>" * 14_000_000 + b"</a>"), xml),
        "xml, a million attributes": Attack(
            _written("a.xml", b"<a " + b" ".join(b'a%d="1"' % n for n in range(1_000_000)) + b"/>"), xml, 1
        ),
        "boxes csv, a quotation without end": Attack(_written("a.csv", head + b'"' + b"a\n" * 20_000_000), table),
        "boxes csv, 10 million columns": Attack(_written("a.csv", head[:-1] + b",a" * 10_000_000 + b"\n"), table),
        "boxes csv, a number of 5 million digits": Attack(
            _written("a.csv", head + b"a,0,vehicle," + b"1" * 5_000_000 + b",2,0,4,2,1,0\n"), table
        ),
    }


def merged() -> str:
    """Nine groups of which each merges the one before nine times."""
    lines = [f"a{n}: &a{n} {{<<: [{', '.join([f'*a{n - 1}'] * 9)}]}}" for n in range(1, 9)]
    return "\n".join(["a0: &a0 {x: 1}", *lines, ""])


# Bags


def bags() -> dict[str, Attack]:
    """Bags whose settings of transport, metadata or packed files are hostile."""
    return {
        "mcap, settings of transport that merge": Attack(partial(_mcap_file, _transport), _bag),
        "mcap, a type within itself": Attack(
            partial(_mcap_file, lambda: _mcap([_message(_cloud())], "sensor_msgs/PointCloud2[] a\n")), _bag
        ),
        "mcap, an array of 10^9 numbers": Attack(
            partial(_mcap_file, lambda: _mcap([_message(_cloud())], "float64[1000000000] a\n")), _bag
        ),
        "mcap, arrays of arrays": Attack(partial(_mcap_file, _arrays), _bag),
        "db3, settings of transport that merge": Attack(partial(_table_file, _table_transport), _bag),
        "bag, metadata that merge": Attack(partial(_folder, merged(), "a.db3", ""), _bag_folder),
        "bag, a view in a file of another kind": Attack(partial(_folder, "", "a.bin", _ENDLESS), _bag_folder),
        "bag, a view in a packed file": Attack(partial(_folder, "", "a.db3.zstd", _ENDLESS), _bag_folder),
        "bag, metadata in /dev/zero": Attack(_zero_metadata, _bag_folder),
    }


_ENDLESS = (
    "DROP TABLE messages; CREATE VIEW messages AS WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) "
    "SELECT x AS id, 1 AS topic_id, 5 AS timestamp, zeroblob(100000000) AS data FROM n;"
)


def _transport() -> bytes:
    data = _mcap([_message(_cloud())])
    settings = _text(b"offered_qos_profiles") + _text(merged().encode())
    plain = struct.pack("<HH", 1, 1) + _text(b"/points") + _text(b"cdr")
    return data.replace(_record(4, plain + _text(b"")), _record(4, plain + _text(settings)))


def _arrays() -> bytes:
    levels = 8
    text = "A0[4000] a\n" + "".join(f"{'=' * 80}\nMSG: sensor_msgs/A{n}\nA{n + 1}[4000] a\n" for n in range(levels))
    return _mcap([_message(_cloud())], text + f"{'=' * 80}\nMSG: sensor_msgs/A{levels}\nuint8 a\n")


def _table_transport(path: Path) -> None:
    with closing(sqlite3.connect(path)) as database:
        database.execute("UPDATE topics SET offered_qos_profiles = ?", (merged(),))
        database.commit()


def _folder(before: str, name: str, script: str, folder: Path) -> None:
    """A bag of a folder whose one file has a name, and has run a script of SQL."""
    from rosbags.rosbag2.storage_mcap import zstd

    _table_file(Path.exists, folder)
    whole = folder / "a.db3"
    with closing(sqlite3.connect(whole)) as database:
        database.executescript(script)
    data = whole.read_bytes()
    (folder / name).write_bytes(zstd.compress(data) if name.endswith(".zstd") else data)
    if name.endswith(".zstd"):
        whole.unlink()
        (folder / "b.db3").write_bytes(b"")
    packed = "file" if name.endswith(".zstd") else ""
    (folder / "metadata.yaml").write_text(
        f"{before}rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: sqlite3\n"
        f"  relative_file_paths: [{name}]\n  duration: {{nanoseconds: 0}}\n"
        "  starting_time: {nanoseconds_since_epoch: 1700000000000000000}\n  message_count: 1\n"
        f"  compression_format: '{'zstd' if packed else ''}'\n  compression_mode: '{packed}'\n"
        "  topics_with_message_count:\n  - message_count: 1\n    topic_metadata: {name: /points, "
        "type: sensor_msgs/msg/PointCloud2, serialization_format: cdr, offered_qos_profiles: ''}\n"
    )


def _zero_metadata(folder: Path) -> None:
    _folder("", "a.db3", "", folder)
    (folder / "metadata.yaml").unlink()
    (folder / "metadata.yaml").symlink_to("/dev/zero")


def _bag_folder(folder: Path) -> Any:
    from farfield.files.bags import Bag

    bag = Bag(folder)
    return [len(raw) for _, _, raw in bag.messages()]


# Checkpoints


def checkpoints() -> dict[str, Attack]:
    """Archives whose members are doubled, nested or many, and whose pickles refer to themselves."""
    changes: dict[str, Callable[[], bytes]] = {
        "members twice": _twice,
        "archives within archives": _nested_archive,
        "90,000 empty members": _many_members,
        "lists that hold one list often": partial(_archive_of, _folded),
        "a pickle of 10^6 nested lists": partial(
            _archive_of, lambda: b"\x80\x02" + b"]" * 1_000_000 + b"a" * 999_999 + b"."
        ),
        "a number of a million bytes": partial(
            _archive_of, lambda: b"\x80\x02\x8b" + struct.pack("<i", 1_000_000) + b"\x01" * 1_000_000 + b"."
        ),
        "texts of 2^31 bytes": partial(_archive_of, lambda: b"\x80\x04\x8d" + struct.pack("<Q", 1 << 31) + b"a."),
        "a place of 2^31 in the memo": partial(
            _archive_of, lambda: b"\x80\x02]r" + struct.pack("<I", (1 << 32) - 1) + b"."
        ),
    }
    return {
        f"{name}, {what}": Attack(
            partial(_sealed, change, sealed), partial(_first, read), int(sealed and "often" in what)
        )
        for name, read, sealed in (("checkpoint", load_checkpoint, True), ("imported weights", read_checkpoint, False))
        for what, change in changes.items()
    }


def _sealed(change: Callable[[], bytes], sealed: bool, folder: Path) -> None:
    data = change()
    seal = b"farfield-sha256:" + hashlib.sha256(data).hexdigest().encode() if sealed else b""
    (folder / "a.pt").write_bytes(data + seal)


def _archive_of(made: Callable[[], bytes]) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("archive/data.pkl", made())
        archive.writestr("archive/byteorder", "little")
        archive.writestr("archive/version", "3\n")
    return packed.getvalue()


def _folded() -> bytes:
    """60 lists of which each holds the one before twice: 2^60 values."""
    value: Any = []
    for _ in range(60):
        value = [value, value]
    return pickle.dumps({"model_state": {"a": value}, "model": value}, protocol=2)


def _twice() -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive, warnings.catch_warnings(action="ignore"):
        for data in (pickle.dumps({}, protocol=2), b"\x80\x02]."):
            archive.writestr("archive/data.pkl", data)
    return packed.getvalue()


def _nested_archive() -> bytes:
    data = _archive_of(lambda: pickle.dumps({}, protocol=2))
    for _ in range(50):
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w") as archive:
            archive.writestr("archive/data.pkl", data)
        data = packed.getvalue()
    return data


def _many_members() -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("archive/data.pkl", pickle.dumps({}, protocol=2))
        for number in range(90_000):
            archive.writestr(f"archive/data/{number}", b"")
    return packed.getvalue()


# Links


def links() -> dict[str, Attack]:
    """Links to devices, and pipes, in the places of files."""
    cloud = lambda folder: CloudFiles([next(folder.iterdir())])[0].cloud()  # noqa: E731
    readers: dict[str, tuple[str, Callable[[Path], Any]]] = {
        **{suffix: (f"a.{suffix}", cloud) for suffix in ("bin", "pcd", "xyz", "npy", "ffcloud")},
        "png": ("a.png", lambda folder: images.read_image(folder / "a.png")),
        "size of png": ("a.png", lambda folder: images.image_size(folder / "a.png")),
        "mcap": ("a.mcap", _bag),
        "db3": ("a.db3", _bag),
        "pcap": ("a.pcap", lambda folder: list(datagrams(folder / "a.pcap"))),
        "checkpoint": ("a.pt", partial(_first, load_checkpoint)),
        "imported weights": ("a.pth", partial(_first, read_checkpoint)),
        "feather": ("a.feather", partial(_first, lambda path: read_feather(path, ["x"]))),
        "radar store": ("cells_1.h5", lambda folder: read_radar(folder / "cells_1.h5", "cells")),
        "calibration": ("a.yaml", partial(_first, read_calibration_file)),
        "boxes csv": ("a.csv", partial(_first, boxes_csv.read_boxes_csv)),
    }
    return {
        f"{name}, {what}": Attack(partial(make, file), read)
        for name, (file, read) in readers.items()
        for what, make in (("a link to /dev/zero", _device), ("a pipe", _pipe))
    }


def _device(name: str, folder: Path) -> None:
    (folder / name).symlink_to("/dev/zero")


def _pipe(name: str, folder: Path) -> None:
    os.mkfifo(folder / name)
