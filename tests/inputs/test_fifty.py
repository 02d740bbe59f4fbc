"""The fifty wrong inputs of ``fifty.md``: an error that names the fault, a warning that does, or the right reading."""

import json
import zipfile
from collections.abc import Sequence
from pathlib import Path
from shutil import copyfile

import numpy as np
import pytest
from PIL import Image

import farfield as ff
from farfield.api import open_dataset
from farfield.cli import main
from farfield.errors import FarfieldError

FRAMES = 4
HEADER = "frame,label,x,y,z,l,w,h,yaw_rad,track_id"
CAR = "4.4,1.9,1.6"
Capsys = pytest.CaptureFixture[str]


def sweep(number: int) -> np.ndarray:
    """A road and one car that drives a metre a frame: x, y, z, intensity."""
    random = np.random.default_rng(number)
    road = np.column_stack([random.uniform(3, 48, 900), random.uniform(-20, 20, 900), random.normal(-1.6, 0.03, 900)])
    car = random.uniform(-0.5, 0.5, (300, 3)) * (4.2, 1.8, 1.4) + (11 + number, 2, -0.75)
    points = np.concatenate([road, car])
    return np.column_stack([points, np.full(len(points), 0.3)]).astype(np.float32)


def row(
    frame: int | str, *, x: float | str | None = None, label: str = "vehicle", yaw: str = "0", track: str = "3"
) -> str:
    name = f"{frame:04d}" if isinstance(frame, int) else frame
    place = 11 + frame if x is None and isinstance(frame, int) else x
    return f"{name},{label},{place},2,-0.75,{CAR},{yaw},{track}"


def table(rows: Sequence[str], header: str = HEADER) -> str:
    return "\n".join([header, *rows]) + "\n"


@pytest.fixture
def base(tmp_path: Path) -> Path:
    folder = tmp_path / "drive"
    folder.mkdir()
    for number in range(FRAMES):
        np.save(folder / f"{number:04d}.npy", sweep(number))
    (folder / "labels.csv").write_text(table([row(number) for number in range(FRAMES)]))
    return folder


@pytest.fixture
def predictions(tmp_path: Path) -> Path:
    path = tmp_path / "predictions.csv"
    path.write_text(table([f"{row(number)},0.9" for number in range(FRAMES)], f"{HEADER},score"))
    return path


def run(capsys: Capsys, *words: Path | str) -> tuple[int, str]:
    """Exit status and all that was printed."""
    capsys.readouterr()
    try:
        status = main([str(word) for word in words])
    except SystemExit as end:
        status = int(end.code or 0)
    printed = capsys.readouterr()
    return status, printed.out + printed.err


def score(capsys: Capsys, predictions: Path, labels: Path, *words: str) -> tuple[int, str]:
    return run(capsys, "score", predictions, labels, "--replicates", "0", *words)


def findings(capsys: Capsys, folder: Path) -> str:
    """What the doctor warns of or fails for, a finding a line."""
    status, text = run(capsys, "doctor", folder, "--workers", "1", "--json", "-")
    if not text.startswith("{"):
        assert status == 1
        return text
    report = json.loads(text[: text.rindex("}") + 1])
    return "\n".join(
        f"{one['topic']}: {one['what']} {one['where']}" for one in report["findings"] if one["severity"] != "ok"
    )


def says(text: str, *words: str) -> None:
    for word in words:
        assert word.lower() in text.lower(), f"SILENT: expected {word!r} in: {text[-900:]}"


def refused(outcome: tuple[int, str], *words: str) -> None:
    status, text = outcome
    assert status == 1 or status == 2, f"SILENT: {text[-900:]}"
    says(text, *words)


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
    assert open_dataset(base)[0].boxes.track_id.tolist() == [9007199254740992, 9007199254740993]


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
    says(findings(capsys, base), "degrees")


# D. Geometry that contradicts itself.

AXES = [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]


def calibrated(
    base: Path, *, focal: float = 1000.0, scale: float = 1.0, pixels: tuple[int, int] = (1920, 1080)
) -> None:
    """A camera that looks ahead, and an image beside each sweep."""
    motion = np.array(AXES, dtype=float)
    motion[:3, :3] *= scale
    camera = {"matrix": [[focal, 0, 960], [0, focal, 540], [0, 0, 1]], "camera_T_lidar": motion.tolist()}
    (base / "calibration.yaml").write_text(json.dumps(camera | {"width": 1920, "height": 1080}))
    for number in range(FRAMES):
        Image.new("RGB", pixels, (90, 90, 90)).save(base / f"{number:04d}.jpg")


def poses(base: Path, *, x_m: Sequence[float] = (0, 1, 2, 3), quaternion: str = "0,0,0,1") -> Path:
    header = "sequence,frame,reference,time_ns,x_m,y_m,z_m,qx,qy,qz,qw,state,blind"
    rows = [f"drive,{number:04d},lidar,,{x},0,0,{quaternion},placed," for number, x in enumerate(x_m)]
    path = base.parent / "drive.csv"
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def test_a_sound_camera_is_not_warned_of(base: Path, capsys: Capsys) -> None:
    calibrated(base)
    assert findings(capsys, base) == ""


def test_d1_an_image_of_another_size(base: Path, capsys: Capsys) -> None:
    calibrated(base, pixels=(320, 240))
    says(findings(capsys, base), "320 x 240", "1920 x 1080")


def test_d2_a_focal_length_in_millimetres(base: Path, capsys: Capsys) -> None:
    calibrated(base, focal=4.0)
    says(findings(capsys, base), "focal", "pixels")


def test_d3_no_rotation(base: Path) -> None:
    calibrated(base, scale=2.0)
    with pytest.raises(FarfieldError, match=r"(?s)calibration.yaml.*rotation"):
        _ = open_dataset(base)[0].cameras


def test_d4_a_quaternion_of_zeros(base: Path) -> None:
    with pytest.raises(FarfieldError, match=r"(?s)line 2.*unit quaternion"):
        _ = open_dataset(base, poses=poses(base, quaternion="0,0,0,0"))[1].world_T_frame


def in_drive(predictions: Path) -> Path:
    """The same table with the name of the sequence."""
    lines = predictions.read_text().splitlines()
    path = predictions.with_name("in_drive.csv")
    path.write_text("\n".join([f"sequence,{lines[0]}", *(f"drive,{line}" for line in lines[1:])]) + "\n")
    return path


def test_d5_w_first(base: Path, predictions: Path, tmp_path: Path, capsys: Capsys) -> None:
    words = ("--data", base, "--poses", poses(base, quaternion="1,0,0,0"), "--out", tmp_path / "tracks.csv")
    says(run(capsys, "track", in_drive(predictions), *words)[1], "upside down")


def test_d6_a_jump(base: Path, predictions: Path, tmp_path: Path, capsys: Capsys) -> None:
    words = ("--data", base, "--poses", poses(base, x_m=(0, 1, 1002, 3)), "--out", tmp_path / "tracks.csv")
    says(run(capsys, "track", in_drive(predictions), *words)[1], "poses", "0002", "jump")


def test_d7_kittis_motion_inverted(base: Path, tmp_path: Path, capsys: Capsys) -> None:
    calibrated(base)
    assert main(["convert", str(base), str(tmp_path / "kitti"), "--to", "kitti"]) == 0
    for path in (tmp_path / "kitti" / "training" / "calib").glob("*.txt"):
        lines = path.read_text().splitlines()
        at = next(number for number, line in enumerate(lines) if line.startswith("Tr_velo_to_cam"))
        motion = np.array(lines[at].split()[1:], dtype=float).reshape(3, 4)
        lines[at] = "Tr_velo_to_cam: " + " ".join(map(str, np.column_stack([motion[:, :3].T, motion[:, 3]]).ravel()))
        path.write_text("\n".join(lines) + "\n")
    says(findings(capsys, tmp_path / "kitti"), "calibration", "invert")


# E. Tracks and time.


def test_e1_an_identity_twice_in_a_frame(base: Path, predictions: Path, capsys: Capsys) -> None:
    (base / "labels.csv").write_text(table([*map(row, range(4)), row(1, x=30)]))
    refused(score(capsys, predictions, base / "labels.csv", "--protocol", "tracking"), "0001", "3")


def test_e2_an_identity_of_two_classes(base: Path, capsys: Capsys) -> None:
    labels = ["vehicle", "vehicle", "bicycle", "bicycle"]
    (base / "labels.csv").write_text(table([row(number, label=label) for number, label in enumerate(labels)]))
    says(findings(capsys, base), "track 3", "bicycle", "vehicle")


def test_e3_an_identity_that_jumps(base: Path, capsys: Capsys) -> None:
    (base / "labels.csv").write_text(table([row(0), row(1), row(2, x=112), row(3, x=113)]))
    says(findings(capsys, base), "track 3", "0002", "99 m")


def test_e4_a_heading_that_flips(base: Path, capsys: Capsys) -> None:
    (base / "labels.csv").write_text(table([row(number, yaw=("0", "3.14159")[number % 2]) for number in range(4)]))
    says(findings(capsys, base), "track 3", "turns")


def test_e5_gps_and_utc(base: Path, capsys: Capsys) -> None:
    text = (base / "labels.csv").read_text()
    for number in range(FRAMES):
        name = str(1_700_000_000_000_000_000 + number * 100_000_000 + (number > 1) * 18_000_000_000)
        (base / f"{number:04d}.npy").rename(base / f"{name}.npy")
        text = text.replace(f"{number:04d},", f"{name},")
    (base / "labels.csv").write_text(text)
    says(findings(capsys, base), "stamps", "18.1 s", "GPS")


def stamps(folder: Path, name: str, lines: Sequence[str]) -> None:
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")


def test_e6_zones(tmp_path: Path, capsys: Capsys) -> None:
    folder = tmp_path / "stamps"
    stamps(folder, "lidar", [f"2024-05-01T12:00:{number:02d}.500+02:00" for number in range(20)])
    stamps(folder, "camera", [f"2024-05-01T10:00:{number:02d}.504Z" for number in range(20)])
    status, text = run(capsys, "sync", folder, "--out", tmp_path / "out")
    assert status == 0, text
    figures = json.loads((tmp_path / "out" / "sync.json").read_text())
    assert "20" in text
    assert "4.0" in text or "4.0" in json.dumps(figures)


def test_e7_stamps_of_32_bits(tmp_path: Path, capsys: Capsys) -> None:
    folder, start = tmp_path / "stamps", 3_900_000_000
    times = [(start + number * 100_000_000) % 2**32 for number in range(20)]
    stamps(folder, "lidar", [str(time) for time in times])
    stamps(folder, "camera", [str(time + 2_000_000) for time in times])
    text = run(capsys, "sync", folder, "--unit", "ns", "--out", tmp_path / "out")[1]
    says(text, "lidar", "backward", "32 bit")


def test_e8_velocities_in_kilometres_an_hour(base: Path, capsys: Capsys) -> None:
    rows = [f"{row(number)},36,0" for number in range(FRAMES)]
    text = table(rows, f"{HEADER},vx_m_s,vy_m_s")
    for number in range(FRAMES):
        name = str(1_700_000_000_000_000_000 + number * 100_000_000)
        (base / f"{number:04d}.npy").rename(base / f"{name}.npy")
        text = text.replace(f"{number:04d},", f"{name},")
    (base / "labels.csv").write_text(text)
    says(findings(capsys, base), "velocit", "km/h")


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
    with pytest.raises(FarfieldError, match=r"(?s)0000\.npy.*npz"):
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
    assert ff.__name__ == "farfield"
