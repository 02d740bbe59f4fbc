"""Films: stamps are kept, sound is not, a hidden face stays covered, and the bytes do not depend on who works."""

import hashlib
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from face_model import has_face_model

av = pytest.importorskip("av")
pytest.importorskip("cv2")
if not has_face_model():
    pytest.skip("the model of faces is not installed", allow_module_level=True)

from faces import EVERY_BOX, HIDDEN, walk
from PIL import Image

from farfield.cli import main
from farfield.files.videos import film_frames, read_film
from farfield.jobs import JobOptions
from farfield.privacy import AnonymizeOptions, anonymise, anonymising
from farfield.privacy.image_boxes import covered_share
from farfield.privacy.sources import find_sources

FACES = AnonymizeOptions(plates=False)
STAMPS = [0, 100, 210, 300, 390, 500, 600, 705]  # milliseconds: frames do not come evenly


def filmed(folder: Path, name: str = "walk.mp4") -> list[np.ndarray]:
    """The walk as a film with sound, a title and a place, and the faces' boxes."""
    boxes = walk(folder / "pictures")
    folder.mkdir(exist_ok=True)
    with av.open(str(folder / name), "w") as container:
        container.metadata["title"] = "my own street"
        container.metadata["location"] = "+48.1+011.5/"
        stream = container.add_stream("libx264", options={"crf": "10"})
        sound = container.add_stream("aac", rate=16000)
        stream.width, stream.height, stream.pix_fmt = 260, 130, "yuv420p"
        stream.codec_context.time_base = stream.time_base = Fraction(1, 1000)
        for number, stamp in enumerate(STAMPS):
            picture = np.array(Image.open(folder / "pictures" / f"{number:02}.png"))
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = stamp, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
        noise = np.random.default_rng(0).normal(0, 3000, (1, 8000)).astype(np.int16)
        heard = av.AudioFrame.from_ndarray(noise, format="s16", layout="mono")
        heard.sample_rate, heard.pts = 16000, 0
        container.mux(sound.encode(heard))
        container.mux(sound.encode())
    for path in (folder / "pictures").iterdir():
        path.unlink()
    (folder / "pictures").rmdir()
    return boxes


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_stamps_stay_and_all_else_is_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    boxes = filmed(tmp_path / "in")
    before = digest(tmp_path / "in" / "walk.mp4")
    done = anonymise(find_sources(tmp_path / "in"), tmp_path / "out", FACES)
    own, covered = (read_film(tmp_path / name / "walk.mp4") for name in ("in", "out"))
    np.testing.assert_allclose(covered.times_s, own.times_s, atol=1e-9)
    with av.open(str(tmp_path / "out" / "walk.mp4")) as container:
        assert [stream.type for stream in container.streams] == ["video"]
        assert not {"title", "location", "creation_time", "encoder"} & set(container.metadata)
    data = (tmp_path / "out" / "walk.mp4").read_bytes()
    assert b"my own street" not in data
    assert b"+48.1" not in data
    pairs = zip(film_frames(own), film_frames(covered), boxes, strict=True)
    for number, (old, new, box) in enumerate(pairs):
        changed = np.abs(old.astype(int) - new).max(axis=2) > 12
        if number != HIDDEN:  # the post is as flat as what covers it
            assert covered_share(changed, box) > 0.6
        assert np.abs(old.astype(int) - new)[:30].mean() < 3  # nothing else changes
    assert {row["how"] for row in done[HIDDEN].rows} == {"bridged"}
    for each, box in zip(done, boxes, strict=True):
        low, high = np.array(each.rows[0]["box_px"][:2]), np.array(each.rows[0]["box_px"][2:])
        inside = (np.minimum(high, box[2:]) - np.maximum(low, box[:2])).clip(min=0).prod()
        assert inside / (box[2:] - box[:2]).prod() >= EVERY_BOX
    assert digest(tmp_path / "in" / "walk.mp4") == before


def test_segments_and_workers_make_no_difference_to_what_is_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In segments of three frames by two workers: the same stamps and boxes, and the same bytes at every call."""
    filmed(tmp_path / "in")
    whole = anonymise(find_sources(tmp_path / "in"), tmp_path / "whole")
    monkeypatch.setattr(anonymising, "SEGMENT_FRAMES", 3)
    for name, workers in (("one", 1), ("two", 2)):
        bulk = JobOptions(workers=workers)
        done = anonymise(find_sources(tmp_path / "in"), tmp_path / name, find=bulk, cover=bulk)
        assert [each.rows for each in done] == [each.rows for each in whole]
    assert digest(tmp_path / "one" / "walk.mp4") == digest(tmp_path / "two" / "walk.mp4")
    stamps = [read_film(tmp_path / name / "walk.mp4").times_s for name in ("whole", "one")]
    np.testing.assert_allclose(*stamps)
    parts = [np.stack(list(film_frames(read_film(tmp_path / name / "walk.mp4")))) for name in ("whole", "one")]
    assert np.abs(parts[0].astype(int) - parts[1]).mean() < 2
    before = (tmp_path / "one" / "walk.mp4").stat().st_mtime_ns
    anonymise(find_sources(tmp_path / "in"), tmp_path / "one")
    assert (tmp_path / "one" / "walk.mp4").stat().st_mtime_ns == before  # nothing is encoded anew
    assert not (tmp_path / "one" / ".unfinished-films").exists()


def test_the_command_takes_a_film_and_shows_its_doubtful_frames(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    filmed(tmp_path / "in", "walk.mkv")
    assert (
        main(["anonymize", str(tmp_path / "in" / "walk.mkv"), str(tmp_path / "out"), "--workers", "1", "--no-plates"])
        == 0
    )
    lines = capsys.readouterr().out.splitlines()
    assert lines[-2:] == [
        "Faces: 1 followed over time, 8 covers, 1 of them doubtful",
        "Number plates: left as they are, all of them",
    ]
    assert lines[-3].startswith("8 pictures and frames; one cover is one box in one of them")
    assert f"walk.mkv, frame {HIDDEN}: face" in (tmp_path / "out" / "anonymized.html").read_text()
    (tmp_path / "in" / "bad.mp4").write_bytes((tmp_path / "in" / "walk.mkv").read_bytes()[:3000])
    assert main(["anonymize", str(tmp_path / "in" / "bad.mp4"), str(tmp_path / "out"), "--workers", "1"]) != 0
    assert "bad.mp4" in capsys.readouterr().err
