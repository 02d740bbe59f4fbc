"""Draw the pictures of README and docs: ``python docs/make_images.py`` (with --plain, without a detector)."""

import sys
from pathlib import Path

import farfield as ff
from farfield.depth import frame_depth
from farfield.evaluation.report_data import VEHICLES, confident
from farfield.figures.birds_eye import WINDOW_M, overview
from farfield.figures.camera import depth_picture
from farfield.figures.plots import scan_patterns
from farfield.figures.style import figure_bytes
from farfield.simulation import simulate_sequence

IMAGES = Path(__file__).parent / "images"
DETECTOR = "pointpillars-cirrus-sim"
SEED, SEQUENCE, FRAMES = 5, 0, 4


def main() -> None:
    """Simulate a moment, detect, draw."""
    frame = list(simulate_sequence("cirrus-sim", seed=SEED, sequence=SEQUENCE, frames=FRAMES))[-1]
    cloud = frame.cloud("gaussian")
    predicted = None if "--plain" in sys.argv else confident(ff.load_detector(DETECTOR)(frame), 0.3)
    figure = overview(cloud, annotated=frame.boxes, predicted=predicted, labels=VEHICLES, window_m=WINDOW_M)
    (IMAGES / "birdseye.png").write_bytes(figure_bytes(figure, "png", dpi=110))
    (IMAGES / "patterns.png").write_bytes(figure_bytes(scan_patterns(dict(frame.clouds)), "png", dpi=100))
    (street,) = simulate_sequence("kitti-sim", sequence=2, frames=1, start=5, sensors=("lidar", "camera"))
    depth = frame_depth(street)
    picture = depth_picture(
        depth.depth_m, depth.measured, depth.uncertainty_m, street.images["camera"], method=depth.method
    )
    (IMAGES / "depth.jpg").write_bytes(figure_bytes(picture, "jpg", dpi=100))
    for path in sorted(IMAGES.glob("*.*g")):
        print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
