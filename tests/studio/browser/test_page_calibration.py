"""Both calibration pages as a person uses them: what was planted is corrected, saved, and read back by the readers."""

import json
import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("starlette")
pytest.importorskip("cv2")
from _studio_screen import Screen, screen
from studio.browser.layout import SIZES, axe_faults, layout_faults
from studio.live import studio
from studio.posts import CAMERA, PLANTED, RADAR, plant_radar, write_kitti, write_kradar

from farfield.calibration.camera_edges import camera_difference
from farfield.datasets import open_dataset
from farfield.datasets.kradar.radar_pose import SIDE_FILE
from farfield.geometry.poses import invert
from farfield.studio.options import CalibrationSettings

pytestmark = pytest.mark.slow

AWAY_X_M, AWAY_Y_M = 0.8, -0.6


def until(page: Screen, condition: str, *, seconds: float = 20.0) -> None:
    """Wait until something of the page is true, and is drawn: what the model says stands there a frame later."""
    page.until(f"is(({{ model, values, picking }}) => {condition})", seconds=seconds)
    page.page.evaluate("() => new Promise(drawn => requestAnimationFrame(() => requestAnimationFrame(drawn)))")


def off_cm(page: Screen) -> float:
    """The median residual in range that the page shows."""
    return float(page.text('[data-figure="range cm"] b'))


def number(page: Screen, name: str) -> float:
    return float(page.page.locator(f"input[name='{name}']").input_value())


def put(page: Screen, name: str, value: float) -> None:
    """Type a number, and Enter."""
    field = page.page.locator(f"input[name='{name}']")
    field.fill(str(value))
    field.press("Enter")
    field.blur()
    until(page, "model.moving === false && model.fresh")


@pytest.fixture(scope="module")
def kradar(tmp_path_factory) -> Path:
    root = write_kradar(tmp_path_factory.mktemp("radar") / "set")
    plant_radar(root, AWAY_X_M, AWAY_Y_M)
    return root


@pytest.fixture(scope="module")
def radar(chromium, kradar, tmp_path_factory):
    settings = CalibrationSettings(kind="radar-lidar", frames=12, folder=tmp_path_factory.mktemp("out"))
    with (
        studio(partial(open_dataset, kradar), mode="calibrate", calibration=settings) as live,
        screen(chromium, live) as shown,
    ):
        yield shown


@pytest.fixture(scope="module")
def kitti(tmp_path_factory) -> Path:
    return write_kitti(tmp_path_factory.mktemp("camera") / "set")


@pytest.fixture(scope="module")
def camera(chromium, kitti, tmp_path_factory):
    settings = CalibrationSettings(kind="lidar-camera", frames=3, folder=tmp_path_factory.mktemp("out"))
    with (
        studio(partial(open_dataset, kitti), mode="calibrate", calibration=settings) as live,
        screen(chromium, live) as shown,
    ):
        yield shown


def test_the_page_shows_both_sensors_and_the_residual_in_centimetres_and_cells(radar: Screen):
    assert radar.tell("colours()") > 10
    assert off_cm(radar) > 20
    assert float(radar.text('[data-figure="range cells"] b')) == pytest.approx(off_cm(radar) / 46.3, abs=0.03)
    assert "z is not observed" in radar.text(".notes")
    assert radar.foreign == []


def test_a_drag_moves_the_cloud_and_is_one_step_of_undo(radar: Screen):
    before = radar.tell("values()")
    start, end = radar.tell("ground([30, 5])"), radar.tell("ground([30.5, 4])")
    radar.drag(start, end)
    until(radar, "model.fresh && model.state.undo")
    after = radar.tell("values()")
    assert after["x_m"] - before["x_m"] == pytest.approx(0.5, abs=0.15)
    assert after["y_m"] - before["y_m"] == pytest.approx(-1.0, abs=0.15)
    assert "not saved" in radar.text("#saved")
    radar.press("Control+z")
    until(radar, "!model.state.undo && model.fresh")
    assert radar.tell("values()") == before
    radar.press("Control+Shift+z")
    until(radar, "model.state.undo && model.fresh")
    assert radar.tell("values()") == after
    radar.press("Control+z")
    until(radar, "!model.state.undo && model.fresh")


def test_slider_number_keys_and_ctrl_drag_move_values_and_the_residual_follows(radar: Screen):
    start = radar.tell("values()")
    worse = off_cm(radar)
    put(radar, "x_m", start["x_m"] + 0.5)
    assert off_cm(radar) > worse
    slider = radar.page.locator("input[name='slide yaw_rad']")
    box = slider.bounding_box()
    radar.page.mouse.click(box["x"] + 0.7 * box["width"], box["y"] + box["height"] / 2)
    until(radar, "values().yaw_rad > 0.01 && !model.moving")
    radar.page.locator("#main").focus()
    radar.press("Shift+w", "]")
    until(radar, f"values().frames === 1 && Math.abs(values().x_m - {start['x_m'] + 1.0}) < 1e-6")
    radar.press("[")
    until(radar, "values().frames === 0 && model.fresh")
    yaw = radar.tell("values()")["yaw_rad"]
    radar.page.keyboard.down("Control")
    radar.drag(radar.tell("ground([40, 0])"), radar.tell("ground([40, 3])"))
    radar.page.keyboard.up("Control")
    turned = f"Math.abs(values().yaw_rad - {yaw + math.atan2(3, 40)}) < 0.02"
    until(radar, f"{turned} && !model.moving && model.fresh")
    while radar.tell("model.state.undo"):
        seq = radar.tell("model.state.seq")
        radar.press("Control+z")
        until(radar, f"model.state.seq > {seq}")
    until(radar, "model.fresh")
    assert radar.tell("values()") == start


def test_residuals_are_not_called_those_of_the_values_from_the_moment_these_change(radar: Screen):
    start = radar.tell("values()")
    typed = """is(({ model }) => {
        const field = document.querySelector("input[name='x_m']");
        field.value = String(Number(field.value) + 0.3);
        field.dispatchEvent(new Event("change"));
        return [model.fresh, model.values.x_m];
    })"""
    fresh, x_m = radar.tell(typed)  # no message of the server comes between the change and the answer
    assert x_m == pytest.approx(start["x_m"] + 0.3, abs=1e-6)
    assert fresh is False
    until(radar, "model.fresh && model.state.undo")
    radar.press("Control+z")
    until(radar, "!model.state.undo && model.fresh")
    assert radar.tell("values()") == start


def test_changes_in_quick_succession_are_all_kept(radar: Screen):
    start = radar.tell("values()")
    radar.page.locator("#main").focus()
    radar.press("w", "w", "d", "w", "e")  # none waits for the answer to the one before
    until(radar, f"Math.abs(model.state.radar.x_m - {start['x_m']} - 0.15) < 1e-6 && model.state.radar.yaw_rad < -1e-4")
    until(radar, f"Math.abs(values().y_m - {start['y_m'] - 0.05}) < 1e-6")
    assert radar.page.locator(".bar.warning").count() == 0
    while radar.tell("model.state.undo"):
        seq = radar.tell("model.state.seq")
        radar.press("Control+z")
        until(radar, f"model.state.seq > {seq}")
    until(radar, "model.fresh")
    assert radar.tell("values()") == start


def test_the_frame_is_stepped_and_the_radar_goes_with_it(radar: Screen):
    first = radar.tell("frame()")
    radar.press("ArrowRight")
    radar.settled()
    assert radar.tell("frame()") == first + 1
    assert radar.tell("radarFrame()") == first + 1
    assert radar.tell("model.residuals.pairs").__len__() > 5
    radar.press("Home")
    radar.settled()


def test_a_planted_error_is_refined_saved_and_read_back(radar: Screen, kradar: Path):
    before = radar.tell("values()")
    truth = RADAR.vector
    radar.page.get_by_role("button", name="Refine").click()
    until(radar, "model.state.solved !== '' && model.job === null && model.fresh", seconds=120)
    assert off_cm(radar) < 12
    assert "matched objects" in radar.text(".notes .solved")
    sigma = [one for one in radar.tell("model.residuals.known") if one["name"] in ("x", "y", "yaw")]
    assert all(one["observed"] > 0.8 for one in sigma)
    found = radar.tell("values()")
    radar.press("b")
    until(radar, "model.blink")
    assert "BEFORE" in radar.text("#corner")
    radar.press("b")
    until(radar, "!model.blink")
    text = kradar / "1" / "info_calib" / "calib_radar_lidar.txt"
    old = text.read_bytes()
    radar.page.get_by_role("button", name="Save", exact=True).click()
    until(radar, "!model.state.unsaved && model.state.restorable", seconds=60)
    assert "as saved" in radar.text("#saved")
    (copy,) = text.parent.glob("calib_radar_lidar.txt.before-*")
    assert copy.read_bytes() == old
    stored = json.loads((text.parent / SIDE_FILE).read_text())["sigma"]
    shown = {f"{one['name']}_{one['unit']}": one["sigma"] for one in radar.tell("model.residuals.known")}
    assert shown == pytest.approx({name: row["sigma"] for name, row in stored.items()}), "one sigma, shown and saved"
    sensor = open_dataset(kradar)[0].sensors["radar"]
    read = invert(sensor.frame_T_sensor)
    assert np.abs(read[:2, 3] - truth[:2]).max() < 0.1
    assert abs(math.degrees(math.atan2(read[1, 0], read[0, 0]))) < 0.2
    assert found["x_m"] == pytest.approx(read[0, 3], abs=1e-3)
    assert abs(before["x_m"] - truth[0]) > 0.7
    radar.page.get_by_role("button", name="Put back").click()
    until(radar, "!model.state.restorable", seconds=60)
    assert text.read_bytes() == old
    assert radar.errors == []


def pick(page: Screen, point: list[float], pixel: np.ndarray) -> None:
    """Click a pixel of the picture, then the point in the cloud below."""
    count = len(page.tell("model.state.picks"))
    page.page.mouse.click(*page.tell(f"pixel({pixel.tolist()})"))
    until(page, "picking.pixel !== null")
    page.page.mouse.click(*page.tell(f"strip({point})"))
    until(page, f"model.state.picks.length === {count + 1} && picking.pixel === null")


def chosen_points(page: Screen, kitti: Path) -> list[tuple[list[float], np.ndarray]]:
    """Points of posts spread over the picture, and where the true camera sees them."""
    cloud = open_dataset(kitti, format="kitti")[0].cloud().points_m.astype(float)
    posts = cloud[(np.hypot(cloud[:, 0], cloud[:, 1]) < 60) & (cloud[:, 2] > -1.2)]
    pixels, _, seen = CAMERA.project(posts)
    inside = seen & (pixels[:, 1] > 20) & (pixels[:, 1] < 350)
    posts, pixels = posts[inside], pixels[inside]
    order = np.argsort(pixels[:, 0])
    spread = order[np.linspace(0, len(order) - 1, 60).astype(int)]
    rows: list[tuple[list[float], np.ndarray]] = []
    for i in spread:
        if all(np.abs(pixels[i] - pixel).max() > 60 for _, pixel in rows):
            near = page.tell(f"nearest({posts[i].tolist()})")
            rows.append((near, CAMERA.project(np.array([near]))[0][0]))
    return rows[:12]


def test_a_camera_is_calibrated_by_clicks_saved_and_read_back(camera: Screen, kitti: Path):
    camera.page.locator(".notes", has_text="take 7 or more").wait_for()
    camera.press("n")
    until(camera, "picking.on")
    rows = chosen_points(camera, kitti)
    assert len(rows) >= 8
    for point, pixel in rows:
        pick(camera, point, pixel)
    until(camera, f"model.state.picks.length === {len(rows)} && model.fresh")
    camera.page.locator("tr[data-pick]").nth(len(rows) - 1).wait_for()
    assert camera.page.locator("tr[data-pick]").count() == len(rows)
    far = [row["residual_px"] for row in camera.tell("model.state.picks")]
    assert min(far) > 3  # the planted error
    camera.page.locator("tr[data-pick='2']").click()
    camera.press("Delete")
    until(camera, f"model.state.picks.length === {len(rows) - 1}")
    camera.page.get_by_role("button", name="Solve pairs").click()
    until(camera, "model.state.solved !== '' && model.job === null && model.fresh", seconds=60)
    assert max(row["residual_px"] for row in camera.tell("model.state.picks")) < 3
    found = camera.tell("values()")["moved"]
    assert np.abs(np.degrees(np.array(found[:3]) + PLANTED[:3])).max() < 0.35
    camera.press("Control+s")
    until(camera, "!model.state.unsaved", seconds=60)
    read = open_dataset(kitti, format="kitti")[0].cameras["camera"]
    error = camera_difference(read, CAMERA)
    assert np.degrees(np.abs(error[:3]).max()) < 0.3
    assert np.abs(error[3:]).max() < 0.25
    assert len(list((kitti / "training" / "calib").glob("000000.txt.before-*"))) == 1
    assert camera.errors == []
    assert camera.foreign == []


def test_edges_are_aligned_as_a_job_and_a_changed_lens_is_said_not_to_be_saved(camera: Screen):
    before = camera.tell("values()")
    camera.page.get_by_role("button", name="Align edges").click()
    until(camera, "model.state.solved.startsWith('aligned') && model.job === null && model.fresh", seconds=120)
    assert float(camera.text('[data-figure="off, median px"] b')) < 2.0
    put(camera, "fx", 715.0)
    camera.page.locator(".saving", has_text="lens is not saved").wait_for()
    camera.press("Control+s")
    camera.page.locator(".bar.warning").wait_for()
    assert "save into the folder of results instead" in camera.text("#bars")
    camera.press("Control+z", "Control+z")
    back = f"Math.abs(values().moved[4] - {before['moved'][4]!r}) < 1e-9"
    until(camera, f"model.state.camera.fx < 708 && {back} && model.fresh")
    assert camera.tell("values()") == before
    assert number(camera, "fx") == 707.0


@pytest.mark.parametrize("name", ["radar", "camera"])
def test_the_pages_are_whole_at_every_size_and_worked_by_keys(request, name: str):
    page: Screen = request.getfixturevalue(name)
    for keys in ((), ("?",)):
        page.press(*keys)
        for width, height in SIZES[::3]:
            page.page.set_viewport_size({"width": width, "height": height})
            page.settled()
            assert layout_faults(page.page) == [], (width, height, keys)
        assert axe_faults(page.page) == []
    assert "Keys while calibrating" in page.text("#help")
    page.press("Escape")
    assert not page.page.locator("#help").is_visible()
    page.page.set_viewport_size({"width": 1280, "height": 720})
    place = page.tell("model.place")
    page.page.locator("#header button").focus()
    slider = page.page.locator("#right input[type=range]").first
    while not slider.evaluate("(one) => one === document.activeElement"):
        page.press("Tab")
    before = float(slider.input_value())
    page.press("ArrowRight")
    assert float(slider.input_value()) > before
    assert page.tell("model.place") == place, "an arrow on a slider changed the frame"
    until(page, "model.moving === false && model.fresh")
