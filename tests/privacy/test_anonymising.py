"""Whole folders: covered over time, nothing left beside the picture, the same bytes whoever works."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from face_model import has_face_model
from PIL import Image

pytest.importorskip("cv2")
if not has_face_model():
    pytest.skip("the model of faces is not installed", allow_module_level=True)

from faces import EVERY_BOX, HIDDEN, portrait, walk, written

from farfield.cli import main
from farfield.errors import ConfigError, FileFormatError
from farfield.files.images import read_image
from farfield.frame import Frame
from farfield.jobs import JobOptions
from farfield.privacy import Anonymized, AnonymizeOptions, PictureSummary, anonymise
from farfield.privacy.anonymising import count_covers, uncovered_rows
from farfield.privacy.covering import box_mask
from farfield.privacy.detectors import PLATES_MISSED, FaceDetector
from farfield.privacy.image_boxes import ImageBoxes, covered_share
from farfield.privacy.sources import find_side_by_side, find_sources, find_stereo_pairs


def digests(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def shares(done, boxes) -> list[float]:
    """Share of each picture's true face that is covered."""
    found = []
    for each, box in zip(done, boxes, strict=True):
        hits = ImageBoxes.of_kind(
            "face", np.array([row["box_px"] for row in each.rows]).reshape(-1, 4), np.ones(len(each.rows))
        )
        found.append(covered_share(box_mask(hits, *each.size_px), np.array(box, float)))
    return found


def test_a_face_is_found_at_several_sizes_and_in_this_order_of_colours() -> None:
    for size in (160, 60, 24):
        image, box = portrait(size)
        hits = FaceDetector()(image)
        best = hits[:1]
        assert covered_share(box_mask(best, image.shape[1], image.shape[0]), box) >= 0.9, size
        assert best.score[0] > 0.5
    grey = np.full((100, 140, 3), 120, dtype=np.uint8)
    assert not len(FaceDetector()(grey))


def test_a_face_that_is_hidden_in_one_picture_stays_covered(tmp_path: Path) -> None:
    """In picture HIDDEN the detector sees nothing; alone it would stay uncovered."""
    boxes = walk(tmp_path / "in")
    before = digests(tmp_path / "in")
    done = anonymise(find_sources(tmp_path / "in"), tmp_path / "out", AnonymizeOptions(plates=False))
    assert min(shares(done, boxes)) >= EVERY_BOX
    assert {row["how"] for row in done[HIDDEN].rows} == {"bridged"}
    alone = anonymise(find_sources(tmp_path / "in"), tmp_path / "alone", AnonymizeOptions(plates=False, together=False))
    assert shares(alone, boxes)[HIDDEN] == 0
    assert digests(tmp_path / "in") == before  # originals are as they were


def test_two_workers_and_a_second_call_leave_the_same_bytes(tmp_path: Path) -> None:
    walk(tmp_path / "in")
    sources = find_sources(tmp_path / "in")
    anonymise(sources, tmp_path / "one")
    anonymise(sources, tmp_path / "two", find=JobOptions(workers=2), cover=JobOptions(workers=2))
    whole = digests(tmp_path / "one")
    assert digests(tmp_path / "two") == whole
    assert set(whole) == {"anonymized.jsonl", ".found.jsonl", ".journal.jsonl", *(f"{n:02}.png" for n in range(8))}
    (tmp_path / "one" / "03.png").write_bytes(b"")
    anonymise(sources, tmp_path / "one")
    assert digests(tmp_path / "one") == whole


def test_nothing_of_the_original_is_left_beside_the_picture(tmp_path: Path) -> None:
    """EXIF with position and a thumbnail of the uncovered face, a comment, a second picture; turned by EXIF too."""
    image, _ = portrait(120)
    thumbnail = Image.fromarray(image)
    exif = Image.Exif()
    exif[0x0112] = 6  # stored lying on its side
    exif[0x010F] = "maker of this camera"
    exif.get_ifd(0x8825)[1] = "N"
    exif.get_ifd(0x8825)[2] = (48.0, 7.0, 12.0)
    stored = Image.fromarray(np.rot90(image).copy())
    (tmp_path / "in").mkdir()
    stored.save(tmp_path / "in" / "a.jpg", exif=exif, comment=b"seen by me", quality=95)
    stored.save(
        tmp_path / "in" / "b.jpg", format="MPO", save_all=True, append_images=[thumbnail], exif=exif, quality=95
    )
    anonymise(find_sources(tmp_path / "in"), tmp_path / "out", AnonymizeOptions(plates=False, together=False))
    for name in ("a.jpg", "b.jpg"):
        data = (tmp_path / "out" / name).read_bytes()
        with Image.open(tmp_path / "out" / name) as covered:
            assert covered.format == "JPEG"
            assert getattr(covered, "n_frames", 1) == 1
            assert not covered.getexif()
            assert covered.size == (image.shape[1], image.shape[0])  # upright
        assert b"Exif" not in data
        assert b"maker" not in data
        assert b"seen by me" not in data
        assert data.count(b"\xff\xd8\xff") == 1
        found = FaceDetector(least_score=0.3)(read_image(tmp_path / "out" / name))
        assert not len(found)
    log = (tmp_path / "out" / "anonymized.jsonl").read_text()
    lines = [json.loads(line) for line in log.splitlines()]
    assert [line.get("file") for line in lines] == [None, "a.jpg", "b.jpg"]
    assert set(lines[1]["covered"][0]) == {"kind", "box_px", "score", "track", "how"}


def test_what_one_eye_sees_is_covered_in_the_other(tmp_path: Path) -> None:
    """The right picture is too pale for the detector, but its face looks alike."""
    image, box = portrait(60, width=180)
    written(tmp_path / "in" / "image_02" / "0.png", image)
    pale = (np.roll(image, -9, axis=1) * 0.015 + 120).astype(np.uint8)
    assert not len(FaceDetector(least_score=0.3)(pale))
    written(tmp_path / "in" / "image_03" / "0.png", pale)
    sources = find_sources(tmp_path / "in")
    strict = AnonymizeOptions(plates=False, together=False)
    done = anonymise(sources, tmp_path / "out", strict, pairs=find_stereo_pairs(sources.folders))
    assert [each.file for each in done] == ["image_02/0.png", "image_03/0.png"]
    assert shares(done, [box, box - [9, 0, 9, 0]]) == [1.0, 1.0]
    assert [row["how"] for each in done for row in each.rows] == ["found", "partner"]


def test_what_one_half_of_a_picture_of_both_eyes_shows_is_covered_in_the_other(tmp_path: Path) -> None:
    """K-Radar's cameras write both eyes into one picture; a pale half goes unseen, on either side."""
    image, box = portrait(60, width=240, height=120)
    pale = (np.roll(image, -9, axis=1) * 0.015 + 120).astype(np.uint8)
    shift = np.array([image.shape[1], 0] * 2)
    written(tmp_path / "in" / "cam-front" / "0.png", np.concatenate([image, pale], axis=1))
    written(tmp_path / "in" / "cam-rear" / "0.png", np.concatenate([pale, image], axis=1))
    written(tmp_path / "in" / "other" / "0.png", np.concatenate([image, pale], axis=1))
    sources = find_sources(tmp_path / "in")
    chosen = AnonymizeOptions(plates=False, together=False, least_score=0.3)
    done = anonymise(sources, tmp_path / "out", chosen, both=find_side_by_side(sources.folders))
    faint = box - [9, 0, 9, 0]
    assert shares(done, [box, box + shift, box]) == [1.0, 1.0, 1.0]
    assert shares(done, [faint + shift, faint, faint + shift]) == [1.0, 1.0, 0.0]
    assert [[row["how"] for row in each.rows] for each in done] == [["found", "partner"]] * 2 + [["found"]]


def test_a_folder_within_the_source_and_damaged_pictures_are_refused(tmp_path: Path) -> None:
    walk(tmp_path / "in")
    sources = find_sources(tmp_path / "in")
    for out in (tmp_path / "in", tmp_path / "in" / "out"):
        with pytest.raises(ConfigError, match="nor below it"):
            anonymise(sources, out)
    (tmp_path / "in" / "04.png").write_bytes((tmp_path / "in" / "04.png").read_bytes()[:200])
    with pytest.raises(FileFormatError, match=r"04\.png"):
        anonymise(sources, tmp_path / "out")
    assert not list((tmp_path / "out").glob("*.png"))


def test_weak_boxes_that_stay_seen_are_named() -> None:
    """Two weak boxes: the one that lies under a cover is hidden, the other is left; the strongest first."""
    seen = ImageBoxes.of_kind(
        "face", np.array([[0, 0, 10, 10], [50, 50, 60, 60], [80, 0, 90, 10.0]]), np.array([0.2, 0.15, 0.25])
    )
    under = ImageBoxes.of_kind("plate", np.array([[-5.0, -5, 30, 30]]), np.array([0.9]))
    assert [(row["box_px"], row["score"]) for row in uncovered_rows(seen, under)] == [
        ([80, 0, 90, 10], 0.25),
        ([50, 50, 60, 60], 0.15),
    ]
    assert uncovered_rows(seen, seen) == ()
    assert len(uncovered_rows(seen, ImageBoxes())) == 3


def test_covers_are_counted_by_frame_and_by_track() -> None:
    """One face over three frames of a film and another in a picture: two faces, four covers; a partner has no track."""
    face = {"kind": "face", "box_px": [0, 0, 9, 9], "score": 0.9, "track": 0, "how": "found"}
    film = [PictureSummary("walk.mp4", (20, 20), 0.1, (face,), frame) for frame in range(3)]
    still = PictureSummary("a/0.png", (20, 20), 0.1, (face, {**face, "track": None, "how": "partner"}))
    assert count_covers([*film, still], "face") == (2, 5)
    assert count_covers([*film, still], "face", together=False) == (4, 5)
    assert count_covers([*film, still], "plate") == (0, 0)


def test_the_last_line_says_what_share_of_plates_is_missed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("torch")
    pytest.importorskip("safetensors")
    written(tmp_path / "in" / "0.png", np.full((64, 64, 3), 120, dtype=np.uint8))
    assert main(["anonymize", str(tmp_path / "in"), str(tmp_path / "out"), "--workers", "1"]) == 0
    missed, measured = PLATES_MISSED
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith(f"Known to be missed: {missed} of {measured} number plates in photographs")
    assert "benchmarks/results/privacy.txt" in last


def test_a_data_sets_images_are_covered_as_they_are_read() -> None:
    image, box = portrait(80)
    frame = Anonymized()(Frame(sequence="s", frame_id="0", images={"camera": image}))
    seen = frame.images["camera"]
    changed = (seen != image).any(axis=2)
    assert covered_share(changed, box) > 0.8
    assert not len(FaceDetector(least_score=0.3)(seen))


def test_the_command_writes_pictures_log_and_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk(tmp_path / "in")
    assert main(["anonymize", str(tmp_path / "in"), str(tmp_path / "out"), "--workers", "1", "--no-plates"]) == 0
    said = capsys.readouterr().out
    assert "8 pictures and frames; one cover is one box in one of them" in said
    assert "Faces: 1 followed over time, 8 covers, 1 of them doubtful\n" in said
    assert said.endswith("Number plates: left as they are, all of them\n")
    assert "Names are no stamps" in said
    page = (tmp_path / "out" / "anonymized.html").read_text()
    assert "03.png: face" in page
    assert "bridged" in page
    assert main(["anonymize", str(tmp_path / "in"), str(tmp_path / "out"), "--stereo", "left"]) != 0
    assert "LEFT:RIGHT" in capsys.readouterr().err
