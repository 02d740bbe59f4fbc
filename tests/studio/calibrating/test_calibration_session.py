"""What a calibration page may ask of the server: what is kept, told to other windows, undone, saved, and refused."""

import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("starlette")
pytest.importorskip("cv2")
from studio.live import Client, Live, studio
from studio.posts import CAMERA, PLANTED, write_kitti

from farfield.calibration.camera_edges import camera_difference
from farfield.datasets import open_dataset
from farfield.datasets.calibration import read_calibration
from farfield.errors import ConfigError
from farfield.frame import Camera
from farfield.studio.calibrating.service import CalibrationService
from farfield.studio.calibrating.task import camera_of, camera_values
from farfield.studio.messages.requests import read_request
from farfield.studio.options import CalibrationSettings

RADAR = {"x_m": -2.5, "y_m": 0.3, "z_m": 0.7, "yaw_rad": 0.0, "frames": 0, "time_offset_s": 0.0}
LENS = {"fx": 707.0, "fy": 707.0, "cx": 604.0, "cy": 180.5, "distortion": [0.0] * 5, "moved": [0.0] * 6}


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_kitti(tmp_path / "set", count=1)


@pytest.fixture
def live(root: Path, tmp_path: Path):
    settings = CalibrationSettings(kind="lidar-camera", frames=1, folder=tmp_path / "out")
    with studio(partial(open_dataset, root), mode="calibrate", calibration=settings) as running:
        yield running


def entered(client: Client) -> dict:
    """The state once the frames are read."""
    client.send(op="calib.open", id="open")
    return client.until("calib.state", wanted=lambda message: message["ready"])


def put(client: Client, state: dict, **change: object) -> dict:
    client.send(op="calib.set", id=client.new_id(), base=state["seq"], camera={**state["camera"], **change})
    return client.until("calib.state", "refused")


@pytest.mark.parametrize(
    ("message", "part"),
    [
        ({"op": "calib.set", "id": "a", "base": 0, "radar": {**RADAR, "x_m": 1001.0}}, "x_m"),
        ({"op": "calib.set", "id": "a", "base": 0, "radar": {**RADAR, "x_m": float("nan")}}, "x_m"),
        ({"op": "calib.set", "id": "a", "base": 0, "radar": {**RADAR, "frames": 21}}, "frames"),
        ({"op": "calib.set", "id": "a", "base": 0, "radar": {**RADAR, "frames": 0.5}}, "frames"),
        ({"op": "calib.set", "id": "a", "base": 0, "radar": {**RADAR, "time_offset_s": 1.5}}, "time_offset_s"),
        ({"op": "calib.set", "id": "a", "base": 0, "radar": {**RADAR, "roll": 0.0}}, "roll"),
        ({"op": "calib.set", "id": "a", "base": -1, "radar": RADAR}, "base"),
        ({"op": "calib.set", "id": "a", "base": 0, "camera": {**LENS, "fx": 0.0}}, "fx"),
        ({"op": "calib.set", "id": "a", "base": 0, "camera": {**LENS, "distortion": [0.0] * 4}}, "distortion"),
        ({"op": "calib.set", "id": "a", "base": 0, "camera": {**LENS, "moved": [11.0] + [0.0] * 5}}, "moved"),
        ({"op": "calib.pick", "id": "a", "frame": 0, "point_m": [1.0, 2.0], "pixel": [1.0, 2.0]}, "point_m"),
        ({"op": "calib.pick", "id": "a", "frame": 0, "point_m": [1.0, 2.0, 1e4], "pixel": [1.0, 2.0]}, "point_m"),
        ({"op": "calib.pick", "id": "a", "frame": 0, "point_m": [1.0, 2.0, 1.0], "pixel": [1e6, 2.0]}, "pixel"),
        ({"op": "calib.solve", "id": "a", "how": "magic"}, "how"),
        ({"op": "calib.save", "id": "a", "to": "/etc/passwd"}, "to"),
        ({"op": "calib.undo", "id": "a", "what": "all"}, "what"),
        ({"op": "calib.cancel", "id": "a", "job": "../x"}, "job"),
    ],
)
def test_messages_out_of_bounds_are_refused_by_the_name_of_their_field(message: dict, part: str):
    with pytest.raises(ConfigError, match=part):
        read_request(json.dumps(message))


def test_values_go_there_and_back():
    moved = camera_of(camera_values(CAMERA, CAMERA), CAMERA)
    np.testing.assert_allclose(moved.camera_T_lidar, CAMERA.camera_T_lidar, atol=1e-12)
    values = camera_values(CAMERA, camera_of(camera_values(CAMERA, CAMERA), CAMERA))
    assert np.abs(values.moved).max() < 1e-9


def test_a_studio_that_only_shows_does_not_calibrate():
    with studio() as running, running.window() as client:
        client.send(op="calib.open", id="a")
        refused = client.until("refused")
        assert refused["code"] == "view"
        assert "farfield calibrate radar-lidar DATA --page" in refused["mend"]
        assert b"studio.js" in running.get("/")[2]


def test_the_page_of_calibration_is_served(live: Live):
    status, headers, body = live.get("/")
    assert status == 200
    assert b"calibrate.js" in body
    assert "script-src 'self'" in headers["content-security-policy"]
    assert live.get("/calibrate.js")[0] == 200


def test_changes_are_told_to_all_windows_and_undone(live: Live):
    with live.window() as one, live.window() as two:
        first = entered(one)
        entered(two)
        assert first["kind"] == "lidar-camera"
        assert first["saves_to"] == ["training/calib/000000.txt"]
        after = put(one, first, moved=[0.01, 0.0, 0.0, 0.0, 0.0, 0.0])
        assert (after["undo"], after["unsaved"]) == (True, True)
        assert two.until("calib.state", wanted=lambda m: m["seq"] == after["seq"])["camera"]["moved"][0] == 0.01
        refused = put(two, first, moved=[0.02, 0.0, 0.0, 0.0, 0.0, 0.0])  # from a state that is no more
        assert refused["code"] == "conflict"
        two.send(op="calib.undo", id="u", what="undo")
        assert two.until("calib.state")["camera"] == first["camera"]
        two.send(op="calib.undo", id="v", what="undo")
        assert "nothing to undo" in two.until("refused")["sentence"]
        two.send(op="calib.undo", id="u", what="redo")
        assert two.until("calib.state")["camera"] == after["camera"]


def test_a_message_that_comes_again_after_a_lost_connection_changes_nothing_twice(live: Live):
    with live.window() as client:
        first = entered(client)
        moved = {**first["camera"], "moved": [0.01, 0.0, 0.0, 0.0, 0.0, 0.0]}
        message = {"op": "calib.set", "id": "s-1", "base": first["seq"], "camera": moved}
        client.send(**message)
        after = client.until("calib.state", "refused")
    with live.window() as client:  # the page comes back, and has no answer
        entered(client)
        client.send(**message)
        again = client.until("calib.state", "refused")
        assert (again["op"], again["answers"], again["seq"]) == ("calib.state", "s-1", after["seq"])
        for _ in range(2):
            client.send(op="calib.undo", id="u-1", what="undo")
            state = client.until("calib.state", "refused")
        assert state["camera"] == first["camera"]
        client.send(op="calib.undo", id="u-2", what="redo")
        assert client.until("calib.state", "refused")["camera"]["moved"][0] == 0.01
        with live.window() as other:  # both recover, and send the pairs of a page that was lost
            for name in ("p-1", "p-2"):
                other.send(op="calib.pick", id=name, frame=0, point_m=[9.0, 1.0, 0.5], pixel=[400.0, 200.0])
                state = other.until("calib.state", "refused", wanted=lambda state, name=name: state["answers"] == name)
                assert len(state["picks"]) == 1


def test_messages_that_were_taken_are_remembered_up_to_a_thousand(root: Path, tmp_path: Path):
    settings = CalibrationSettings(kind="lidar-camera", frames=1, folder=tmp_path / "out")
    service = CalibrationService(open_dataset(root), settings)
    for number in range(1001):
        service.note_taken(f"message {number}")
    assert [service.was_taken(f"message {number}") for number in (0, 1, 1000)] == [False, True, True]


def test_residuals_are_told_of_values_that_are_not_kept(live: Live):
    with live.window() as client:
        client.send(op="calib.match", id="m", frame=0, camera=LENS)
        assert client.until("refused")["code"] in ("reading", "view")
        state = entered(client)
        client.send(op="calib.match", id="m1", frame=0, camera={**LENS, "moved": (-PLANTED).tolist()})
        there = client.until("calib.residual")
        client.send(op="calib.match", id="m2", frame=0, camera=state["camera"])
        here = client.until("calib.residual")
        strength = [each["residuals"]["figures"][2]["value"] for each in (there, here)]
        assert strength[0] > strength[1]
        assert sum(there["residuals"]["histogram"]["counts"]) == there["residuals"]["figures"][0]["value"]
        client.send(op="calib.match", id="m3", frame=0, radar=RADAR)
        assert client.until("refused")["code"] == "kind"
        client.send(op="calib.match", id="m4", frame=7, camera=LENS)
        assert "expected a number from 0 to 0" in client.until("refused")["sentence"]
        client.send(op="calib.undo", id="u", what="undo")
        assert client.until("refused")["code"] == "undo"  # nothing was kept


def picked(client: Client, root: Path, count: int) -> dict:
    """Pick true pairs."""
    points = open_dataset(root)[0].cloud().points_m.astype(float)
    pixels, depth, seen = CAMERA.project(points)
    rows = np.flatnonzero(seen & (depth < 45) & (points[:, 2] > -1.3))
    order = rows[np.argsort(pixels[rows, 0])]
    state: dict = {}
    for i in order[np.linspace(0, len(order) - 1, count).astype(int)]:
        client.send(op="calib.pick", id="p", frame=0, point_m=points[i].tolist(), pixel=pixels[i].tolist())
        state = client.until("calib.state")
    return state


def test_picks_are_solved_saved_read_back_and_put_back(live: Live, root: Path, tmp_path: Path):
    with live.window() as client:
        entered(client)
        client.send(op="calib.solve", id="s", how="pairs")
        failed = client.until("job", wanted=lambda job: job["state"] == "failed")
        assert "expected 6 points" in failed["message"]
        state = picked(client, root, 10)
        assert min(pick["residual_px"] for pick in state["picks"]) > 2
        client.send(op="calib.unpick", id="p", pick=3, used=False)
        assert not client.until("calib.state")["picks"][2]["used"]
        client.send(op="calib.unpick", id="p", pick=3)
        assert len(client.until("calib.state")["picks"]) == 9
        client.send(op="calib.unpick", id="p", pick=99)
        assert "no pair 99" in client.until("refused")["sentence"]
        client.send(op="calib.pick", id="p", frame=5, point_m=[5.0, 0.0, 0.0], pixel=[1.0, 1.0])
        assert client.until("refused")["code"] == "frame"
        client.send(op="calib.solve", id="s-2", how="pairs")
        solved = client.until("calib.state", wanted=lambda state: state["solved"] != "")
        assert max(pick["residual_px"] for pick in solved["picks"]) < 0.5
        path = root / "training" / "calib" / "000000.txt"
        old = path.read_bytes()
        client.send(op="calib.save", id="w", to="data")
        saved = client.until("calib.saved")
        assert saved["files"] == ["training/calib/000000.txt"]
        assert len(saved["copies"]) == 1
        assert not client.until("calib.state")["unsaved"]
        error = camera_difference(open_dataset(root)[0].cameras["camera"], CAMERA)
        assert np.abs(error).max() < 1e-3
        client.send(op="calib.restore", id="r")
        assert client.until("calib.saved")["restored"]
        assert path.read_bytes() == old
        client.send(op="calib.restore", id="r-2")
        assert client.until("refused")["code"] == "restore"
        put(client, solved | {"seq": _seq(client)}, fx=720.0)
        client.send(op="calib.save", id="w-2", to="data")
        assert "the pose alone" in client.until("refused")["sentence"]
        client.send(op="calib.save", id="w", to="folder")
        client.until("calib.saved")
        assert read_calibration(tmp_path / "out" / "calibration.json")["camera"].matrix[0, 0] == 720.0


def _seq(client: Client) -> int:
    client.send(op="calib.open", id="o")
    return client.until("calib.state")["seq"]


def endless(before: Camera, views: object, *, progress: Callable[[float], None]) -> None:
    """An alignment that ends only where it is stopped: the true one may be over before that is asked for."""
    del before, views
    until = time.monotonic() + 30
    while time.monotonic() < until:
        progress(0.5)
        time.sleep(0.01)


def test_a_job_is_stopped_and_changes_nothing(live: Live, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("farfield.studio.calibrating.camera_task.align_edges", endless)
    with live.window() as client:
        before = entered(client)
        client.send(op="calib.solve", id="s", how="edges")
        job = client.until("job")
        client.send(op="calib.solve", id="s2", how="edges")
        assert client.until("refused")["code"] == "busy"
        client.send(op="calib.cancel", id="c", job="calib-0")
        assert client.until("refused")["code"] == "job"
        client.send(op="calib.cancel", id="c", job=job["job"])
        over = client.until("job", wanted=lambda job: job["state"] in ("cancelled", "done", "failed"))
        assert over["state"] == "cancelled"
        client.send(op="calib.open", id="o")
        assert client.until("calib.state")["camera"] == before["camera"]
        client.send(op="calib.solve", id="s", how="objects")
        assert "by pairs or edges" in client.until("job", wanted=lambda job: job["state"] == "failed")["message"]


def test_a_data_set_without_the_sensors_is_refused(root: Path):
    with pytest.raises(ConfigError, match="expected a K-Radar"):
        CalibrationService(open_dataset(root), CalibrationSettings(kind="radar-lidar", frames=1))
    with pytest.raises(ConfigError, match="expected one of camera; got nose"):
        CalibrationService(open_dataset(root), CalibrationSettings(kind="lidar-camera", frames=1, camera="nose"))
