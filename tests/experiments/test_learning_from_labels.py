"""farfield adapt --learn-from: labels of a few sweeps teach; which are refused, and what of them reaches the loss."""

import os
import shutil
import signal
import subprocess
import sys
import time
import weakref
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml

torch = pytest.importorskip("torch")

sys.path.append(str(Path(__file__).parents[1] / "detectors"))  # the small detectors of its small.py

from small import SMALL

import farfield as ff
from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.datasets.folder import write_boxes
from farfield.datasets.joined import joined, roots_of
from farfield.datasets.maps import AnnotatedField
from farfield.datasets.recipes import replay
from farfield.datasets.separate_labels import labelled_by_files
from farfield.detectors.weights import load_weights
from farfield.errors import ConfigError, DatasetError, FarfieldError
from farfield.evaluation.leakage import seen_in_training
from farfield.experiments.adapting import dry_run
from farfield.experiments.plan import Plan
from farfield.experiments.schema import Experiment
from farfield.files.boxes_csv import BoxRows, write_boxes_csv
from farfield.frame import Boxes, Frame

QUICK = ("training.workers=0", "training.precision=fp32", "training.threads=1", "training.log_every_steps=1")
CHOICES = {"steps": 2, "rounds": 1, "source_frames": 4, "overrides": QUICK}
CAR_M, LORRY_M = (4.5, 1.9, 1.6), (9.0, 2.6, 3.0)


class Streets(NamedTuple):
    """Folders of sweeps: cars that a detector learnt from, and a user's own, with lorries, whose labels lie apart."""

    start: Path
    source: Path
    sweeps: Path
    truth: Path


def boxes_of(seed: int, size_m: tuple[float, float, float]) -> Boxes:
    rng = np.random.default_rng(seed)
    x = np.array([10.0, 24.0, 38.0, 52.0]) + rng.uniform(-2, 2, 4)
    y = np.array([-8.0, 8.0, -8.0, 8.0]) + rng.uniform(-3, 3, 4)
    centre = np.column_stack([x, y, np.full(4, size_m[2] / 2 - 1.9)])
    return Boxes(centre_m=centre, size_m=np.tile(size_m, (4, 1)), yaw_rad=np.zeros(4), label=["vehicle"] * 4)


def sweep_of(seed: int, boxes: Boxes) -> np.ndarray:
    """A flat road and the surfaces of the boxes, 1,600 points."""
    rng = np.random.default_rng(seed)
    road = np.column_stack([rng.uniform(0, 64, 800), rng.uniform(-20, 20, 800), np.full(800, -1.9)])
    unit = rng.uniform(-0.5, 0.5, (len(boxes), 200, 3))
    side = rng.integers(0, 3, (len(boxes), 200))
    np.put_along_axis(unit, side[..., None], np.sign(np.take_along_axis(unit, side[..., None], 2)) * 0.5, 2)
    bodies = (unit * boxes.size_m[:, None] + boxes.centre_m[:, None]).reshape(-1, 3)
    return np.concatenate([road, bodies]).astype(np.float32)


def write_table(path: Path, boxes: dict[str, Boxes], label: str = "vehicle") -> Path:
    joined = Boxes.concatenate(list(boxes.values()))
    frame = np.repeat(list(boxes), [len(part) for part in boxes.values()])
    columns = {"centre_m": joined.centre_m, "size_m": joined.size_m, "yaw_rad": joined.yaw_rad}
    write_boxes_csv(path, BoxRows(frame=frame, label=np.full(len(joined), label), **columns))
    return path


def street(folder: Path, seed: int, frames: int, size_m: tuple[float, float, float]) -> dict[str, Boxes]:
    folder.mkdir()
    boxes = {f"{number:04d}": boxes_of(seed + number, size_m) for number in range(frames)}
    for number, (name, of_frame) in enumerate(boxes.items()):
        np.save(folder / f"{name}.npy", sweep_of(seed + number, of_frame))
    return boxes


@pytest.fixture(scope="module")
def streets(tmp_path_factory: pytest.TempPathFactory) -> Streets:
    home = tmp_path_factory.mktemp("streets")
    write_table(home / "labels.csv", street(home / "cars", 100, 8, CAR_M))
    shutil.move(home / "labels.csv", home / "cars" / "labels.csv")
    truth = write_table(home / "truth.csv", street(home / "lorries", 200, 10, LORRY_M))
    tree = {
        "name": "tiny",
        "data": {"path": str(home / "cars"), "clouds": ["lidar"]},
        "detector": {"name": "pointpillars", **SMALL["pointpillars"].settings, "score_threshold": 0.0, "max_boxes": 20},
        "augmentation": {"scale": 0.0},
        "training": {
            "steps": 50,
            "batch_size": 4,
            "learning_rate": 6e-3,
            "precision": "fp32",
            "threads": 1,
            "workers": 0,
        },
    }
    Plan(Experiment.model_validate(tree), home / "run").run()
    return Streets(home / "run", home / "cars", home / "lorries", truth)


def some_of(truth: Path, path: Path, *frames: int) -> Path:
    """The labels of some frames."""
    header, *rows = truth.read_text().splitlines()
    names = [f"{number:04d}" for number in frames]
    column = header.split(",").index("frame")
    path.write_text("\n".join([header, *(row for row in rows if row.split(",")[column] in names)]) + "\n")
    return path


def adapted(streets: Streets, out: Path, learn_from: Any, **changes: Any) -> Any:
    return ff.adapt(
        streets.start, streets.sweeps, out=out, source=streets.source, learn_from=learn_from, **CHOICES | changes
    )


def test_few_labelled_and_other_sweeps_teach_and_the_weights_say_how_many(streets: Streets, tmp_path: Path) -> None:
    labels = some_of(streets.truth, tmp_path / "two.csv", 1, 4)
    done = adapted(streets, tmp_path / "out", labels)
    provenance = load_weights(done.weights)[1]
    assert provenance["adapted"]["sweeps"] == {"labelled": 2, "unlabelled": 8, "drives": 1}
    assert {name: stream["frames"] for name, stream in provenance["streams"].items()} == {
        "source": 4,
        "target": 8,
        "labels": 2,
    }
    experiment = yaml.safe_load((tmp_path / "out" / "round-1" / "experiment.yaml").read_text())
    assert experiment["method"]["labels"] is True
    assert experiment["training"]["batch_size"] == 4
    log = (tmp_path / "out" / "round-1" / "log.jsonl").read_text()
    assert '"labels_' in log
    assert '"gradient_labels"' in log
    assert "2 sweeps of 1 drive with 8 labelled boxes" in done.page.read_text()
    assert set(done.after.boxes) == {("lorries", f"{n:04d}") for n in range(10) if n not in (1, 4)}
    data = open_dataset(streets.sweeps)
    assert seen_in_training(data, provenance, set(data.keys)) == ("all 10 frames", 10)
    write_table(labels, {"0001": boxes_of(201, LORRY_M), "0004": moved(boxes_of(204, LORRY_M), 0.1)})
    with pytest.raises(ConfigError, match="it differs in labels"):  # those that were edited teach something else
        adapted(streets, tmp_path / "out", labels)


def test_labels_lie_in_a_table_in_a_folder_or_in_the_data_set_itself(streets: Streets, tmp_path: Path) -> None:
    table = some_of(streets.truth, tmp_path / "one.csv", 3)
    folder, own = tmp_path / "json", tmp_path / "lorries"
    folder.mkdir()
    write_boxes(folder / "0003.json", boxes_of(203, LORRY_M))
    shutil.copytree(streets.sweeps, own)
    shutil.copy(table, own / "labels.csv")
    lines = []
    for number, labels in enumerate((table, folder, own)):
        text = dry_run(
            streets.start,
            streets.sweeps,
            out=tmp_path / str(number),
            source=streets.source,
            learn_from=labels,
            **CHOICES,
        )
        lines.append(text[1:])
    assert lines[0] == lines[1] == lines[2]  # also where the labelled sweep is a copy in another folder
    assert lines[0][0] == "learns from 1 sweep with labels: 4 vehicle"
    assert lines[0][1].startswith("9 sweeps searched 2 times")


def test_frames_that_teach_and_score_are_refused_by_name(streets: Streets, tmp_path: Path) -> None:
    labels = some_of(streets.truth, tmp_path / "two.csv", 1, 4)
    scored = tmp_path / "copies"  # other names, the same contents
    scored.mkdir()
    for name, copy in (("0004", "a"), ("0005", "b")):
        shutil.copy(streets.sweeps / f"{name}.npy", scored / f"{copy}.npy")
    write_table(scored / "labels.csv", {"a": boxes_of(204, LORRY_M), "b": boxes_of(205, LORRY_M)})
    with pytest.raises(ConfigError, match=r"--labels .*copies\) apart from .*1 frame is in both: lorries/0004\. "):
        adapted(streets, tmp_path / "out", labels, labels=scored)
    assert not (tmp_path / "out").exists()
    (scored / "a.npy").unlink()
    write_table(scored / "labels.csv", {"b": boxes_of(205, LORRY_M)})
    with pytest.raises(ConfigError, match=r"annotated frames in .* that are not learnt from; all 1 are learnt from"):
        adapted(streets, tmp_path / "out", labels, labels=scored)  # an unlabelled sweep of DATA teaches, too
    choices = {**CHOICES, "source": streets.source, "learn_from": labels, "labels": scored, "frames": 3}
    assert dry_run(streets.start, streets.sweeps, out=tmp_path / "out", **choices)  # 0000, 0003 and 0007 teach


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda t, p: some_of(t, p), FarfieldError, "expected labels, found none"),
        (lambda t, p: p / "nothing", ConfigError, "nothing is there"),
        (lambda t, p: write_table(p, {"4": boxes_of(204, LORRY_M)}), DatasetError, "are not there: 4.*leading zeros"),
        (lambda t, p: write_table(p, {"0004": boxes_of(1, CAR_M)}, "cone"), DatasetError, r"there are: cone \(4\)"),
        (
            lambda t, p: write_table(p, {"0004": moved(boxes_of(204, LORRY_M), -70)}),
            DatasetError,
            r"where the detector looks \(0 to 64 m ahead, 20 m to either side\), found none of 4",
        ),
        (
            lambda t, p: write_table(p, {"0004": moved(boxes_of(204, LORRY_M), 0, 12)}),
            DatasetError,
            "expected points in the labelled boxes",
        ),
    ],
)
def test_labels_that_cannot_teach_are_refused(
    make: Any, error: type[Exception], message: str, streets: Streets, tmp_path: Path
) -> None:
    with pytest.raises(error, match=message):
        adapted(streets, tmp_path / "out", make(streets.truth, tmp_path / "labels.csv"))
    assert not (tmp_path / "out").exists()


def moved(boxes: Boxes, x_m: float, z_m: float = 0.0) -> Boxes:
    return boxes.replace(centre_m=boxes.centre_m + np.array([x_m, 0, z_m]))


def test_drives_in_folders_of_their_own_are_one_target(
    streets: Streets, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, seed in (("monday", 300), ("tuesday", 400)):
        boxes = street(tmp_path / name, seed, 3, LORRY_M)
        write_table(tmp_path / name / "labels.csv", {"0001": boxes["0001"]})
    data = joined([open_dataset(tmp_path / name) for name in ("monday", "tuesday")])
    assert data.keys[2:4] == (("monday", "0002"), ("tuesday", "0000"))
    assert {name: rows.tolist() for name, rows in data.drive_indices().items()} == {
        "monday": [0, 1, 2],
        "tuesday": [3, 4, 5],
    }
    assert [data.has_annotation(index) for index in range(6)] == [False, True, False, False, True, False]
    np.testing.assert_array_equal(data[4].cloud().points_m, np.load(tmp_path / "tuesday" / "0001.npy"))
    assert data.before(4, 1).key == ("tuesday", "0000")
    assert data.before(3, 1) is None
    with pytest.raises(DatasetError, match=r"drives of different names, found 'monday'.* cannot be joined as they are"):
        joined([data, open_dataset(tmp_path / "monday")])
    words = ["adapt", str(streets.start), str(tmp_path / "monday"), str(tmp_path / "tuesday"), "--dry-run"]
    words += ["--source", str(streets.source), "--out", str(tmp_path / "out")]
    assert main([*words, "--learn-from", str(tmp_path / "tuesday")]) == 0
    printed = capsys.readouterr().out
    assert "learns from 1 sweep with labels: 4 vehicle" in printed
    assert "5 sweeps searched 3 times" in printed


def test_views_of_drives_lie_over_all_of_them(tmp_path: Path) -> None:
    """Labels go beneath a turn, a detector's own turn takes its place, and the fingerprint tells it."""
    boxes = [street(tmp_path / name, seed, 2, LORRY_M)["0001"] for name, seed in (("monday", 300), ("tuesday", 400))]
    labels = write_table(tmp_path / "labels.csv", {"0001": boxes[1]})
    header, *rows = labels.read_text().split()
    labels.write_text("\n".join([f"sequence,{header}", *(f"tuesday,{row}" for row in rows)]))
    turned = {
        yaw_deg: [open_dataset(tmp_path / name, rotate_deg=yaw_deg) for name in ("monday", "tuesday")]
        for yaw_deg in (0, 90, 180)
    }
    data = joined(turned[180])
    labelled = labelled_by_files(data, labels)
    assert labelled.keys == (("tuesday", "0001"),)
    np.testing.assert_allclose(labelled[0].boxes.centre_m[:, :2], -boxes[1].centre_m[:, :2], atol=1e-6)
    np.testing.assert_array_equal(labelled[0].cloud().points_m, turned[180][1][1].cloud().points_m)
    assert len({joined(parts).fingerprint() for parts in turned.values()}) == 3
    assert replay(data, turned[180][0].recipe) is data
    part = joined([turned[180][0].select([1]), turned[180][1].select([1, 0])])
    assert part.keys == (("monday", "0001"), ("tuesday", "0001"), ("tuesday", "0000"))
    np.testing.assert_array_equal(part[1].cloud().points_m, labelled[0].cloud().points_m)
    with pytest.raises(
        DatasetError, match=r"tuesday: expected frames seen as those of .*monday, through no map; got move"
    ):
        joined([turned[0][0], turned[180][1]])
    assert roots_of(part) == (tmp_path / "monday", tmp_path / "tuesday")


def test_sweeps_that_are_all_labelled_are_for_train(streets: Streets, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"all 10 sweeps are labelled\. .*farfield train"):
        adapted(streets, tmp_path / "out", streets.truth)


def test_the_command_says_what_of_the_labels_teaches_nothing(
    streets: Streets, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    boxes = boxes_of(204, LORRY_M)
    boxes = boxes.replace(label=["vehicle", "vehicle", "vehicle", "cone"])
    table = write_table(tmp_path / "labels.csv", {"0004": boxes})
    rows = table.read_text().splitlines()
    rows[1] = rows[1].replace("vehicle", "cone")
    far = write_table(tmp_path / "far.csv", {"0004": moved(boxes_of(204, LORRY_M), 60)}).read_text().splitlines()[1]
    table.write_text("\n".join([*rows, far]) + "\n")
    words = ["adapt", str(streets.start), str(streets.sweeps), "--source", str(streets.source), "--dry-run"]
    assert main([*words, "--learn-from", str(table), "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert "learns from 1 sweep with labels: 3 vehicle" in printed
    assert "warning: the detector does not tell labelled boxes of cone (1): they teach as background" in printed
    assert "warning: 1 labelled box lies where the detector does not look" in printed


@pytest.mark.slow
def test_labelled_boxes_reach_the_loss(streets: Streets, tmp_path: Path) -> None:
    """Lorries where cars were learnt: two labelled sweeps teach their size, pseudo boxes alone do not."""
    labels = some_of(streets.truth, tmp_path / "two.csv", 1, 4)
    truth = {f"{n:04d}": boxes_of(200 + n, LORRY_M) for n in range(10) if n not in (1, 4)}
    error_m = {}
    for weight in (0, 1):
        overrides = (*QUICK, f"method.labels_weight={weight}", "training.learning_rate=0.006")
        done = adapted(streets, tmp_path / str(weight), labels, steps=24, overrides=overrides)
        error_m[weight] = np.mean([length_error_m(boxes, truth[key[1]]) for key, boxes in done.after.boxes.items()])
    assert error_m[1] < 0.5 * error_m[0]


def length_error_m(detected: Boxes, truth: Boxes) -> float:
    """Error of the length of the best box near each lorry, metres; as if it had none where there is none."""
    errors = []
    for centre in truth.centre_m:
        near = detected[np.hypot(*(detected.centre_m - centre)[:, :2].T) < 3]
        best = 0.0 if not len(near) else float(near.size_m[int(np.argmax(near.score)), 0])
        errors.append(abs(best - LORRY_M[0]))
    return float(np.mean(errors))


@pytest.mark.slow
def test_no_more_frames_live_where_there_are_more_sweeps(
    streets: Streets, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    labels = some_of(streets.truth, tmp_path / "two.csv", 0, 1)
    most = {}
    for frames in (5, 8):
        alive: list[int] = []
        with monkeypatch.context() as patch:
            patch.setattr("farfield.datasets.folder.Folder.frame", counted(alive))
            adapted(streets, tmp_path / str(frames), labels, frames=frames)
        most[frames] = max(alive)
    assert most[8] <= most[5]


def counted(alive: list[int]) -> Any:
    """``Folder.frame`` that notes how many of the frames that it gave before are still held when it is called."""
    build, frames = ff.datasets.folder.Folder.frame, list[weakref.ref[Frame]]()

    def frame(self: Any, index: int) -> Frame:
        alive.append(sum(one() is not None for one in frames))
        made = build(self, index)
        frames.append(weakref.ref(made))
        return made

    return frame


def test_what_was_not_annotated_is_not_taught_as_empty(tmp_path: Path) -> None:
    kitti = Path(__file__).parents[3] / "shared" / "real" / "kitti"
    if not kitti.is_dir():
        pytest.skip("no real frames")
    data = open_dataset(kitti)
    cut = data.mapped(AnnotatedField())
    frame, whole = cut[1], data[1]
    assert len(frame.cloud().points_m) < 0.5 * len(whole.cloud().points_m)
    assert frame.annotation.region.contains(frame.cloud().points_m.astype(np.float64)).all()
    assert ff.open_dataset(kitti).mapped(AnnotatedField()).annotation(1) is not None


RUN = """
import sys
import farfield as ff

ff.adapt(sys.argv[1], sys.argv[2], out=sys.argv[3], source=sys.argv[4], learn_from=sys.argv[5], steps=30, rounds=2,
         source_frames=4, overrides=tuple(sys.argv[6:]))
"""


@pytest.mark.slow
def test_one_that_was_killed_goes_on_to_the_same_weights(streets: Streets, tmp_path: Path) -> None:
    labels = some_of(streets.truth, tmp_path / "two.csv", 1, 4)
    script = tmp_path / "adapt.py"
    script.write_text(RUN)
    inputs = [str(streets.source), str(labels), *QUICK, "training.checkpoint_every_s=0.001", "training.workers=1"]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    command = {
        name: [sys.executable, str(script), str(streets.start), str(streets.sweeps), str(tmp_path / name), *inputs]
        for name in ("whole", "cut")
    }
    subprocess.run(command["whole"], env=environment, check=True, capture_output=True, timeout=200)
    process = subprocess.Popen(command["cut"], env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    log, end = tmp_path / "cut" / "round-1" / "log.jsonl", time.monotonic() + 100
    while not (log.is_file() and len(log.read_text().splitlines()) >= 4) and time.monotonic() < end:
        assert process.poll() is None
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not (tmp_path / "cut" / "round-1" / "weights.safetensors").exists()
    subprocess.run(command["cut"], env=environment, check=True, capture_output=True, timeout=200)
    one, other = (load_weights(tmp_path / name / "weights.safetensors")[0].state_dict() for name in ("whole", "cut"))
    assert all(torch.equal(one[name], other[name]) for name in one)
