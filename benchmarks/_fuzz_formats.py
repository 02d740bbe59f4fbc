"""Good files and hidden pickles of every format, for fuzz_readers.py."""

import hashlib
import io
import json
import math
import pickle
import re
import struct
import zlib
from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from farfield.datasets.class_mapping import read_class_mapping
from farfield.datasets.kradar import texts
from farfield.datasets.kradar.index import KRadarFiles
from farfield.datasets.kradar.label_table import read_label_table
from farfield.datasets.kradar.labels import format_labels, read_labels
from farfield.datasets.kradar.layout import INDEX_NAMES
from farfield.datasets.kradar.reader import read_split_list
from farfield.datasets.kradar.writer import read_record
from farfield.datasets.ouster import Capture
from farfield.errors import FileFormatError
from farfield.files import astyx, mat, npy, radar_cells, radiate, view_of_delft
from farfield.files.bags import Bag
from farfield.files.clock_logs import read_clock_log
from farfield.files.cuboids import Cuboid, CuboidEntry
from farfield.files.datumaro import format_datumaro, parse_datumaro
from farfield.files.description import read_description
from farfield.files.mat import open_mat
from farfield.files.openlabel import format_openlabel, parse_openlabel
from farfield.files.ouster import read_sensor
from farfield.files.sensor_messages import read_points
from farfield.files.stamps import read_stamps, recognise_stamps
from farfield.files.supervisely import parse_supervisely
from farfield.files.sustechpoints import format_sustechpoints, parse_sustechpoints
from farfield.files.tracklets import parse_frame_list, parse_tracklets
from farfield.files.videos import film_frames, read_film, write_film
from farfield.frame import Boxes

# Readers of K-Radar's, View-of-Delft's and RADIATE's files for fuzz_readers.py: good files and hidden pickles.


Recipe = tuple[str, Callable[[Path], Any], tuple[bytes, ...], Callable[[Any], bool], tuple[bytes, ...]]
_HEADER = (
    "* idx(tesseract_os2-64_cam-front_os1-128_cam-lrr)=00033_00001_00002_00001_00004, timestamp=1643292946.710046076"
)
_LINE = "24.073344860569517, -3.859259747420597, -0.39446028568879465, 0.6625, 1.7289561090229424, 0.85, 0.69"


def read_astyx_points(path: Path) -> Any:
    return astyx.read_points(path, astyx.RADAR_COLUMNS)


def astyx_objects() -> bytes:
    entry = {"classname": "Car", "center3d": [15.28, 4.24, -0.46], "dimension3d": [3.66, 1.8, 1.45]}
    return json.dumps({"objects": [entry | {"orientation_quat": [0.6, 0, 0, 0.8], "occlusion": 1}] * 2}).encode()


def astyx_sensors() -> bytes:
    data = {"T_to_ref_COS": np.eye(4).tolist(), "K": [[1817.98, 0, 1040.27], [0, 1816.84, 319.5], [0, 0, 1]]}
    return json.dumps({"sensors": [{"sensor_uid": "camera_front", "calib_data": data}]}).encode()


def anything(found: Any) -> bool:
    return found is not None


def radar_targets(folder: Path) -> dict[str, Recipe]:
    """By reader: suffix, reader, good files, whether a result is valid, and files that must be refused as they are."""
    rng = np.random.default_rng(6)
    gps = "1643292946.25, 36.37, 127.36, 80.5, " + ", ".join(["0.01"] * 9)
    imu = "1643292946.25, " + ", ".join(["0.25"] * 24)
    local = (
        "timestamp,local_x,local_y,local_z\n1643292946686577,0.000,0.000,0.000\n1643292946788769,0.384,1.339,-0.119\n"
    )
    relative = (
        "1.0 0.0 0.0 0.0 0.0 0.0 0.0\n9.999978e-01 1.243496e-03 -1.696353e-03 3.130206e-05 1.4728 -0.0065 0.0039\n"
    )
    pose = " ".join(f"{value:.6e}" for value in np.eye(4)[:3].ravel())
    times = "os2-64_00001.pcd, 1643292946.710046076\nos2-64_00002.pcd, 1643292946.810046076\n"
    plain: dict[str, tuple[Callable[[Path], Any], str]] = {
        "kradar times": (texts.read_times, times),
        "kradar description": (read_description, "urban,night,normal\n"),
        "kradar calib": (texts.read_radar_calibration, "frame difference,x,y\n32,-2.54,0.3\n"),
        "kradar camera": (texts.read_camera, camera_yaml()),
        "kradar odometry": (texts.read_odometry, f"{pose}\n{pose}"),
        "kradar gt_rel": (texts.read_relative_odometry, relative),
        "kradar gps": (texts.read_gps, f"{gps}\n" * 5),
        "kradar imu": (texts.read_imu, f"{imu}\n" * 5),
        "kradar local": (texts.read_local, local),
        "kradar split": (read_split_list, "1,00033_00001.txt\n1,00034_00002.txt"),
        "kradar record": (read_record, record()),
    }
    labels = label_seeds(rng)
    arrays = npy_seeds(folder, rng)
    pickles = pickle_seeds()
    return {
        "mat": (".mat", read_mat, mat_seeds(folder, rng), finite_shape, pickles),
        "mat in blocks": (".mat", read_in_blocks, mat_seeds(folder, rng), anything, pickles),
        "npy": (".npy", npy.read_npy, arrays, finite_shape, pickles),
        "kradar labels": (".txt", read_both_ways, labels, anything, ()),
        **{name: (".txt", read, (text.encode(),), anything, ()) for name, (read, text) in plain.items()},
        "radar cells": (".h5", radar_cells.read_radar_cells, cell_seeds(folder, rng), anything, pickles),
        "radar cells sealed": (".h5", read_sealed, cell_seeds(folder, rng), anything, ()),
        "delft poses": (".json", view_of_delft.read_camera_poses, (delft_poses(),), anything, ()),
        "delft labels": (".json", view_of_delft.read_objects, (delft_labels(),), anything, ()),
        "astyx points": (
            ".txt",
            read_astyx_points,
            (b"\nX Y Z V_r Mag\n20.5 1 0 -3.5 48\n5 0 0 0 51\n",),
            anything,
            (),
        ),
        "astyx objects": (".json", astyx.read_objects, (astyx_objects(),), anything, ()),
        "astyx sensors": (".json", astyx.read_sensors, (astyx_sensors(),), anything, ()),
        "radiate times": (
            ".txt",
            radiate.read_times,
            (b"Frame: 000001 Time: 1574859771.744660272\nFrame: 000002 Time: 1574859771.977525228\n",),
            anything,
            (),
        ),
        "radiate tracks": (".json", radiate.read_tracks, (radiate_tracks(),), anything, ()),
    }


def finite_shape(found: Any) -> bool:
    return bool(isinstance(found, np.ndarray) and found.dtype.kind in "fiub")


def read_mat(path: Path) -> np.ndarray:
    return mat.read_mat(path, "arrDREA", max_bytes=1 << 24)


def read_in_blocks(path: Path) -> int:
    with open_mat(path, "arrDREA", max_bytes=1 << 24) as stream:
        return sum(len(block) for block in stream.blocks(7))


def read_both_ways(path: Path) -> object:
    """The tolerant reader and the fast one; they must agree."""
    table = read_label_table([KRadarFiles(sequence="1", radar=33, lidar=1, label=path)])
    try:
        slow = read_labels(path)
    except FileFormatError:
        if not table.damaged:
            raise AssertionError("the fast reader took what the tolerant one refuses") from None
        raise
    fast = table.boxes()
    same = not table.damaged and len(fast) == len(slow.boxes) and table.name.tolist() == list(slow.raw_label)
    tracked = slow.boxes.track_id is not None  # version 1 numbers the objects of a frame, which identifies none
    close = same and all(
        np.allclose(getattr(fast, name), getattr(slow.boxes, name), rtol=1e-12, atol=1e-12)
        for name in ("centre_m", "size_m", "yaw_rad", *["track_id"] * tracked)
    )
    if not close:
        raise AssertionError("the fast reader and the tolerant one disagree")
    return slow


def read_sealed(path: Path) -> Any:
    """Cells whose checksum fits whatever damage there is, so that the HDF5 library sees it."""
    data = path.read_bytes()
    mark = b"Farfield radar cells 1\n"
    body = data[512:]
    path.write_bytes((mark + hashlib.sha256(body).hexdigest().encode() + b"\n").ljust(512, b"\0") + body)
    return radar_cells.read_radar_cells(path)


def label_seeds(rng: np.random.Generator) -> tuple[bytes, ...]:
    boxes = Boxes(
        centre_m=rng.normal(0, 40, (4, 3)),
        size_m=rng.uniform(0.5, 8, (4, 3)),
        yaw_rad=rng.uniform(-3, 3, 4),
        label=["vehicle", "large_vehicle", "pedestrian", "vehicle"],
        track_id=np.arange(4),
    )
    indices = dict(zip(INDEX_NAMES, (33, 1, 2, 1, 4), strict=True))
    written = [format_labels(boxes, indices, 1_643_292_946_710_046_076, version=v) for v in ("v1.0", "v2.1")]
    merged = f"{_HEADER}*, 0, Sedan, {_LINE}\n*, 1, Bus or Truck, {_LINE}"
    slips = f"{_HEADER} \n*, LL, 0, Sedan, {_LINE}\n*,R , 7, Pedestrian Group, {_LINE},\n#, 1, 1, Sedan, 1, 2, 3, 4, 5"
    return tuple(text.encode() for text in (*written, merged, slips, _HEADER))


def camera_yaml() -> str:
    keys = ("fx", "fy", "k1", "k2", "k3", "k4", "k5", "px", "py", "pitch_ldr2cam", "roll_ldr2cam", "yaw_ldr2cam")
    rows = [f"{key}: {0.25 + number}" for number, key in enumerate((*keys, "x_ldr2cam", "y_ldr2cam", "z_ldr2cam"))]
    return "\n".join(["cam_number: 1", *rows, ""])


def record() -> str:
    tree = {
        "sequence": "1",
        "indices": {"radar": 33, "os2-64": 1, "cam-front": 2},
        "time_ns": 1_643_292_946_710_046_076,
        "conditions": {"road": "urban", "time": "day", "weather": "fog"},
        "world_T_lidar": np.eye(4).tolist(),
    }
    return json.dumps(tree, indent=1)


def mat_seeds(folder: Path, rng: np.random.Generator) -> tuple[bytes, ...]:
    values = rng.exponential(1e12, (4, 6, 5, 3))
    seeds = []
    for number, (array, compress) in enumerate(((values, False), (values, True), (values.astype("f4"), False))):
        path = folder / f"{number}.mat"
        mat.write_mat(path, "arrDREA", array, compress=compress)
        seeds.append(path.read_bytes())
    return tuple(seeds)


def npy_seeds(folder: Path, rng: np.random.Generator) -> tuple[bytes, ...]:
    values = rng.normal(size=(20, 4))
    seeds = []
    for number, array in enumerate((values, np.asfortranarray(values.astype("f4")), values > 0)):
        np.save(folder / f"{number}.npy", array)
        seeds.append((folder / f"{number}.npy").read_bytes())
    return tuple(seeds)


class Trap:
    """What a hostile pickle does when it is loaded."""

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[str]]:
        return print, ("A PICKLE WAS LOADED",)


def pickle_seeds() -> tuple[bytes, ...]:
    """A bare pickle, an object array in .npy, and a .npz of it: none may be read."""
    array = np.empty(2, dtype=object)
    array[:] = [Trap(), 1]
    plain, packed = io.BytesIO(), io.BytesIO()
    np.save(plain, array, allow_pickle=True)
    np.savez(packed, a=array)
    return pickle.dumps(Trap()), plain.getvalue(), packed.getvalue(), zlib.compress(pickle.dumps(Trap()))


def cell_seeds(folder: Path, rng: np.random.Generator) -> tuple[bytes, ...]:
    index = np.sort(rng.choice(15_000_000, 400, replace=False)).astype(np.int32)
    columns: dict[str, Any] = {
        "index": index,
        "code": rng.integers(0, 65_536, 400).astype(np.uint16),
        "quantiles": rng.integers(0, 60_000, (2, 8)).astype(np.int32),
    }
    doppler = rng.integers(-20_000, 20_000, 400).astype(np.int16)
    radar_cells.write_radar_cells(folder / "a.h5", **columns, attributes={"region": "wide"})
    radar_cells.write_radar_cells(folder / "b.h5", **columns, doppler=doppler)
    return (folder / "a.h5").read_bytes(), (folder / "b.h5").read_bytes()


def delft_poses() -> bytes:
    names = ("odomToCamera", "mapToCamera", "UTMToCamera")
    return "\n".join(json.dumps({name: np.eye(4).ravel().tolist()}) for name in names).encode()


def delft_labels() -> bytes:
    geometry = {
        "center": {"x": 10.0, "y": -2.0, "z": 0.5},
        "size": {"length": 4.0, "width": 1.8, "height": 1.5},
        "quaternion": {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8},
    }
    objects = [{"className": "car", "objectId": str(k), "geometry": geometry, "attributes": {}} for k in range(3)]
    return json.dumps(objects).encode()


def radiate_tracks() -> bytes:
    box = {"position": [500.0, 400.0, 12.5, 24.0], "rotation": 12.0}
    return json.dumps([{"id": k, "class_name": "car", "bboxes": [[], box, box]} for k in range(3)]).encode()


# Lists of stamps, logs of clocks, films and ROS 2 bags for fuzz_readers.py.


LISTS = (
    b"1574859771.744660272\n1574859771.5\n" * 4,
    b"1574859771744660272\n" * 5,
    b"frame,time_us\n0,1574859771744660\n1,1574859771844660\n",
    b"2011-09-26 13:02:25.964389445\n2011-09-26 13:02:26\n",
    b"Frame: 000001 Time: 1574859771.744660272\nFrame: 000002 Time: 1574859771.977525228\n",
)
LOGS = (
    b"ptp4l[85.240]: master offset      -1200 s0 freq   +1234 path delay      5671\n"
    b"ptp4l[86.240]: master offset        -23 s2 freq   +1250 path delay       567\n",
    b"phc2sys[12.500]: CLOCK_REALTIME rms  12 max   34 freq  -123 +/-   4 delay   567 +/-   8\n",
)


def time_targets(folder: Path) -> dict[str, Recipe]:
    """By reader: suffix, reader, good files, whether a result is valid, and files that must be refused as they are."""
    found: dict[str, Recipe] = {
        "stamps": (".txt", stamps, LISTS, whole_numbers, ()),
        "clock logs": (".log", read_clock_log, LOGS, len, ()),
    }
    captures, metadata = capture_seeds()
    found["captures"] = (".pcap", partial(read_capture, metadata[0]), captures, anything, ())
    found["ouster metadata"] = (".json", read_sensor, metadata, anything, ())
    if find_spec("av") is not None:
        found["films"] = (".mp4", film_pictures, film_seeds(folder), finite_counts, ())
    if find_spec("rosbags") is not None:
        for suffix in (".mcap", ".db3"):
            found[f"bag{suffix}"] = (suffix, messages, bag_seeds(folder, suffix), finite_counts, ())
    return found


def stamps(path: Path) -> np.ndarray:
    """All stamps of a list; none where it is not recognised."""
    known = recognise_stamps(path)
    return np.concatenate([np.zeros(0, np.int64), *([] if known is None else read_stamps(known))])


def whole_numbers(values: np.ndarray) -> bool:
    return values.dtype == np.int64 and bool((np.abs(values) < 5 * 10**18).all())


def messages(path: Path) -> list[int]:
    """Points of each cloud of a bag, all of whose messages are decoded."""
    bag, found = Bag(path), []
    try:
        for topic, _, raw in bag.messages():
            message = bag.decode(topic, raw)
            if topic.kind == "sensor_msgs/msg/PointCloud2":
                found.append(len(next(iter(read_points(message, path).values()), ())))
    finally:
        bag.close()
    return found


def film_pictures(path: Path) -> list[int]:
    """Mean of each frame of a film, all of which are decoded."""
    return [int(picture.mean()) for picture in film_frames(read_film(path))]


def film_seeds(folder: Path) -> tuple[bytes, ...]:
    """Two small films."""
    rng, made = np.random.default_rng(2), []
    for suffix in (".mp4", ".mkv"):
        pictures = iter(rng.integers(0, 256, (6, 32, 48, 3), dtype=np.uint8))
        write_film(folder / f"film{suffix}", pictures, range(0, 600, 100), Fraction(1, 1000))
        made.append((folder / f"film{suffix}").read_bytes())
    return tuple(made)


def finite_counts(counts: list[int]) -> bool:
    return all(count >= 0 for count in counts)


def bag_seeds(folder: Path, suffix: str) -> tuple[bytes, ...]:
    """Small bags with three clouds and their stamps, as rosbags writes them; MCAP also with packed chunks."""
    return tuple(_bag_seed(folder, suffix, packed) for packed in ((False, True) if suffix == ".mcap" else (False,)))


def _bag_seed(folder: Path, suffix: str, packed: bool) -> bytes:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types, kind = store.types, "sensor_msgs/msg/PointCloud2"
    plugin = StoragePlugin.MCAP if suffix == ".mcap" else StoragePlugin.SQLITE3
    place = folder / f"bag{suffix[1:]}{'-packed' if packed else ''}"
    if not place.exists():
        bag = Writer(place, version=9, storage_plugin=plugin)
        bag.set_compression(CompressionMode.STORAGE if packed else CompressionMode.NONE, CompressionFormat.ZSTD)
        with bag as writer:
            connection = writer.add_connection("/points", kind, typestore=store)
            for number in range(3):
                stamp = types["builtin_interfaces/msg/Time"](sec=1_700_000_000 + number, nanosec=5)
                field = types["sensor_msgs/msg/PointField"]
                cloud = types[kind](
                    header=types["std_msgs/msg/Header"](stamp=stamp, frame_id="lidar"),
                    height=1,
                    width=10,
                    fields=[field(name=n, offset=4 * k, datatype=7, count=1) for k, n in enumerate("xyz")],
                    is_bigendian=False,
                    point_step=12,
                    row_step=120,
                    data=np.arange(120, dtype=np.uint8),
                    is_dense=True,
                )
                writer.write(connection, 1_700_000_000_000_000_000 + number, store.serialize_cdr(cloud, kind))
    return (place / f"{place.name}{suffix}").read_bytes()


# Targets of the fuzzer: boxes in the formats of annotation tools.


Parts = tuple[str, Callable[[Path], Any], tuple[bytes, ...], Callable[[Any], bool], tuple[bytes, ...]]
CARS = [
    Cuboid(frame=name, label="Car", box=(10.0 + number, -2.5, 0.3, 4.6, 1.9, 1.5, 0.52), track=str(number))
    for number, name in enumerate(("a", "a", "b"))
]
DEEP = b'{"a":' * 5000 + b"1" + b"}" * 5000
POSE = "<item><tx>10.0</tx><ty>2.0</ty><tz>-1.8</tz><rx>0</rx><ry>0</ry><rz>0.5</rz><occlusion>0</occlusion></item>"
OBJECT = (
    "<item><objectType>Car</objectType><h>1.5</h><w>1.9</w><l>4.6</l><first_frame>2</first_frame>"
    f"<poses><count>2</count>{POSE}{POSE}</poses></item>"
)
XML = f"<?xml version='1.0'?><!DOCTYPE b><b><tracklets><count>1</count>{OBJECT}</tracklets></b>"
LAUGHS = "".join(f"<!ENTITY a{n + 1} '{f'&a{n};' * 10}'>" for n in range(9))
BOMB = f"<!DOCTYPE b [<!ENTITY a0 'ha'>{LAUGHS}]><b><tracklets>&a9;</tracklets></b>"
FETCH = "<!DOCTYPE b [<!ENTITY a SYSTEM 'file:///dev/zero'>]><b><tracklets>&a;</tracklets></b>"
PLACE = {"x": 10.0, "y": 2.0, "z": 0.5}
GEOMETRY = {"position": PLACE, "rotation": {"x": 0, "y": 0, "z": 0.5}, "dimensions": {"x": 4.6, "y": 1.9, "z": 1.5}}
SUPERVISELY = {
    "objects": [{"key": "k", "classTitle": "Car", "tags": [{"name": "parked", "value": True}]}],
    "figures": [{"key": "f", "objectKey": "k", "geometryType": "cuboid_3d", "geometry": GEOMETRY}],
}


def capture_seeds() -> tuple[tuple[bytes, ...], tuple[bytes, ...]]:
    """Captures of an Ouster and metadata, each a whole turn of two beams."""
    angles = {"beam_altitude_angles": [1.0, -1.0], "beam_azimuth_angles": [2.0, -2.0]}
    transform = {"lidar_to_sensor_transform": [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36, 0, 0, 0, 1]}
    layout = {"columns_per_frame": 16, "columns_per_packet": 16, "udp_profile_lidar": "RNG15_RFL8_NIR8"}
    described = json.dumps(angles | transform | {"lidar_origin_to_beam_origin_mm": 15.8, "data_format": layout})
    columns = [struct.pack("<QHH", 10**9 + 10**6 * number, number, 1) + b"\x00\x05\x09\x01" * 2 for number in range(16)]
    packet = b"\x01" + bytes(31) + b"".join(columns) + bytes(32)
    datagram = struct.pack(">HHHH", 7502, 7502, 8 + len(packet), 0) + packet
    head = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(datagram), 1, 0, 64, 17, 0, b"\x0a" * 4, b"\x0b" * 4)
    frame = bytes(12) + b"\x08\x00" + head + datagram
    record = struct.pack("<IIII", 5, 0, len(frame), len(frame)) + frame
    capture = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 1 << 18, 1) + record
    return (capture, capture + record), (described.encode(),)


def read_capture(metadata: bytes, path: Path) -> int:
    """Points of the first turn."""
    described = path.with_name("sensor.json")
    described.write_bytes(metadata)
    capture = Capture.of(path, described)
    return len(capture.cloud(0)) if capture.sweeps else 0


def exchange_targets() -> Mapping[str, Parts]:
    """Suffix, reader, good files, what a valid result is, and files that must be refused, by the reader's name."""
    parts = {
        "openlabel": (parse_openlabel, format_openlabel(CARS, ["a", "b"], [5, 6])),
        "sustechpoints": (parse_sustechpoints, format_sustechpoints(CARS)),
        "datumaro": (parse_datumaro, format_datumaro(CARS, ["a", "b"])),
        "supervisely": (parse_supervisely, json.dumps(SUPERVISELY)),
    }
    found: dict[str, Parts] = {
        name: (".json", partial(_read, parse), (text.encode(),), sound, (DEEP, *wrong_boxes(name)))
        for name, (parse, text) in parts.items()
    }
    hostile = (BOMB.encode(), FETCH.encode(), b"<a>" * 100_000, *wrong_boxes("tracklets"))
    mapping = (b"classes: {Auto: vehicle, 'Cone 1': animal}\n", "classes: {Gef\u00e4hrt: trailer}\n".encode())
    return found | {
        "tracklets": (".xml", partial(_read, parse_tracklets), (XML.encode(),), sound, hostile),
        "frame lists": (".txt", partial(_read, parse_frame_list), LISTED, one_sweep_a_number, TWICE_LISTED),
        "class mappings": (".yaml", read_class_mapping, mapping, printable, WRONG_MAPPINGS),
    }


def wrong_boxes(name: str) -> tuple[bytes, ...]:
    """Files that are whole and wrong, which must be refused: a yaw in degrees, and a box that lies on its side."""
    if name == "tracklets":
        return XML.replace("<rz>0.5", "<rz>90").encode(), XML.replace("<rx>0", "<rx>1.57").encode()
    if name == "supervisely":
        turns = [{"x": 0, "y": 0, "z": 90}, {"x": 0, "y": 1.57, "z": 0}]
        figures = [{**SUPERVISELY["figures"][0], "geometry": GEOMETRY | {"rotation": turn}} for turn in turns]
        return tuple(json.dumps(SUPERVISELY | {"figures": [figure]}).encode() for figure in figures)
    if name == "sustechpoints":
        text = format_sustechpoints(CARS)
        return text.replace('"z": 0.52', '"z": 90').encode(), text.replace('"y": 0,', '"y": 1.57,').encode()
    if name == "datumaro":
        text = format_datumaro(CARS, ["a", "b"])
        items = json.loads(text)["items"]
        doubled = json.dumps({**json.loads(text), "items": items + items}).encode()
        return re.sub(r"0\.52\b", "90", text).encode(), doubled
    return ()


LISTED = (b"0 0000000005\n1 0000000006\n", b"\xef\xbb\xbf# sweeps\r\n7\ta b\r\n")
TWICE_LISTED = (b"0 a\n0 b\n", b"0 a\n1 a\n", b"a 0\n")
WRONG_MAPPINGS = (
    b"classes: {Car: vehicle, Car: animal}\n",
    b"class: {Auto: vehicle}\n",
    b'classes: {Auto: "a\\nb"}\n',
)


def one_sweep_a_number(names: Mapping[int, str]) -> bool:
    """No number and no sweep stands twice."""
    return len(set(names.values())) == len(names) and all(number >= 0 and name for number, name in names.items())


def printable(classes: Mapping[str, str]) -> bool:
    """Every class is a name on one line."""
    return all(name and name.isprintable() for name in classes.values())


def _read(parse: Callable[[bytes, Path], Any], path: Path) -> Any:
    return parse(path.read_bytes(), path)


def sound(found: Any) -> bool:
    """Every box has finite numbers and positive sizes."""
    cuboids = [each.cuboid if isinstance(each, CuboidEntry) else each for each in found]
    return all(all(map(math.isfinite, one.box)) and min(one.box[3:6]) > 0 for one in cuboids)
