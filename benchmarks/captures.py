"""Captures of sensors beside other decoders: ouster-sdk, tier4/nebula's clouds and velodyne-decoder.

The other decoders get an environment of their own, built at the first run (ouster-sdk's licence forbids shipping it).
Its Python runs this file too, with ``--worker``, and has no farfield.
"""

import sqlite3
import struct
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

REQUIREMENTS = ("ouster-sdk==1.0.1", "velodyne-decoder==3.1.0")
ENVIRONMENT = Path(tempfile.gettempdir()) / "farfield-captures"
SHARED = Path(__file__).resolve().parents[2] / "shared" / "open" / "ouster"
STEADY = "OS-1-128_v2.3.0_1024x10_lb_n3"
VELODYNES = {"vlp16": 16, "vlp32": 32, "vls128": 128}
"""Lasers by folder of nebula's tests."""
HESAIS = {
    "40p": "Pandar40P",
    "64": "Pandar64",
    "qt64": "PandarQT64",
    "qt128": "PandarQT128",
    "xt16": "PandarXT16",
    "xt32": "PandarXT32",
    "xt32m": "PandarXT32M",
}
SEAM_DEG, DECODER_DEG = 0.012, 0.03


def tool_python(environment: Path) -> Path:
    """Build the other decoders' environment unless it is there, and return its interpreter."""
    python, done = environment / "bin" / "python", environment / ".installed"
    if not done.exists():
        print(f"building {environment.name} with {', '.join(REQUIREMENTS)}", flush=True)
        venv.create(environment, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", *REQUIREMENTS], check=True)
        done.touch()
    return python


def worked(python: Path, *words: object) -> None:
    """Run a worker of this file with the other Python."""
    subprocess.run([python, __file__, "--worker", *map(str, words)], check=True)


def worker(kind: str, *words: str) -> None:
    """What the other Python does: decode, or write OSF, or find poses."""
    {"sweeps": sdk_sweeps, "record": sdk_record, "poses": sdk_poses, "velodyne": other_velodyne}[kind](*words)


def sdk_sources(capture: str) -> Any:
    from ouster.sdk import open_source

    return open_source(capture, meta=[capture.replace(".pcap", ".json")])


def sdk_sweeps(capture: str, output: str) -> None:
    """Points, rings, times and reflectivity of each sweep by ouster-sdk."""
    from ouster.sdk import core

    source = sdk_sources(capture)
    info = source.sensor_info[0]
    lut = core.XYZLut(info, use_extrinsics=False)
    arrays = {}
    scans = [scan for scans in source for scan in scans if scan is not None]
    for number, scan in enumerate(scans):
        returned = scan.field("RANGE") > 0
        ring, column = np.nonzero(returned)
        arrays |= {
            f"points_{number}": lut(scan)[returned],
            f"ring_{number}": ring,
            f"time_{number}": scan.timestamp[column].astype(np.int64),
            f"reflectivity_{number}": scan.field("REFLECTIVITY")[returned],
        }
    np.savez(output, count=len(scans), **arrays)


def sdk_record(capture: str, output: str, packing: str) -> None:
    """Write a capture as OSF."""
    from ouster.sdk import osf

    source = sdk_sources(capture)
    encoder = osf.PngLidarFrameEncoder(1) if packing == "PNG" else osf.ZPngLidarFrameEncoder(1)
    writer = osf.Writer(output, source.sensor_info, encoder=osf.Encoder(encoder))
    for scans in source:
        for sensor, scan in enumerate(scans):
            if scan is not None:
                writer.save(sensor, scan)
    writer.close()


def sdk_poses(capture: str, output: str) -> None:
    """Where the sensor stood at the first column of each sweep, by ouster-sdk's own odometry."""
    from ouster.sdk import mapping

    source = sdk_sources(capture)
    engine = mapping.SlamEngine.create(source.sensor_info, mapping.SlamConfig.create())
    poses = []
    for scans in source:
        done = engine.update(scans)
        scan = next(scan for scan in done if scan is not None)
        poses.append(np.asarray(scan.body_to_world)[0])
    np.savez(output, poses=np.array(poses))


def other_velodyne(capture: str, output: str) -> None:
    """All points of a capture by velodyne-decoder: x, y, z, ring from below, reflectivity."""
    import velodyne_decoder

    clouds = [cloud for _, cloud in velodyne_decoder.read_pcap(capture, velodyne_decoder.Config())]
    points = np.concatenate([np.asarray(cloud)[:, :7] for cloud in clouds])
    np.savez(output, points=points[:, :3], reflectivity=points[:, 3], ring=points[:, 6])


def run_ouster(arguments: Sequence[str]) -> int:
    """Compare the five real Ouster captures, and OSF made of them, with ouster-sdk's own decoding.

        python benchmarks/captures.py ouster [--env FOLDER] [--without-sdk]

    Points are paired by column and ring, so that a missing or moved one shows.
    """
    from _report import MissingError, Table, part_parser

    from farfield.datasets.osf import Osf
    from farfield.datasets.ouster import Ouster

    parser = part_parser(run_ouster.__doc__)
    parser.add_argument("--env", type=Path, default=ENVIRONMENT)
    parser.add_argument("--without-sdk", action="store_true", help="only our side")
    options = parser.parse_args(arguments)
    if not SHARED.is_dir():
        raise MissingError("no Ouster captures beside the project")
    began = time.process_time()
    data = Ouster(SHARED)
    sizes = {frame.key: len(frame.clouds["lidar"]) for frame in data}
    print(f"decoded {len(sizes)} sweeps, {sum(sizes.values()):,} points in {time.process_time() - began:.2f} s of CPU")
    if options.without_sdk:
        return 0
    python, table = tool_python(options.env), Table()
    with tempfile.TemporaryDirectory() as folder:
        for capture in sorted(SHARED.glob("*.pcap")):
            output = Path(folder) / f"{capture.stem}.npz"
            worked(python, "sweeps", capture, output)
            compare_sweeps(table, data, capture.stem, output, "pcap")
            for packing in ("zpng", "PNG"):
                recorded = Path(folder) / packing
                recorded.mkdir(exist_ok=True)
                worked(python, "record", capture, recorded / f"{capture.stem}.osf", packing)
        for packing in ("zpng", "PNG"):
            recordings = Osf(Path(folder) / packing)
            for name in dict.fromkeys(recordings.sequences):
                compare_sweeps(table, recordings, name, Path(folder) / f"{name}.npz", packing)
    return table.status


def compare_sweeps(table: Any, data: Any, name: str, path: Path, kind: str) -> None:
    """One row: points, rings, times and reflectivity of a capture's sweeps against ouster-sdk's."""
    indices = [index for index, sequence in enumerate(data.sequences) if sequence == name]
    with np.load(path) as other:
        assert int(other["count"]) == len(indices)
        points, away_m, equal = 0, 0.0, True
        for number, index in enumerate(indices):
            frame = data[index]
            cloud = frame.clouds["lidar"]
            order = np.lexsort((cloud.extra["offset_ns"], cloud.extra["ring"]))
            theirs = other[f"points_{number}"]
            points += len(cloud)
            if len(theirs) != len(cloud):
                equal = False
                continue
            away_m = max(away_m, float(np.linalg.norm(cloud.points_m[order] - theirs, axis=1).max()))
            times_ns = frame.time_ns + cloud.extra["offset_ns"][order]
            equal &= bool((cloud.extra["ring"][order] == other[f"ring_{number}"]).all())
            equal &= bool((times_ns == other[f"time_{number}"]).all())
            reflectivity = cloud.extra["reflectivity"][order].astype(np.int64)
            of_early = reflectivity.max() > 255  # 16 bits, of which ouster-sdk reads the lower eight
            equal &= bool(((reflectivity & 255 if of_early else reflectivity) == other[f"reflectivity_{number}"]).all())
    figure = f"{points:,} points, {'equal' if equal else 'DIFFERENT'}, {away_m * 1000:.4f} mm"
    table.add(f"{kind}: {name[:44]}", figure, "equal, 0.02 mm (float32)", equal and away_m < 2e-5)


def bag_packets(path: Path) -> list[tuple[int, bytes]]:
    """Times and packets of a ROS 2 bag of one of nebula's tests: VelodyneScan, PandarScan or NebulaPackets."""
    with sqlite3.connect(f"file:{path}?mode=ro", uri=True) as base:
        query = "select type, data from messages join topics on topics.id = topic_id order by messages.timestamp"
        rows = base.execute(query).fetchall()
    packets = []
    for kind, message in rows:
        at = 12
        at = (at + 4 + struct.unpack_from("<I", message, at)[0] + 3) // 4 * 4
        (count,) = struct.unpack_from("<I", message, at)
        at += 4
        for _ in range(count):
            at = (at + 3) // 4 * 4
            seconds, nanoseconds = struct.unpack_from("<iI", message, at)
            at, size = at + 8, 1206
            start = at
            if "Nebula" in kind:
                (size,) = struct.unpack_from("<I", message, at)
                start = at + 4
            if "Pandar" in kind:
                at = (at + 1500 + 3) // 4 * 4
                (size,) = struct.unpack_from("<I", message, at)
                at += 4
            else:
                at = start + size
            packets.append((seconds * 10**9 + nanoseconds, message[start : start + size]))
    return packets


def write_pcap(path: Path, packets: Sequence[tuple[int, bytes]]) -> None:
    """Write packets as a sensor's network would have carried them."""
    records = [struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 1 << 18, 1)]
    for time_ns, packet in packets:
        datagram = struct.pack(">HHHH", 2368, 2368, len(packet) + 8, 0) + packet
        head = (
            struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(datagram), 0, 0, 64, 17, 0) + b"\xc0\xa8\x01\xc9" + b"\xff" * 4
        )
        frame = bytes(12) + b"\x08\x00" + head + datagram
        records += [struct.pack("<IIII", time_ns // 10**9, time_ns % 10**9, len(frame), len(frame)), frame]
    path.write_bytes(b"".join(records))


def pcd_points_m(path: Path) -> np.ndarray:
    """x, y, z of a binary PCD of single numbers."""
    content = path.read_bytes()
    start = content.index(b"\n", content.index(b"DATA binary")) + 1
    lines = dict(line.split(maxsplit=1) for line in content[:start].decode().splitlines() if line[0] != "#")
    kinds = {"F": "f", "U": "u", "I": "i"}
    columns = zip(lines["FIELDS"].split(), lines["TYPE"].split(), lines["SIZE"].split(), strict=True)
    dtype = np.dtype([(name, f"<{kinds[kind]}{size}") for name, kind, size in columns])
    rows = np.frombuffer(content[start:], dtype=dtype, count=int(lines["POINTS"]))
    return np.stack([rows["x"], rows["y"], rows["z"]], axis=1).astype(np.float64)


def run_nebula(arguments: Sequence[str]) -> int:
    """Compare packets of real Velodynes and Hesais with the clouds that nebula and velodyne-decoder make of them.

        python benchmarks/captures.py nebula FOLDER [--env FOLDER] [--without-decoder]

    FOLDER is a checkout of github.com/tier4/nebula (its tests hold ROS 2 bags of packets and a cloud of each). A point
    counts where one of ours lies within some hundredths of a degree of it as the sensor sees it: nebula rounds
    directions to hundredths. Of Velodynes nebula interpolates directions in another way (not at all within a VLS-128's
    firing), and leaves heights of the beams' origins out; velodyne-decoder does both as the manuals say.

    The VLP-32C saw but a sector: velodyne-decoder turns the shots of packets that span the rest as if fired in it.
    """
    from _report import MissingError, Table, part_parser

    from farfield.datasets.captures import Captures

    parser = part_parser(run_nebula.__doc__)
    parser.add_argument("nebula", type=Path)
    parser.add_argument("--env", type=Path, default=ENVIRONMENT)
    parser.add_argument("--without-decoder", action="store_true")
    options = parser.parse_args(arguments)
    found = {path.parent.parent.name: path for path in options.nebula.rglob("decoder_ground_truth/*/*/*_0.db3")}
    if not found:
        raise MissingError(f"no bags of nebula's tests in {options.nebula}")
    table = Table()
    with tempfile.TemporaryDirectory() as folder:
        for kind in (*VELODYNES, *HESAIS):
            bag = found[kind]
            capture = Path(folder) / kind / f"{kind}.pcap"
            capture.parent.mkdir()
            packets = bag_packets(bag)
            write_pcap(capture, packets)
            if kind in HESAIS:
                angles = next(options.nebula.rglob(f"calibration/{HESAIS[kind]}.csv"))
                capture.with_suffix(".csv").write_bytes(angles.read_bytes())
            data = Captures(capture.parent, cut_deg=0, least_share=0.0)
            cloud = [frame.clouds["lidar"] for frame in data]
            points_m = np.concatenate([part.points_m for part in cloud]).astype(np.float64)
            theirs = pcd_points_m(next(bag.parent.parent.glob("*.pcd")))
            name = data[0].metadata["model"]
            if kind in HESAIS:
                theirs = np.stack([theirs[:, 1], -theirs[:, 0], theirs[:, 2]], axis=1)
                share = share_within(points_m, theirs, SEAM_DEG)
                table.add(f"{name}: nebula's {len(theirs):,} points", f"{share:.3%} found", "99.9 %", share > 0.999)
            elif not options.without_decoder:
                output = Path(folder) / f"{kind}.npz"
                worked(tool_python(options.env), "velodyne", capture, output)
                with np.load(output) as other:
                    share, rings = decoder_share(cloud, points_m, other, VELODYNES[kind])
                row = f"{share:.3%} found, rings {rings:.3%}"
                size = len(other_points(output))
                held = share > 0.99 and rings == 1
                table.add(f"{name}: velodyne-decoder's {size:,} points", row, "99.0%, rings all", held)
    return table.status


def other_points(path: Path) -> np.ndarray:
    with np.load(path) as other:
        return other["points"]


def share_within(points_m: np.ndarray, theirs: np.ndarray, degrees: float) -> float:
    """Of their points how many have one of ours so near, as the sensor sees them."""
    from scipy.spatial import cKDTree

    away_m, _ = cKDTree(points_m).query(theirs)
    return float(np.mean(away_m <= np.deg2rad(degrees) * np.linalg.norm(theirs, axis=1) + 1e-3))


def decoder_share(cloud: Sequence[Any], points_m: np.ndarray, other: Any, lasers: int) -> tuple[float, float]:
    """Of velodyne-decoder's points how many have one of ours near, and of those how many the same ring."""
    from scipy.spatial import cKDTree

    theirs = other["points"].astype(np.float64)
    away_m, nearest = cKDTree(points_m).query(theirs)
    near = np.rad2deg(away_m / np.maximum(np.linalg.norm(theirs, axis=1), 1.0)) <= DECODER_DEG
    ring = np.concatenate([part.extra["ring"] for part in cloud])  # theirs count from below
    return float(near.mean()), float(np.mean(lasers - 1 - other["ring"][near] == ring[nearest[near]]))


def run_odometry(arguments: Sequence[str]) -> int:
    """The three sweeps of OS-1-128 through odometry: beside ouster-sdk's own, and repeated as of a sensor that stands.

        python benchmarks/captures.py odometry [--env FOLDER] [--without-sdk]

    That sensor drove: ouster-sdk's own poses say so too. A sensor that stands is one sweep three times.
    """
    from dataclasses import replace

    from _report import MissingError, Table, part_parser

    from farfield.datasets.memory import in_memory
    from farfield.datasets.ouster import Ouster
    from farfield.frame import Cloud, Constant, Lazy
    from farfield.odometry.drives import odometry

    parser = part_parser(run_odometry.__doc__)
    parser.add_argument("--env", type=Path, default=ENVIRONMENT)
    parser.add_argument("--without-sdk", action="store_true")
    options = parser.parse_args(arguments)
    if not SHARED.is_dir():
        raise MissingError("no Ouster captures beside the project")
    frames = [frame for frame in Ouster(SHARED) if frame.sequence == STEADY]
    rng, table = np.random.default_rng(2026), Table()
    still = []
    for number in range(len(frames)):
        cloud = frames[0].clouds["lidar"]
        noise = 1 + rng.normal(0, 0.01, len(cloud)) / np.maximum(np.linalg.norm(cloud.points_m, axis=1), 1)
        clouds = Lazy({"lidar": Constant(Cloud(cloud.points_m * noise[:, None], cloud.intensity, cloud.extra))})
        time_ns = frames[0].time_ns + number * 100_000_000
        still.append(replace(frames[0], frame_id=f"{number:06d}", time_ns=time_ns, clouds=clouds))
    with tempfile.TemporaryDirectory() as folder:
        (driven,) = odometry(in_memory(frames, in_order=True), Path(folder) / "driven", backward=False)
        (stood,) = odometry(in_memory(still, in_order=True), Path(folder) / "stood", backward=False)
        ours_m = driven.table.world_T_frame[:, :3, 3]
        print(f"moved, sweep by sweep: {', '.join(f'{away * 1000:.0f} mm' for away in np.linalg.norm(ours_m, axis=1))}")
        away_m = float(np.linalg.norm(stood.table.world_T_frame[:, :3, 3], axis=1).max())
        table.add("one sweep three times, with noise of 1 cm", f"{away_m * 1000:.1f} mm", "20 mm", away_m < 0.02)
        if not options.without_sdk:
            output = Path(folder) / "poses.npz"
            worked(tool_python(options.env), "poses", SHARED / f"{STEADY}.pcap", output)
            with np.load(output) as other:
                theirs_m = other["poses"][:, :3, 3]
            print(f"by ouster-sdk: {', '.join(f'{away * 1000:.0f} mm' for away in np.linalg.norm(theirs_m, axis=1))}")
            apart_m = float(np.linalg.norm(ours_m - theirs_m, axis=1).max())
            table.add("apart from ouster-sdk's own odometry", f"{apart_m * 1000:.0f} mm", "100 mm", apart_m < 0.1)
    return table.status


def run_speed(arguments: Sequence[str]) -> int:
    """Time to open a capture of a VLS-128 and to decode a sweep, of packets that are made here.

    python benchmarks/captures.py speed [--seconds 10]
    """
    from _report import part_parser

    from farfield.datasets.captures import Captures

    parser = part_parser(run_speed.__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args(arguments)
    rng = np.random.default_rng(2026)
    count = int(options.seconds / 160e-6)
    shots = np.dtype([("range", "<u2"), ("reflectivity", "u1")])
    block = np.dtype([("bank", "<u2"), ("azimuth", "<u2"), ("shots", shots, 32)])
    packets = np.zeros(count, np.dtype([("blocks", block, 12), ("us", "<u4"), ("mode", "u1"), ("model", "u1")]))
    packets["blocks"]["bank"] = [0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF] * 3
    firing = np.arange(3 * count).reshape(count, 3)
    packets["blocks"]["azimuth"] = np.repeat(firing * 36_000 * 10 * 160e-6 / 3 % 36_000, 4, axis=1).astype(int)
    packets["blocks"]["shots"]["range"] = rng.integers(0, 50_000, (count, 12, 32))
    packets["us"], packets["mode"], packets["model"] = np.arange(count) * 160, 0x37, 0xA1
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "made.pcap"
        rows = zip((np.arange(count) * 160_000).tolist(), (packet.tobytes() for packet in packets), strict=True)
        write_pcap(path, [(1_700_000_000 * 10**9 + time_ns, packet) for time_ns, packet in rows])
        began = time.process_time()
        data = Captures(folder)
        opened_s = time.process_time() - began
        began = time.process_time()
        points = sum(len(frame.clouds["lidar"]) for frame in data)
        decoded_s = time.process_time() - began
    print(f"opened {options.seconds:g} s of a VLS-128, {count:,} packets, in {opened_s:.2f} s of CPU")
    print(f"decoded {len(data)} sweeps, {points:,} points: {decoded_s / len(data) * 1000:.0f} ms of CPU a sweep")
    return 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        worker(*sys.argv[2:])
    else:
        from _report import Part, run_parts

        PARTS = {
            "ouster": Part(run_ouster, "--without-sdk", exact=True),
            "odometry": Part(run_odometry, "--without-sdk"),
            "speed": Part(run_speed, "--seconds 0.5"),
            "nebula": Part(run_nebula, None, alone=True),
        }
        sys.exit(run_parts(__doc__, PARTS))
