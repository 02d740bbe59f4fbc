"""Rendered pictures of a board, whose camera is known, give that camera back."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from _board_rendering import board_poses, render_board

from farfield import cli
from farfield.calibration.boards import Board, Sighting, board_picture, calibrate_board, find_board
from farfield.datasets.calibration import read_calibration
from farfield.errors import ConfigError
from farfield.files.images import read_image, write_image
from farfield.geometry.cameras import Camera

TRUTH = Camera(
    matrix=np.array([[285.0, 0, 314], [0, 288, 184], [0, 0, 1]]),
    distortion=np.array([-0.12, 0.02, 0.002, -0.002, 0.0]),
    width_px=640,
    height_px=360,
)


def sightings(board: Board, count: int, seed: int, truth: Camera = TRUTH) -> list[Sighting]:
    """Corners as they project, with a tenth of a pixel of noise, without pictures."""
    rng, found = np.random.default_rng(seed), []
    for number, place in enumerate(board_poses(truth, board, count, rng)):
        pixels = replace(truth, camera_T_lidar=place).project(board.corners_m)[0]
        noisy = pixels + rng.normal(0, 0.1, pixels.shape)
        corner = np.arange(len(pixels))
        found.append(Sighting(name=str(number), corner=corner, pixels=noisy, size_px=(truth.width_px, truth.height_px)))
    return found


@pytest.mark.parametrize("markers", [False, True])
def test_corners_are_found_within_a_fifth_of_a_pixel(markers: bool) -> None:
    pytest.importorskip("cv2")
    board, rng = Board(markers=markers), np.random.default_rng(4)
    camera = replace(TRUTH, matrix=np.diag([1.5, 1.5, 1.0]) @ TRUTH.matrix, width_px=960, height_px=540)
    place = board_poses(camera, board, 1, rng)[0]
    found = find_board(render_board(camera, place, board, rng=rng), board, "one")
    assert found is not None
    truth = replace(camera, camera_T_lidar=place).project(board.corners_m)[0]
    away = np.linalg.norm(found.pixels - truth[found.corner], axis=1)
    if not markers and away.max() > 5:  # a plain board looks the same turned by half a turn
        away = np.linalg.norm(found.pixels[::-1] - truth[found.corner], axis=1)
    assert np.sqrt((away**2).mean()) < 0.2
    assert find_board(np.full((360, 640, 3), 128, np.uint8), board) is None


def test_the_camera_is_given_back() -> None:
    pytest.importorskip("cv2")
    found = calibrate_board(sightings(Board(), 10, 1), Board())
    focal = np.diag(found.camera.matrix)[:2] / np.diag(TRUTH.matrix)[:2] - 1
    assert np.abs(focal).max() < 0.003
    assert (np.abs(focal * np.diag(TRUTH.matrix)[:2]) < 4 * found.sigma[:2]).all()
    np.testing.assert_allclose(found.camera.matrix[:2, 2], TRUTH.matrix[:2, 2], atol=0.6)
    assert found.camera.distortion[4] == 0  # nothing asks for k3
    assert found.covered > 0.9
    assert found.notes == ()


def test_k3_is_freed_where_the_corners_ask_for_it() -> None:
    pytest.importorskip("cv2")
    matrix = np.array([[420.0, 0, 318], [0, 420, 184], [0, 0, 1]])
    bent = replace(TRUTH, matrix=matrix, distortion=np.array([-0.2, 0.08, 0.0, 0.0, -0.03]))
    found = calibrate_board(sightings(Board(), 9, 2, bent), Board())
    assert found.camera.distortion[4] == pytest.approx(-0.03, abs=0.01)


def test_a_picture_with_wrong_corners_is_left_out() -> None:
    pytest.importorskip("cv2")
    seen = sightings(Board(), 9, 3)
    wrong = replace(seen[4], pixels=seen[4].pixels + np.random.default_rng(0).normal(0, 4, seen[4].pixels.shape))
    found = calibrate_board([*seen[:4], wrong, *seen[5:]], Board())
    assert list(found.left_out) == ["4"]
    assert np.abs(np.diag(found.camera.matrix)[:2] / np.diag(TRUTH.matrix)[:2] - 1).max() < 0.003


def test_boards_in_the_middle_do_not_tell_the_rest() -> None:
    pytest.importorskip("cv2")
    seen = sightings(Board(), 6, 5)
    middle = [replace(each, pixels=(each.pixels - [320, 180]) * 0.3 + [320, 180]) for each in seen]
    assert any("distortion is a guess" in note for note in calibrate_board(middle, Board()).notes)


def test_too_few_pictures_and_two_sizes_are_refused() -> None:
    pytest.importorskip("cv2")
    seen = sightings(Board(), 6, 1)
    with pytest.raises(ConfigError, match="5 or more pictures"):
        calibrate_board(seen[:4], Board())
    with pytest.raises(ConfigError, match="of one size"):
        calibrate_board([*seen, replace(seen[0], size_px=(10, 10))], Board())
    with pytest.raises(ConfigError, match="two or more inner corners"):
        Board(columns=1)


def test_the_verb_calibrates_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("cv2")
    board, rng = Board(columns=6, rows=4), np.random.default_rng(1)
    (tmp_path / "pictures").mkdir()
    for number, place in enumerate(board_poses(TRUTH, board, 9, rng)):
        write_image(tmp_path / "pictures" / f"{number}.png", render_board(TRUTH, place, board, rng=rng))
    write_image(tmp_path / "pictures" / "empty.png", np.full((360, 640, 3), 90, np.uint8))
    words = ["board", str(tmp_path / "pictures"), "--corners", "6", "4", "--out", str(tmp_path / "out")]
    assert cli.main(["calibrate", *words, "--save", str(tmp_path / "intrinsics.json"), "--camera", "front"]) == 0
    found = read_calibration(tmp_path / "intrinsics.json")["front"]
    assert np.abs(np.diag(found.matrix)[:2] / np.diag(TRUTH.matrix)[:2] - 1).max() < 0.003
    assert "empty.png" in (tmp_path / "out" / "calibration.json").read_text()
    assert cli.main(["calibrate", *words, "--draw", str(tmp_path / "board.png"), "--charuco"]) == 0
    assert "30 mm wide" in capsys.readouterr().out
    drawn = read_image(tmp_path / "board.png")[:, :, 0]
    np.testing.assert_array_equal(drawn, board_picture(Board(columns=6, rows=4, markers=True)))
    assert cli.main(["calibrate", "board", str(tmp_path / "out")]) == 1
    assert "found none" in capsys.readouterr().err
