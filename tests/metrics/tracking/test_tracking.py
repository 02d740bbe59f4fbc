"""Scores of tracks: worked cases, a plain HOTA, and the figures of an independent evaluation of real tracks."""

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from farfield.errors import ConfigError
from farfield.frame.annotation import Annotation
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import pairwise_iou
from farfield.metrics.box_files import read
from farfield.metrics.detections import Detections
from farfield.metrics.tracking.scene import best_pairs
from farfield.tracking import track

Row = tuple[int, float]  # identity, place along x


def cars(rows: list[Row], *, score: float | None = None, label: str = "Car") -> Boxes:
    return Boxes(
        centre_m=np.array([[x, 0.0, 0.0] for _, x in rows]).reshape(-1, 3),
        size_m=np.tile([4.0, 2.0, 1.5], (len(rows), 1)),
        yaw_rad=np.zeros(len(rows)),
        label=[label] * len(rows),
        track_id=np.array([name for name, _ in rows], dtype=np.int64),
        score=None if score is None else np.full(len(rows), score),
    )


def tracks(predicted: list[list[Row]], annotated: list[list[Row]]) -> Detections:
    return Detections(
        boxes={("a", str(number)): cars(rows, score=0.5) for number, rows in enumerate(predicted)},
        annotations={("a", str(number)): Annotation(boxes=cars(rows)) for number, rows in enumerate(annotated)},
    )


def figures(found: Detections, **settings: Any) -> dict[str, float | None]:
    return {name.split("/")[1]: v for name, v in found.score("tracking", label="Car", **settings).figures.items()}


STANDING = [[(1, 10.0)]] * 6


@pytest.mark.parametrize(
    ("names", "switches", "fragments"),
    [
        ([7, 7, 7, 7, 7, 7], 0, 0),
        ([7, 7, 8, 8, 8, 8], 1, 1),
        ([7, 7, None, 7, 7, 7], 0, 1),
        ([7, 7, None, 8, 8, 8], 0, 1),  # over a gap it is no switch
        ([7, 7, 8, None, 7, 7], 1, 1),
        ([None, None, 7, 7, 7, 7], 0, 0),
        ([None, None, None, None, None, 7], 0, 1),  # KITTI's last frame
    ],
)
def test_switches_and_fragments_are_kittis(names: list[int | None], switches: int, fragments: int) -> None:
    found = figures(tracks([[] if name is None else [(name, 10.0)] for name in names], STANDING))
    assert (found["IDS"], found["FRAG"]) == (switches, fragments)
    missed = sum(name is None for name in names)
    assert found["MOTA"] == pytest.approx(1 - (missed + switches) / 6)
    assert found["MOTP"] == pytest.approx(1.0)


def test_an_ignored_frame_resets_and_counts_nowhere() -> None:
    found = tracks([[(7, 10.0)], [(7, 10.0)], [(8, 10.0)]], [[(1, 10.0)]] * 3)
    annotations = {
        key: Annotation(
            boxes=a.boxes, details={"occlusion": np.array([3 * (key[1] == "1")]), "truncation": np.zeros(1)}
        )
        for key, a in found.annotations.items()
    }
    got = figures(Detections(boxes=found.boxes, annotations=annotations))
    assert (got["TP"], got["FP"], got["FN"], got["IDS"]) == (2, 0, 0, 0)


def test_low_boxes_and_dontcare_regions_excuse() -> None:
    found = tracks([[(7, 10.0), (8, 40.0), (9, 60.0), (6, 80.0)]], [[(1, 10.0)]])
    box_px = np.array([[0, 0, 50, 50.0], [100, 0, 150, 25], [200, 0, 250, 50], [300, 0, 350, 50]])
    annotations = {
        key: Annotation(boxes=a.boxes, unboxed={"dontcare_px": np.array([[190.0, 0, 260, 60]])})
        for key, a in found.annotations.items()
    }
    got = Detections(
        boxes=found.boxes, annotations=annotations, prediction_details={("a", "0"): {"box_px": box_px}}
    ).score("tracking", label="Car")
    assert (got.figures["tracking/TP"], got.figures["tracking/FP"]) == (1, 1)
    assert any("without occlusion" in note for note in got.notes)


def test_ranges_cut_no_track_and_add_up() -> None:
    moving = [[(1, 60.0 + 4 * number)] for number in range(6)]
    result = tracks([*moving[:3], *([[(2, x)] for [(_, x)] in moving[3:]])], moving).score("tracking", label="Car")
    near, far = result.ranges["0-70"], result.ranges["70-150"]
    assert (near["tracking/TP"], far["tracking/TP"], far["tracking/IDS"]) == (3, 3, 1)
    assert near["tracking/AssA"] == pytest.approx(0.5)
    assert "tracking/MT" not in near


def test_boxes_without_identity_are_refused() -> None:
    found = tracks([[(7, 10.0)]], [[(1, 10.0)]])
    bare = found.replaced({key: boxes.replace(track_id=None) for key, boxes in found.boxes.items()})
    with pytest.raises(ConfigError, match="farfield track"):
        bare.score("tracking", label="Car")
    with pytest.raises(ConfigError, match="track 7 twice"):
        tracks([[(7, 10.0), (7, 30.0)]], [[(1, 10.0)]]).score("tracking", label="Car")


def plain_hota(found: Detections) -> tuple[float, float, float]:
    """HOTA, DetA, AssA by the paper's sums, pair by pair."""
    overlaps, fits, spans = {}, {}, [{}, {}]  # type: ignore[var-annotated]
    for key, annotation in found.annotations.items():
        iou = pairwise_iou(annotation.boxes, found.boxes[key])
        overlaps[key] = iou
        ids = annotation.boxes.track_id.tolist(), found.boxes[key].track_id.tolist()  # type: ignore[union-attr]
        for names, span in zip(ids, spans, strict=True):
            for name in names:
                span[name] = span.get(name, 0) + 1
        for (i, a), (j, b) in itertools.product(enumerate(ids[0]), enumerate(ids[1])):
            whole = iou[i].sum() + iou[:, j].sum() - iou[i, j]
            fits[a, b] = fits.get((a, b), 0.0) + (iou[i, j] / whole if whole > 0 else 0.0)
    fit = {(a, b): value / (spans[0][a] + spans[1][b] - value) for (a, b), value in fits.items()}
    every, hits = [], []
    for key, iou in overlaps.items():
        ids = found.annotations[key].boxes.track_id.tolist(), found.boxes[key].track_id.tolist()  # type: ignore
        worth = np.array([[fit[a, b] for b in ids[1]] for a in ids[0]]).reshape(iou.shape) * iou
        hits += [(ids[0][i], ids[1][j], iou[i, j]) for i, j in zip(*linear_sum_assignment(-worth), strict=True)]
    for alpha in np.arange(0.05, 0.99, 0.05):
        true = [(a, b) for a, b, s in hits if s >= alpha - 1e-15]
        shares = [true.count(ab) / (spans[0][ab[0]] + spans[1][ab[1]] - true.count(ab)) for ab in true]
        detected = len(true) / (sum(spans[0].values()) + sum(spans[1].values()) - len(true))
        associated = sum(shares) / max(len(true), 1)
        every.append((np.sqrt(detected * associated), detected, associated))
    return tuple(np.mean(every, axis=0))


@pytest.mark.parametrize("seed", range(20))
def test_hota_is_that_of_the_papers_sums(seed: int) -> None:
    rng = np.random.default_rng(seed)
    annotated = [[(n, 10.0 + 5 * n + 0.3 * f) for n in range(5) if rng.random() < 0.8] for f in range(8)]
    predicted = [
        [(int((n + (rng.random() < 0.2)) % 5) + 10 * int(n == 4), x + rng.normal(0, 0.8)) for n, x in rows]
        for rows in annotated
    ]
    predicted = [list({name: (name, x) for name, x in rows}.values()) for rows in predicted]
    found = tracks(predicted, annotated)
    got = figures(found)
    assert [got[name] for name in ("HOTA", "DetA", "AssA")] == pytest.approx(plain_hota(found), abs=1e-9)


def test_pairs_are_the_best_of_all() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        mask = rng.random((5, 5)) < 0.4
        row, column = np.nonzero(mask)
        gain = rng.random(len(row))
        worth = np.zeros((5, 5))
        worth[row, column] = gain
        chosen = best_pairs(row, column, gain, np.zeros(len(row), dtype=np.int64))
        assert gain[chosen].sum() == pytest.approx(worth[linear_sum_assignment(-worth)].sum())
        assert len({*row[chosen]}) == len({*column[chosen]}) == len(chosen)


def expected(root: Path) -> dict[str, Any]:
    return dict(json.loads((root / "kitti_tracking" / "expected_tracking.json").read_text()))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "name"),
    [pytest.param("ab3dmot", "ab3dmot_2022", marks=pytest.mark.whole), ("ab3dmot-paper", "ab3dmot_paper")],
)
def test_real_tracks_score_as_an_independent_evaluation_has_them(shared_real: Path, preset: str, name: str) -> None:
    root = shared_real / "kitti_tracking"
    found = read(root / "detections_pointrcnn_car", root / "label", format="kitti-tracking")
    followed, wanted = track(found, preset), expected(shared_real)[name]
    hota = wanted["trackeval_3d_all_tracks"]
    for iou in (0.25, 0.5, 0.7):
        compare(followed.score("tracking", label="Car", iou=iou).figures, wanted[f"iou_{iou:g}"])
        plainly = followed.score("tracking", label="Car", iou=iou, count_ignored=False).figures
        compare(plainly, wanted[f"iou_{iou:g}_valid_labels_only"])
        assert plainly["tracking/IDF1"] == pytest.approx(hota[f"IDF1_{iou:g}"], abs=1e-9)
    assert {n: plainly[f"tracking/{n}"] for n in hota["HOTA"]} == pytest.approx(hota["HOTA"], abs=1e-9)
    cut = followed.score("tracking", label="Car", least_track_score=wanted["iou_0.25"]["best"]["threshold"]).figures
    best = wanted["trackeval_3d_at_best_mota_0.25"]["HOTA"]
    assert {n: cut[f"tracking/{n}"] for n in best} == pytest.approx(best, abs=1e-4)


def compare(got: Any, wanted: dict[str, Any]) -> None:
    rates = ("sAMOTA", "AMOTA", "AMOTP")
    assert [got[f"tracking/{name}"] for name in rates] == pytest.approx([wanted[name] for name in rates], abs=1e-9)
    for part, prefix in (("best", "tracking"), ("all_tracks", "all_tracks")):
        for name in ("TP", "FP", "FN", "IDS", "FRAG", "MT", "ML", "tracks", "MOTA", "MOTP"):
            assert got[f"{prefix}/{name}"] == pytest.approx(wanted[part][name], abs=1e-9), (part, name)
