"""nuScenes' scores of tracks: worked cases, and the development kit's own figures of a scene."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.frame.annotation import Annotation
from farfield.frame.drive import Drive
from farfield.geometry.boxes import Boxes
from farfield.metrics.detections import Detections

Row = tuple[int, float]

# nuscenes-devkit 1.2.0 with motmetrics 1.4.0, printed by benchmarks/nuscenes_devkit.py tracking for its scenes.
KIT = {
    "AMOTA": 0.555809353173,
    "AMOTP": 0.848624396879,
    "MOTA": 0.57825567503,
    "MOTP": 0.604507055865,
    "MOTAR": 0.724550898204,
    "recall": 0.853046594982,
    "TP": 668,
    "FP": 184,
    "FN": 123,
    "IDS": 46,
    "FRAG": 21,
    "MT": 24,
    "ML": 0,
    "FAF": 157.264957265,
    "TID": 0.597222222222,
    "LGD": 1.45833333333,
}
KIT_ON_KITTI = {
    "AMOTA": 0.849277207055,
    "AMOTP": 0.380497248967,
    "MOTA": 0.790633608815,
    "MOTP": 0.219095271803,
    "recall": 0.911845730028,
    "TP": 331,
    "FP": 44,
    "FN": 32,
    "IDS": 0,
}


def cars(rows: list[Row], score: float | None = None) -> Boxes:
    return Boxes(
        centre_m=np.array([[x, 0.0, 0.0] for _, x in rows]).reshape(-1, 3),
        size_m=np.tile([4.0, 2.0, 1.5], (len(rows), 1)),
        yaw_rad=np.zeros(len(rows)),
        label=["car"] * len(rows),
        track_id=np.array([name for name, _ in rows], dtype=np.int64),
        score=None if score is None else np.full(len(rows), score),
    )


def found(predicted: list[list[Row]], annotated: list[list[Row]]) -> Detections:
    return Detections(
        boxes={("a", str(n)): cars(rows, 0.5) for n, rows in enumerate(predicted)},
        annotations={("a", str(n)): Annotation(boxes=cars(rows)) for n, rows in enumerate(annotated)},
    )


def figures(of: Detections, **settings: Any) -> dict[str, float | None]:
    result = of.score("nuscenes-tracking", label="car", **settings)
    return {name.split("/")[1]: value for name, value in result.figures.items()}


STANDING = [[(1, 10.0)]] * 6


@pytest.mark.parametrize(
    ("names", "switches", "fragments", "gap_s", "first_s"),
    [
        ([7, 7, 7, 7, 7, 7], 0, 0, 0.0, 0.0),
        ([7, 7, 8, 8, 8, 8], 1, 0, 0.0, 0.0),
        ([7, None, None, 8, 8, 8], 1, 1, 1.0, 0.0),  # over a gap it is one, too
        ([None, 7, 7, 7, 7, None], 0, 0, 0.5, 0.5),
        ([7, 7, 8, None, 7, 7], 1, 0, 0.0, 0.0),  # track 7 is filled, and goes on at its place beside 8
    ],
)
def test_worked_cases(names: list[int | None], switches: int, fragments: int, gap_s: float, first_s: float) -> None:
    rows: list[list[Row]] = [[] if name is None else [(name, 10.0)] for name in names]
    got = figures(found(rows, STANDING))
    if names == [7, 7, 8, None, 7, 7]:
        assert (got["IDS"], got["FP"], got["FN"]) == (0, 1, 0)
        return
    assert (got["IDS"], got["FRAG"], got["LGD"], got["TID"]) == (switches, fragments, gap_s, first_s)
    missed = sum(name is None for name in names)
    assert got["MOTA"] == pytest.approx(1 - (missed + switches) / 6)
    assert got["MOTP"] == pytest.approx(0.0)


def test_what_is_not_found_is_worst() -> None:
    got = figures(found([[(7, 40.0)]] * 6, STANDING))
    assert (got["AMOTA"], got["AMOTP"], got["MOTA"], got["FN"], got["ML"], got["threshold"]) == (0, 2.0, 0, 6, 1, None)
    nothing = figures(found([[]] * 6, [[]] * 6))
    assert nothing["AMOTA"] is None


def test_ranges_points_and_tracks_without_identity() -> None:
    moving = [[(1, 60.0 + 4 * n)] for n in range(6)]
    result = found(moving, moving).score("nuscenes-tracking", label="car", range_bins_m=(0, 70, 150))
    assert (result.ranges["0-70"]["tracking/TP"], result.ranges["70-150"]["tracking/TP"]) == (3, 3)
    assert "AMOTA" in str(result)
    near = figures(found(moving, moving), most_range_m=70.0)
    assert near["TP"] == 3
    bare = found(moving, moving)
    bare = bare.replaced({key: boxes.replace(track_id=None) for key, boxes in bare.boxes.items()})
    with pytest.raises(ConfigError, match="farfield track"):
        figures(bare)
    with pytest.raises(ConfigError, match="distance_m"):
        figures(found(moving, moving), distance_m=0.0)


def test_tracks_are_filled_in_the_world_by_time() -> None:
    standing = found([[(7, 10.0)], [], [(7, 6.0)]], [[(1, 10.0)], [(1, 8.0)], [(1, 6.0)]])
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = [0, 2, 4]
    keys = tuple(("a", str(n)) for n in range(3))
    drive = Drive(name="a", indices=np.arange(3), keys=keys, times_ns=np.array([0, 5, 10]), world_T_frame=poses)
    with_poses = Detections(boxes=standing.boxes, annotations=standing.annotations, drives=(drive,))
    assert figures(with_poses)["MOTP"] == pytest.approx(0.0)
    assert figures(with_poses)["TP"] == 3


@pytest.fixture
def bench(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    monkeypatch.syspath_prepend(str(request.config.rootpath / "benchmarks"))
    import nuscenes_devkit

    yield nuscenes_devkit
    sys.modules.pop("nuscenes_devkit")


def test_figures_are_the_development_kits(bench: Any) -> None:
    got = figures(bench.tracking_random_scene())
    assert {name: got[name] for name in KIT} == pytest.approx(KIT, abs=1e-9)


@pytest.mark.slow
def test_figures_of_real_tracks_are_the_development_kits(bench: Any, shared_real: Path) -> None:
    assert (shared_real / "kitti_tracking").is_dir()
    result = bench.kitti_scene().score("nuscenes-tracking", label="Car").figures
    assert {name: result[f"tracking/{name}"] for name in KIT_ON_KITTI} == pytest.approx(KIT_ON_KITTI, abs=1e-9)
