"""farfield adapt: what it refuses, what it settles, a tiny adaptation from end to end, and one that is killed."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

torch = pytest.importorskip("torch")
pytest.importorskip("embreex")

sys.path.append(str(Path(__file__).parents[1] / "detectors"))  # the small detectors of its small.py

from small import SMALL, small_detector

import farfield as ff
from farfield.datasets import Dataset, open_dataset
from farfield.detectors.weights import load_weights, save_weights
from farfield.errors import ConfigError, DatasetError, FarfieldError
from farfield.experiments.adapting import AdaptationOptions, AdaptationResult
from farfield.experiments.adapting.options import CalibratedThresholds
from farfield.experiments.adapting.report import changes, edges_to, extents, most_changed
from farfield.experiments.adapting.rounds import measured_step_s, rare_classes, steps_in, steps_wanted
from farfield.experiments.adapting.source import TrainingHistory, learnt_by, simulation_of
from farfield.experiments.frames import spread
from farfield.experiments.plan import Plan
from farfield.experiments.schema import Experiment, experiment_of
from farfield.frame import Annotation, Boxes, Constant, Frame
from farfield.metrics import score_calibration

EAGER = {"score_threshold": 0.0, "max_boxes": 20, "candidates": 20}  # a network that has learnt nothing finds something
QUICK = ("training.workers=0", "training.precision=fp32", "training.threads=1", "training.log_every_steps=1")
TINY = {"steps": 4, "rounds": 2, "source_frames": 2, "overrides": QUICK}


@pytest.fixture(scope="module")
def start(simulated_cirrus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a small detector whose provenance names the preset of mini frames."""
    home = tmp_path_factory.mktemp("start")
    tree = {
        "name": "tiny",
        "data": {
            "path": str(home / "data"),
            "clouds": ["gaussian"],
            "simulate": {"preset": "cirrus-sim-mini", "sequences": 1, "frames": 1},
        },
        "detector": {"name": "pointpillars", **SMALL["pointpillars"].settings, **EAGER},
        "augmentation": {"pasted": {"vehicle": 1}},
        "training": {"steps": 2, "batch_size": 2, "precision": "fp32", "threads": 1, "workers": 0},
    }
    Plan(Experiment.model_validate(tree), home / "run").run()
    return home / "run"


@pytest.fixture
def eager(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the scores of a network that has learnt next to nothing be sure ones."""
    monkeypatch.setattr(score_calibration, "POSITIVE", 0.001)
    monkeypatch.setattr(score_calibration, "NEGATIVE", 0.0)


def tensors_of(path: Path) -> dict[str, Any]:
    return load_weights(path)[0].state_dict()


def test_weights_a_page_and_what_they_come_from(
    start: Path, simulated_cirrus: Path, tmp_path: Path, eager: None
) -> None:
    out = tmp_path / "adapted"
    done: AdaptationResult = ff.adapt(start, simulated_cirrus, out=out, clouds=("uniform",), **TINY)
    before, after = tensors_of(start / "weights.safetensors"), tensors_of(done.weights)
    assert before.keys() == after.keys()
    assert any(not torch.equal(before[name], after[name]) for name in before)
    _, provenance = load_weights(done.weights)
    data = open_dataset(simulated_cirrus)
    assert provenance["adapted"]["start"] == str(start)
    assert provenance["adapted"]["start_digest"] == ff.load_detector(start).digest()
    assert provenance["adapted"]["target_fingerprint"] == provenance["streams"]["target"]["data_fingerprint"]
    assert provenance["experiment"]["method"]["norm"] == "per_domain"
    detector = ff.load_detector(out)
    assert detector.learnt_clouds == ("uniform",)
    assert len(detector(data[0])) == len(done.after.boxes[data.keys[0]])
    page = done.page.read_text(encoding="utf-8")
    assert "Boxes a sweep, before → after" in page
    assert "part of an object that the sensor sees" in page
    assert page.count("data:image/svg+xml") == 2 + len(data)  # histograms, curves, a picture of each frame
    assert (out / "source" / "simulation.json").is_file()
    assert "camera" not in json.loads((out / "source" / "simulation.json").read_text())["sensors"]


def test_scores_on_labels_are_told_and_decide_nothing(
    start: Path, simulated_cirrus: Path, tmp_path: Path, eager: None
) -> None:
    choices = {**TINY, "frames": 1, "rounds": 1, "steps": 1}
    plain = ff.adapt(start, simulated_cirrus, out=tmp_path / "plain", **choices)
    assert plain.scores is None
    assert "before and after</h2>" not in plain.page.read_text()
    done = ff.adapt(start, simulated_cirrus, out=tmp_path / "told", labels=simulated_cirrus, **choices)
    learnt, other = tensors_of(plain.weights), tensors_of(done.weights)
    assert all(torch.equal(learnt[name], other[name]) for name in learnt)
    assert done.scores is not None
    assert (done.scores.frames, done.scores.shared_drives) == (len(open_dataset(simulated_cirrus)) - 1, 1)
    kept = json.loads((tmp_path / "told" / "scores.json").read_text())
    assert [row["figure"] for row in kept["rows"] if row["label"] == "vehicle"] == ["DDS", "mAP"]
    for row in kept["rows"]:
        assert row["annotated"] > 0
        assert row["gain"] == pytest.approx(row["after"] - row["before"])
    assert "Scores on labels, before and after" in done.page.read_text()
    with pytest.raises(ConfigError, match="not learnt from; all 3 are learnt from"):
        ff.adapt(start, simulated_cirrus, out=tmp_path / "none", labels=simulated_cirrus, **{**choices, "frames": 0})
    assert not (tmp_path / "none").exists()


def test_whole_bodies_are_taught_by_the_source_first(
    start: Path, simulated_cirrus: Path, tmp_path: Path, eager: None
) -> None:
    out = tmp_path / "bodies"
    done = ff.adapt(start, simulated_cirrus, out=out, whole_bodies=True, labels=simulated_cirrus, frames=1, **TINY)
    weights = [
        experiment_of(yaml.safe_load((out / f"round-{number}" / "experiment.yaml").read_text())).method.settings.get(
            "weight"
        )
        for number in (1, 2)
    ]
    assert weights == [0.0, None]  # then its default, 1
    _, provenance = load_weights(done.weights)
    maps = {name: stream["recipe"]["maps"] for name, stream in provenance["streams"].items()}
    assert {"name": "whole_bodies", "settings": {}} in maps["source"]
    assert not any(one["name"] == "whole_bodies" for one in maps["target"])
    simulated = open_dataset(out / "source", whole_bodies=True)
    assert provenance["streams"]["source"]["data_fingerprint"] == simulated.select([0, 1]).fingerprint()
    visible = open_dataset(simulated_cirrus).annotation(0)
    found = ff.detect(ff.load_detector(out), open_dataset(simulated_cirrus))
    truth = found.annotations[open_dataset(simulated_cirrus).keys[0]]
    assert visible is not None
    assert visible.full_boxes is not None
    np.testing.assert_array_equal(truth.boxes.size_m, visible.full_boxes.size_m)  # and it is scored on these
    assert "So do those of the source from which this detector learnt here" in done.page.read_text()
    with pytest.raises(ConfigError, match="2 rounds or more with whole_bodies"):
        ff.adapt(start, simulated_cirrus, out=tmp_path / "one", whole_bodies=True, rounds=1)


def test_whole_bodies_that_nothing_tells_are_refused(start: Path, simulated_cirrus: Path, tmp_path: Path) -> None:
    bare = tmp_path / "bare"
    shutil.copytree(simulated_cirrus, bare)
    for path in bare.glob("**/*.json"):
        tree = json.loads(path.read_text())
        tree["labels"] = [{k: v for k, v in one.items() if not k.startswith("full_")} for one in tree["labels"]]
        path.write_text(json.dumps(tree))
    choices = {**TINY, "source": bare, "whole_bodies": True}
    with pytest.raises((ConfigError, DatasetError), match="show the part that the sensor sees"):
        ff.adapt(start, simulated_cirrus, out=tmp_path / "out", **choices)
    assert not (tmp_path / "out").exists()


def test_done_work_is_kept_and_another_adaptation_refused(
    start: Path, simulated_cirrus: Path, tmp_path: Path, eager: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "adapted"
    first = tensors_of(ff.adapt(start, simulated_cirrus, out=out, **TINY).weights)
    with monkeypatch.context() as patch:
        patch.setattr("farfield.experiments.adapting.job.Plan", None)  # no round is done again
        again = tensors_of(ff.adapt(start, simulated_cirrus, out=out, **TINY).weights)
    assert all(torch.equal(first[name], again[name]) for name in first)
    with pytest.raises(ConfigError, match=r"found another adaptation: it differs in rounds, steps.*--overwrite"):
        ff.adapt(start, simulated_cirrus, out=out, **{**TINY, "rounds": 1, "steps": 1})
    mark = (out / "source" / "simulation.json").stat().st_mtime_ns
    anew = ff.adapt(start, simulated_cirrus, out=out, overwrite=True, **{**TINY, "rounds": 1, "steps": 1})
    assert anew.settled.steps == 1
    assert not (out / "round-2").exists()
    assert (out / "source" / "simulation.json").stat().st_mtime_ns == mark


def test_a_given_source_is_read_and_an_adapted_detector_adapts_again(
    start: Path, simulated_cirrus: Path, tmp_path: Path, eager: None
) -> None:
    choices = {**TINY, "rounds": 1, "steps": 1}
    ff.adapt(start, simulated_cirrus, out=tmp_path / "one", source=simulated_cirrus, **choices)
    assert not (tmp_path / "one" / "source").exists()
    with pytest.raises(ConfigError, match="learnt from a real data set"):
        ff.adapt(tmp_path / "one", simulated_cirrus, out=tmp_path / "two", **choices)
    done = ff.adapt(tmp_path / "one", simulated_cirrus, out=tmp_path / "two", source=simulated_cirrus, **choices)
    assert done.weights.is_file()


def test_a_round_without_a_pseudo_box_is_an_error(start: Path, simulated_cirrus: Path, tmp_path: Path) -> None:
    out = tmp_path / "adapted"
    with pytest.raises(FarfieldError, match=r"round 1 has no pseudo box: in 3 frames .* no score reaches vehicle 0\.6"):
        ff.adapt(start, simulated_cirrus, out=out, **TINY)
    assert not (out / "weights.safetensors").exists()


def test_what_cannot_be_adapted_is_refused_before_anything_is_written(
    start: Path, simulated_cirrus: Path, tmp_path: Path
) -> None:
    network, provenance = load_weights(start / "weights.safetensors")
    nameless, real, points = (tmp_path / f"{name}.safetensors" for name in ("nameless", "real", "points"))
    save_weights(nameless, network.state_dict(), config=network.config, provenance={})
    data = {**provenance["experiment"]["data"], "simulate": None, "path": "kitti"}
    measured = {**provenance, "experiment": {**provenance["experiment"], "data": data}}
    save_weights(real, network.state_dict(), config=network.config, provenance=measured)
    rcnn = small_detector("pointrcnn")
    save_weights(points, rcnn.state_dict(), config=rcnn.config, provenance=provenance)
    out = tmp_path / "out"
    for detector, message in (
        ("no-such-weights", "Expected a bundled detector"),
        (nameless, "nameless.safetensors says nothing"),
        (real, r"learnt from a real data set \(kitti\).*--source DATA"),
        (points, "targets that can ignore boxes"),
    ):
        with pytest.raises(FarfieldError, match=message):
            ff.adapt(detector, simulated_cirrus, out=out, **TINY)
    with pytest.raises(ConfigError, match="named 'lidar'; its clouds are: gaussian, uniform"):
        ff.adapt(start, simulated_cirrus, out=out, clouds=("lidar",), **TINY)
    assert not out.exists()


def test_nothing_of_others_is_written_over(start: Path, simulated_cirrus: Path, tmp_path: Path) -> None:
    before = {path.name: path.stat().st_mtime_ns for path in start.iterdir()}
    for overwrite in (False, True):
        with pytest.raises(ConfigError, match=r"one that farfield adapt began; it holds checkpoint\.pt"):
            ff.adapt(start, simulated_cirrus, out=start, overwrite=overwrite, **TINY)
    assert {path.name: path.stat().st_mtime_ns for path in start.iterdir()} == before
    (tmp_path / "weights.safetensors").touch()
    with pytest.raises(ConfigError, match=r"it holds weights\.safetensors"):
        ff.adapt(start, simulated_cirrus, out=tmp_path, **TINY)


@pytest.mark.parametrize(
    ("choices", "message"),
    [
        ({"round": 2}, "round: no such key. It has: clouds, frames"),
        ({"rounds": 0}, "rounds: expected 1 or more"),
        ({"overrides": ("data.source.path=x",)}, "other than method.start"),
        ({"overrides": ("method.positive=0.3",)}, "other than method.start"),
    ],
)
def test_choices_that_do_not_fit_are_refused(
    choices: dict[str, Any], message: str, start: Path, simulated_cirrus: Path, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=message):
        ff.adapt(start, simulated_cirrus, out=tmp_path, **choices)


def test_the_source_is_simulated_on_other_roads_without_camera() -> None:
    learnt = TrainingHistory(path="x", simulate={"preset": "cirrus-sim", "seed": 3, "sequences": 9, "frames": 9})
    made = simulation_of(learnt, 15, 0, "mine")
    assert (made.sensors, made.seed, made.sequences, made.frames) == ("gaussian,uniform", 1003, 3, 6)
    few = simulation_of(learnt, 2, 1, "mine")
    assert (few.seed, few.sequences, few.frames) == (1004, 1, 2)
    towns = replace(learnt, simulate={**learnt.simulate, "world": "v3"})
    assert (made.world, simulation_of(towns, 2, 0, "mine").world) == (None, "v3")


def test_a_provenance_of_several_streams_gives_its_source() -> None:
    data = {"target": {"path": "t"}, "source": {"path": "s", "aliases": {"car": "vehicle"}}}
    experiment = {"data": data, "augmentation": {"thinning": 0.5, "bank_size": 4000}, "training": {"steps": 40}}
    learnt = learnt_by({"experiment": experiment}, "mine")
    assert (learnt.path, learnt.aliases, learnt.augmentation, learnt.steps) == (
        "s",
        {"car": "vehicle"},
        {"thinning": 0.5},
        40,
    )


def test_steps_follow_the_sources_and_the_time() -> None:
    assert steps_wanted(AdaptationOptions(), TrainingHistory(path="x", training={"steps": 2600})) == 325
    assert steps_wanted(AdaptationOptions(), TrainingHistory(path="x", training={"steps": 300_000})) == 500
    assert steps_wanted(AdaptationOptions(steps=7, rounds=3), TrainingHistory(path="x")) == 2
    assert steps_in(100.0, 1.0, AdaptationOptions(minutes=9), 325) == 45
    assert steps_in(1e6, 1.0, AdaptationOptions(minutes=9), 325) == 325
    assert steps_in(10.0, 1.0, AdaptationOptions(minutes=9), 4) == 4
    with pytest.raises(ConfigError, match=r"enough for 20 steps in each of 2 rounds; of 1 minutes 0 s are left"):
        steps_in(-5.0, 2.0, AdaptationOptions(minutes=1), 325)


def as_if_slow(*given: Any) -> float:
    assert measured_step_s(*given) > 0
    return 1.0


def test_minutes_bound_the_steps(
    start: Path, simulated_cirrus: Path, tmp_path: Path, eager: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("farfield.experiments.adapting.job.measured_step_s", as_if_slow)
    choices = {**TINY, "steps": 10**6, "rounds": 1, "minutes": 1.0}
    done = ff.adapt(start, simulated_cirrus, out=tmp_path / "out", **choices)
    assert 20 <= done.settled.steps < 54  # nine tenths of what is left of 60 s, a second each
    assert done.settled.step_s == 1.0
    assert not list((tmp_path / "out").glob(".measured-*"))


def boxes_at(*x: float) -> Boxes:
    n = len(x)
    return Boxes(centre_m=np.column_stack([x, np.zeros((n, 2))]), size_m=np.ones((n, 3)), yaw_rad=np.zeros(n))


def test_a_class_without_enough_sure_boxes_is_ignored_and_not_unlearnt() -> None:
    scores = {"vehicle": 0.5, "pedestrian": 0.4}
    settled = CalibratedThresholds(settings={}, positive=scores, negative=scores, measured=(), source_rate=1.0, steps=1)
    cars = boxes_at(*range(20)).replace(label=["vehicle"] * 20, score=np.full(20, 0.5))
    people = boxes_at(*range(30)).replace(label=["pedestrian"] * 30, score=np.linspace(0.0, 0.58, 30))
    assert rare_classes({("s", "0"): cars, ("s", "1"): people}, settled) == ("pedestrian",)
    assert rare_classes({("s", "0"): cars[:19]}, settled) == ("vehicle", "pedestrian")


def test_the_frames_that_changed_most_are_shown() -> None:
    assert changes(boxes_at(1, 20), boxes_at(1.5, 40, 60)) == 3
    before = {("s", name): boxes_at(1, 20) for name in "abc"}
    after = {("s", "a"): boxes_at(1, 20), ("s", "b"): boxes_at(), ("s", "c"): boxes_at(1)}
    assert most_changed(before, after, 2) == [("s", "b"), ("s", "c")]
    calm = {("t", "0"): boxes_at(1)}
    assert most_changed({**before, **calm}, {**after, **calm}, 2) == [("s", "b"), ("t", "0")]  # another drive first
    assert edges_to(64.0) == [0.0, 30.0, 64.0]
    assert list(spread(400, 4)) == [0, 100, 200, 300]


class Annotated(Dataset):
    """A frame whose boxes have an extent, or that was not annotated."""

    sequences, frame_ids = ("s",), ("0",)

    def __init__(self, extent: Any) -> None:
        self.extent = extent

    def frame(self, index: int) -> Frame:
        given = None if self.extent is None else Constant(Annotation(boxes=boxes_at(3), extent=self.extent))
        return Frame(sequence="s", frame_id=str(index), load_annotation=given)

    def files(self, index: int) -> list[Path]:
        return []


def test_the_page_says_what_boxes_show() -> None:
    visible, full, none = (Annotated(extent) for extent in ("visible", "full", None))
    unlike = extents({"source": visible, "target": full})
    assert "the whole body of an object, those that this detector learnt from the part" in unlike
    assert "compare like with like" in extents({"source": full, "target": full})
    assert "its labels were not used" in unlike
    assert "its labels taught nothing" in extents({"source": visible, "target": full}, scored=True)
    assert extents({"source": full, "target": none}) == ""


RUN = """
import sys
from pathlib import Path
import farfield as ff
from farfield.metrics import score_calibration

score_calibration.POSITIVE, score_calibration.NEGATIVE = 0.001, 0.0
ff.adapt(sys.argv[1], sys.argv[2], out=sys.argv[3], steps=30, rounds=2, source_frames=2, overrides=tuple(sys.argv[4:]))
"""


@pytest.mark.slow
def test_a_killed_adaptation_goes_on_to_the_same_weights(start: Path, simulated_cirrus: Path, tmp_path: Path) -> None:
    script = tmp_path / "adapt.py"
    script.write_text(RUN)
    words = (*QUICK, "training.checkpoint_every_s=0.001")
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    command = {
        name: [sys.executable, str(script), str(start), str(simulated_cirrus), str(tmp_path / name), *words]
        for name in ("whole", "cut")
    }
    subprocess.run(command["whole"], env=environment, check=True, capture_output=True, timeout=300)
    for number, least in ((1, 4), (2, 6)):  # killed in either round
        process = subprocess.Popen(
            command["cut"], env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        log, end = tmp_path / "cut" / f"round-{number}" / "log.jsonl", time.monotonic() + 200
        while not (log.is_file() and len(log.read_text().splitlines()) >= least) and time.monotonic() < end:
            assert process.poll() is None
            time.sleep(0.005)
        process.send_signal(signal.SIGKILL)
        process.wait()
        assert not (tmp_path / "cut" / f"round-{number}" / "weights.safetensors").exists()
    subprocess.run(command["cut"], env=environment, check=True, capture_output=True, timeout=300)
    one, other = (tensors_of(tmp_path / name / "weights.safetensors") for name in ("whole", "cut"))
    assert all(torch.equal(one[name], other[name]) for name in one)


def test_minutes_that_cannot_suffice_are_refused_before_the_work(
    start: Path, simulated_cirrus: Path, tmp_path: Path
) -> None:
    """It simulated the source and searched both data sets first, which took 98 s."""
    out = tmp_path / "out"
    with pytest.raises(ConfigError, match=r"--minutes: expected enough .*about .* minutes.*; got 0\.001.*--frames"):
        ff.adapt(start, simulated_cirrus, out=out, **{**TINY, "minutes": 0.001})
    assert not out.exists()
