"""What is hidden: faces and number plates, in drawn and real pictures; the training of the network of plates."""

import csv
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from _plates_pool import filled_pool, train_networks
from _plates_scenes import Scene, scenes_of, with_plates, zoomed
from _plates_training import Sampler
from _report import ROOT, SHARED_REAL, MissingError, Part, part_parser, progress, run_parts
from PIL import Image, ImageFilter

from farfield.files.images import read_image
from farfield.privacy.covering import box_mask
from farfield.privacy.detectors import PLATE_THRESHOLD, FaceDetector, PlateDetector
from farfield.privacy.frames import drop_plates_off_vehicles, project_vehicles
from farfield.privacy.image_boxes import ImageBoxes, covered_share
from farfield.privacy.plate_network import load_networks, save_networks
from farfield.simulation import simulate_sequence

STRONG, FACES_HIT, BOARDS = 0.3, 0.9, 6
FACES_SIZES_PX = (10, 20, 40)
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
    return [covered_share(mask, box) >= FACES_HIT for box in faces], int((mask & ~allowed).sum())


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


def faces_on_scenes(scenes: int, folder: Path, lights: Sequence[str]) -> tuple[list[str], list[str]]:
    """A table by light and size, and what a frame takes."""
    boards, detectors = portraits(folder), (FaceDetector(), FaceDetector(sizes=(1.0, 2.0)))
    lines = [f"{'portraits in scenes':34} " + " ".join(f"{size:>6} px" for size in FACES_SIZES_PX) + "  false cover"]
    clocks: list[list[float]] = [[] for _ in detectors]
    shape = (0, 0)
    for light, settings in [(name, LIGHTS[name]) for name in lights]:
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
                for size in FACES_SIZES_PX:
                    covered: list[bool] = []
                    for scene in progress(pictures, f"{light}, {size} px"):
                        picture, faces = with_boards(scene, size, mask, boards, rng)
                        began = time.process_time()
                        hits = detector(picture)
                        clocks[which].append(time.process_time() - began)
                        hit, wrong = missed_and_false(picture, hits[hits.score >= STRONG], faces, np.zeros((0, 4)))
                        covered, false = covered + hit, false + wrong
                    cells.append(f"{np.mean(covered):>8.2f}")
                pixels = len(pictures) * len(FACES_SIZES_PX) * shape[0] * shape[1]
                words = f"{light}, {'mask' if mask else 'no mask'}{', twice the size too' if which else ''}"
                lines.append(f"{words:34} {' '.join(cells)}  {false / pixels:>10.3%}")
    one, two = (np.median(clock) for clock in clocks)
    speed = f"{1 / one:.1f} frames a CPU second, {1 / two:.1f} at twice the size too (median)"
    return lines, [f"{shape[1]} x {shape[0]} pixels: {speed}"]


def run_faces(arguments: Sequence[str]) -> None:
    """Faces: recall and false cover on free pictures, on portraits in rendered scenes by light and size, and speed.

        python benchmarks/privacy.py faces [--scenes 16]

    Covered means that at least 90 % of a face's box (hair line to chin, ear to ear) lie in covered boxes; false cover
    is the share of pixels that are covered outside of faces grown by half to each side. First the pictures beside the
    project, where there are any: their boxes were drawn with this detector's help, so they flatter it. Then portraits
    as flat boards in simulated camera images by day, at night and in rain, with faces 10, 20 and 40 pixels high, with
    and without a mask over mouth and nose; light, blur and noise follow the place where the board stands.
    """
    parser = part_parser(run_faces.__doc__)
    parser.add_argument("--scenes", type=int, default=16)
    parser.add_argument("--real", type=Path, default=SHARED_REAL / "faces_and_plates")
    parser.add_argument("--without-pictures", action="store_true")
    parser.add_argument("--lights", nargs="+", choices=LIGHTS, default=list(LIGHTS))
    options = parser.parse_args(arguments)
    if not (options.real / "boxes.csv").is_file():
        raise MissingError(f"no pictures of faces in {options.real.name}")
    lines = []
    if not options.without_pictures:
        lines += [*on_free_pictures(options.real), ""]
    scenes, speed = faces_on_scenes(options.scenes, options.real, options.lights)
    print("\n".join([*lines, *scenes, "", *speed]))


TRAINED = {"seed": 9100, "sizes": ("us",), "lights": ("day", "night", "rain", "day")}
CALIBRATED = {"seed": 8200, "sizes": ("kitti",)}
MEASURED = {"seed": 7700, "sizes": ("korea",)}
PLATES_SIZES_PX = (8, 12, 20, 40)
WEAK, PLATES_HIT, MOST_FALSE = 0.1, 0.9, 0.75
SCORES = (
    0.1,
    0.15,
    0.2,
    0.25,
    0.3,
    0.35,
    0.4,
    0.5,
    0.55,
    0.6,
    0.65,
    0.7,
    0.75,
    0.8,
    0.85,
    0.9,
    0.93,
    0.95,
    0.97,
    0.98,
    0.99,
    0.995,
)
VEHICLES = (
    "Car",
    "Van",
    "Truck",
    "Tram",
    "Misc",
    "DontCare",
    "car",
    "truck",
    "motor",
    "moped_scooter",
    "vehicle_other",
)
WEIGHTS = ROOT / "src" / "farfield" / "privacy" / "plates.safetensors"


@dataclass
class Tally:
    """Plates by size and whether they were covered, and pixels."""

    high_px: list[float] = field(default_factory=list)
    wide_px: list[float] = field(default_factory=list)
    covered: list[bool] = field(default_factory=list)
    false: int = 0
    pixels: int = 0
    false_covers: int = 0
    pictures: int = 0

    def add(self, image: np.ndarray, hits: ImageBoxes, plates: np.ndarray, ignored: np.ndarray) -> list[bool]:
        """Count a picture; which of its plates are covered."""
        height, width = image.shape[:2]
        mask, allowed = box_mask(hits, width, height), np.zeros((height, width), dtype=bool)
        for left, top, right, bottom in np.concatenate([plates, ignored]):
            across, down = (right - left) / 2, (bottom - top) / 2
            rows, columns = (top - down, bottom + down), (left - across, right + across)
            allowed[max(0, int(rows[0])) : max(0, int(rows[1])), max(0, int(columns[0])) : max(0, int(columns[1]))] = 1
        found = [covered_share(mask, box) >= PLATES_HIT for box in plates]
        self.covered += found
        self.high_px += (plates[:, 3] - plates[:, 1]).tolist()
        self.wide_px += (plates[:, 2] - plates[:, 0]).tolist()
        self.false += int((mask & ~allowed).sum())
        self.pixels += height * width
        centre = ((hits.box_px[:, :2] + hits.box_px[:, 2:]) / 2).clip(0, [width - 1, height - 1]).astype(int)
        self.false_covers += int((~allowed[centre[:, 1], centre[:, 0]]).sum())
        self.pictures += 1
        return found

    def share(self, low: float, high: float = np.inf, *, wide: bool = False) -> str:
        """Covered of those whose height, or width, lies in a span."""
        size = np.array(self.wide_px if wide else self.high_px)
        inside = (size >= low) & (size < high)
        return f"{np.array(self.covered, float)[inside].mean():.3f} of {inside.sum()}" if inside.any() else "none"

    def row(self, words: str) -> str:
        """A line under :data:`HEADS`."""
        spans = [*zip(PLATES_SIZES_PX, (*PLATES_SIZES_PX[1:], np.inf), strict=True)]
        cells = [self.share(*span) for span in spans] + [self.share(20), self.share(20, wide=True)]
        return (
            f"{words:31} "
            + " ".join(f"{cell:>14}" for cell in cells)
            + f" {self.false / max(self.pixels, 1):>9.3%}"
            + (f" {self.false_covers / max(self.pictures, 1):>10.2f}")
        )


HEADS = f"{'height of the plate':31} " + " ".join(
    f"{name:>14}" for name in ("8-12 px", "12-20 px", "20-40 px", "40 px on", "20 px on", "width 20 px on")
)
HEADS += f" {'false':>9} {'a picture':>10}"


def pictures_of(
    scenes: Iterable[Scene], pictures: int, seed: int
) -> Iterator[tuple[Scene, np.ndarray, np.ndarray, np.ndarray]]:
    """Pictures with plates, their boxes, and those that do not count: all scenes, then through a longer lens, again."""
    kept = list(scenes)
    for number in range(pictures):
        rng, scene = np.random.default_rng([seed, number]), kept[number % len(kept)]
        scene = zoomed(scene, rng) if (number // len(kept)) % 2 else scene
        yield scene, *with_plates(scene, rng)


def plate_free(real: Path) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Real pictures of KITTI and View-of-Delft beside the project, and their vehicles' boxes, which do not count."""
    folders = ("kitti/training", "kitti_more/training", "view_of_delft/lidar/training")
    for labels in sorted(path for name in folders for path in (real / name / "label_2").glob("*.txt")):
        found = list((labels.parent.parent / "image_2").glob(f"{labels.stem}.*"))
        if not found:
            continue
        rows = [line.split() for line in labels.read_text().splitlines()]
        boxes = [[float(value) for value in row[4:8]] for row in rows if len(row) > 7 and row[0] in VEHICLES]
        yield read_image(found[0]), np.array(boxes).reshape(-1, 4)


def calibrated(scenes: list[Scene], pictures: int, real: Path, weights: Path) -> list[str]:
    """Choose the score, move the bias, and say what was seen."""
    detector = PlateDetector(least_score=SCORES[0], weights=weights)
    drawn, free = {score: Tally() for score in SCORES}, {score: Tally() for score in SCORES}
    for _, image, plates, ignored in progress(pictures_of(scenes, pictures, CALIBRATED["seed"]), "rendered"):
        hits = detector(image)
        for score, tally in drawn.items():
            tally.add(image, hits[hits.score >= score], plates, ignored)
    for image, vehicles in progress(list(plate_free(real)), "real, plate-free"):
        hits = detector(image)
        for score, tally in free.items():
            tally.add(image, hits[hits.score >= score], np.zeros((0, 4)), vehicles)
    lines, chosen = (
        [f"{'score':>5} {'20 px on':>14} {'12-20 px':>14} {'false, drawn':>13} {'false, real':>12}"],
        SCORES[-1],
    )
    for score in reversed(SCORES):
        one, other = (tally[score].false_covers / max(tally[score].pictures, 1) for tally in (drawn, free))
        chosen = score if max(one, other) <= MOST_FALSE else chosen
        sizes = f"{drawn[score].share(20):>14} {drawn[score].share(12, 20):>14}"
        lines.append(f"{score:5.3f} {sizes} {one:>13.2f} {other:>12.2f}")
    finder, judge, _ = load_networks(weights)
    shift = np.log(PLATE_THRESHOLD / (1 - PLATE_THRESHOLD)) - np.log(chosen / (1 - chosen))
    with torch.no_grad():
        judge.head[-1].bias[0] += shift
    save_networks(weights, finder, judge)
    counts = f"{pictures} rendered pictures, {len(list(plate_free(real)))} real ones outside of vehicles"
    return [
        f"{counts}: a score of {chosen} is the least with at most {MOST_FALSE} false covers a picture; "
        f"now {PLATE_THRESHOLD}",
        *lines,
    ]


def plates_on_scenes(scenes: list[Scene], pictures: int, weights: Path) -> list[str]:
    """Tables by light, with and without context."""
    detector = PlateDetector(least_score=WEAK, weights=weights)
    tallies: dict[str, dict[str, Tally]] = {}
    clock, seen = 0.0, 0
    for scene, image, plates, ignored in progress(pictures_of(scenes, pictures, MEASURED["seed"]), "rendered"):
        began = time.process_time()
        hits = detector(image)
        clock, seen = clock + time.process_time() - began, seen + image.shape[0] * image.shape[1]
        where = project_vehicles(scene.boxes, scene.camera)
        ways = {
            "": hits[hits.score >= PLATE_THRESHOLD],
            ", context": drop_plates_off_vehicles(hits, where, PLATE_THRESHOLD),
            ", weak too": hits,
        }
        for words, kept in ways.items():
            for light in (scene.light, "all"):
                tallies.setdefault(words, {}).setdefault(light, Tally()).add(image, kept, plates, ignored)
    lines = [f"{pictures} rendered pictures of {len(scenes)} scenes", HEADS]
    for words, parts in tallies.items():
        lines += [tally.row(f"{light}{words}") for light, tally in parts.items()]
    lines.append(
        f"{seen / max(clock, 1e-9) / 1e6:.1f} million pixels a CPU second: {seen / clock / 921600:.1f} of 1280 x 720"
    )
    return lines


def annotated(folder: Path) -> Iterator[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    """Name, picture, plates and ignored boxes of the pictures beside the project."""
    from farfield.files.videos import film_frames, read_film

    with (folder / "boxes.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["kind"] == "plate"]
    for name, number in sorted({(row["file"], int(row["frame"])) for row in rows}):
        mine = [row for row in rows if (row["file"], int(row["frame"])) == (name, number)]
        boxes = np.array([[float(row[key]) for key in "xywh"] for row in mine])
        boxes[:, 2:] += boxes[:, :2]
        ignored = np.array([row["ignore"] == "1" for row in mine])
        if name.endswith(".mp4"):
            picture = next(iter(film_frames(read_film(folder / name), number, number + 1)))
        else:
            picture = np.array(Image.open(folder / name).convert("RGB"))
        yield f"{name} {number}", picture, boxes[~ignored], boxes[ignored]


def on_real(folder: Path, weights: Path) -> list[str]:
    """What is covered in the pictures beside the project, each picture by itself, and what is missed."""
    detector, strong, weak, lines = PlateDetector(least_score=WEAK, weights=weights), Tally(), Tally(), []
    for name, picture, plates, ignored in annotated(folder):
        hits = detector(picture)
        before = strong.false_covers
        found = strong.add(picture, hits[hits.score >= PLATE_THRESHOLD], plates, ignored)
        weak.add(picture, hits, plates, ignored)
        missed = [
            f"{box[2] - box[0]:.0f} x {box[3] - box[1]:.0f}" for box, hit in zip(plates, found, strict=True) if not hit
        ]
        words = f"missed {', '.join(missed)}" if missed else "all covered"
        lines.append(f"{name:20} {sum(found):2}/{len(found):2}  false covers {strong.false_covers - before}  {words}")
    totals = [
        f"{sum(tally.covered)} of {len(tally.covered)} plates, {tally.false_covers} false covers {words}"
        for tally, words in (
            (strong, f"from {PLATE_THRESHOLD} on"),
            (weak, f"from {WEAK} on, where only a track decides"),
        )
    ]
    return ["free pictures (width x height of what is missed)", *lines, *totals]


def run_plates(arguments: Sequence[str]) -> None:
    """Number plates: the training of the network that the package ships, and what it finds.

        python benchmarks/privacy.py plates train --crops 22000 --seconds 780
        python benchmarks/privacy.py plates calibrate
        python benchmarks/privacy.py plates measure [--pictures 1000]

    Training draws plates onto the vehicles of simulated scenes and onto drawn surroundings; with scikit-image and
    scikit-learn installed their free pictures serve as what is no plate. ``--start`` goes on from other weights.
    ``calibrate`` picks the score from which a hit counts, on rendered scenes of other seeds and on real pictures
    outside of all vehicles: at most three false covers in four pictures. It moves the judge's bias so that this score
    is 0.3, as for faces. ``measure`` takes scenes of other seeds and bodies again. Covered: at least 90 % of a plate's
    upright box; false cover: one whose centre lies outside of plates and ignored boxes grown by half to each side.
    ``--cache FOLDER`` keeps simulated scenes.
    """
    parser = part_parser(run_plates.__doc__)
    parser.add_argument("what", choices=("train", "calibrate", "measure"), nargs="?", default="measure")
    parser.add_argument("--weights", type=Path, default=WEIGHTS)
    parser.add_argument("--scenes", type=int, default=120)
    parser.add_argument("--pictures", type=int, default=1000)
    parser.add_argument("--crops", type=int, default=22000)
    parser.add_argument("--seconds", type=float, default=780, help="of training")
    parser.add_argument("--workers", type=int, default=1, help="processes that draw crops")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--start", type=Path, help="weights to go on from")
    parser.add_argument("--cache", type=Path, help="keep simulated scenes here")
    parser.add_argument("--real", type=Path, default=SHARED_REAL)
    parser.add_argument("--without-real", action="store_true")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    settings = {"train": TRAINED, "calibrate": CALIBRATED, "measure": MEASURED}[options.what]
    scenes = list(scenes_of(range(options.scenes), folder=options.cache, **settings))
    if options.what == "train":
        start = load_networks(options.start)[0] if options.start is not None else None
        pool = filled_pool(Sampler(scenes, 1), options.crops, options.workers)
        networks = train_networks(pool, 1, seconds=options.seconds, device=options.device, start=start)
        save_networks(options.weights, *networks)
        return
    lines = []
    if options.what == "calibrate":
        lines += calibrated(scenes, options.pictures, options.real, options.weights)
    else:
        lines += plates_on_scenes(scenes, options.pictures, options.weights)
        folder = options.real / "faces_and_plates"
        if (folder / "boxes.csv").is_file() and not options.without_real:
            lines += ["", *on_real(folder, options.weights)]
    print("\n".join(lines))


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "faces": Part(run_faces, "--scenes 1 --without-pictures --lights night"),
                "plates": Part(run_plates, "measure --scenes 1 --pictures 2 --without-real"),
            },
        )
    )
