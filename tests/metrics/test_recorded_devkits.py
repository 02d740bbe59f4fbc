"""What the tools of nuScenes, Argoverse 2 and KITTI said of files as ``predict --to`` writes them, recorded.

The figures were printed by nuscenes-devkit 1.2.0, av2 0.3.6 and two builds of KITTI's program, and kept by

    python benchmarks/published_protocols.py results --random --samples 6 --frames 20 --record FILE --peer-python ...
"""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyarrow")

import _written_results as written

from farfield.frame import Boxes
from farfield.metrics import Bootstrap, KittiSettings, evaluate_kitti
from farfield.metrics.frames import frames_in_order

RECORDED: dict[str, dict[str, float]] = json.loads(Path(__file__).with_name("recorded_devkits.json").read_text())
SAMPLES, FRAMES = 6, 20


def held(ours: Mapping[str, float], name: str, kind: str) -> None:
    """Every figure that the tool gave is ours to the limit."""
    theirs = RECORDED[name]
    assert len(theirs) >= 30
    apart = {figure: abs(ours[figure] - value) for figure, value in theirs.items()}
    assert {figure: value for figure, value in apart.items() if not value <= written.LIMITS[kind]} == {}


@pytest.mark.parametrize(
    ("digits", "words", "name"),
    [
        (15, (), "nuScenes, random scenes"),
        (2, ("--options", "ties=later_first"), "nuScenes, scores of two digits (ties=later_first)"),
    ],
)
def test_nuscenes_figures_are_the_devkit_s(tmp_path: Path, digits: int, words: tuple[str, ...], name: str) -> None:
    job = written.nuscenes_scene(tmp_path, samples=SAMPLES, digits=digits)
    samples = json.loads(job["results"].read_text())["results"].values()
    assert max(map(len, samples)) == 500 < job["most"], "the devkit takes no more"
    held(written.our_nuscenes(tmp_path, job, *words), name, "nuscenes")


def test_argoverse2_figures_are_those_of_av2(tmp_path: Path) -> None:
    job = written.argoverse2_scene(tmp_path, frames=FRAMES)
    held(written.our_argoverse2(tmp_path, job), "Argoverse 2, random sweeps", "argoverse2")


@pytest.mark.parametrize("points", ["r11", "r40"])
def test_kitti_figures_are_those_of_its_program(tmp_path: Path, points: str) -> None:
    job = written.kitti_scene(tmp_path, frames=FRAMES)
    held(written.our_kitti(tmp_path, job, points), f"KITTI, random objects, {points.upper()}", "kitti")


def test_each_form_reads_back_as_it_was_written(tmp_path: Path) -> None:
    apart = written.read_back(tmp_path)
    assert len(apart) == 8
    for format, worst in apart.items():
        assert worst["score"] <= (1e-7 if format == "waymo" else 0.0), format
        assert max(worst.values()) < 1e-7 if format == "waymo" else max(worst.values()) < 1e-9, format


def test_equal_scores_of_two_frames_stand_as_in_the_file_where_the_devkit_s_order_is_asked_for() -> None:
    none = Boxes.empty()
    annotations = {("s", name): none for name in ("a", "b", "c")}
    predictions = {("s", name): none for name in ("c", "a")}
    assert frames_in_order(predictions, annotations, "nearest_first") == [("s", "a"), ("s", "b"), ("s", "c")]
    assert frames_in_order(predictions, annotations, "later_first") == [("s", "c"), ("s", "a"), ("s", "b")]


def test_a_perfect_detector_of_few_boxes_falls_short_of_100_only_by_kitti_s_own_sampling() -> None:
    boxes = Boxes(
        centre_m=np.array([[10.0, 0, 0], [20, 5, 0]]), size_m=np.full((2, 3), 2.0), yaw_rad=np.zeros(2), label="Car"
    )
    scored = boxes.replace(score=np.array([0.9, 0.8]))
    figures = {}
    for sampling in ("filled", "gaps"):
        settings = KittiSettings(sampling=sampling, bootstrap=Bootstrap(replicates=0))  # type: ignore[arg-type]
        figures[sampling] = evaluate_kitti({("", "0"): scored}, {("", "0"): boxes}, settings).figures
    assert figures["filled"]["ap/3d_r40/all"] == figures["filled"]["ap/3d_r11/all"] == 1.0
    assert figures["gaps"]["ap/3d_r11/all"] == pytest.approx(1 / 11)  # two thresholds: the recalls 0 and 1/40
    assert figures["gaps"]["ap/3d_r40/all"] == pytest.approx(1 / 40)
