"""What a person takes away: pictures, films, pages that open from disk."""

import base64
import gzip
import hashlib
import io
import json
import re
from dataclasses import MISSING, fields
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from PIL import Image
from studio.live import studio
from studio.showing.test_studio_wire import decode

from farfield.cli import main
from farfield.errors import ConfigError, FileFormatError
from farfield.files.images import write_animation
from farfield.studio.exports import standalone
from farfield.studio.messages.replies import FrameState, Welcome
from farfield.studio.messages.rows import FrameInfo
from farfield.studio.showing.opened import STATIC


def png(grey: int) -> bytes:
    written = io.BytesIO()
    Image.fromarray(np.full((40, 60, 3), grey, dtype=np.uint8)).save(written, "PNG")
    return written.getvalue()


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory):
    with studio(notes=tmp_path_factory.mktemp("notes")) as running:
        yield running


def export(client, **request) -> dict:
    client.send(op="export", id="e", **request)
    return client.until("job", "refused", wanted=lambda m: m.get("state") in ("done", "failed", None))


@pytest.mark.parametrize("kind", ["gif", "webp"])
def test_a_film_of_pictures_that_the_page_sent(live, kind):
    shots = []
    for grey in (0, 120, 250):
        status, _, body = live.request("POST", "/shot", png(grey), origin=live.origin)
        assert status == 201
        shots.append(json.loads(body)["shot"])
    with live.window() as client:
        done = export(client, kind=kind, shots=shots, name="drive", rate_hz=5)
    assert done["state"] == "done", done
    status, headers, body = live.get("/" + done["url"])
    assert (status, headers["content-type"]) == (200, f"image/{kind}")
    assert headers["content-disposition"] == f'attachment; filename="drive.{kind}"'
    with Image.open(io.BytesIO(body)) as film:
        assert (film.n_frames, film.size) == (3, (60, 40))
        film.seek(2)
        film.load()
        assert film.info["duration"] == 200
        assert np.asarray(film.convert("RGB")).mean() > 240


def test_a_film_whose_file_went_with_the_connection_is_not_made_twice(live):
    _, _, body = live.request("POST", "/shot", png(9), origin=live.origin)
    shots = [json.loads(body)["shot"]]
    done = []
    for _ in range(2):
        with live.window() as client:
            done.append(export(client, kind="gif", shots=shots, name="again", rate_hz=5))
    assert done[0]["state"] == "done", done
    assert done[0]["url"] == done[1]["url"]


def test_only_pictures_are_kept_and_only_those_sent_make_a_film(live):
    assert live.request("POST", "/shot", b"<svg/>", origin=live.origin)[0] == 400
    with live.window() as client:
        assert export(client, kind="gif", shots=["shot-999"])["state"] == "failed"
        assert export(client, kind="gif", shots=[])["state"] == "failed"


def test_a_damaged_picture_is_named(tmp_path: Path):
    (tmp_path / "a.png").write_bytes(png(0)[:60])
    with pytest.raises(FileFormatError, match=r"a\.png"):
        write_animation(tmp_path / "film.gif", [tmp_path / "a.png"])


@pytest.mark.skipif(not (STATIC / "index.html").is_file(), reason="the page is not built: npm run build in web/")
def test_a_page_holds_its_frames_and_its_script_by_hash(live):
    with live.window() as client:
        state = client.open(0)
        done = export(client, kind="html", frames=[0], name="one")
    assert done["state"] == "done", done
    text = live.get("/" + done["url"])[2].decode()
    assert len(text) < 2_000_000
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', text)[1]
    script = re.search(r'<script type="module">(.*?)</script>', text, re.DOTALL)[1]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in policy
    assert "unsafe" not in policy
    assert 'src="./' not in text
    assert 'href="./' not in text
    held = json.loads(re.search(r'id="farfield-data">(.*?)</script>', text, re.DOTALL)[1])
    assert held["frames"][0]["boxes"] == state["boxes"]
    assert set(held["payloads"]) == {layer["url"] for layer in state["layers"]}
    points = gzip.decompress(base64.b64decode(held["payloads"]["layer/0/0"]))
    assert decode(points)[0]["layer"] == "gaussian"


def test_too_many_frames_are_refused_with_the_reason(live):
    with live.window() as client:
        failed = export(client, kind="html", frames=list(range(21)))
    assert failed["state"] == "failed"
    assert "at most 20" in failed["message"]


def test_a_page_cannot_be_left_by_what_it_holds(tmp_path: Path):
    (tmp_path / "index.html").write_text(
        '<head><meta charset="utf-8" /><script type="module" crossorigin src="./studio.js"></script>'
        '<link rel="stylesheet" crossorigin href="./studio.css"></head>'
    )
    (tmp_path / "studio.js").write_text('const a = "</script><b>";')
    (tmp_path / "studio.css").write_text("b { color: red }")
    given = dict.fromkeys((each.name for each in fields(Welcome) if each.default is MISSING), ())
    given |= {"farfield": "0", "mode": "view", "data": "d", "store": "", "title": "</script><script>alert(1)</script>"}
    given |= {"frames": 1, "annotator": "", "window": "w", "windows": 1, "journal_seq": 0, "extent": None}
    hostile = Welcome(**given)
    frame = FrameState(frame=FrameInfo(index=0, sequence="s", frame_id="f"), layers=(), boxes=())
    text = standalone(tmp_path, hostile, [frame], {"layer/0/0": b"x"})
    assert text.count("</script>") == 2
    assert "<script>alert" not in text
    with pytest.raises(ConfigError, match="npm run build"):
        standalone(tmp_path / "no", hostile, [frame], {})


def test_labels_are_not_exported_from_a_view(live):
    with live.window() as client:
        failed = export(client, kind="labels")
    assert failed["state"] == "failed"
    assert "farfield annotate" in failed["message"]


@pytest.mark.skipif(not (STATIC / "index.html").is_file(), reason="the page is not built: npm run build in web/")
def test_the_verb_writes_a_page_without_a_browser(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    target = tmp_path / "two.html"
    assert main(["view", "--html", str(target), "--frame", "1,0"]) == 0
    assert f"written: {target}" in capsys.readouterr().out
    held = json.loads(re.search(r'id="farfield-data">(.*?)</script>', target.read_text(), re.DOTALL)[1])
    assert [frame["frame"]["index"] for frame in held["frames"]] == [1, 0]
    assert held["welcome"]["first"] == 1
    assert main(["view", "--html", str(target), "--frame", "9"]) == 1
    assert "expected a number below 2" in capsys.readouterr().err


@pytest.mark.skipif(not (STATIC / "index.html").is_file(), reason="the page is not built: npm run build in web/")
def test_the_verb_s_page_has_the_boxes_of_the_detectors(tmp_path: Path, monkeypatch):
    """They were left out without a word."""
    pytest.importorskip("torch")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    target = tmp_path / "one.html"
    assert main(["view", "open-sweeps", "--html", str(target), "--detector", "pointpillars-roads"]) == 0
    held = json.loads(re.search(r'id="farfield-data">(.*?)</script>', target.read_text(), re.DOTALL)[1])
    (frame,) = held["frames"]
    (predicted,) = frame["predicted"]
    assert predicted["set"] == "detector-pointpillars-roads"
    assert len(predicted["rows"]) > 3
