"""Make the sweeps of ``farfield/datasets/open-sweeps`` from the files that their authors published.

    python tools/open_sweeps.py FOLDER [OUT]

FOLDER has ``ouster/`` (captures and metadata of ouster-lidar/ouster-sdk, tests/pcaps) and ``velodyne_vls128/`` (one
sweep of tier4/nebula). Written are ``NAME.sweep`` and ``sweeps.json``; boxes are left as they are.
"""

import json
import shutil
import sys
from pathlib import Path

import numpy as np

import farfield as ff
from farfield.datasets.open_sweeps import INDEX, ROOT, SUFFIX, pack_sweep
from farfield.files.atomic import write_bytes, write_text

OUSTER = "ouster-lidar/ouster-sdk 46b7bce, tests/pcaps/{}.pcap, sweep {}"
SWEEPS = {  # name: location, sensor, capture, sweep
    "os-0-128": ("corner", "Ouster OS-0-128", "OS-0-128-U1_v2.3.0_1024x10", 0),
    "os-1-32": ("corner", "Ouster OS-1-32", "OS-1-32-G_v2.1.1_1024x10", 0),
    "os-2-32": ("corner", "Ouster OS-2-32", "OS-2-32-U0_v2.0.0_1024x10", 0),
    "os-2-128": ("corner", "Ouster OS-2-128", "OS-2-128-U1_v2.3.0_1024x10", 0),
    "os-1-128": ("avenue", "Ouster OS-1-128", "OS-1-128_v2.3.0_1024x10_lb_n3", 0),
}
VLS = "tier4/nebula 606ac41, nebula_velodyne/test_resources/decoder_ground_truth/vls128/1585897255376374245.pcd"
MAX_M = 250.0


def main(folder: Path, out: Path = ROOT) -> None:
    """Write the sweeps and their index."""
    data = ff.open_dataset(folder / "ouster")
    entries = []
    for name, (location, sensor, capture, number) in SWEEPS.items():
        cloud = data[data.keys.index((capture, f"{number:06d}"))].cloud("lidar")
        order = np.lexsort((cloud.extra["offset_ns"], cloud.extra["ring"]))
        order = order[np.abs(cloud.points_m[order]).max(axis=1) < MAX_M]
        reflectivity = np.round(cloud.intensity[order] * 255)
        packed = pack_sweep(cloud.points_m[order], [reflectivity, cloud.extra["ring"][order]])
        write_bytes(out / f"{name}{SUFFIX}", packed)
        entry = {"name": name, "location": location, "sensor": sensor, "points": len(order)}
        entry |= {"columns": ["reflectivity", "ring"], "source": OUSTER.format(capture, number)}
        entries.append(entry | {"licence": "BSD-3-Clause, LICENSE-ouster"})
    x, y, z = ff.open_dataset(folder / "velodyne_vls128")[0].cloud("lidar").points_m.T
    packed = pack_sweep(np.column_stack([y, -x, z]), [])  # its road runs along +y, a frame's along +x
    write_bytes(out / f"vls-128{SUFFIX}", packed)
    entry = {"name": "vls-128", "location": "junction", "sensor": "Velodyne VLS-128", "points": len(x)}
    entries.append(entry | {"source": VLS, "licence": "Apache-2.0, LICENSE-velodyne"})
    write_text(out / INDEX, json.dumps({"open_sweeps": entries}, indent=1) + "\n")
    for source, name in (("ouster", "LICENSE-ouster"), ("velodyne_vls128", "LICENSE-velodyne")):
        shutil.copyfile(folder / source / "LICENSE", out / name)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
