"""Draw the pictures of README and docs: ``python docs/make_images.py``."""

from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

import farfield as ff
from farfield.depth import frame_depth
from farfield.evaluation.around import detect_around
from farfield.evaluation.report_data import confident
from farfield.figures.birds_eye import street as street_from_above
from farfield.figures.camera import depth_picture
from farfield.figures.plots import scan_patterns
from farfield.figures.style import figure_bytes, new_figure
from farfield.simulation import simulate_sequence
from farfield.simulation.bodies.actors import Actor, mean_size_m
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import Mesh
from farfield.simulation.trace import Tracer
from farfield.vocabulary.scores import SHOWN_SCORE

IMAGES = Path(__file__).parent / "images"
DETECTOR = "pointpillars-cirrus-sim"
SEED, SEQUENCE, FRAMES = 5, 0, 4
BODIES = ("sedan", "hatch", "estate", "suv", "mpv", "pickup", "van", "light_truck", "box", "semi", "tipper", "bus")
COLOURS = {
    Material.CAR_PAINT: (0.72, 0.22, 0.16), Material.GLASS: (0.55, 0.75, 0.92), Material.TRIM: (0.2, 0.2, 0.2),
    Material.TYRE: (0.12, 0.12, 0.12), Material.LAMP: (1.0, 0.88, 0.35), Material.PLATE: (1.0, 1.0, 1.0),
    Material.CLOTH: (0.3, 0.28, 0.45), Material.CARGO: (0.8, 0.8, 0.78),
}  # fmt: skip


def shaded(mesh: Mesh, azimuth_deg: float, elevation_deg: float, width: int = 330) -> np.ndarray:
    """A body seen from a direction, lit from above; windows show half of what is behind them."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    towards = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    up = np.cross(towards, right)
    across, tall = (mesh.vertices_m @ axis for axis in (right, up))
    step = (np.ptp(across) + 0.2) / width
    x, y = np.meshgrid(
        np.arange(across.min() - 0.1, across.max() + 0.1, step), np.arange(tall.max(), tall.min(), -step)
    )
    origins = x[..., None] * right + y[..., None] * up + 30.0 * towards
    corners = mesh.vertices_m[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    light = 0.35 + 0.65 * np.abs(normal @ [0.4, 0.5, 0.77])
    colour = np.array([COLOURS.get(Material(m), (0.55, 0.55, 0.58)) for m in mesh.material]) * light[:, None]
    colour = np.vstack([colour, [1.0, 1.0, 1.0]])  # the last for rays that meet nothing
    clear = mesh.material != Material.GLASS
    rays, directions = origins.reshape(-1, 3), np.tile(-towards, (x.size, 1))
    first = Tracer(mesh).cast_from(rays, directions).face
    bare = Tracer(Mesh.of(mesh.vertices_m, mesh.faces[clear], mesh.material[clear])).cast_from(rays, directions).face
    behind = np.where(bare < 0, -1, np.flatnonzero(clear)[bare])
    glazed = (first >= 0) & ~np.append(clear, True)[first]
    picture = np.where(glazed[:, None], (colour[first] + colour[behind]) / 2, colour[first])
    return picture.reshape(*x.shape, 3)


def bodies_sheet() -> Figure:
    """One body of each family of world v3, from the left and from ahead."""
    figure = new_figure(11.0, 7.0)
    grid = figure.subplots(4, 6)
    for number, kind in enumerate(BODIES):
        mesh = Actor(0, kind, mean_size_m(kind), np.random.SeedSequence(1), "v3").build()
        for axes, view in zip(grid[number // 3, 2 * (number % 3) :], ((90, 0), (35, 18)), strict=False):
            axes.imshow(np.clip(shaded(mesh, *view), 0, 1))
            axes.set_axis_off()
        grid[number // 3, 2 * (number % 3)].set_title(kind.replace("_", " "), fontsize=8)
    return figure


STREET = "os-2-128"


def save_small(figure: Figure, name: str, dpi: int) -> None:
    """Write a drawing in 256 colours, at a third of the bytes."""
    picture = Image.open(BytesIO(figure_bytes(figure, "png", dpi=dpi))).convert("RGB")
    picture.quantize(256, dither=Image.Dither.NONE).save(IMAGES / name, optimize=True)


def main() -> None:
    """Simulate a moment, take a real one, detect, draw."""
    frame = list(simulate_sequence("cirrus-sim", seed=SEED, sequence=SEQUENCE, frames=FRAMES))[-1]
    sweeps = ff.open_dataset("open-sweeps")
    sweep = sweeps[sweeps.frame_ids.index(STREET)]
    vehicles = confident(detect_around(ff.load_detector(DETECTOR), sweep), SHOWN_SCORE)
    save_small(street_from_above(sweep, vehicles), "street.png", dpi=110)
    save_small(scan_patterns(dict(frame.clouds)), "patterns.png", dpi=100)
    (street,) = simulate_sequence("kitti-sim", sequence=2, frames=1, start=5, sensors=("lidar", "camera"))
    depth = frame_depth(street)
    picture = depth_picture(
        depth.depth_m, depth.measured, depth.uncertainty_m, street.images["camera"], method=depth.method
    )
    (IMAGES / "depth.jpg").write_bytes(figure_bytes(picture, "jpg", dpi=100))
    save_small(bodies_sheet(), "bodies.png", dpi=72)
    for path in sorted(IMAGES.glob("*.*g")):
        print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
