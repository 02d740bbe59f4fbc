"""Write docs/limits.md: what one file may cost, from the constants in the code.

python tools/limits.py            print the page
python tools/limits.py --write    write it
"""

import sys
from pathlib import Path

from farfield.calibration import saving
from farfield.datasets import open_sweeps
from farfield.datasets.kradar import labels
from farfield.files import (
    archives,
    bag_guard,
    bags,
    captures,
    data_frames,
    feather,
    json_text,
    kitti,
    limits,
    mat,
    nuscenes,
    parquet,
    pcd,
    pickles,
    radar_cells,
    waymo_objects,
    xml_tree,
    yaml_text,
)
from farfield.metrics import frames

PAGE = Path(__file__).resolve().parents[1] / "docs" / "limits.md"
HEAD = """# Limits

Printed by `tools/limits.py` from the constants in the code. Nothing is allocated on the word of a file: what it claims
is compared with the bytes that it has, and what it unpacks to with the limits below, before memory is taken. What is
beyond is refused with one error that names the file, the place, the limit and what was found; a pipe or a device in a
file's place is refused, never waited for.

The limit of a file counts for its own reader, and no flag of a command moves it: split a larger file, or leave out what
is not needed. In Python, readers take `max_bytes`. A bag or a
capture has no limit of its own, only its parts.

**A small file costs at most 1 GB beyond the data that was asked for, and 20 s.** `python benchmarks/fuzz_readers.py
hostile` reads hostile files of every kind and prints memory and time of each.

| limit | value | constant |
|---|---|---|
"""


def rows() -> list[tuple[str, str, str]]:
    """What is limited, the limit in words, and where the constant stands."""
    of = "farfield.files.limits"
    return [
        ("a file, and what a file, chunk or array unpacks to", _bytes(limits.MAX_BYTES), f"{of}.MAX_BYTES"),
        ("a MATLAB file, packed or not", _bytes(limits.MAX_TENSOR_BYTES), f"{of}.MAX_TENSOR_BYTES"),
        ("weights and imported checkpoints", _bytes(limits.MAX_WEIGHTS_BYTES), f"{of}.MAX_WEIGHTS_BYTES"),
        (
            "members of a checkpoint's archive",
            f"{archives._MAX_MEMBERS:,}, unpacked, no byte shared",
            "farfield.files.archives",
        ),
        ("points of an Open Sweep", f"{open_sweeps.MAX_POINTS:,}", "farfield.datasets.open_sweeps.MAX_POINTS"),
        ("numbers of a point", f"{limits.MAX_NUMBERS}", f"{of}.MAX_NUMBERS"),
        ("characters of a name", f"{limits.MAX_NAME}", f"{of}.MAX_NAME"),
        ("boxes of a frame that is scored, a side", f"{frames.MAX_BOXES:,}", "farfield.metrics.frames.MAX_BOXES"),
        (
            "pairs of boxes of a frame that may touch",
            f"{frames.MAX_PAIRS:,}, such as 500 boxes a side that all lie upon one another",
            "farfield.metrics.frames.MAX_PAIRS",
        ),
        ("pixels of a picture", f"{limits.MAX_PIXELS:,}", f"{of}.MAX_PIXELS"),
        ("pixels of a JPEG in all its scans", f"{limits.MAX_SCANNED_PIXELS:,}", f"{of}.MAX_SCANNED_PIXELS"),
        (
            "values of a JSON text in memory",
            f"{_bytes(json_text.MAX_MEMORY_BYTES)} and {json_text.MEMORY_SHARE} times its size",
            "farfield.files.json_text.MAX_MEMORY_BYTES, MEMORY_SHARE",
        ),
        ("results of nuScenes, in JSON", _bytes(nuscenes._MAX_BYTES), "farfield.files.nuscenes"),
        (
            "Waymo's `Objects` or a `Submission`",
            f"{_bytes(waymo_objects.MAX_OBJECTS_BYTES)}, {waymo_objects.MAX_OBJECTS:,} objects",
            "farfield.files.waymo_objects.MAX_OBJECTS_BYTES, MAX_OBJECTS",
        ),
        (
            "a file in YAML",
            f"{_bytes(yaml_text.MAX_BYTES)}, {yaml_text.MAX_NODES:,} values with those that aliases repeat, "
            f"{yaml_text.MAX_DEPTH} deep",
            "farfield.files.yaml_text.MAX_BYTES, MAX_NODES, MAX_DEPTH",
        ),
        (
            "a record of a `.pcap`; datagrams that wait for fragments, these fragments",
            f"{_bytes(captures._MOST_BYTES)}; {captures._MOST_OPEN:,}, {captures._MOST_PIECES:,}",
            "farfield.files.captures",
        ),
        (
            "a file in XML",
            f"{_bytes(xml_tree.MAX_BYTES)}, {xml_tree.MAX_ELEMENTS:,} elements",
            "farfield.files.xml_tree.MAX_BYTES, MAX_ELEMENTS",
        ),
        ("a KITTI label file", _bytes(kitti.MAX_TEXT_BYTES), "farfield.files.kitti.MAX_TEXT_BYTES"),
        ("a K-Radar label file", _bytes(labels.MAX_BYTES), "farfield.datasets.kradar.labels.MAX_BYTES"),
        ("a calibration", _bytes(saving._MAX_BYTES), "farfield.calibration.saving"),
        ("a feather table, unpacked, 8 bytes a cell", _bytes(feather.MAX_BYTES), "farfield.files.feather"),
        (
            "a Parquet column's chunk, unpacked, 8 bytes a value",
            f"{_bytes(limits.MAX_BYTES)} and {limits.MAX_EXPANSION} times its packed size",
            "farfield.files.parquet",
        ),
        ("a Parquet table", f"{parquet._MOST_ROWS:,} rows", "farfield.files.parquet"),
        (
            "a pickle of a data frame, unpacked",
            f"{_bytes(data_frames.MAX_FRAME_BYTES)}, {pickles.MAX_OPCODES:,} op-codes, marks {pickles.MAX_MARKS} deep",
            "farfield.files.data_frames.MAX_FRAME_BYTES, farfield.files.pickles.MAX_OPCODES, MAX_MARKS",
        ),
        ("cells of a radar store's column", f"{radar_cells._MAX_CELLS:,}", "farfield.files.radar_cells"),
        ("expansion of LZF in PCD", f"{pcd.LZF_MAX_EXPANSION} times", "farfield.files.pcd.LZF_MAX_EXPANSION"),
        ("expansion of zlib in MATLAB files", f"{mat.MAX_EXPANSION:,} times", "farfield.files.mat.MAX_EXPANSION"),
        ("a message of a bag", _bytes(limits.MAX_BYTES), "farfield.files.limits.MAX_BYTES"),
        (
            "chunks of a bag, each and all together",
            f"{_bytes(limits.FREE_BYTES)} and {limits.MAX_EXPANSION} times their packed size",
            f"{of}.FREE_BYTES, MAX_EXPANSION",
        ),
        (
            "chunks of a bag whose times overlap",
            f"{_bytes(limits.FREE_BYTES)} and {bag_guard.allowed_at_once(1)} times their packed size",
            "farfield.files.bag_guard.allowed_at_once",
        ),
        (
            "messages of a bag",
            f"{bags._FREE_MESSAGES:,} and one for each {bags._LEAST_MESSAGE_BYTES} bytes",
            "farfield.files.bags",
        ),
        ("a message's definition in a bag", _bytes(bags._MAX_DEFINITION_BYTES), "farfield.files.bags"),
    ]


def _bytes(count: int) -> str:
    for shift, unit in ((30, "GiB"), (20, "MiB"), (10, "KiB")):
        if count >= 1 << shift:
            return f"{count / (1 << shift):g} {unit}"
    return f"{count} bytes"


def page() -> str:
    """The whole page."""
    return HEAD + "".join(f"| {what} | {limit} | `{constant}` |\n" for what, limit, constant in rows())


if __name__ == "__main__":
    if "--write" in sys.argv[1:]:
        PAGE.write_text(page(), encoding="utf-8")
    else:
        print(page(), end="")
