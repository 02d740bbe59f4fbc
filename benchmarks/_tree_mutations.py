"""Changes of the structure of files, by what kind of file it is: what a format's own words and numbers may turn into.

A mutation takes random numbers and a file's bytes, and gives other bytes with words about what was changed. Where it
puts a number outside what every schema bounds (a negative size, a turn of zeros, NaN for a place), ``bounded`` says so:
what is read then may not differ without a word.
"""

import gzip
import io
import json
import pickletools
import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

NUMBERS: tuple[Any, ...] = (-1, 0, 2**31, 2**31 - 1, 2**63, 2**64, 10**30, 1e308, -1e308, float("nan"), float("inf"))
OTHER: tuple[Any, ...] = (None, True, "", "x", [], {}, [[]], "-1", "nan", 0.5, "../../../../etc/passwd", "a" * 5000)
SIZES = re.compile(r"^(size|length|width|height|size_3d_\w+|dimensions\.\w|BoundingBox3D Extent \w)$")
PLACES = re.compile(r"^(translation|center|centre|BoundingBox3D Origin \w|x|y|z|poses|lidar_extrinsics)$")
TURNS = re.compile(r"^(rotation|heading|orientation_3d_q\w|BoundingBox3D Orientation Quat \w)$")
COUNTS = re.compile(r"^(num_lidar_pts|num_radar_pts)$")
TIMES = re.compile(r"^(timestamp|Timestamp|timestamps)$")
TOKEN = re.compile(r"^[0-9a-f]{32}$")


@dataclass(frozen=True)
class Mutation:
    """What becomes of a file."""

    data: bytes
    words: str
    bounded: bool = False


Mutate = Callable[[np.random.Generator, bytes], Mutation]


def nodes(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths to all values beneath one; of a long list a few rows alone."""
    listed = [path]
    if isinstance(value, Mapping):
        for key, entry in value.items():
            listed += nodes(entry, (*path, key))
    elif isinstance(value, list):
        rows = range(len(value)) if len(value) < 12 else (0, 1, 5, len(value) - 1)
        for row in rows:
            listed += nodes(value[row], (*path, row))
    return listed


def at(value: Any, path: tuple[Any, ...]) -> Any:
    """What stands at a path."""
    for key in path:
        value = value[key]
    return value


def mutate_json(random: np.random.Generator, data: bytes) -> Mutation:
    """Keys removed, renamed or retyped, numbers that cannot be, tokens that lead nowhere or in a circle."""
    value = json.loads(data)
    paths = [path for path in nodes(value) if path]
    if not paths:
        return mutate_bytes(random, data)
    kind = str(random.choice(["remove", "rename", "retype", "number", "token", "bound", "bound", "duplicate", "bytes"]))
    if kind == "bytes":
        return mutate_bytes(random, data)
    if kind == "bound":
        return bounded_json(random, value, paths) or mutate_bytes(random, data)
    path = paths[random.integers(len(paths))]
    if kind == "token":
        tokens = [path for path in paths if isinstance(at(value, path), str) and TOKEN.match(at(value, path))]
        if tokens:
            path = tokens[random.integers(len(tokens))]
            row = at(value, path[:-1])
            own = row.get("token") if isinstance(row, dict) else None
            other = (
                own
                if own and path[-1] in ("next", "prev") and random.random() < 0.5
                else f"{random.integers(2**60):032x}"
            )
            row[path[-1]] = other
            return Mutation(
                json.dumps(value).encode(), f"{shown(path)}: token {'of itself' if other == own else 'of nothing'}"
            )
        kind = "retype"
    holder, key = at(value, path[:-1]), path[-1]
    if kind == "remove":
        del holder[key]
    elif kind == "rename" and isinstance(holder, dict):
        holder[f"{key}_"] = holder.pop(key)
    elif kind == "duplicate" and isinstance(holder, list):
        holder.append(holder[key])
    elif kind == "number":
        holder[key] = NUMBERS[random.integers(len(NUMBERS))]
    else:
        holder[key] = OTHER[random.integers(len(OTHER))]
    return Mutation(json.dumps(value).encode(), f"{kind} {shown(path)}")


def shown(path: tuple[Any, ...]) -> str:
    """A path in words."""
    return "/".join(str(part) for part in path)[:80]


def bounded_json(random: np.random.Generator, value: Any, paths: list[tuple[Any, ...]]) -> Mutation | None:
    """A number outside what the schema bounds: sizes, places, turns, counts."""
    candidates = []
    for path in paths:
        key = next((part for part in reversed(path) if isinstance(part, str)), "")
        number = at(value, path)
        if isinstance(number, bool) or not isinstance(number, int | float):
            continue
        if SIZES.match(key):
            candidates.append((path, (-1.5, 0.0, float("nan"), float("inf"), 1e9)))
        elif PLACES.match(key):
            candidates.append((path, (float("nan"), float("inf"), 1e300)))
        elif TURNS.match(key):
            candidates.append((path, (float("nan"), 7.5, 1e200)))
        elif COUNTS.match(key):
            candidates.append((path, (-3, 2.5, 2**70)))
        elif TIMES.match(key):
            candidates.append((path, (-1, float("nan"), 2**70, 1e300)))
    if not candidates:
        return None
    path, bad = candidates[random.integers(len(candidates))]
    number = bad[random.integers(len(bad))]
    at(value, path[:-1])[path[-1]] = number
    return Mutation(json.dumps(value).encode(), f"{shown(path)} = {number!r}", bounded=True)


def mutate_bytes(random: np.random.Generator, data: bytes) -> Mutation:
    """Cut, emptied, doubled, flipped."""
    kind = str(random.choice(["cut", "cut", "empty", "doubled", "flipped", "one more byte"]))
    if kind == "cut":
        where = int(random.integers(len(data) + 1))
        return Mutation(data[:where], f"cut at {where} of {len(data)}")
    if kind == "empty":
        return Mutation(b"", kind)
    if kind == "doubled":
        return Mutation(data + data, kind)
    if kind == "one more byte":
        return Mutation(data + b"\x07", kind)
    changed = bytearray(data or b"\0")
    for position in random.integers(8 * min(len(changed), 2000), size=int(random.integers(1, 9))):
        changed[position // 8] ^= 1 << position % 8
    return Mutation(bytes(changed), kind)


def mutate_rows(random: np.random.Generator, data: bytes) -> Mutation:
    """Rows of float32: cut within one, numbers that are not finite or of a map."""
    if random.random() < 0.4 or len(data) < 40:
        return mutate_bytes(random, data)
    changed = bytearray(data)
    position = 4 * int(random.integers(len(data) // 4))
    number = float(random.choice([np.nan, np.inf, 1e30, 6e5, -1e9]))
    changed[position : position + 4] = struct.pack("<f", number)
    return Mutation(bytes(changed), f"float {position // 4} = {number}")


def mutate_npy(random: np.random.Generator, data: bytes) -> Mutation:
    """An array of other shape, type or order, or whose header lies."""
    if random.random() < 0.4:
        return mutate_bytes(random, data)
    if random.random() < 0.5:
        changed = data
        for old, new in ((b"'<f4'", b"'<f8'"), (b"'<f4'", b"'|O'"), (b"False", b"True"), (b"(", b"(9")):
            if random.random() < 0.4:
                changed = changed.replace(old, new, 1)
        return Mutation(changed, "header of npy")
    values = np.load(io.BytesIO(data))
    file = io.BytesIO()
    if values.dtype.names:
        names = list(values.dtype.names)
        keep = [name for name in names if name != names[random.integers(len(names))]]
        np.save(file, np.array(values[keep].tolist(), [(name, "<f8") for name in keep]))
        return Mutation(file.getvalue(), f"columns {', '.join(keep)}")
    shaped = [values.T, values[:, :3], values[:0], values.astype("i2"), values[None], values.ravel()]
    np.save(file, shaped[random.integers(len(shaped))])
    return Mutation(file.getvalue(), "another array")


def mutate_text(random: np.random.Generator, data: bytes) -> Mutation:
    """Words removed, doubled or turned into numbers that cannot be."""
    lines = data.decode("utf-8", "replace").split("\n")
    filled = [row for row, line in enumerate(lines) if line.split()]
    if not filled or random.random() < 0.2:
        return mutate_bytes(random, data)
    row = filled[random.integers(len(filled))]
    words = re.split(r"([ ,]+)", lines[row])
    place = 2 * int(random.integers((len(words) + 1) // 2))
    number = str(random.choice(["nan", "inf", "-1", "0", "1e308", "9999999999", "x", "", "0x10", "1_0", "-0.0"]))
    kind = str(random.choice(["word", "word", "lost", "twice", "line twice"]))
    bounded = kind == "word" and number in ("nan", "inf") and bool(re.fullmatch(r"-?[\d.]+", words[place]))
    if kind == "word":
        words[place] = number
    elif kind == "lost":
        words = words[:place] + words[place + 2 :]
    elif kind == "twice":
        words[place:place] = [words[place], " "]
    lines[row] = "".join(words)
    if kind == "line twice":
        lines.insert(row, lines[row])
    changed = f"line {row}, word {place // 2}: {number if kind == 'word' else kind}"
    return Mutation("\n".join(lines).encode(), changed, bounded)


def mutate_header(random: np.random.Generator, data: bytes) -> Mutation:
    """The lines of a PLY's or PCD's header, which then lie about what follows."""
    end = max(data.find(b"end_header\n") + 11, data.find(b"DATA binary\n") + 12)
    if end < 20 or random.random() < 0.25:
        return mutate_bytes(random, data)
    lines = data[:end].decode("latin-1").split("\n")
    row = int(random.integers(len(lines) - 1))
    words = lines[row].split(" ")
    place = int(random.integers(len(words)))
    options = [
        "",
        "0",
        "-1",
        "2147483648",
        "99999999999999",
        "1",
        "double",
        "uchar",
        "float",
        "x",
        "8",
        "F",
        "U",
        "ascii",
    ]
    kind = str(random.choice(["word", "word", "line lost", "line twice", "order"]))
    lies = kind in ("word", "order") and lines[row].startswith(("element", "POINTS", "WIDTH", "SIZE", "format", "DATA"))
    if kind == "word":
        words[place] = options[random.integers(len(options))]
        lines[row] = " ".join(words)
    elif kind == "line lost":
        del lines[row]
    elif kind == "line twice":
        lines.insert(row, lines[row])
    else:
        lines[row] = lines[row].replace("little", "big").replace("binary", "binary_compressed")
    return Mutation(
        "\n".join(lines).encode("latin-1") + data[end:],
        f"header line {row}: {kind} {lines[min(row, len(lines) - 1)]!r}"[:120],
        lies,
    )


_LAS = {  # offset in the header: format
    6: "H", 24: "B", 25: "B", 94: "H", 96: "I", 100: "I", 104: "B", 105: "H", 107: "I", 111: "I", 131: "d", 139: "d",
    147: "d", 155: "d", 179: "d", 187: "d",
}  # fmt: skip


def mutate_las(random: np.random.Generator, data: bytes) -> Mutation:
    """A number of the header of LAS."""
    if random.random() < 0.3 or len(data) < 227:
        return mutate_bytes(random, data)
    offset = list(_LAS)[random.integers(len(_LAS))]
    kind = _LAS[offset]
    changed = bytearray(data)
    if kind == "d":
        number: Any = float(random.choice([np.nan, np.inf, 0, -0.001, 1e300, 1.0]))
    else:
        number = int(
            random.choice([0, 1, 3, 2 ** (8 * struct.calcsize(kind)) - 1, 2 ** (8 * struct.calcsize(kind) - 1)])
        )
    struct.pack_into(f"<{kind}", changed, offset, number)
    lies = offset in (96, 105, 107) or (kind == "d" and offset < 155 and not (np.isfinite(number) and number))
    return Mutation(bytes(changed), f"LAS header, byte {offset} = {number}", bounded=lies)


def mutate_pickle(random: np.random.Generator, data: bytes) -> Mutation:
    """Opcodes swapped, names changed, lengths that lie, in a gzipped pickle."""
    if random.random() < 0.15:
        return mutate_bytes(random, data)
    whole = bytearray(gzip.decompress(data))
    places = [(position, opcode.name) for opcode, _, position in pickletools.genops(bytes(whole))]
    position, name = places[random.integers(len(places))]
    kind = str(random.choice(["opcode", "argument", "lost", "name", "name", "length"]))
    if kind == "opcode":
        whole[position] = int(random.choice(list(b"NRbt0(]}\x81\x85\x93\x88.JKh\x94QPi\x82oc")))
    elif kind == "argument" and position + 1 < len(whole):
        whole[position + 1] ^= int(random.integers(1, 256))
    elif kind == "lost":
        following = next((later for later, _ in places if later > position), len(whole))
        del whole[position:following]
    elif kind == "name":
        names = [
            b"BlockManager",
            b"DataFrame",
            b"_new_Index",
            b"numpy",
            b"slice",
            b"dtype",
            b"_frombuffer",
            b"_reconstruct",
            b"RangeIndex",
        ]
        other = [b"eval", b"system", b"getattr", b"object", b"_unpickle_block", b"ndarray", b"Series", b"MultiIndex"]
        old, new = names[random.integers(len(names))], other[random.integers(len(other))]
        whole = bytearray(bytes(whole).replace(bytes([len(old)]) + old, bytes([len(new)]) + new))
    else:
        for opcode, size in ((b"\x96", 8), (b"B", 4), (b"J", 4)):
            where = whole.find(opcode, int(random.integers(len(whole))))
            if where >= 0:
                whole[where + 1 : where + 1 + size] = (2**31 - 1).to_bytes(size, "little")
                break
    return Mutation(gzip.compress(bytes(whole), 1, mtime=0), f"pickle: {kind} at {position} ({name})")


def mutate_parquet(random: np.random.Generator, data: bytes) -> Mutation:
    """Columns that are lost, renamed, of another type or null, and numbers that cannot be."""
    import pyarrow as pa
    from pyarrow import parquet

    if random.random() < 0.2:
        return mutate_bytes(random, data)
    table = parquet.read_table(io.BytesIO(data))
    names = table.column_names
    name = names[random.integers(len(names))]
    row = names.index(name)
    values = table.column(name).to_pylist()
    kind = str(
        random.choice(["lost", "renamed", "texts", "nulls", "emptied", "number", "number", "doubled", "shuffled"])
    )
    bounded = False
    if kind == "lost":
        table = table.drop([name])
    elif kind == "renamed":
        table = table.rename_columns([f"{other}_" if other == name else other for other in names])
    elif kind == "texts":
        table = table.set_column(row, name, pa.array([str(value)[:20] for value in values]))
    elif kind == "nulls":
        table = table.set_column(row, name, pa.array([None] * len(values), table.schema.field(name).type))
    elif kind == "emptied":
        table = table.slice(0, 0)
    elif kind == "doubled":
        table = pa.concat_tables([table, table])
    elif kind == "shuffled":
        table = table.take(pa.array(random.permutation(len(values))))
    else:
        number = float(random.choice([np.nan, np.inf, -5.0, 1e30, 2.0**31 - 1]))
        bounded = ".box." in name and not ("size" not in name and number == -5.0) and number != 2.0**31 - 1
        pick = int(random.integers(max(len(values), 1)))
        try:
            first = values[pick]
            if isinstance(first, list):
                values[pick] = [number, *first[1:]]
            else:
                values[pick] = number if isinstance(first, float) else int(np.nan_to_num(number, posinf=127)) % 128 - 64
            table = table.set_column(row, name, pa.array(values, table.schema.field(name).type))
        except (pa.ArrowInvalid, pa.ArrowTypeError, OverflowError, ValueError):
            return mutate_bytes(random, data)
        kind = f"{number}"
    file = io.BytesIO()
    parquet.write_table(table, file, row_group_size=max(1, int(random.integers(1, 9))))
    return Mutation(file.getvalue(), f"{name}: {kind}", bounded)


def mutate_packets(random: np.random.Generator, data: bytes) -> Mutation:
    """Bytes of packets and of their headers, in a pcap."""
    if random.random() < 0.2:
        return mutate_bytes(random, data)
    changed = bytearray(data)
    starts, position = [], 24
    while position + 16 <= len(data):
        starts.append(position)
        position += 16 + struct.unpack_from("<I", data, position + 8)[0]
    start = starts[random.integers(len(starts))]
    kind = str(random.choice(["length", "time", "headers", "payload", "payload", "azimuth", "lost", "order", "link"]))
    if kind == "length":
        struct.pack_into("<I", changed, start + 8, int(random.choice([0, 1, 41, 2**31, 2**32 - 1])))
    elif kind == "time":
        struct.pack_into(
            "<II", changed, start, int(random.choice([0, 2**31, 2**32 - 1])), int(random.choice([0, 10**9]))
        )
    elif kind == "headers":
        changed[start + 16 + int(random.integers(42))] ^= int(random.integers(1, 256))
    elif kind == "payload":
        size = struct.unpack_from("<I", data, start + 8)[0] - 42
        for offset in random.integers(size, size=int(random.integers(1, 20))):
            changed[start + 58 + int(offset)] ^= int(random.integers(1, 256))
    elif kind == "azimuth":
        struct.pack_into("<H", changed, start + 60, int(random.integers(36_001, 65_536)))
    elif kind == "lost":
        end = next((later for later in starts if later > start), len(data))
        del changed[start:end]
    elif kind == "order":
        struct.pack_into(">I", changed, 0, 0xA1B2C3D4)
    else:
        struct.pack_into("<I", changed, 20, int(random.choice([0, 12, 101, 113, 276])))
    words = f"pcap: {kind} of packet {starts.index(start)}"
    return Mutation(bytes(changed), words, bounded=kind in ("azimuth", "length", "link", "order"))


def mutate_records(random: np.random.Generator, data: bytes) -> Mutation:
    """Lengths and codes of the records of a bag."""
    if random.random() < 0.25:
        return mutate_bytes(random, data)
    changed = bytearray(data)
    fields = [
        match.start() for match in re.finditer(rb"(op|conn|size|count|chunk_pos|index_pos|time|ver|topic)=", data)
    ]
    position = fields[random.integers(len(fields))]
    kind = str(random.choice(["length", "value", "value", "name"]))
    if kind == "length":
        struct.pack_into("<I", changed, position - 4, int(random.choice([0, 1, 2**31 - 1, 2**32 - 1])))
    elif kind == "name":
        changed[position] ^= 1
    else:
        equals = data.index(b"=", position)
        for offset in range(int(random.integers(1, 5))):
            changed[equals + 1 + offset] = int(random.choice([0, 255, 127, 1]))
    return Mutation(bytes(changed), f"bag: {kind} of {data[position : position + 8]!r} at {position}")


BY_SUFFIX: dict[str, Mutate] = {
    ".json": mutate_json,
    ".bin": mutate_rows,
    ".npy": mutate_npy,
    ".txt": mutate_text,
    ".csv": mutate_text,
    ".ply": mutate_header,
    ".pcd": mutate_header,
    ".las": mutate_las,
    ".laz": mutate_las,
    ".gz": mutate_pickle,
    ".parquet": mutate_parquet,
    ".pcap": mutate_packets,
    ".bag": mutate_records,
}


def mutate_tree(random: np.random.Generator, files: Mapping[str, bytes], folder: Path) -> tuple[str, bool]:
    """Write a tree with one change in it, and say what it is and whether the schema bounds the number that changed."""
    names = sorted(files)
    suffixes = sorted({Path(name).suffix for name in names})
    suffix = suffixes[random.integers(len(suffixes))]
    chosen = [name for name in names if Path(name).suffix == suffix]
    name = chosen[random.integers(len(chosen))]
    for other, data in files.items():
        path = folder / other
        path.parent.mkdir(parents=True, exist_ok=True)
        if other != name:
            path.write_bytes(data)
    if random.random() < 0.12:
        return f"{name}: {change_file(random, folder / name, files, chosen, folder)}", False
    mutation = BY_SUFFIX.get(suffix, mutate_bytes)(random, files[name])
    (folder / name).write_bytes(mutation.data)
    return f"{name}: {mutation.words}", mutation.bounded


def change_file(
    random: np.random.Generator, path: Path, files: Mapping[str, bytes], alike: list[str], folder: Path
) -> str:
    """A file that is missing, exchanged with another, a folder, or a link."""
    kind = str(random.choice(["missing", "swapped", "folder", "link to itself", "link to nothing", "link outside"]))
    if kind == "swapped":
        path.write_bytes(files[alike[random.integers(len(alike))]])
    elif kind == "folder":
        path.mkdir()
    elif kind == "link to itself":
        path.symlink_to(path)
    elif kind == "link to nothing":
        path.symlink_to(folder / "nothing")
    elif kind == "link outside":
        path.symlink_to("/etc/passwd")
    return kind
