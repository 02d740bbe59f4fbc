"""Looking through the studio: frames, layers, pictures, radar maps, predictions, bookmarks, several windows."""

import contextlib
import json
import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from studio.live import Live, studio
from studio.showing.test_studio_wire import decode

from farfield.files.boxes_csv import BoxRows, write_boxes_csv
from farfield.radar.axes import CUBE_X_M, CUBE_Y_M, OUTSIDE
from farfield.studio.samples import open_samples
from farfield.studio.showing.radar import RadarPower, in_radar
from farfield.vocabulary.studio import STUDIO_PORT, studio_link


@pytest.fixture(scope="module")
def predictions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All boxes of the first frame but one, moved by 0.2 m, and one where nothing is."""
    data = open_samples()
    boxes = data[0].boxes
    kept = boxes[np.arange(len(boxes)) != 0]
    n = len(kept)
    path = tmp_path_factory.mktemp("predicted") / "found.csv"
    rows = BoxRows(
        sequence=np.array([data.keys[0][0]] * (n + 1)),
        frame=np.array([data.keys[0][1]] * (n + 1)),
        label=np.append(kept.label, "vehicle"),
        centre_m=np.vstack([np.add(kept.centre_m, [0.2, 0, 0]), [[30.0, 40.0, 0.0]]]),
        size_m=np.vstack([kept.size_m, [[4.5, 2.0, 1.6]]]),
        yaw_rad=np.append(kept.yaw_rad, 0.0),
        score=np.append(np.linspace(0.9, 0.2, n), 0.3),
        track_id=np.arange(n + 1),
    )
    write_boxes_csv(path, rows)
    return path


@pytest.fixture(scope="module")
def live(predictions: Path, tmp_path_factory: pytest.TempPathFactory):
    notes = tmp_path_factory.mktemp("notes")
    with studio(predictions=(predictions,), protocol="dds", notes=notes) as running:
        yield running


def test_the_welcome_says_what_is_open(live: Live):
    with live.window() as client:
        said = client.welcome
        assert (said["mode"], said["frames"], len(said["labels"])) == ("view", 2, 2)
        assert [drive["frames"] for drive in said["drives"]] == [[0], [1]]
        assert {spec["name"] for spec in said["classes"]} >= {"vehicle", "pedestrian"}
        assert said["predictions"][0]["title"] == "found.csv"
        assert said["predictions"][0]["kind"] == "tracks"


@pytest.mark.parametrize("frame", [0, 1])
def test_every_layer_of_a_frame_can_be_fetched(live: Live, frame):
    with live.window() as client:
        layers = client.open(frame)["layers"]
    kinds = [layer["kind"] for layer in layers]
    assert kinds.count("points") == 2
    assert "image" in kinds
    assert ("bev" in kinds, "bfs" in kinds) == (frame == 1, frame == 1)
    data = open_samples()[frame]
    for layer in layers:
        status, headers, body = live.get("/" + layer["url"])
        assert status == 200, layer
        assert live.get("/" + layer["url"], if_none_match=headers["etag"])[0] == 304
        if layer["kind"] == "points":
            assert decode(body)[0]["count"] == len(data.cloud(layer["name"]))
        elif layer["kind"] == "image":
            assert body[:2] in (b"\xff\xd8", b"\x89P")
        else:
            header, arrays = decode(body)
            grid = layer["grid"]
            rows, columns = (grid["y_m"], grid["x_m"]) if layer["kind"] == "bev" else (grid["z_m"], grid["y_m"])
            assert (header["count"], header["fields"][0]["items"]) == (rows[2], columns[2])
            assert arrays["level"].max() == 255


def test_a_picture_that_is_a_file_of_its_own_comes_untouched(live: Live):
    with live.window() as client:
        layer = next(layer for layer in client.open(0)["layers"] if layer["kind"] == "image")
    file = open_samples().root / layer["file"]
    assert live.get("/" + layer["url"])[2] == file.read_bytes()
    assert layer["camera"]["width_px"] == 640


def test_a_slice_of_the_radar_holds_no_more_than_the_whole(live: Live):
    whole, part = (decode(live.get(f"/radar/1/bfs{query}")[2]) for query in ("", "?low=20&high=25"))
    assert part[0]["count"] == whole[0]["count"]
    assert (part[1]["level"] > 0).sum() < (whole[1]["level"] > 0).sum()


def test_the_cells_of_the_radar_near_a_place(live: Live):
    """The sample's cube: the cells about a place at all heights, as the frame has them."""
    header, arrays = decode(live.get("/radar/1/near?x=20&y=3&reach=6")[2])
    axes = header["axes"]
    assert list(axes) == ["z_m", "y_m", "x_m"]
    assert arrays["level"].size == np.prod([count for _, _, count in axes.values()])
    frame = open_samples()[1]
    power = RadarPower.read(frame.radar)
    x, y = in_radar(frame, (20.0, 3.0))
    for name, middle in (("x_m", x), ("y_m", y)):
        first, step, count = axes[name]
        assert first == pytest.approx(middle - 6, abs=step)
        assert first + step * (count - 1) == pytest.approx(middle + 6, abs=step)
    level = arrays["level"].reshape([count for _, _, count in axes.values()])
    row, column = (round((axes[name][0] - axis[0]) / 0.4) for name, axis in (("y_m", CUBE_Y_M), ("x_m", CUBE_X_M)))
    cut = power.power[:, row : row + level.shape[1], column : column + level.shape[2]]
    assert np.array_equal(level > 0, cut > OUTSIDE)
    assert np.unravel_index(level.argmax(), level.shape) == np.unravel_index(cut.argmax(), cut.shape)
    assert -3 < header["ground_z_m"] < 0
    for query in ("x=nan&y=1e9&reach=-1", "x=900&y=900"):  # no cell lies there
        assert [count for _, _, count in decode(live.get(f"/radar/1/near?{query}")[2])[0]["axes"].values()] == [0, 0, 0]
    assert live.get("/radar/0/near?x=20&y=3")[0] == 404  # that frame has no radar


def test_boxes_come_with_their_points_and_predictions_with_their_verdicts(live: Live):
    with live.window() as client:
        state = client.open(0)
        boxes = {row["id"]: row for row in state["boxes"]}
        counts = open_samples()[0].boxes.point_count
        assert [row["points"] for row in state["boxes"]] == counts.tolist()
        (found,) = state["predicted"]
        assert "0:0" in found["missed"] or "0:0" in found["ignored"]
        matched = [row for row in found["rows"] if row["match"] == "matched"]
        assert len(matched) >= 5
        for row in matched:
            assert abs(row["box"][0] - boxes[row["truth"]]["box"][0] - 0.2) < 1e-6
        stranger = next(row for row in found["rows"] if row["box"][1] == 40.0)
        assert (stranger["match"], stranger["truth"]) == ("false", None)
        assert [row["score"] for row in found["rows"]] == sorted((r["score"] for r in found["rows"]), reverse=True)
        assert state["trails"]
        few = client.open(0, threshold=0.5)["predicted"][0]["rows"]
        assert few
        assert all(row["score"] >= 0.5 for row in few)


@pytest.mark.parametrize("threshold", [0.0, 0.5])
def test_the_marks_of_the_timeline_say_what_the_frames_say(live: Live, threshold: float):
    with live.window() as client:
        expected = {}
        for index in range(2):
            for found in client.open(index, threshold=threshold)["predicted"]:
                wrong = sum(row["match"] == "false" for row in found["rows"])
                if wrong or found["missed"]:
                    expected[found["set"], index] = (len(found["missed"]), wrong)
        client.send(op="match.list", threshold=threshold)
        reply = client.until("matches")
        marks = {(reply["set"], row["frame"]): (row["missed"], row["wrong"]) for row in reply["rows"]}
    assert reply["first"]
    assert expected
    assert marks == expected


def test_times_are_text_because_they_exceed_what_the_browser_holds(live: Live):
    with live.window() as client:
        state = client.open(0)
    assert state["frame"]["time_ns"] == "1600000000000000000"
    assert any(layer["time_ns"] == "1600000000065239867" for layer in state["layers"])


def test_bookmarks_are_told_to_all_and_outlive_the_studio(live: Live, tmp_path: Path):
    with live.window(annotator="kim") as one, live.window() as two:
        one.send(op="bookmark.set", id="b1", frame=1, note="glare")
        rows = two.until("bookmarks")["rows"]
        assert rows == [{"frame": 1, "note": "glare", "by": "kim"}]
    with studio(notes=tmp_path) as first, first.window() as client:
        client.send(op="bookmark.set", id="b2", frame=0, note="")
        client.until("bookmarks")
    with studio(notes=tmp_path) as again, again.window() as client:
        assert client.welcome["bookmarks"] == [{"frame": 0, "note": "", "by": ""}]
        client.send(op="bookmark.set", id="b3", frame=0, note=None)
        assert client.until("bookmarks")["rows"] == []


def test_a_dragged_box_is_passed_on_to_those_who_see_its_frame(live: Live):
    with live.window() as one, live.window() as two, live.window() as other:
        for client, frame in ((one, 0), (two, 0), (other, 1)):
            client.open(frame)
        one.send(op="preview", frame=0, box="3", value=[1, 2, 3, 4, 2, 1.5, 0.1])
        seen = two.until("previewed")
        assert (seen["window"], seen["value"][6]) == (one.name, 0.1)
        other.send(op="frame.open", frame=1)
        assert other.until("previewed", "frame.state")["op"] == "frame.state"


def test_the_number_of_windows_is_told(live: Live):
    with live.window() as one:
        with live.window(annotator="lee"):
            told = one.until("windows", wanted=lambda message: "lee" in message["annotators"])
            assert told["count"] >= 2
        assert one.until("windows", wanted=lambda message: "lee" not in message["annotators"])


def test_a_link_to_a_frame_by_name_leads_to_its_number(live: Live):
    status, headers, _ = live.get("/?frame=kradar-1%2F00006_00001&test=1")
    assert (status, headers["location"]) == (303, "/?frame=1&test=1")
    assert live.get("/?frame=no%2Fframe")[1]["location"] == "/?frame=0"
    assert live.get("/?frame=1")[0] in (200, 404)


def test_a_report_links_to_its_frame(live: Live):
    link = studio_link("kradar-1", "00006_00001")
    path = link.removeprefix(f"http://127.0.0.1:{STUDIO_PORT}")
    told = {"sec_fetch_site": "cross-site", "sec_fetch_mode": "navigate", "sec_fetch_dest": "document"}
    bounced = re.search(rb'url=([^"]+)"', live.get(path, cookie="", **told)[2])[1].decode()
    assert live.get(bounced)[1]["location"] == "/?frame=1"


def test_the_page_is_served_with_its_kinds(live: Live):
    status, headers, body = live.get("/", accept_encoding="gzip")
    if status == 404:
        assert b"npm run build" in body
        pytest.skip("the page is not built")
    assert headers["content-type"].startswith("text/html")
    status, headers, _ = live.get("/studio.js", accept_encoding="gzip")
    assert (status, headers["content-encoding"]) == (200, "gzip")
    assert headers["content-type"].startswith("text/javascript")


def test_the_server_says_goodbye():
    with contextlib.ExitStack() as stack:
        with studio() as running:
            assert json.loads(running.get("/health")[2])["ready"]
            client = stack.enter_context(running.window())
        assert client.until("bye")["reason"].startswith("the studio was ended")
