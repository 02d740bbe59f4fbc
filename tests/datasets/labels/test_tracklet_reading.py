"""Tracklets of KITTI, CVAT and Datumaro: sizes and places by who wrote them, boxes on the sweeps that are meant."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.datasets.labels import label_format
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.pcd import write_pcd
from farfield.files.tracklets import CONVENTIONS
from farfield.inspection.doctor import examine

SIZE, CENTRE = (4.4, 1.8, 1.5), (10.0, 2.0, -0.95)
TOOL = "<amt_occlusion>-1</amt_occlusion><amt_occlusion_kf>-1</amt_occlusion_kf><amt_border_kf>-1</amt_border_kf>"
STAMP = "2011-09-26 13:02:25.000000000\n"


def tracklets(convention: str, *, marks: bool, first: int = 0, label: str = "Car", frames: int = 3) -> str:
    """A car of SIZE at CENTRE, 1 m further in each frame, as a writer of the convention has it."""
    meaning = CONVENTIONS[convention]
    sizes = "".join(f"<{name}>{value}</{name}>" for name, value in zip(meaning.sizes, SIZE, strict=True))
    z = CENTRE[2] - (SIZE[2] / 2 if meaning.bottom else 0)
    version = f"<item_version>{2 if meaning.bottom else 0}</item_version>" if marks else ""
    poses = "".join(
        f"<item><tx>{CENTRE[0] + step}</tx><ty>{CENTRE[1]}</ty><tz>{z}</tz><rx>0</rx><ry>0</ry><rz>0</rz>"
        f"{TOOL if marks and not meaning.bottom else ''}</item>"
        for step in range(frames)
    )
    item = f"<item><objectType>{label}</objectType>{sizes}<first_frame>{first}</first_frame>"
    return f"<b><tracklets>{item}<poses>{version}{poses}</poses></item></tracklets></b>"


def car_points(step: int, *, count: int = 400) -> np.ndarray:
    """Points on the surface of the car of a frame."""
    rng = np.random.default_rng(step)
    unit = rng.uniform(-0.5, 0.5, (count, 3))
    axis = rng.integers(0, 3, count)
    unit[np.arange(count), axis] = np.where(rng.random(count) < 0.5, -0.49, 0.49)
    return unit * SIZE + np.array(CENTRE) + [step, 0, 0]


def drive(root: Path, stems: list[str], text: str, *, points: bool = False, raw: bool = False) -> Path:
    """A drive: as CVAT exports it, or as KITTI's raw data with its stamps."""
    folder = root / "drive"
    data = folder / "velodyne_points" / "data"
    data.mkdir(parents=True)
    for step, stem in enumerate(stems):
        rows = car_points(step) if points else np.array([[1.0, 1, 1], [60, 3, 1]])
        if raw:
            np.column_stack([rows, np.full(len(rows), 0.5)]).astype("<f4").tofile(data / f"{stem}.bin")
        else:
            write_pcd(data / f"{stem}.pcd", dict(zip("xyz", rows.astype(np.float32).T, strict=True)))
    if raw:
        (data.parent / "timestamps.txt").write_text(STAMP * 20)
    (folder / "tracklet_labels.xml").write_text(text)
    return root


STEMS = ["0000000000", "0000000001", "0000000002"]


@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize("convention", ["kitti", "cvat", "datumaro"])
@pytest.mark.parametrize("evidence", ["marks", "list", "points", "shapes", "flag"])
def test_the_car_keeps_its_shape_whoever_wrote_it(tmp_path: Path, convention: str, evidence: str, raw: bool) -> None:
    if evidence == "list" and convention == "kitti":
        pytest.skip("KITTI writes no list")
    text = tracklets(convention, marks=evidence == "marks")
    root = drive(tmp_path, STEMS, text, points=evidence == "points", raw=raw)
    if evidence == "list":
        names = "".join(f"{row} {stem}\n" for row, stem in enumerate(STEMS))
        (root / "drive" / "frame_list.txt").write_text(names)
    data = open_dataset(root, **({"tracklets": convention} if evidence == "flag" else {}))
    assert data.name == ("kitti_raw" if raw else "cvat")
    for step, frame in enumerate(data):
        np.testing.assert_allclose(frame.boxes.size_m[0], SIZE)
        np.testing.assert_allclose(frame.boxes.centre_m[0], CENTRE + np.array([step, 0, 0]), atol=1e-9)
    if convention != "kitti" or evidence != "marks":
        (sentence,) = data.assumptions
        assert f"is read as {convention}'s" in sentence
        assert "--tracklets" in sentence
        assert any(convention in finding.what for finding in examine(data).findings if finding.topic == "reading")
    else:
        assert data.assumptions == ()


def test_points_decide_whatever_is_in_doubt_about_times_and_intensities(tmp_path: Path) -> None:
    """What a flag of the clouds overrules does not keep tracklets from being read onto them."""
    root = drive(tmp_path, STEMS, tracklets("cvat", marks=False))
    for step, stem in enumerate(STEMS):
        points = dict(zip("xyz", car_points(step).astype(np.float32).T, strict=True))
        strength = np.full(400, 0.5, np.float32)
        strength[0] = 90.0  # an outlier beside fractions: 255 by the flag
        extra = {"intensity": strength, "t": np.linspace(0, 1, 400, dtype=np.float32)}  # a share of the turn
        write_pcd(root / "drive" / "velodyne_points" / "data" / f"{stem}.pcd", points | extra)
    for flags in ({"point_times": "none"}, {"intensity_scale": 255}):
        with pytest.raises(FileFormatError, match=r"--point-times|--intensity-scale"):
            open_dataset(root, **flags)[0].cloud()
    data = open_dataset(root, point_times="none", intensity_scale=255)
    assert data[0].cloud().column("intensity").max() == pytest.approx(90 / 255)
    np.testing.assert_allclose(data[0].boxes.size_m[0], SIZE)
    assert "the points in the boxes" in data.assumptions[0]


@pytest.mark.parametrize("convention", ["kitti", "cvat", "datumaro"])
def test_an_edit_is_written_as_the_file_means_its_numbers(tmp_path: Path, convention: str) -> None:
    root = drive(tmp_path, STEMS, tracklets(convention, marks=True))
    data = open_dataset(root)
    labels = label_format(data)
    key, path = data.keys[1], labels.path(data.keys[1])
    (car,) = labels.parse(path.read_bytes(), path, [key])[key]
    np.testing.assert_allclose(car.box[:6], (11.0, 2.0, -0.95, *SIZE))
    box = (11.0, 2.5, -0.9, 4.6, 1.9, 1.6, 0.1)
    boxes = {other: labels.parse(path.read_bytes(), path, [other])[other] for other in data.keys}
    boxes = {other: [replace(rows[0], box=(*rows[0].box[:3], *box[3:6], 0.1))] for other, rows in boxes.items()}
    boxes[key] = [replace(boxes[key][0], box=box), replace(car, id="new", track="9", box=(30.0, *box[1:]))]
    path.write_bytes(labels.render(path.read_bytes(), path, boxes))
    edited = open_dataset(root)[1].boxes
    np.testing.assert_allclose(edited.size_m, [box[3:6]] * 2)
    np.testing.assert_allclose(edited.centre_m, [box[:3], (30.0, *box[1:3])])


def test_a_pose_that_only_fills_a_gap_is_no_box(tmp_path: Path) -> None:
    """Datumaro puts poses outside the image where an object is not there."""
    text = tracklets("cvat", marks=True).replace("<amt_occlusion>", "<truncation>2</truncation><amt_occlusion>", 1)
    data = open_dataset(drive(tmp_path, STEMS, text))
    assert [len(frame.boxes) for frame in data] == [0, 1, 1]


@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize(
    ("stems", "names"),
    [
        (["0000000005", "0000000006", "0000000007"], "{stem}"),
        (["000001", "000002", "000003"], "{stem}.pcd"),
        (["frame_05", "frame_06", "frame_07"], "velodyne_points/data/{stem}.bin"),
        (["1.5", "1.6", "1.7"], "{stem}"),
    ],
)
def test_boxes_stand_on_the_sweep_that_the_list_names(tmp_path: Path, stems: list[str], names: str, raw: bool) -> None:
    root = drive(tmp_path, stems, tracklets("cvat", marks=True), raw=raw)
    lines = [f"{row} {names.format(stem=stem)}\n" for row, stem in enumerate(reversed(stems))]
    (root / "drive" / "frame_list.txt").write_text("".join(lines))
    data = open_dataset(root)
    assert [frame.boxes.centre_m[0, 0] for frame in data] == [12.0, 11.0, 10.0]
    labels = label_format(data)
    path = labels.path(data.keys[0])
    assert labels.parse(path.read_bytes(), path, [data.keys[0]])[data.keys[0]][0].box[0] == 12.0


@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize(
    "stems",
    [
        ["0000000005", "0000000006", "0000000007"],  # no frame is called like a sweep
        ["000001", "000002", "000003"],  # two are, wrongly
        ["000000", "000002", "000004"],  # every second sweep
        ["frame_05", "frame_06", "frame_07"],
        ["a", "b"],  # more frames than sweeps
        ["1", "01", "2"],
    ],
)
def test_boxes_of_sweeps_that_are_not_known_are_refused(tmp_path: Path, stems: list[str], raw: bool) -> None:
    data = open_dataset(drive(tmp_path, stems, tracklets("cvat", marks=True), raw=raw))
    with pytest.raises(DatasetError, match=r"tracklet_labels\.xml.*frame_list\.txt"):
        data[0].boxes  # noqa: B018


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("0 0000000000\n1 0000000001\n", DatasetError),  # frame 2 has boxes and no line
        ("0 0000000000\n1 0000000001\n2 0000000009\n", DatasetError),  # a sweep that is not there
        ("0 0000000000\n0 0000000001\n", FileFormatError),
        ("0 0000000000\n1 0000000000\n", FileFormatError),
        ("0000000000\n", FileFormatError),
        ("zero 0000000000\n", FileFormatError),
    ],
)
def test_a_list_that_does_not_fit_is_refused(tmp_path: Path, text: str, error: type[Exception]) -> None:
    root = drive(tmp_path, STEMS, tracklets("cvat", marks=True))
    (root / "drive" / "frame_list.txt").write_text(text)
    with pytest.raises(error, match=r"frame_list\.txt"):
        open_dataset(root)[0].boxes  # noqa: B018


def test_some_sweeps_of_kitti_s_own_drive_keep_their_boxes(tmp_path: Path) -> None:
    data = open_dataset(drive(tmp_path, ["0000000001", "0000000002"], tracklets("kitti", marks=True), raw=True))
    assert [frame.boxes.centre_m[0, 0] for frame in data] == [11.0, 12.0]


def test_the_flag_overrules_and_is_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = drive(tmp_path, STEMS, tracklets("cvat", marks=True))
    assert open_dataset(root, tracklets="kitti")[0].boxes.size_m[0].tolist() == [1.5, 1.8, 4.4]
    with pytest.raises(ConfigError, match="kitti, cvat, datumaro"):
        open_dataset(root, tracklets="other")
    target = tmp_path.with_name(f"{tmp_path.name}-boxes.csv")
    assert main(["convert", str(root), str(target), "--to", "boxes-csv"]) == 0
    assert "is read as cvat's" in capsys.readouterr().err
    assert "4.4,1.8,1.5" in target.read_text()


def test_kitti_s_own_drive_is_read_as_published(shared_real: Path) -> None:
    for format in ("kitti_raw", "cvat"):
        data = open_dataset(shared_real / "kitti_raw", format=format)
        assert data.assumptions == ()
        assert {len(frame.boxes) for frame in data} == {5}
