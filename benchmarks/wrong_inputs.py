"""Wrong inputs that a person would make: is any wrong result silent?"""

import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from _report import Part, part_parser, run_parts

HEADER = ("frame", "label", "x", "y", "z", "l", "w", "h", "yaw_rad", "score")
FRAMES, CARS, GROUND_M = 8, 10, -1.7
Rows = list[dict[str, float | str]]


@dataclass(frozen=True)
class Case:
    """What a person does wrong.

    Args:
        name: Short name.
        what: The mistake.
        make: Writes the files into a folder and gives the command's words.
        told: What has to stand in the output, as a regular expression.
    """

    name: str
    what: str
    make: Callable[[Path], Sequence[str]]
    told: str


def truth(seed: int = 0) -> Rows:
    """Cars on flat ground ahead of the sensor, those of each frame elsewhere."""
    random = np.random.default_rng(seed)
    rows: Rows = []
    for frame in range(FRAMES):
        for place in range(CARS):
            x, y = 8 + 8 * place + random.uniform(0, 3), random.uniform(5, 20) * random.choice([-1, 1])
            box = {"x": x, "y": y, "z": GROUND_M + 0.8, "l": 4.5, "w": 1.9, "h": 1.6}
            rows.append({"frame": f"{frame:06d}", "label": "vehicle", **box, "yaw_rad": random.uniform(-3, 3)})
    return rows


def found(seed: int = 1) -> Rows:
    """What a good detector finds of them."""
    random = np.random.default_rng(seed)
    moved = [row | {name: float(row[name]) + random.normal(0, 0.1) for name in "xyz"} for row in truth()]
    return [row | {"score": round(random.uniform(0.4, 1), 3)} for row in moved]


def table(rows: Rows, separator: str = ",") -> str:
    """Rows as text."""
    names = [name for name in dict.fromkeys((*HEADER, *rows[0])) if name in rows[0]]
    lines = [separator.join(str(row[name]) for name in names) for row in rows]
    return "\n".join([separator.join(names), *lines]) + "\n"


def changed(rows: Rows, change: Callable[[dict[str, float | str]], dict[str, float | str]]) -> Rows:
    """Rows with some values changed."""
    return [row | change(row) for row in rows]


def scored(
    folder: Path,
    change: Callable[[Rows], Rows] = list,
    *,
    extra: Sequence[str] = (),
    separator: str = ",",
    encoding: str = "utf-8",
) -> list[str]:
    """A score of good predictions after a change of them."""
    (folder / "labels.csv").write_text(table(truth()))
    (folder / "predictions.csv").write_text(table(change(found()), separator), encoding=encoding)
    return ["score", "predictions.csv", "labels.csv", "--replicates", "0", *extra]


def mirrored(rows: Rows) -> Rows:
    return changed(rows, lambda row: {"y": -float(row["y"]), "yaw_rad": -float(row["yaw_rad"])})


def in_camera_axes(rows: Rows) -> Rows:
    return changed(rows, lambda row: {"x": -float(row["y"]), "y": -float(row["z"]), "z": row["x"]})


def at_the_bottom(rows: Rows) -> Rows:
    return changed(rows, lambda row: {"z": float(row["z"]) - float(row["h"]) / 2})


def swapped_sizes(rows: Rows) -> Rows:
    return changed(rows, lambda row: {"l": row["w"], "w": row["l"]})


def half_sizes(rows: Rows) -> Rows:
    return changed(rows, lambda row: {name: float(row[name]) / 2 for name in "lwh"})


def clockwise(rows: Rows) -> Rows:
    return changed(rows, lambda row: {"yaw_rad": -float(row["yaw_rad"])})


def in_per_cent(rows: Rows) -> Rows:
    return changed(rows, lambda row: {"score": 100 * float(row["score"])})


def equally_sure(rows: Rows) -> Rows:
    return changed(rows, lambda _: {"score": 1.0})


def one_frame_late(rows: Rows) -> Rows:
    return changed(rows, lambda row: {"frame": f"{int(row['frame']) + 1:06d}"})


def twice(rows: Rows) -> Rows:
    return [*rows, *rows]


def in_km_h(rows: Rows) -> Rows:
    return changed(rows, lambda _: {"vx_m_s": 110.0, "vy_m_s": 30.0})


def exchanged(folder: Path) -> list[str]:
    scored(folder)
    return ["score", "labels.csv", "predictions.csv", "--replicates", "0"]


def with_itself(folder: Path) -> list[str]:
    scored(folder)
    return ["score", "predictions.csv", "predictions.csv", "--replicates", "0"]


def without_image_boxes(folder: Path) -> list[str]:
    """KITTI's results of a detector that knows no image: -1 in all four places."""
    for side, rows, pixels in (("label_2", truth(), "600 150 700 250"), ("results", found(), "-1 -1 -1 -1")):
        (folder / side).mkdir()
        for frame in dict.fromkeys(str(row["frame"]) for row in rows):
            lines = [
                f"Car 0 0 0 {pixels} 1.6 1.9 4.5 {-float(row['y'])} 1.7 {row['x']} {-float(row['yaw_rad']) - 1.57} "
                + str(row.get("score", ""))
                for row in rows
                if row["frame"] == frame
            ]
            (folder / side / f"{frame}.txt").write_text("\n".join(map(str.strip, lines)) + "\n")
    words = ["score", "results", "label_2", "--protocol", "kitti", "--format", "kitti", "--label", "Car"]
    return [*words, "--replicates", "0"]


def cloud(frame: int, points: int = 20_000) -> np.ndarray:
    """Ground, and the cars of a frame as boxes full of points; x, y, z, intensity."""
    random = np.random.default_rng(frame)
    ground = np.column_stack([random.uniform(-80, 100, points), random.uniform(-40, 40, points), np.zeros(points)])
    parts = [ground + np.array([0, 0, GROUND_M])]
    for row in truth():
        if int(row["frame"]) == frame:
            yaw, inside = float(row["yaw_rad"]), random.uniform(-0.5, 0.5, (200, 3)) * [4.5, 1.9, 1.6]
            turn = np.array([[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
            parts.append(inside @ turn + [float(row[name]) for name in "xyz"])
    place = np.concatenate(parts)
    return np.column_stack([place, random.beta(2, 6, len(place))]).astype(np.float32)


def sweeps(folder: Path, change: Callable[[np.ndarray], np.ndarray] = np.asarray, *, labels: bool = True) -> Path:
    """A folder of own clouds with a table of boxes."""
    own = folder / "own"
    own.mkdir()
    for frame in range(FRAMES):
        np.save(own / f"{frame:06d}.npy", change(cloud(frame)))
    if labels:
        (own / "labels.csv").write_text(table(truth()))
    return own


def json_boxes(frame: int, shift: float = 0.0) -> str:
    rows = [row for row in truth() if int(row["frame"]) == frame]
    entries = [
        f'{{"label": "vehicle", "centre_m": [{float(r["x"]) + shift}, {r["y"]}, {r["z"]}], '
        f'"size_m": [4.5, 1.9, 1.6], "yaw_rad": {r["yaw_rad"]}}}'
        for r in rows
    ]
    return f'{{"boxes": [{", ".join(entries)}]}}'


def named_like_images(folder: Path) -> list[str]:
    own = sweeps(folder, labels=False)
    (own / "labels").mkdir()
    (own / "labels" / "000000.json").write_text(json_boxes(0))
    for frame in range(1, FRAMES):
        (own / "labels" / f"img_{frame:06d}.json").write_text(json_boxes(frame))
    return ["doctor", "own"]


def annotated_twice(folder: Path) -> list[str]:
    own = sweeps(folder, labels=False)
    for place, shift in (("boxes", 0.0), ("labels", 3.0)):
        (own / place).mkdir()
        for frame in range(FRAMES):
            (own / place / f"{frame:06d}.json").write_text(json_boxes(frame, shift))
    return ["doctor", "own"]


def other_sequence(folder: Path) -> list[str]:
    own = sweeps(folder)
    rows = changed(truth(), lambda _: {"sequence": "drive_7"})
    (own / "labels.csv").write_text(table(rows))
    return ["doctor", "own"]


def in_utm(folder: Path) -> list[str]:
    own = sweeps(folder, lambda rows: rows.astype(np.float64) + np.array([691_000, 5_335_000, 520, 0]), labels=False)
    return ["predict", "pointpillars-cirrus-sim", str(own), "--out", "boxes.csv"]


def upside_down(folder: Path) -> list[str]:
    sweeps(folder, lambda rows: rows * np.array([1, -1, -1, 1], dtype=np.float32), labels=False)
    return ["doctor", "own"]


def in_folders_of_drives(folder: Path) -> list[str]:
    sweeps(folder).rename(folder / "drive1")
    (folder / "all").mkdir()
    (folder / "drive1").rename(folder / "all" / "drive1")
    return ["doctor", "all"]


def pointer_of_lfs(folder: Path) -> list[str]:
    text = f"version https://git-lfs.github.com/spec/v1\noid sha256:{'a' * 64}\nsize 1900000\n"
    (folder / "000000.bin").write_text(text)
    return ["predict", "pointpillars-cirrus-sim", "000000.bin"]


def as_ply(folder: Path) -> list[str]:
    (folder / "scan.ply").write_text("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n")
    return ["predict", "pointpillars-cirrus-sim", "scan.ply"]


def turned_in_radians(folder: Path) -> list[str]:
    sweeps(folder)
    return ["evaluate", "pointpillars-cirrus-sim", "own", "--rotate-deg", "3.14159", "--no-report"]


def inverted_camera(folder: Path) -> list[str]:
    from PIL import Image

    own = sweeps(folder)
    for frame in range(FRAMES):
        Image.new("RGB", (1280, 720), (90, 90, 90)).save(own / f"{frame:06d}.png")
    rows = "[[0, 0, 1, 0.3], [-1, 0, 0, 0], [0, -1, 0, 1.2], [0, 0, 0, 1]]"  # lidar_T_camera
    matrix = "[[1000, 0, 640], [0, 1000, 360], [0, 0, 1]]"
    text = f"matrix: {matrix}\ncamera_T_lidar: {rows}\nwidth: 1280\nheight: 720\n"
    (own / "calibration.yaml").write_text(text)
    return ["doctor", "own"]


def with_threshold_in_per_cent(folder: Path) -> list[str]:
    np.save(folder / "a.npy", cloud(0))
    return ["predict", "pointpillars-cirrus-sim", "a.npy", "--score-threshold", "30"]


def no_frames(folder: Path) -> list[str]:
    del folder
    return ["simulate", "cirrus-sim", "out", "--frames", "0"]


CASES = (
    Case("semicolons", "CSV separated by semicolons", partial(scored, separator=";"), "semicolon"),
    Case("utf-16", "CSV saved as Unicode text", partial(scored, encoding="utf-16"), "UTF-8"),
    Case("mirrored", "y points right in the predictions", partial(scored, change=mirrored), "mirror|y points right"),
    Case("camera axes", "x right, y down, z ahead", partial(scored, change=in_camera_axes), "camera"),
    Case("bottom", "z is the bottom of the box", partial(scored, change=at_the_bottom), "bottom|half .*height"),
    Case("sizes swapped", "length and width exchanged", partial(scored, change=swapped_sizes), "length and width"),
    Case("half sizes", "half extents for sizes", partial(scored, change=half_sizes), "half|twice as (large|long)"),
    Case("clockwise", "yaw counted clockwise", partial(scored, change=clockwise), "clockwise"),
    Case("per cent", "scores from 0 to 100", partial(scored, change=in_per_cent), "not from 0 to 1"),
    Case("equal scores", "1.0 for every box", partial(scored, change=equally_sure), "(same|equal|one) score"),
    Case("off by one", "frames numbered from 1 instead of 0", partial(scored, change=one_frame_late), "one frame|next"),
    Case("twice", "a file that was appended to itself", partial(scored, change=twice), "twice"),
    Case("km/h", "velocities in km/h", partial(scored, change=in_km_h), "velocit|m/s|speed"),
    Case("exchanged", "labels given as predictions", exchanged, "labels .*scores|exchanged|other way"),
    Case("with itself", "predictions scored against themselves", with_itself, "same (file|boxes)"),
    Case("bins falling", "range bins from far to near", partial(scored, extra=["--range-bins-m", "250,70,0"]), "range"),
    Case("bins joined", "0-70-250 for 0,70,250", partial(scored, extra=["--range-bins-m", "0-70-250"]), "range"),
    Case("no image boxes", "KITTI results without 2D boxes", without_image_boxes, "2D|box_px|image"),
    Case("named like images", "label files named like the images", named_like_images, "no cloud|belong to no|orphan"),
    Case("annotated twice", "boxes/ and labels/ hold different boxes", annotated_twice, "one annotation|two|both"),
    Case("other sequence", "labels.csv names another sequence", other_sequence, "drive_7|sequence"),
    Case("utm", "a cloud in UTM coordinates", in_utm, "window|metres|reach|origin"),
    Case("upside down", "z points down, y right (aerospace)", upside_down, "down|above the sensor|upside"),
    Case("folders", "clouds one folder deeper", in_folders_of_drives, "drive1|in the folder|deeper"),
    Case("lfs", "a pointer of Git LFS instead of the cloud", pointer_of_lfs, "LFS"),
    Case("ply", "a .ply", as_ply, r"\.pcd"),
    Case("radians", "--rotate-deg 3.14159", turned_in_radians, "radian"),
    Case("inverted", "the camera's pose for its inverse", inverted_camera, "invert"),
    Case("threshold", "--score-threshold 30", with_threshold_in_per_cent, "score.threshold"),
    Case("no frames", "simulate --frames 0", no_frames, "frames"),
)


def outcome(case: Case) -> tuple[str, str]:
    """What happens, and the words that say it."""
    with tempfile.TemporaryDirectory() as folder:
        words = case.make(Path(folder))
        command = [sys.executable, "-m", "farfield.cli", *words]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        told = (done.stdout + done.stderr).replace(f"{folder}/", "").replace("\u2502", " ")
    text = " ".join(told.split())
    if "Traceback" in text:
        return "TRACEBACK", text[-160:]
    hit = re.search(case.told, text, re.IGNORECASE)
    said = text[max(hit.start() - 70, 0) : hit.end() + 90] if hit else text[-160:]
    if done.returncode:
        return ("refused" if hit else "UNCLEAR"), said
    return ("said" if hit else "SILENT"), said


def run_inputs(arguments: Sequence[str]) -> int:
    """Thirty wrong inputs that a person would make, each given to a command: is any wrong result silent?

        python benchmarks/wrong_inputs.py [--only NAME ...]

    Written down before any of them was tried. A case is "refused" (exit status above 0, with the cause in the message),
    "said" (a note or a finding names it), "SILENT" (exit status 0 and no word of it), "UNCLEAR" (refused in other
    words) or "TRACEBACK". Exit status 1 where one is silent, unclear or a traceback.
    """
    parser = part_parser(run_inputs.__doc__)
    parser.add_argument("--only", nargs="+", help="names of cases")
    options = parser.parse_args(arguments)
    bad = 0
    print(f"{'case':20}{'outcome':11}mistake; words", flush=True)
    for case in CASES:
        if options.only is None or case.name in options.only:
            verdict, said = outcome(case)
            bad += verdict.isupper()
            print(f"{case.name:20}{verdict:11}{case.what}\n{'':31}... {said} ...", flush=True)
    print(f"\n{bad} silent, unclear or a traceback")
    return int(bad > 0)


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "inputs": Part(run_inputs, "--only 'no frames' lfs", exact=True),
            },
        )
    )
