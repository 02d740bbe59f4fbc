"""Wrong data, wrong names and wrong places end with a message and exit status 1, never with a figure."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import farfield as ff
from farfield.api import open_dataset
from farfield.cli import main
from farfield.datasets.base import Dataset
from farfield.datasets.convert import convert
from farfield.datasets.folder import write_boxes
from farfield.datasets.memory import CloudFiles
from farfield.errors import ConfigError, DatasetError
from farfield.evaluation import detect, detections_from_boxes
from farfield.frame import Annotation, Boxes, Cloud, Frame
from farfield.inspection.doctor import examine
from farfield.vocabulary.classes import closest_class

CARS = np.array([[12.0, 0.0, -1.2], [25.0, 4.0, -1.2], [40.0, -5.0, -1.2]])


def cars(label: str = "vehicle") -> Boxes:
    return Boxes(centre_m=CARS, size_m=np.tile([4.4, 1.8, 1.5], (3, 1)), yaw_rad=np.zeros(3), label=[label] * 3)


def cloud(seed: int = 0) -> np.ndarray:
    random = np.random.default_rng(seed)
    ground = np.column_stack(
        [random.uniform(3, 60, 4000), random.uniform(-12, 12, 4000), random.normal(-2, 0.03, 4000)]
    )
    parts = [ground, *(random.uniform(-1, 1, (400, 3)) * [2.2, 0.9, 0.75] + place for place in CARS)]
    points = np.concatenate(parts)
    return np.column_stack([points, np.full(len(points), 0.3)]).astype(np.float32)


def own(folder: Path, label: str = "vehicle", frames: int = 2, annotated: int = 2) -> Path:
    """A folder of clouds, of which some have boxes of a class."""
    folder.mkdir(parents=True)
    for number in range(frames):
        np.save(folder / f"{number:03d}.npy", cloud(number))
        if number < annotated:
            write_boxes(folder / f"{number:03d}.json", cars(label))
    return folder


class TestColumns:
    """Line 1: one flag everywhere, and no reader that takes four for granted."""

    def test_the_flag_is_in_every_verb_that_reads_clouds(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        folder = tmp_path / "own"
        folder.mkdir()
        np.random.default_rng(1).normal(size=(500, 4)).astype(np.float32).tofile(folder / "a.bin")
        main(["doctor", str(folder), "--columns", "5", "--json", "-"])
        report = json.loads(capsys.readouterr().out)
        assert report["facts"]["clouds"]["lidar"]["points"] == 400
        assert main(["convert", str(folder), str(tmp_path / "out"), "--to", "kitti", "--columns", "5"]) == 0
        written = next((tmp_path / "out" / "training" / "velodyne").glob("*.bin"))
        assert written.stat().st_size == 400 * 16
        assert len(CloudFiles([folder / "a.bin"], bin_columns=5)[0].cloud()) == 400

    @pytest.mark.parametrize("layout", ["tracking", "raw"])
    def test_kittis_other_layouts_look_too(self, tmp_path: Path, layout: str) -> None:
        rows = np.column_stack([cloud(), np.arange(len(cloud())) % 32]).astype(np.float32)
        drive = tmp_path / "2011_09_26" / "2011_09_26_drive_0001_sync" / "velodyne_points"
        folder = tmp_path / "training" / "velodyne" / "0000" if layout == "tracking" else drive / "data"
        folder.mkdir(parents=True)
        rows.tofile(folder / ("000000.bin" if layout == "tracking" else "0000000000.bin"))
        for name in ("timestamps", "timestamps_start", "timestamps_end") if layout == "raw" else ():
            (drive / f"{name}.txt").write_text("2011-09-26 13:02:25.951199337\n")
        data = open_dataset(tmp_path)
        assert data.name == f"kitti_{layout}"
        np.testing.assert_array_equal(data[0].cloud().points_m, rows[:, :3])


class TestClasses:
    """Lines 4 and 7: names that nobody knows, classes without a box."""

    def test_the_doctor_names_them(self, tmp_path: Path) -> None:
        report = examine(open_dataset(own(tmp_path / "own", "Auto")))
        (finding,) = [finding for finding in report.findings if finding.topic == "class names"]
        assert finding.severity == "fail"
        assert "'Auto' (6)" in finding.what
        assert "vehicle" in finding.what
        assert "relabel=Auto:vehicle" in finding.fix

    def test_the_doctor_guesses(self, tmp_path: Path) -> None:
        report = examine(open_dataset(own(tmp_path / "own", "Vehicel")))
        (finding,) = [finding for finding in report.findings if finding.topic == "class names"]
        assert "did you mean Vehicel: vehicle?" in finding.what
        assert closest_class("LKW", ["vehicle"]) == ""

    def test_training_without_one_box_stops(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        pytest.importorskip("torch")
        folder = own(tmp_path / "own", "Auto")
        words = [f"data.path={folder}", "data.split=null", "training.steps=1"]
        options = [word for each in words for word in ("-o", each)]
        assert main(["train", "pointpillars-kitti", *options, "--out", str(tmp_path / "run")]) == 1
        said = capsys.readouterr().err
        assert "Auto (6)" in said
        assert "data.aliases={Auto: vehicle}" in said

    def test_evaluate_refuses_classes_that_do_not_meet(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        pytest.importorskip("torch")
        folder = str(own(tmp_path / "own", "Auto"))
        words = ["evaluate", "pointpillars-cirrus-sim", folder, "--no-report", "--out", str(tmp_path / "out")]
        assert main(words) == 1
        assert "relabel=Auto:vehicle" in capsys.readouterr().err
        assert main([*words, "--label", "Car"]) == 1
        assert main([*words, "--options", "relabel=Auto:vehicle", "--replicates", "0"]) == 0

    def test_advice_on_a_class_that_nobody_has_can_be_followed(self, tmp_path: Path) -> None:
        data = open_dataset(own(tmp_path / "own"))
        found = replace(detect(nothing, data), classes=("vehicle", "pedestrian"))
        with pytest.raises(ConfigError, match=r"got Auto\. Take an annotated one: --label vehicle$"):
            found.check_label("dds", "Auto")
        with pytest.raises(ConfigError, match="relabel=vehicle:boat"):
            replace(found, classes=("boat",)).check_label("dds", "vehicle")

    def test_a_class_without_boxes_is_refused(self, tmp_path: Path) -> None:
        data = open_dataset(own(tmp_path / "own"))
        with pytest.raises(ConfigError, match=r"vehicle \(6\)"):
            ff.evaluate(nothing, data, label="pedestrian")


def nothing(frame: Frame | Cloud) -> Boxes:
    """A detector that finds nothing."""
    del frame
    return Boxes.empty(scored=True)


class TestFrames:
    """Lines 5 and 7: frames without a partner or an annotation."""

    def test_frames_without_annotation_are_counted(self, tmp_path: Path) -> None:
        found = detect(nothing, open_dataset(own(tmp_path / "own", annotated=1)), annotated_only=True)
        assert "1 of 2 frames are not annotated and do not count" in found.notes

    def test_predictions_of_other_frames_are_not_dropped(self, tmp_path: Path) -> None:
        data, scored = open_dataset(own(tmp_path / "own")), cars().replace(score=np.ones(3))
        with pytest.raises(ConfigError, match="Sequence and frame must be the same text"):
            detections_from_boxes({("own", "0"): scored}, data)
        assert any(
            "1 of 2 frames" in note
            for note in detections_from_boxes({("own", "0"): scored, ("own", "000"): scored}, data).notes
        )

    def test_annotated_frames_without_a_box_give_exit_status_1(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        pytest.importorskip("torch")
        folder = own(tmp_path / "own", annotated=0)
        write_boxes(folder / "000.json", Boxes.empty())
        words = ["evaluate", "pointpillars-cirrus-sim", str(folder), "--no-report", "--out", str(tmp_path / "out")]
        assert main([*words, "--replicates", "0"]) == 1
        said = capsys.readouterr().out
        assert "no box is annotated" in said
        assert "1 of 2 frames are not annotated" in said


class TestPlaces:
    """Line 6: nothing is written over what is read."""

    @pytest.mark.parametrize(("to", "name"), [("kitti", ""), ("cirrus", ""), ("boxes-csv", "labels.csv")])
    def test_convert_leaves_its_source(self, tmp_path: Path, to: str, name: str) -> None:
        folder = own(tmp_path / "own", annotated=0)
        (folder / "labels.csv").write_text("frame,label,x,y,z,l,w,h,yaw_rad\n000,vehicle,9,0,-1,4,2,1.5,0\n")
        before = sorted(path.name for path in folder.iterdir())
        data: Dataset = open_dataset(folder)
        with pytest.raises(ConfigError, match="which is read"):
            convert(data, folder / name, to=to)  # type: ignore[arg-type]
        assert sorted(path.name for path in folder.iterdir()) == before

    def test_predict_leaves_the_labels(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        pytest.importorskip("torch")
        folder = own(tmp_path / "own", annotated=0)
        text = "frame,label,x,y,z,l,w,h,yaw_rad\n000,vehicle,9,0,-1,4,2,1.5,0\n"
        (folder / "labels.csv").write_text(text)
        assert main(["predict", "pointpillars-cirrus-sim", str(folder), "--out", str(folder / "labels.csv")]) == 1
        assert (folder / "labels.csv").read_text() == text
        assert "which is read" in capsys.readouterr().err

    def test_track_leaves_the_detections(self, tmp_path: Path) -> None:
        path = tmp_path / "a.csv"
        path.write_text("frame,label,x,y,z,l,w,h,yaw_rad,score\n000,vehicle,9,0,-1,4,2,1.5,0,0.5\n")
        assert main(["track", str(path), "--out", str(path)]) == 1
        assert "track_id" not in path.read_text()

    def test_evaluations_of_two_detectors_stand_apart(self, tmp_path: Path) -> None:
        from farfield.evaluation.record import default_folder

        first, other = open_dataset(own(tmp_path / "data")), open_dataset(own(tmp_path / "x" / "data", frames=1))
        runs = tmp_path / "runs"
        a, b = default_folder("a", "1", first, runs=runs), default_folder("b", "2", first, runs=runs)
        assert a != b
        a.mkdir(parents=True)
        subject = {"detector_digest": "1", "fingerprint": first.fingerprint()}
        (a / "evaluation.json").write_text(json.dumps({"results": {"lidar": {"subject": subject}}}))
        assert default_folder("a", "1", first, runs=runs) == a
        assert default_folder("a", "1", other, runs=runs) != a
        assert default_folder("a", "2", first, runs=runs) != a


class TestFormats:
    """Line 8a: what opens as something else, or not at all."""

    def test_a_radar_is_no_kitti(self, shared_real: Path) -> None:
        with pytest.raises(DatasetError, match="format=tj4dradset"):
            open_dataset(shared_real / "tj4dradset", format="kitti")

    def test_doubtful_columns_are_named(self, shared_real: Path) -> None:
        report = examine(open_dataset(shared_real / "sustechpoints"))
        (said,) = [finding.what for finding in report.findings if "impossible numbers" in finding.what]
        assert "timestamp" in said
        assert "ring" in said

    def test_labels_alone_open(self, shared_real: Path) -> None:
        data = open_dataset(shared_real / "argoverse2_tracks")
        assert (data.name, len(data)) == ("argoverse2", 157)
        assert data[0].annotation is not None
        assert not data[0].clouds
        assert "EGO_VEHICLE" not in set(data[0].annotation.original_label or ())

    def test_an_organised_cloud_opens_and_counts_what_is_missing(self, shared_real: Path) -> None:
        assert open_dataset(shared_real / "pandaset")[0].cloud().missing == 41_489


def test_annotation_is_kept() -> None:
    """A frame whose annotation holds no box is annotated still: it counts against false detections."""
    frame = Frame.of(Cloud(cloud()[:, :3].copy()), Annotation(boxes=Boxes.empty()))
    assert detect(nothing, [frame], annotated_only=True).annotations
