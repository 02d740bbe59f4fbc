"""Faces: recall and false cover on free pictures, on portraits in rendered scenes by light and size, and speed.

    python benchmarks/faces.py [--scenes 16] [--output benchmarks/results/faces.txt]

Covered means that at least 90 % of a face's box (hair line to chin, ear to ear) lie in covered boxes; false cover is
the share of pixels that are covered outside of faces grown by half to each side. First the pictures beside the project,
where there are any: their boxes were drawn with this detector's help, so they flatter it. Then portraits as flat boards
in simulated camera images by day, at night and in rain, with faces 10, 20 and 40 pixels high, with and without a mask
over mouth and nose; light, blur and noise follow the place where the board stands.
"""

import argparse
import csv
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from _report import SHARED_REAL, header, progress
from PIL import Image, ImageFilter

from farfield.files.atomic import write_text
from farfield.privacy.covering import box_mask
from farfield.privacy.detectors import FaceDetector
from farfield.privacy.image_boxes import ImageBoxes, covered_share
from farfield.simulation import simulate_sequence

STRONG, HIT, BOARDS = 0.3, 0.9, 6
SIZES_PX = (10, 20, 40)
LIGHTS = {
    "day": {"time": "day", "weather": "normal"},
    "night": {"time": "night", "weather": "normal"},
    "rain": {"time": "day", "weather": "rain"},
}


def free_pictures(folder: Path) -> Iterator[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    """Name, picture, faces and ignored boxes (left, top, right, bottom) of those beside the project."""
    with (folder / "boxes.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["kind"] == "face" and not row["file"].endswith(".mp4")]
    for name, number in sorted({(row["file"], int(row["frame"])) for row in rows}):
        with Image.open(folder / name) as image:
            image.seek(number)
            picture = np.array(image.convert("RGB"))
        mine = [row for row in rows if (row["file"], int(row["frame"])) == (name, number)]
        boxes = np.array([[float(row[key]) for key in "xywh"] for row in mine])
        boxes[:, 2:] += boxes[:, :2]
        ignored = np.array([row["ignore"] == "1" for row in mine])
        yield name, picture, boxes[~ignored], boxes[ignored]


def missed_and_false(
    picture: np.ndarray, hits: ImageBoxes, faces: np.ndarray, ignored: np.ndarray
) -> tuple[list[bool], int]:
    """Whether each face is covered, and how many pixels are covered for nothing."""
    height, width = picture.shape[:2]
    mask, allowed = box_mask(hits, width, height), np.zeros((height, width), dtype=bool)
    for left, top, right, bottom in np.concatenate([faces, ignored]):
        across, down = (right - left) / 2, (bottom - top) / 2
        allowed[max(0, int(top - down)) : int(bottom + down), max(0, int(left - across)) : int(right + across)] = True
    return [covered_share(mask, box) >= HIT for box in faces], int((mask & ~allowed).sum())


def on_free_pictures(folder: Path) -> list[str]:
    """A line for each way of looking."""
    lines = [f"{'free pictures':34} {'10-20 px':>9} {'20-40 px':>9} {'40 px on':>9} {'false cover':>12}"]
    ways = (
        ("RGB, as it is", FaceDetector(), False),
        ("RGB, and at twice the size", FaceDetector(sizes=(1.0, 2.0)), False),
        ("BGR: the wrong order", FaceDetector(), True),
    )
    for words, detector, swapped in ways:
        found: dict[str, list[bool]] = {"10-20": [], "20-40": [], "40": []}
        false = pixels = 0
        for _, picture, faces, ignored in free_pictures(folder):
            hits = detector(np.ascontiguousarray(picture[..., ::-1]) if swapped else picture)
            covered, wrong = missed_and_false(picture, hits[hits.score >= STRONG], faces, ignored)
            false, pixels = false + wrong, pixels + picture.shape[0] * picture.shape[1]
            for box, hit in zip(faces, covered, strict=True):
                tall = box[3] - box[1]
                found["10-20" if tall < 20 else "20-40" if tall < 40 else "40"].append(hit)
        cells = [f"{sum(hits)}/{len(hits)}" for hits in found.values()]
        lines.append(f"{words:34} {cells[0]:>9} {cells[1]:>9} {cells[2]:>9} {false / pixels:>11.3%}")
    return lines


def portraits(folder: Path) -> list[tuple[Image.Image, np.ndarray]]:
    """Free portraits, each with its face: left, top, right, bottom."""
    from matplotlib.cbook import get_sample_data

    with get_sample_data("grace_hopper.jpg") as file:
        found = [(Image.open(file).convert("RGB"), np.array([166.0, 112.0, 366.0, 342.0]))]
    if (folder / "astronaut.png").is_file():
        found.append((Image.open(folder / "astronaut.png").convert("RGB"), np.array([178.0, 55.0, 270.0, 179.0])))
    return found


def masked(portrait: Image.Image, face: np.ndarray) -> Image.Image:
    """The portrait with a mask over mouth and nose."""
    left, top, right, bottom = face
    image = np.array(portrait)
    upper, lower = round(top + 0.5 * (bottom - top)), round(bottom + 0.02 * (bottom - top))
    image[upper:lower, round(left + 0.06 * (right - left)) : round(right - 0.06 * (right - left))] = (205, 214, 222)
    return Image.fromarray(image)


def with_boards(
    scene: np.ndarray, size_px: int, mask: bool, boards: list[tuple[Image.Image, np.ndarray]], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """A scene with portraits in it, and the faces' boxes; the light is that of the place."""
    picture, faces = scene.astype(float), []
    height, width = scene.shape[:2]
    lanes = np.linspace(0, width, BOARDS + 1)
    for lane in range(BOARDS):
        portrait, face = boards[int(rng.integers(len(boards)))]
        portrait = masked(portrait, face) if mask else portrait
        scale = size_px / (face[3] - face[1])
        small = portrait.resize((max(1, round(portrait.width * scale)), max(1, round(portrait.height * scale))), 4)
        board = np.asarray(small.filter(ImageFilter.GaussianBlur(rng.uniform(0.2, 0.6))), dtype=float)
        top = int(rng.uniform(0.45, 0.62) * height)
        left = int(rng.uniform(lanes[lane], max(lanes[lane] + 1, lanes[lane + 1] - board.shape[1])))
        board = board[: height - top, : width - left]
        around = picture[top : top + board.shape[0], left : left + board.shape[1]]
        lit = board * np.clip(around.mean() / 110.0, 0.06, 1.2) + rng.normal(0, 3, board.shape)
        picture[top : top + board.shape[0], left : left + board.shape[1]] = lit
        faces.append(face * scale + np.tile([left, top], 2))
    boxes = np.array(faces)
    return picture.clip(0, 255).astype(np.uint8), boxes[(boxes[:, 2] <= width) & (boxes[:, 3] <= height)]


def on_scenes(scenes: int, folder: Path) -> tuple[list[str], list[str]]:
    """A table by light and size, and what a frame takes."""
    boards, detectors = portraits(folder), (FaceDetector(), FaceDetector(sizes=(1.0, 2.0)))
    lines = [f"{'portraits in scenes':34} " + " ".join(f"{size:>6} px" for size in SIZES_PX) + "  false cover"]
    clocks: list[list[float]] = [[] for _ in detectors]
    shape = (0, 0)
    for light, settings in LIGHTS.items():
        drawn = [
            next(
                iter(
                    simulate_sequence("cirrus-sim", seed=77, sequence=number, frames=1, sensors=("camera",), **settings)
                )
            )
            for number in progress(range(scenes), f"scenes, {light}")
        ]
        pictures = [frame.images["camera"] for frame in drawn]
        shape = pictures[0].shape[:2]
        for mask in (False, True):
            for which, detector in enumerate(detectors):
                rng, cells, false = np.random.default_rng(5), [], 0
                for size in SIZES_PX:
                    covered: list[bool] = []
                    for scene in progress(pictures, f"{light}, {size} px"):
                        picture, faces = with_boards(scene, size, mask, boards, rng)
                        began = time.process_time()
                        hits = detector(picture)
                        clocks[which].append(time.process_time() - began)
                        hit, wrong = missed_and_false(picture, hits[hits.score >= STRONG], faces, np.zeros((0, 4)))
                        covered, false = covered + hit, false + wrong
                    cells.append(f"{np.mean(covered):>8.2f}")
                pixels = len(pictures) * len(SIZES_PX) * shape[0] * shape[1]
                words = f"{light}, {'mask' if mask else 'no mask'}{', twice the size too' if which else ''}"
                lines.append(f"{words:34} {' '.join(cells)}  {false / pixels:>10.3%}")
    one, two = (np.median(clock) for clock in clocks)
    speed = f"{1 / one:.1f} frames a CPU second, {1 / two:.1f} at twice the size too (median)"
    return lines, [f"{shape[1]} x {shape[0]} pixels: {speed}"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=16)
    parser.add_argument("--real", type=Path, default=SHARED_REAL / "faces_and_plates")
    parser.add_argument("--output", type=Path)
    arguments = parser.parse_args()
    lines = [header(), ""]
    if (arguments.real / "boxes.csv").is_file():
        lines += [*on_free_pictures(arguments.real), ""]
    scenes, speed = on_scenes(arguments.scenes, arguments.real)
    lines += [*scenes, "", *speed]
    text = "\n".join(lines)
    print(text)
    if arguments.output is not None:
        write_text(arguments.output, text + "\n")


if __name__ == "__main__":
    main()
