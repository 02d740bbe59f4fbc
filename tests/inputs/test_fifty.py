"""Wrong inputs A to C and F of ``fifty.md``: an error or a warning names the fault, or the reading is right."""

import json
import zipfile
from pathlib import Path
from shutil import copyfile

import numpy as np
import pytest
from wrong_inputs import (
    CAR,
    Capsys,
    findings,
    refused,
    row,
    run,
    says,
    score,
    sweep,
    table,
)

from farfield.api import open_dataset
from farfield.errors import FarfieldError


def test_base_is_sound(base: Path, predictions: Path, capsys: Capsys) -> None:
    assert findings(capsys, base) == ""
    status, text = score(capsys, predictions, base / "labels.csv")
    assert status == 0
    assert "warning" not in text.lower()
    assert "1.000" in text


# A. Companions that do not belong together.


def test_a1_a_table_and_a_file_for_one_frame(base: Path) -> None:
    box = {"label": "vehicle", "centre_m": [30, 2, -0.7], "size_m": [4, 2, 1.6], "yaw_rad": 0}
    (base / "0000.json").write_text(json.dumps({"boxes": [box]}))
    with pytest.raises(FarfieldError, match=r"(?s)0000.*labels\.csv"):
        open_dataset(base)


def test_a2_two_files_for_one_frame(base: Path) -> None:
    (base / "labels.csv").unlink()
    for number, name in enumerate(("labels", "boxes")):
        (base / name).mkdir()
        box = {"label": "vehicle", "centre_m": [30 + number, 2, -0.7], "size_m": [4, 2, 1.6], "yaw_rad": 0}
        (base / name / "0001.json").write_text(json.dumps({"boxes": [box]}))
    with pytest.raises(FarfieldError, match="0001"):
        open_dataset(base)


def test_a2_boxes_twice_in_a_file(base: Path) -> None:
    """A brother: JSON itself takes the last of two equal keys."""
    (base / "labels.csv").unlink()
    (base / "0001.json").write_text('{"boxes": [], "boxes": []}')
    with pytest.raises(FarfieldError, match=r"(?s)0001\.json.*'boxes' twice"):
        _ = open_dataset(base)[1].boxes


def test_a3_labels_of_another_numbering(base: Path, capsys: Capsys) -> None:
    (base / "labels.csv").write_text(table([row(f"{100 + number:04d}", x=11) for number in range(4)]))
    refused(run(capsys, "doctor", base), "labels.csv", "0100", "0000")


def test_a4_labels_of_more_frames_than_there_are(base: Path, capsys: Capsys) -> None:
    rows = [row(number) for number in range(4)] + [row(f"{number:04d}", x=11) for number in range(100, 200)]
    (base / "labels.csv").write_text(table(rows))
    says(findings(capsys, base), "100 annotations belong to no cloud")


def test_a5_a_table_twice_in_one_file(base: Path, capsys: Capsys) -> None:
    text = (base / "labels.csv").read_text()
    (base / "labels.csv").write_text(text + text)
    refused(run(capsys, "doctor", base), "labels.csv", "line 6", "header")


def test_a6_a_table_that_breaks_off(base: Path, capsys: Capsys) -> None:
    text = (base / "labels.csv").read_text()
    (base / "labels.csv").write_text(text[: text.rindex(CAR) + 5])
    refused(run(capsys, "doctor", base), "labels.csv", "line 5")


def test_a7_one_sweep_under_two_names(base: Path, capsys: Capsys) -> None:
    copyfile(base / "0001.npy", base / "0002.npy")
    says(findings(capsys, base), "0001", "0002", "same")


def test_a8_two_recordings_in_one_folder(base: Path, capsys: Capsys) -> None:
    for old, new in (("0002", "1700000000000000000"), ("0003", "1700000000100000000")):
        (base / f"{old}.npy").rename(base / f"{new}.npy")
        (base / "labels.csv").write_text((base / "labels.csv").read_text().replace(f"{old},", f"{new},"))
    says(findings(capsys, base), "times", "1700000000000000000")


def test_a9_a_mapping_of_another_project(base: Path, capsys: Capsys) -> None:
    (base / "mapping.yaml").write_text("classes: {Lorry: large_vehicle}\n")
    says(findings(capsys, base), "mapping.yaml", "Lorry")


# B. Settings that contradict.


@pytest.mark.parametrize(
    ("words", "named"),
    [
        pytest.param(["--range-bins-m", "70,35,0"], "range", id="b1_falling"),
        pytest.param(["--range-bins-m", "0,70,70,150"], "range", id="b2_twice"),
        pytest.param(["--iou", "50", "--protocol", "tracking"], "iou", id="b3_per_cent"),
    ],
)
def test_b1_to_b3_flags_of_score(words: list[str], named: str, base: Path, predictions: Path, capsys: Capsys) -> None:
    refused(score(capsys, predictions, base / "labels.csv", *words), named)


def test_b4_a_least_score_in_per_cent(predictions: Path, tmp_path: Path, capsys: Capsys) -> None:
    words = ("--least-score", "30", "--out", str(tmp_path / "tracks.csv"))
    says(run(capsys, "track", predictions, *words)[1], "least-score", "0.9")


def test_b4_a_least_track_score_in_per_cent(predictions: Path, tmp_path: Path, capsys: Capsys) -> None:
    words = ("--least-track-score", "30", "--out", str(tmp_path / "tracks.csv"))
    says(run(capsys, "track", predictions, *words)[1], "least-track-score", "0.9")


def test_b5_a_class_twice_in_the_mapping(base: Path, capsys: Capsys) -> None:
    (base / "mapping.yaml").write_text("classes:\n  Auto: vehicle\n  LKW: large_vehicle\n  Auto: pedestrian\n")
    refused(run(capsys, "doctor", base), "mapping.yaml", "Auto", "twice")


def test_b6_numbered_classes(base: Path) -> None:
    (base / "mapping.yaml").write_text("classes: {0: vehicle, 1: pedestrian}\n")
    (base / "labels.csv").write_text(table([row(number, label=str(number % 2)) for number in range(4)]))
    data = open_dataset(base)
    assert [str(data[number].boxes.label[0]) for number in range(4)] == ["vehicle", "pedestrian"] * 2


EXPERIMENTS = {
    "b7_two_blocks": (
        "name: mine\ndata: {path: x}\ntraining: {steps: 5}\nmethod: {name: supervised}\ntraining: {batch_size: 2}\n",
        "training.*twice",
    ),
    "b8_no_steps": ("name: mine\ndata: {path: x}\ntraining: {steps: 0}\n", "steps"),
    "b9_centimetres": (
        "name: mine\ndata: {path: x}\ndetector:\n  name: pointpillars\n  anchors:\n"
        "    vehicle: {size_m: [450, 190, 160], z_m: -1.0, positive_iou: 0.6, negative_iou: 0.45}\n",
        "centimetres",
    ),
}


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_b7_to_b9_experiments(name: str, tmp_path: Path) -> None:
    from farfield.experiments.schema import load_experiment

    text, named = EXPERIMENTS[name]
    (tmp_path / "mine.yaml").write_text(text)
    with pytest.raises(FarfieldError, match=f"(?s)mine.yaml.*{named}"):
        load_experiment(tmp_path / "mine.yaml")


# C. Numbers: kinds, sizes, locales.


def test_c1_float16_that_overflows(base: Path, capsys: Capsys) -> None:
    rows = sweep(0).astype(np.float64)
    rows[5, 0] = 70_000
    with np.errstate(over="ignore"):
        np.save(base / "0000.npy", rows.astype(np.float16))
    says(findings(capsys, base), "0000.npy", "float16")


def test_c2_big_endian(base: Path) -> None:
    np.save(base / "0000.npy", sweep(0).astype(">f4"))
    np.testing.assert_array_equal(open_dataset(base)[0].cloud().points_m, sweep(0)[:, :3])


def test_c3_on_its_side(base: Path) -> None:
    np.save(base / "0000.npy", sweep(0).T)
    np.testing.assert_array_equal(open_dataset(base)[0].cloud().points_m, sweep(0)[:, :3])


def test_c4_decimal_commas(base: Path, predictions: Path, capsys: Capsys) -> None:
    text = (base / "labels.csv").read_text()
    (base / "labels.csv").write_text(text.replace(",", ";").replace(".", ","))
    refused(score(capsys, predictions, base / "labels.csv"), "labels.csv", "semicolons", "commas")


def test_c5_underscores_in_numbers(base: Path, predictions: Path, capsys: Capsys) -> None:
    (base / "labels.csv").write_text(table([row(0, x="1_1.0"), *(row(number) for number in (1, 2, 3))]))
    refused(score(capsys, predictions, base / "labels.csv"), "labels.csv", "line 2", "1_1.0")


def test_c6_large_identities(base: Path) -> None:
    rows = [row(0, track="9007199254740992"), row(0, x=30, track="9007199254740993")]
    (base / "labels.csv").write_text(table(rows))
    with pytest.raises(FarfieldError, match=r"(?s)line 2.*track_id.*2\^53.*9007199254740992"):
        open_dataset(base)


def test_c7_broken_identities(base: Path) -> None:
    (base / "labels.csv").write_text(table([row(0, track="3.0"), row(1, track="3.7")]))
    with pytest.raises(FarfieldError, match=r"(?s)line 3.*track_id.*3\.7"):
        open_dataset(base)
    (base / "labels.csv").write_text(table([row(0, track="3.0")]))
    assert open_dataset(base)[0].boxes.track_id.tolist() == [3]


def test_c8_lost_zeros(base: Path, predictions: Path, capsys: Capsys) -> None:
    text = predictions.read_text()
    predictions.write_text("".join(line.removeprefix("000") for line in text.splitlines(keepends=True)))
    refused(score(capsys, predictions, base / "labels.csv"), "'0'", "'0000'", "zeros")


def test_c9_degrees(base: Path, predictions: Path, capsys: Capsys) -> None:
    (base / "labels.csv").write_text(table([row(number, yaw=str(90 * number)) for number in range(4)]))
    says(score(capsys, predictions, base / "labels.csv")[1], "degrees")


def test_c9_degrees_in_a_folder(base: Path, capsys: Capsys) -> None:
    """A brother: the same table where no score is computed."""
    (base / "labels.csv").write_text(table([row(number, yaw=str(90 * number)) for number in range(4)]))
    says(findings(capsys, base), "degrees")


# F. Text, archives, folders.


def test_f1_utf_16(base: Path, predictions: Path, capsys: Capsys) -> None:
    path = base / "labels.csv"
    path.write_text(path.read_text(), encoding="utf-16")
    refused(score(capsys, predictions, path), "labels.csv", "UTF-16")


def test_f2_marks_and_tabs(base: Path, predictions: Path, capsys: Capsys) -> None:
    path = base / "labels.csv"
    path.write_bytes(b"\xef\xbb\xbf" + path.read_text().replace(",", "\t").replace("\n", "\r\n").encode())
    refused(score(capsys, predictions, path), "labels.csv", "tabs")


def test_f3_an_archive_called_npy(base: Path) -> None:
    with (base / "0000.npy").open("wb") as handle:
        np.savez(handle, points=sweep(0))
    with pytest.raises(FarfieldError, match=r"(?s)0000\.npy.*zip"):
        open_dataset(base)[0].cloud()


def test_f4_a_pcd_called_bin(base: Path) -> None:
    (base / "0000.npy").unlink()
    lines = [" ".join(f"{value:.3f}" for value in point) for point in sweep(0)]
    head = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n"
    head += f"WIDTH {len(lines)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(lines)}\nDATA ascii\n"
    content = (head + "\n".join(lines) + "\n").encode()
    (base / "0000.bin").write_bytes(content + b"\n" * (-len(content) % 16))
    with pytest.raises(FarfieldError, match=r"(?s)0000\.bin.*PCD"):
        open_dataset(base)[0].cloud()


def test_f5_an_npy_called_bin(base: Path) -> None:
    (base / "0000.npy").rename(base / "0000.bin")
    with pytest.raises(FarfieldError, match=r"(?s)0000\.bin.*\.npy"):
        open_dataset(base)[0].cloud()


def test_f6_a_macs_forks(base: Path, capsys: Capsys) -> None:
    for path in sorted(base.iterdir()):
        (base / f"._{path.name}").write_bytes(b"\x00\x05\x16\x07\x00\x02\x00\x00Mac OS X        " + bytes(50))
    assert open_dataset(base).frame_ids == ("0000", "0001", "0002", "0003")
    assert findings(capsys, base) == ""


def test_f7_a_zip(base: Path, tmp_path: Path, capsys: Capsys) -> None:
    with zipfile.ZipFile(tmp_path / "drive.zip", "w") as archive:
        for path in base.iterdir():
            archive.write(path, path.name)
    refused(run(capsys, "doctor", tmp_path / "drive.zip"), "drive.zip", "unpack")


def test_f8_labels_and_predictions_exchanged(base: Path, predictions: Path, capsys: Capsys) -> None:
    says(score(capsys, base / "labels.csv", predictions)[1], "exchanged")


def test_the_page_lists_fifty() -> None:
    text = (Path(__file__).parent / "fifty.md").read_text()
    assert sum(line.startswith(tuple(f"| {letter}" for letter in "ABCDEF")) for line in text.splitlines()) == 50
