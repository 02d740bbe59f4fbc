"""Make the frames that ship, from simulated ones: fewer points and pixels, the same layouts.

farfield simulate cirrus-sim OUT/c --frames 1 --sequences 1 --sensors gaussian,uniform,camera
farfield simulate kradar-sim-mini OUT/k --frames 1 --sequences 1 --sensors os2-64,cells,cam-front
python tools/sample_data.py OUT/c OUT/k src/farfield/studio/samples
"""

import shutil
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int, UInt8
from PIL import Image

from farfield.datasets import open_dataset
from farfield.datasets.cirrus.writer import CirrusWriter
from farfield.datasets.kradar.writer import KRadarWriter
from farfield.frame import Annotation, Boxes, Camera, Cloud, Frame
from farfield.frame.provenance import SIMULATION_FILE
from farfield.geometry.boxes import BOX_MARGIN_M, count_points_in_boxes, points_in_boxes
from farfield.radar.cells import RadarCells

POINTS = 7000
CELLS = 30_000
WIDTH_PX = 640
_ROOM_M = 0.3
_OF_A_BOX = 120


def main(arguments: list[str]) -> int:
    """Make both frames."""
    simulated_cirrus, simulated_kradar, out = map(Path, arguments)
    for name in ("cirrus", "kradar"):
        shutil.rmtree(out / name, ignore_errors=True)
    CirrusWriter(out / "cirrus").write(smaller(open_dataset(simulated_cirrus)[0]))
    writer = KRadarWriter(out / "kradar", labels=("v2.1",))
    writer.write(smaller(open_dataset(simulated_kradar)[0]))
    writer.finish()
    for source, name in ((simulated_cirrus, "cirrus"), (simulated_kradar, "kradar")):
        shutil.copyfile(source / SIMULATION_FILE, out / name / SIMULATION_FILE)  # says that it is simulated
    return 0


def smaller(frame: Frame) -> Frame:
    """A frame with fewer points, radar cells and pixels; and what is annotated counted anew."""
    boxes = frame.boxes if frame.boxes is not None else Boxes.empty()
    clouds = {name: thinned(frame.cloud(name), boxes) for name in frame.clouds if name != "radar"}
    images = {name: shrunk(frame.images[name]) for name in frame.images if not name.endswith("-right")}
    cameras = {name: shrunk_camera(frame.cameras[name], frame.images[name].shape[1]) for name in images}
    radar = {name: strongest(frame.radar[name]) for name in frame.radar if name == "cells"}
    fewer = replace(frame, clouds=clouds, images=images, cameras=cameras, radar=radar)
    return fewer.annotated(None if frame.annotation is None else counted(frame.annotation, clouds))


def counted(annotation: Annotation, clouds: Mapping[str, Cloud]) -> Annotation:
    """The annotation with the numbers of points that the clouds have left."""
    names = [name for name in clouds if name != "uniform"]
    boxes = annotation.boxes.replace(point_count=_inside(clouds[names[0]], annotation.boxes))
    details = dict(annotation.details)
    if "point_count_uniform" in details:
        details["point_count_uniform"] = _inside(clouds["uniform"], annotation.boxes)
    return replace(annotation, boxes=boxes, details=details)


def _inside(cloud: Cloud, boxes: Boxes) -> Int[np.ndarray, " n"]:
    return count_points_in_boxes(cloud.points_m, boxes, margin_m=BOX_MARGIN_M)


def thinned(cloud: Cloud, boxes: Boxes, *, points: int = POINTS) -> Cloud:
    """About so many points, to the centimetre: up to 120 or so in each box, and of the others one every so often."""
    near, chosen = np.zeros(len(cloud), dtype=bool), np.zeros(len(cloud), dtype=bool)
    for rows in points_in_boxes(cloud.points_m, boxes, margin_m=_ROOM_M):
        near[rows] = True
        chosen[rows[:: max(len(rows) // _OF_A_BOX, 1)]] = True
    others = np.flatnonzero(~near)
    step = max(len(others) // max(points - int(chosen.sum()), 1), 1)
    chosen[others[::step]] = True
    kept = cloud[chosen]
    extra = {name: values for name, values in kept.extra.items() if name == "ring"}
    return Cloud(np.round(kept.points_m, 2), kept.intensity, extra)


def strongest(cells: RadarCells, *, count: int = CELLS) -> RadarCells:
    """The strongest cells of a radar."""
    rows = np.sort(np.argsort(-cells.code.astype(np.int64), kind="stable")[:count])
    doppler = None if cells.doppler is None else cells.doppler[rows]
    return RadarCells(cells.index[rows], cells.code[rows], doppler, cells.quantiles)


def shrunk(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "_ _ 3"]:
    """A picture :data:`WIDTH_PX` wide, of few colours, so that it packs well."""
    height = round(image.shape[0] * WIDTH_PX / image.shape[1])
    small = Image.fromarray(image).resize((WIDTH_PX, height), Image.Resampling.BOX)
    return np.asarray(small.quantize(32, dither=Image.Dither.NONE).convert("RGB"))


def shrunk_camera(camera: Camera, width_px: int) -> Camera:
    """The camera of the shrunk picture: pixel centres at whole numbers."""
    scale = WIDTH_PX / width_px
    matrix = camera.matrix.copy()
    matrix[:2] *= scale
    matrix[:2, 2] += (scale - 1) / 2
    known: Mapping[str, Any] = {"width_px": WIDTH_PX, "height_px": round(camera.height_px * scale)}
    return replace(camera, matrix=matrix, **known)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
