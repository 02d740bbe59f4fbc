"""The tracker: its filter and overlaps against plain forms, births and deaths, presets, order of detections."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.spatial import ConvexHull

from farfield.errors import ConfigError
from farfield.frame.annotation import Annotation
from farfield.frame.drive import Drive
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import paired_iou
from farfield.geometry.poses import pose_from_yaw
from farfield.metrics.detections import Detections
from farfield.tracking import PRESETS, TrackerSettings, track, with_options
from farfield.tracking.association import assign_giou, associate, hull_area_m2, iou_3d
from farfield.tracking.tracker import DetectionBatch, TrackEngine


def random_boxes(rng: np.random.Generator, n: int, spread_m: float = 4.0) -> Boxes:
    return Boxes(
        centre_m=rng.uniform(-spread_m, spread_m, (n, 3)) * [1, 1, 0.2],
        size_m=rng.uniform([3, 1.5, 1.4], [5, 2.2, 2.0], (n, 3)),
        yaw_rad=rng.uniform(-np.pi, np.pi, n),
        label="car",
        score=rng.uniform(0, 1, n),
    )


def seen(rows: np.ndarray) -> DetectionBatch:
    n = len(rows)
    whole = np.zeros(n, dtype=np.int64)
    return DetectionBatch(
        drive=whole,
        boxes=rows,
        velocity_m_s=np.zeros((n, 2)),
        ray_m=rows[:, :2],
        score=np.ones(n),
        label=whole,
        source=np.arange(n),
    )


def test_hulls_are_those_of_qhull_whatever_the_points() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(200, 8, 2))
    points[100:, 4:] = points[100:, :4] + np.array([1.0, 0.0])
    wanted = [ConvexHull(each).volume for each in points]
    np.testing.assert_allclose(hull_area_m2(points), wanted, rtol=1e-9)
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    np.testing.assert_allclose(hull_area_m2(np.stack([np.concatenate([square, square])])), [1.0])
    np.testing.assert_allclose(hull_area_m2(np.stack([np.concatenate([square, square + np.array([1.0, 0.0])])])), [2.0])


def test_overlaps_are_the_exact_ones_and_the_general_one_is_below() -> None:
    rng = np.random.default_rng(1)
    a, b = random_boxes(rng, 300), random_boxes(rng, 300)
    np.testing.assert_allclose(iou_3d(a.to_numpy(), b.to_numpy()), paired_iou(a, b), atol=1e-12)
    general = iou_3d(a.to_numpy(), b.to_numpy(), generalised=True)
    assert (general <= paired_iou(a, b) + 1e-12).all()
    assert (general > -1).all()
    np.testing.assert_allclose(iou_3d(a.to_numpy(), a.to_numpy(), generalised=True), 1.0)


def test_the_gate_by_centres_loses_no_pair() -> None:
    rng = np.random.default_rng(4)
    a, b = random_boxes(rng, 120, spread_m=15.0).to_numpy(), random_boxes(rng, 120, spread_m=15.0).to_numpy()
    drive, gate = np.arange(120), np.full(1, -0.5)
    label = np.zeros(120, dtype=np.int64)
    for least in (-0.8, -0.5, -0.2, 0.1):
        settings = TrackerSettings(similarity="giou", gate=least, gate_sigmas=None)
        rows, _ = associate(a, drive, label, b, drive, label, settings, gate * 0 + least)
        np.testing.assert_array_equal(rows, np.flatnonzero(iou_3d(a, b, generalised=True) >= least))


@pytest.mark.parametrize("gate", [-1.0, -0.2, 0.3])
def test_the_assignment_by_bounds_is_that_of_all_pairs(gate: float) -> None:
    rng = np.random.default_rng(8)
    for spread_m, n, m in ((6.0, 7, 12), (30.0, 12, 7), (60.0, 20, 20), (200.0, 5, 9), (30.0, 0, 3)):
        parts = [
            (random_boxes(rng, n, spread_m).to_numpy(), random_boxes(rng, m, spread_m).to_numpy()) for _ in range(20)
        ]
        of_tracks, of_seen = (np.concatenate([part[side] for part in parts]) for side in (0, 1))
        # Half of the detections are the tracks' own, as in a drive, so that most pairs are plain.
        own = slice(0, min(n, m) * 10)
        of_seen[own, :2] = of_tracks[own, :2] + rng.normal(0, 0.3, (min(n, m) * 10, 2))
        drive = np.repeat(np.arange(20), n), np.repeat(np.arange(20), m)
        a, b = assign_giou(of_tracks, drive[0], of_seen, drive[1], 21, np.full(20 * m, gate))
        for place in range(20):
            one, other = of_tracks[drive[0] == place], of_seen[drive[1] == place]
            whole = iou_3d(np.repeat(one, m, axis=0), np.tile(other, (n, 1)), generalised=True).reshape(n, m)
            wanted = linear_sum_assignment(whole, maximize=True)
            kept = whole[wanted] >= gate
            here = drive[0][a] == place
            found = sorted(zip((a[here] - place * n).tolist(), (b[here] - place * m).tolist(), strict=True))
            assert found == list(zip(wanted[0][kept].tolist(), wanted[1][kept].tolist(), strict=True))


def test_many_drives_are_assigned_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(9)
    rows, others = random_boxes(rng, 60, 20.0).to_numpy(), random_boxes(rng, 60, 20.0).to_numpy()
    drive, gate = np.repeat(np.arange(6), 10), np.full(60, -1.0)
    whole = assign_giou(rows, drive, others, drive, 6, gate)
    monkeypatch.setattr("farfield.tracking.association._MOST_CELLS", 200)
    pieces = assign_giou(rows, drive, others, drive, 6, gate)
    assert sorted(zip(*map(np.ndarray.tolist, whole), strict=True)) == sorted(
        zip(*map(np.ndarray.tolist, pieces), strict=True)
    )


def test_the_closed_form_is_the_filter_of_ten_by_ten_matrices() -> None:
    rng = np.random.default_rng(2)
    rows = np.cumsum(rng.normal(0, 0.2, (12, 7)), axis=0) + np.array([20, 0, 0, 4, 2, 1.5, 0])
    engine = TrackEngine(PRESETS["ab3dmot-paper"].changed(gate=1e-9), drives=1, labels=("car",))
    state, p = np.r_[rows[0], np.zeros(3)], np.diag([10.0] * 7 + [1e4] * 3)
    move, q, h = np.eye(10), np.diag([1.0] * 7 + [0.01] * 3), np.eye(7, 10)
    move[:3, 7:] = np.eye(3)
    for number, row in enumerate(rows):
        shown = engine.step(seen(row[None]), np.ones(1), np.ones(1, dtype=bool))
        if number:
            state, p = move @ state, move @ p @ move.T + q
            gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + np.eye(7))
            state, p = state + gain @ (row - h @ state), p - gain @ h @ p
        assert len(shown) == 1
        np.testing.assert_allclose(
            np.r_[shown.position_m[0], shown.size_m[0], shown.yaw_rad[0], shown.velocity[0]], state, atol=1e-9
        )


def line(xs: list[float | None], **changes: object) -> Detections:
    one = [
        Boxes.empty(scored=True)
        if x is None
        else Boxes(
            centre_m=np.array([[x, 0.0, 0.0]]),
            size_m=np.array([[4.0, 2.0, 1.5]]),
            yaw_rad=np.zeros(1),
            label="car",
            score=np.array([0.9]),
        )
        for x in xs
    ]
    return Detections(boxes={("a", str(number)): boxes for number, boxes in enumerate(one)}, annotations={})


def shown_in(found: Detections) -> list[list[int]]:
    return [[] if boxes.track_id is None else boxes.track_id.tolist() for boxes in found.boxes.values()]


def test_births_coasting_and_deaths_of_the_recipe() -> None:
    found = track(line([10, 10, None, None, 10, 10, 10, 10]), "ab3dmot")
    # Reported from the start in the first three frames; one frame of coasting; reborn, and proven at the third match.
    assert shown_in(found) == [[0], [0], [0], [], [], [], [1], [1]]
    assert shown_in(track(line([10, 10, None, None, 10]), "ab3dmot", max_age=3)) == [[0], [0], [0], [], [0]]


def test_missing_numbers_are_frames_without_detections() -> None:
    whole = line([10, 10, None, None, 10])
    sparse = Detections(boxes={key: boxes for key, boxes in whole.boxes.items() if len(boxes)}, annotations={})
    assert shown_in(track(sparse, "ab3dmot")) == shown_in(track(whole, "ab3dmot"))
    marked = Detections(boxes=sparse.boxes, annotations=dict.fromkeys(sparse.boxes, Annotation(boxes=Boxes.empty())))
    assert set(track(marked, "ab3dmot").annotations) == set(whole.boxes)


def test_velocity_follows_the_stamps_and_the_sensors_own_motion() -> None:
    """A standing car seen from a sensor that drives at 10 m/s, at uneven steps."""
    times_ns = np.cumsum([0, 1, 1, 2, 1, 1, 3, 1, 1, 1]) * 100_000_000
    ego_x = 10.0 * times_ns / 1e9
    found = line((60.0 - ego_x).tolist())
    poses = np.stack([pose_from_yaw(0.0) for _ in ego_x])
    poses[:, 0, 3] = ego_x
    keys = tuple(found.boxes)
    for pose, speed in ((poses, 0.0), (None, -10.0)):
        drive = Drive(name="a", indices=np.arange(10), keys=keys, times_ns=times_ns, world_T_frame=pose)
        followed = track(
            Detections(boxes=found.boxes, annotations={}, drives=(drive,)), similarity="distance", gate=6.0
        )
        last = followed.boxes[keys[-1]]
        assert last.track_id.tolist() == [0]  # type: ignore[union-attr]
        assert last.velocity_m_s is not None
        np.testing.assert_allclose(last.velocity_m_s[0, :2], [speed, 0], atol=0.2)
        np.testing.assert_allclose(last.centre_m[0, 0], 60 - ego_x[-1], atol=1e-6)


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_the_order_of_detections_does_not_matter(preset: str) -> None:
    rng = np.random.default_rng(3)
    boxes = {("a", str(n)): random_boxes(rng, 12, spread_m=40.0) for n in range(8)}
    turned = {key: part[rng.permutation(len(part))] for key, part in boxes.items()}
    one, other = (track(Detections(boxes=each, annotations={}), preset) for each in (boxes, turned))
    for key, part in one.boxes.items():
        np.testing.assert_array_equal(part.centre_m, other.boxes[key].centre_m)
        if len(part):
            np.testing.assert_array_equal(part.track_id, other.boxes[key].track_id)
    assert sum(map(len, one.boxes.values())) > 0


def test_a_weak_detection_keeps_a_track_alive_or_moves_it() -> None:
    found = line([10.0, 10.0, 10.0, 10.5, 10.5, 10.5, 10.0])
    weak = {
        key: boxes.replace(score=np.array([0.2])) if key[1] in "345" else boxes for key, boxes in found.boxes.items()
    }
    settings = TrackerSettings(similarity="giou", gate=-0.5, strong_score=0.5, weak_gate=-0.5, max_age=2)
    assert shown_in(track(Detections(boxes=weak, annotations={}), settings)) == [[0]] * 7
    assert shown_in(track(Detections(boxes=weak, annotations={}), settings, weak_gate=None))[3:6] == [[], [], []]


def test_distances_gate_by_class_and_greedy_goes_by_score() -> None:
    found = line([10.0, 13.0, 16.0])
    assert shown_in(track(found, "centerpoint")) == [[0], [0], [0]]
    assert shown_in(track(found, "centerpoint", gates_m={"car": 1.0})) == [[0], [1], [2]]
    # A frame without detections forgets all tracks.
    assert shown_in(track(line([10.0, None, 10.0]), "centerpoint")) == [[0], [], [1]]


def at_scores(scores: list[float], x: float = 10.0) -> Detections:
    found = line([x] * len(scores))
    boxes = found.boxes.items()
    return Detections(
        boxes={key: part.replace(score=np.array([scores[row]])) for row, (key, part) in enumerate(boxes)},
        annotations={},
    )


def test_weak_tracks_wait_for_more_matches_and_are_not_lost() -> None:
    weak = [0.3] * 7
    assert shown_in(track(at_scores(weak))) == [[]] * 4 + [[0]] * 3
    assert shown_in(track(at_scores(weak), unsure_hits=7)) == [[]] * 6 + [[0]]
    assert shown_in(track(at_scores(weak), sure_score=None)) == [[0]] * 7
    # One sure detection is enough for ever; logits of the same probability say the same.
    once = [0.3, 0.95, 0.3, 0.3]
    assert shown_in(track(at_scores(once))) == [[], [0], [0], [0]]
    logits = [float(np.log(p / (1 - p))) for p in once]
    assert shown_in(track(at_scores(logits))) == [[], [0], [0], [0]]


def test_gates_grow_with_time_and_with_uncertainty() -> None:
    found = line([10.0, 10.0, 10.0, 12.5])
    wide = {"gate_sigmas": None, "sure_score": None, "gate": 1.0}
    assert shown_in(track(found, **wide, gate_speed_m_s=0.0))[3] == []
    assert shown_in(track(found, **wide, gate_speed_m_s=0.0, min_hits=1))[3] == [1]
    assert shown_in(track(found, **wide, gate_speed_m_s=16.0))[3] == [0]
    assert shown_in(track(found, **wide, gate_speed_m_s=8.0, step_s=0.2))[3] == [0]
    # Two frames without a match: twice as far.
    coasted = line([10.0, 10.0, 10.0, None, 13.5])
    assert shown_in(track(coasted, **wide, gate_speed_m_s=10.0, min_hits=1))[4] == [1]
    assert shown_in(track(coasted, **wide, gate_speed_m_s=13.0, min_hits=1))[4] == [0]


def test_gates_by_uncertainty_are_wider_far_away() -> None:
    """A jump of 2 m across the ray: impossible at 20 m, nothing at 200 m, where half a degree is 1.7 m."""
    radar = {
        "gate": 50.0,
        "gate_sigmas": 3.0,
        "range_sigma_m": 0.3,
        "azimuth_sigma_rad": np.radians(0.5),
        "min_hits": 1,
    }
    names = []
    for x in (20.0, 200.0):
        found = line([x] * 12)
        last = list(found.boxes)[-1]
        moved = found.boxes[last].replace(centre_m=np.array([[x, 2.0, 0.0]]))
        jumped = Detections(boxes={**found.boxes, last: moved}, annotations={})
        names.append(shown_in(track(jumped, sure_score=None, acceleration=1.0, **radar))[-1])
    assert names == [[1], [0]]


def test_births_and_deaths_are_others_far_away() -> None:
    far = {"far_m": 100.0, "far_min_hits": 4, "far_max_age": 5, "max_age": 2, "warm_up": 0, "sure_score": None}
    for x, wanted in ((50.0, [[], [], [0], [], [], []]), (150.0, [[], [], [], [], [], [0]])):
        assert shown_in(track(line([x, x, x, None, None, x]), **far)) == wanted


def test_tracks_live_for_seconds_where_frames_are_not_evenly_apart() -> None:
    """Two frames without a match: 0.2 s at 10 Hz, 2 s at 1 Hz."""
    seen = line([5.0, 5.0, None, None, 5.0])
    settings = {"warm_up": 0, "min_hits": 1, "sure_score": None, "max_age": 1, "gate_speed_m_s": 0.0}
    for step_s, longest_s, same in ((0.1, 0.3, True), (1.0, 0.3, False), (1.0, 2.5, True), (0.1, 0.2, False)):
        shown = shown_in(track(seen, step_s=step_s, max_age_s=longest_s, **settings))
        assert shown == [[0], [0], [], [], [0 if same else 1]], (step_s, longest_s)
    assert shown_in(track(seen, **settings))[-1] == [1]


def test_options_are_words() -> None:
    settings = with_options(TrackerSettings(), ["max_age_s=1.5", "gates_m={car: 3}", "similarity=giou", "gate=-0.2"])
    assert (settings.max_age_s, settings.gates_m, settings.similarity, settings.gate) == (
        1.5,
        {"car": 3.0},
        "giou",
        -0.2,
    )
    for word, message in (
        ("max_age", "of the form name=value"),
        ("age=3", "expected options among .*max_age_s.*; got age"),
        ("max_age=many", "max_age: .* got 'many'"),
        ("similarity=near", "similarity: "),
        ("min_hits=0", "min_hits: expected 1 or more"),
        ("gates_m=[", "gates_m: expected a value as YAML writes it"),
    ):
        with pytest.raises(ConfigError, match=message):
            with_options(TrackerSettings(), [word])


def test_the_docs_name_every_option() -> None:
    words = (Path(__file__).parents[2] / "docs" / "tracking.md").read_text()
    assert [each.name for each in fields(TrackerSettings) if f"`{each.name}`" not in words] == []


def test_impossible_options_are_refused() -> None:
    with pytest.raises(ConfigError, match="preset: expected one of default"):
        track(line([1.0]), "sort")
    with pytest.raises(ConfigError, match="max_age: expected 1 or more"):
        TrackerSettings().changed(max_age=0)
    for name, value in (("sure_score", 2.0), ("gate_sigmas", 0.0), ("gate_speed_m_s", -1.0), ("unsure_hits", 0)):
        with pytest.raises(ConfigError, match=f"{name}: expected"):
            TrackerSettings().changed(**{name: value})
    with pytest.raises(ConfigError, match="expected options among"):
        track(line([1.0]), far=3)
