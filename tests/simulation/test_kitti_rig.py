"""The KITTI rig: beams against real sweeps, full boxes, annotated in the camera's field alone."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("embreex")

from farfield.errors import ConfigError
from farfield.frame import Frame
from farfield.simulation import find_preset, simulate_frame
from farfield.simulation.lidar.model import HDL_64E, HDL_64E_BEAMS, detection_probability, signal
from farfield.simulation.rigs.drive import drive_of
from farfield.simulation.rigs.kitti import KittiFrame

FIELD_PX = (1242, 375)


@pytest.fixture(scope="module")
def moments() -> list[KittiFrame]:
    preset = find_preset("kitti-sim-mini")
    return [KittiFrame(drive_of(preset, 0, sequence), index) for sequence, index in ((0, 1), (1, 1))]


@pytest.fixture(scope="module")
def frame() -> Frame:
    return simulate_frame("kitti-sim-mini", sequence=1, index=1)


def test_64_beams_from_2_degrees_up_to_24_9_down_the_upper_half_denser() -> None:
    elevation_deg = np.array(HDL_64E_BEAMS.elevation_deg)
    assert elevation_deg.shape == (64,)
    assert (elevation_deg[0], elevation_deg[-1]) == (2.0, -24.9)
    steps = -np.diff(elevation_deg)
    assert (steps > 0).all()
    assert steps[:31].max() < steps[31:].min()


def test_the_beams_are_those_of_real_sweeps(shared_real: Path) -> None:
    """Rings stand one after the other in KITTI's files; heights over distances along a ring give its elevation."""
    path = shared_real / "kitti" / "training" / "velodyne" / "000000.bin"
    points = np.fromfile(path, np.float32).reshape(-1, 4).astype(np.float64)
    azimuth = np.mod(np.arctan2(points[:, 1], points[:, 0]), 2 * np.pi)
    rings = np.split(points, np.flatnonzero(np.diff(azimuth) < -np.pi) + 1)
    assert len(rings) == 64
    slopes = [np.polyfit(np.hypot(ring[:, 0], ring[:, 1]), ring[:, 2], 1)[0] for ring in rings]
    apart_deg = np.degrees(np.arctan(slopes)) - np.array(HDL_64E_BEAMS.elevation_deg)
    assert np.abs(apart_deg).max() < 0.3
    assert apart_deg.std() < 0.15
    assert 79 < np.linalg.norm(points[:, :3], axis=1).max() + 1 < HDL_64E.max_range_m + 1


def test_every_point_lies_on_its_beam(frame: Frame) -> None:
    cloud = frame.clouds["lidar"]
    points = cloud.points_m.astype(np.float64)
    elevation_deg = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    expected = np.array(HDL_64E_BEAMS.elevation_deg)[cloud.extra["ring"]]
    np.testing.assert_allclose(elevation_deg, expected, atol=1e-3)
    assert np.linalg.norm(points, axis=1).max() < HDL_64E.max_range_m + 0.3
    assert np.ptp(np.arctan2(points[:, 1], points[:, 0])) > 6.2  # all around
    assert np.ptp(cloud.extra["time_ns"]) > 0.099e9  # 10 Hz
    assert -1.9 < np.median(points[cloud.extra["ring"] > 50, 2]) < -1.6  # the road is 1.73 m below


def test_a_tenth_reflecting_target_is_seen_at_the_data_sheets_50_m() -> None:
    strength, _ = signal(HDL_64E, np.array([50.0, 75.0]), np.ones(2), np.full(2, 0.1), np.zeros(2, dtype=np.int64))
    near, far = detection_probability(HDL_64E, strength)
    assert near > 0.8
    assert far < 0.2


def test_whole_bodies_are_annotated(moments: list[KittiFrame]) -> None:
    for moment in moments:
        boxes = moment.annotation.boxes
        bodies = {actor.track_id: actor.size_m for actor in moment.window.actors}
        assert len(boxes) > 3
        assert boxes.track_id is not None
        np.testing.assert_array_equal(boxes.size_m, [bodies[int(number)] for number in boxes.track_id])
        np.testing.assert_allclose(boxes.centre_m[:, 2] - boxes.size_m[:, 2] / 2, -1.73, atol=2.0)


def test_only_what_the_camera_sees_is_annotated_and_all_of_it(moments: list[KittiFrame]) -> None:
    for moment in moments:
        annotated = {int(number) for number in moment.annotation.boxes.track_id}  # type: ignore[union-attr]
        owner = moment.sweep.actor
        hits = np.bincount(owner[owner >= 0], minlength=len(moment.window.actors))
        points = moment.sweep.cloud.points_m.astype(np.float64)
        in_image = moment.camera.project(points)[2]
        for row, actor in enumerate(moment.window.actors):
            mine = points[owner == row]
            if actor.track_id in annotated:
                assert hits[row] >= 5
                assert mine[:, 0].max() > 0
            elif hits[row] >= 5 and in_image[owner == row].all():
                pytest.fail(f"{actor.label} in full view is not annotated")
        behind = points[owner >= 0][:, 0] < -5
        assert behind.any()  # the LiDAR sees more than is annotated


def test_boxes_in_the_image_and_what_is_known_of_them(frame: Frame) -> None:
    annotation = frame.annotation
    assert annotation is not None
    assert annotation.extent == "full"
    assert annotation.region is not None
    camera = annotation.region.camera
    assert (camera.width_px, camera.height_px) == FIELD_PX
    box_px, truncation = annotation.details["box_px"], annotation.details["truncation"]
    assert ((box_px >= 0) & (box_px <= [1241, 374, 1241, 374])).all()
    whole = truncation == 0
    assert whole.any()
    assert annotation.region.contains(annotation.boxes.centre_m[whole]).all()
    assert set(annotation.details["occlusion"].tolist()) <= {0, 1, 2}


def test_occlusion_is_the_share_of_shots_that_others_stop(moments: list[KittiFrame]) -> None:
    levels = []
    for moment in moments:
        aimed = moment.sweep.aimed
        assert aimed is not None
        rows = np.flatnonzero(aimed >= 5)
        alone = np.array([moment._shots_alone(int(row)) for row in rows])
        assert (aimed[rows] <= 1.3 * alone + 3).all()  # glass passes more shots where nothing stands behind
        level = moment._occlusion(rows)
        share = aimed[rows] / alone
        assert share[level == 0].min() >= share[level > 0].max(initial=0)
        levels += level.tolist()
    assert 0 in levels
    assert {1, 2} & set(levels)


def test_the_camera_is_known_without_an_image_and_frames_keep_their_numbers(frame: Frame) -> None:
    assert frame.key == ("0001", "001001")
    assert not frame.images
    np.testing.assert_allclose(frame.cameras["camera"].matrix[:2, 2], (609.5593, 172.854))
    with pytest.raises(ConfigError, match="six digits"):
        simulate_frame("kitti-sim-mini", sequence=1000, index=0)
