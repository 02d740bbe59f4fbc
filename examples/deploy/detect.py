"""From a PCD file to boxes with numpy and onnxruntime alone: PointPillars as ``farfield export`` writes it.

    farfield export pointpillars-cirrus-sim pointpillars.onnx      # once, where torch is
    python detect.py pointpillars.onnx scan.pcd                    # where the car is

Copy this file and change it. It prints ``label,score,x,y,z,length,width,height,yaw`` a line, in the cloud's own axes:
x forward, y left, z up, metres; yaw counter-clockwise from +x, radians.
"""

import json
import math
import sys
from pathlib import Path

import numpy as np
import onnxruntime

TYPES = {"F4": "<f4", "F8": "<f8", "I1": "i1", "I2": "<i2", "I4": "<i4", "U1": "u1", "U2": "<u2", "U4": "<u4"}


def read_pcd(path: Path) -> dict[str, np.ndarray]:
    """Columns of a PCD file in ascii or binary (not compressed), by name."""
    data = path.read_bytes()
    header, at = {}, 0
    while "DATA" not in header:
        end = data.index(b"\n", at)
        key, *values = data[at:end].decode("ascii").split() or [""]
        header[key], at = values, end + 1
    names, points = header["FIELDS"], int(header["POINTS"][0])
    counts = list(map(int, header.get("COUNT", ["1"] * len(names))))
    if header["DATA"] == ["ascii"]:
        rows = np.loadtxt(data[at:].decode("ascii").splitlines(), ndmin=2) if points else np.zeros((0, sum(counts)))
        starts = np.cumsum([0, *counts])
        return {name: rows[:, start] for name, start in zip(names, starts, strict=False)}
    if header["DATA"] != ["binary"]:
        raise SystemExit(f"{path}: expected DATA ascii or binary, got {' '.join(header['DATA'])}")
    kinds = [TYPES[kind + size] for kind, size in zip(header["TYPE"], header["SIZE"], strict=True)]
    fields = [(f"{number}", kind, (count,)) for number, (kind, count) in enumerate(zip(kinds, counts, strict=True))]
    table = np.frombuffer(data, np.dtype(fields), count=points, offset=at)
    return {name: table[f"{number}"][:, 0] for number, name in enumerate(names)}


def points_of(columns: dict[str, np.ndarray], names: list[str]) -> np.ndarray:
    """Rows of the columns that the network reads, without points that have no place; intensities as 0 to 1."""
    own = {"x_m": columns["x"], "y_m": columns["y"], "z_m": columns["z"]}
    if "intensity" in names:
        intensity = columns["intensity"].astype(np.float32)
        own["intensity"] = intensity / 255 if intensity.max(initial=0) > 1 else intensity
    own["lag_s"] = np.zeros(len(columns["x"]))  # one sweep, not several
    rows = np.stack([own[name] for name in names], 1).astype(np.float32)
    return rows[np.isfinite(rows).all(1) & (rows[:, :3] != 0).any(1)]


def pillars(points: np.ndarray, reading: dict) -> dict[str, np.ndarray]:
    """What the network reads: each point described, the pillar of each, and the cell of each pillar."""
    grid, multiple = reading["grid"], reading["multiple"]
    cell_m = grid["cell_m"]
    lengths = (grid["range_m"], 2 * grid["half_width_m"])
    nx, ny = (math.ceil(round(length / cell_m, 6) / multiple) * multiple for length in lengths)
    y_min_m = -ny * cell_m / 2
    ix, iy = np.floor(points[:, 0] / cell_m), np.floor((points[:, 1] - y_min_m) / cell_m)
    inside = (ix >= 0) & (ix < nx) & (iy >= 0) & (iy < ny)
    inside &= (points[:, 2] >= grid["z_min_m"]) & (points[:, 2] < grid["z_max_m"])
    points, key = points[inside], ix[inside].astype(np.int64) * ny + iy[inside].astype(np.int64)
    cell, pillar, count = np.unique(key, return_inverse=True, return_counts=True)
    xyz, f4 = points[:, :3], np.float32
    sums = [np.bincount(pillar, weights=column, minlength=len(cell)) for column in xyz.T.astype(np.float64)]
    mean = (np.stack(sums, 1) / count[:, None]).astype(f4)
    column, row = (index.astype(f4) for index in np.divmod(key, ny))
    centre = np.stack([(column + f4(0.5)) * f4(cell_m), (row + f4(0.5)) * f4(cell_m) + f4(y_min_m)], 1)
    scale = np.array([grid["range_m"], grid["half_width_m"], grid["z_max_m"]], f4)
    first = 0 if reading["positions"] == "absolute" else 2
    number = np.log1p(count.astype(f4))[pillar, None]
    parts = [(xyz / scale)[:, first:], (xyz - mean[pillar]) / f4(cell_m), (xyz[:, :2] - centre) / f4(cell_m), number]
    described = np.concatenate([*parts, points[:, 3:]], 1)
    return {"points": np.ascontiguousarray(described, f4), "pillar": pillar, "cell": cell}


def overlap(one: np.ndarray, other: np.ndarray) -> float:
    """Intersection over union of two boxes seen from above: one's corners clipped by the other's sides."""
    polygon = corners(one)
    sides = corners(other)
    for start, end in zip(sides, np.roll(sides, -1, 0), strict=True):
        side = (end[0] - start[0]) * (polygon[:, 1] - start[1]) - (end[1] - start[1]) * (polygon[:, 0] - start[0])
        clipped = []
        for index in range(len(polygon)):
            a, b, da, db = polygon[index - 1], polygon[index], side[index - 1], side[index]
            if (da >= 0) != (db >= 0):
                clipped.append(a + (b - a) * da / (da - db))
            if db >= 0:
                clipped.append(b)
        if len(clipped) < 3:
            return 0.0
        polygon = np.array(clipped)
    x, y = polygon.T
    shared = abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2
    return shared / max(one[3] * one[4] + other[3] * other[4] - shared, 1e-12)


def corners(box: np.ndarray) -> np.ndarray:
    """Corners of a box seen from above, counter-clockwise, shape (4, 2)."""
    cos, sin = math.cos(box[6]), math.sin(box[6])
    local = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * box[3:5] / 2
    return local @ np.array([[cos, sin], [-sin, cos]]) + box[:2]


def apart(boxes: np.ndarray, limit: float, most: int) -> list[int]:
    """Boxes, best first, that no better one that stays overlaps by more than a limit."""
    stay: list[int] = []
    radius = np.hypot(boxes[:, 3], boxes[:, 4]) / 2
    for index, box in enumerate(boxes):
        gap = np.hypot(boxes[stay, 0] - box[0], boxes[stay, 1] - box[1])
        near = [stay[i] for i in np.flatnonzero(gap < radius[stay] + radius[index])]
        if not any(overlap(boxes[other], box) > max(limit, 1e-9) for other in near):
            stay.append(index)
            if len(stay) == most:
                break
    return stay


def load(path: Path, threads: int = 0) -> tuple[onnxruntime.InferenceSession, dict]:
    """A session and what the file says of itself. ``threads``: 0 takes all cores."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.enable_mem_pattern = False
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    record = json.loads(session.get_modelmeta().custom_metadata_map["farfield"])
    reading = record["reading"]
    if reading["kind"] != "pillars" or reading["features"] != "farfield" or record["score_bands"]:
        raise SystemExit(f"{path}: this example runs PointPillars with farfield's features and uncalibrated scores")
    return session, record


def detect(
    session: onnxruntime.InferenceSession, record: dict, points: np.ndarray
) -> list[tuple[str, float, np.ndarray]]:
    """Label, score and box of each object, best first."""
    boxes, scores, labels = session.run(["boxes", "scores", "labels"], pillars(points, record["reading"]))
    sure = scores >= record["score_threshold"]
    boxes, scores, labels = boxes[sure].astype(np.float64), scores[sure], labels[sure]
    stay = apart(boxes, record["nms_iou"], record["max_boxes"])
    return [(record["classes"][labels[i]], float(scores[i]), boxes[i]) for i in stay]


def main(arguments: list[str]) -> int:
    """Print the boxes of a PCD file."""
    if len(arguments) != 2:
        print(__doc__, file=sys.stderr)
        return 2
    session, record = load(Path(arguments[0]))
    points = points_of(read_pcd(Path(arguments[1])), record["reading"]["columns"])
    print("label,score,x,y,z,length,width,height,yaw")
    for label, score, box in detect(session, record, points):
        print(f"{label},{score:.4f}," + ",".join(f"{number:.4f}" for number in box))
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
