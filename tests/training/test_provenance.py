"""What weights say of the data that they learnt from: what `simulate` did not make is never called simulated."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import farfield as ff
from farfield.datasets.contents import frame_digests
from farfield.detectors.weights import load_weights
from farfield.errors import ConfigError
from farfield.evaluation.evaluating import training_text
from farfield.experiments.adapting.report import held_frames
from farfield.experiments.course import course_of
from farfield.experiments.plan import Plan, with_real_data_named
from farfield.experiments.schema import DataConfig, load_experiment
from farfield.frame.provenance import SIMULATION_FILE, is_simulated
from farfield.simulation.recording import record
from farfield.training.report import TrainingReport

SIMULATED = "data.simulate={preset: cirrus-sim-varied, sequences: 30, frames: 20, seed: 1}"


class Lines(TrainingReport):
    """Keeps the lines."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def say(self, text: str) -> None:
        self.lines.append(text)


@pytest.fixture
def own(data: Path, tmp_path: Path) -> Path:
    """Sweeps that `simulate` did not make, as far as anyone can tell."""
    shutil.copytree(data, tmp_path / "own")
    (tmp_path / "own" / SIMULATION_FILE).unlink(missing_ok=True)
    return tmp_path / "own"


def test_own_data_in_the_place_of_simulated_ones_are_not_called_simulated(
    experiment: Path, own: Path, tmp_path: Path
) -> None:
    words = [f"data.path={own}", SIMULATED, "training.steps=1", "augmentation.pasted={}"]
    report, folder = Lines(), tmp_path / "run"
    Plan(load_experiment(experiment, words), folder).run(report)
    provenance = load_weights(folder / "weights.safetensors")[1]
    assert "simulated" not in training_text(provenance), training_text(provenance)
    assert training_text(provenance).startswith(f"3 frames of {own}, clouds gaussian and uniform, 1 step of 2")
    assert provenance["experiment"]["data"]["simulate"] is None
    assert "cirrus-sim-varied" not in (folder / "experiment.yaml").read_text()
    assert "cirrus-sim-varied" not in (folder / "provenance.json").read_text()
    (line,) = [line for line in report.lines if "data.simulate" in line]
    assert "farfield simulate did not make" in line
    assert str(own) in line
    assert any(line.startswith(f"data: {own} (cirrus), 3 frames") for line in report.lines)
    assert not any("simulated before" in line for line in report.lines)


def test_a_run_that_was_begun_before_goes_on(experiment: Path, own: Path, tmp_path: Path) -> None:
    """Its checkpoint says that its data were simulated."""
    from farfield.training.checkpoints import load_checkpoint, save_checkpoint

    words = [f"data.path={own}", SIMULATED, "augmentation.pasted={}"]
    path = tmp_path / "run" / "checkpoint.pt"
    Plan(load_experiment(experiment, [*words, "training.steps=1"]), tmp_path / "run").run()
    state = load_checkpoint(path)
    provenance = json.loads(state["provenance"])
    provenance["experiment"]["data"]["simulate"] = {"preset": "cirrus-sim-varied", "sequences": 30, "frames": 20}
    save_checkpoint(path, {**state, "provenance": json.dumps(provenance)})
    Plan(load_experiment(experiment, [*words, "training.steps=2"]), tmp_path / "run").run()
    assert load_checkpoint(path)["step"] == 2


def test_frames_beside_simulated_ones_are_not_called_simulated(experiment: Path, tmp_path: Path) -> None:
    """A drive that was copied into the folder passed for one that was simulated."""
    mixed = tmp_path / "mixed"
    record("cirrus-sim-mini", mixed, frames=2, sequences=1, seed=3)
    simulate = "data.simulate={preset: cirrus-sim-mini, sequences: 1, frames: 2, seed: 3}"
    settings = load_experiment(experiment, [f"data.path={mixed}", simulate])
    assert with_real_data_named(settings, {"labelled": ff.open_dataset(mixed)}) == (settings, [])
    for path in [path for path in mixed.rglob("dataset1_*/*") if path.is_file()]:
        name = path.relative_to(mixed).as_posix().replace("ataset1", "ataset2")
        if not name.endswith(".ffcloud"):
            (mixed / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, mixed / name)
    opened = ff.open_dataset(mixed)
    assert len(opened) == 4
    changed, (note,) = with_real_data_named(settings, {"labelled": opened})
    assert isinstance(changed.data, DataConfig)
    assert changed.data.simulate is None
    assert "did not make 2 of the 4 frames" in note
    assert is_simulated(mixed / "Cirrus_dataset1")
    assert not is_simulated(folder_of_sweeps(mixed / "mine", 2, np.random.default_rng(0))), "a folder beside them"


def described(**data: Any) -> dict[str, Any]:
    training = {"steps": 5, "batch_size": 2, "seed": 0}
    return {"experiment": {"data": data, "method": {"name": "teacher"}, "training": training}, "frames": 240}


def test_each_stream_is_named_by_its_own_data() -> None:
    """Adapted weights learnt from real sweeps too."""
    simulate = {"preset": "cirrus-sim", "seed": 1001}
    provenance = {
        **described(
            source={"path": "s", "clouds": ["gaussian"], "simulate": simulate},
            target={"path": "/data/mine", "clouds": ["lidar"], "simulate": None},
        ),
        "streams": {"source": {"frames": 240}, "target": {"frames": 17}},
        "start": {"weights": "pointpillars-cirrus-sim"},
    }
    text = training_text(provenance)
    assert text.startswith(
        "240 simulated frames (preset cirrus-sim, seed 1001), clouds gaussian, and 17 frames of /data/mine, clouds "
        "lidar, by the method teacher, from the weights pointpillars-cirrus-sim, 5 steps of 2"
    )


def test_a_source_that_was_not_simulated_is_refused(own: Path, tmp_path: Path) -> None:
    shutil.copytree(own, tmp_path / "out" / "source")
    with pytest.raises(ConfigError, match="farfield simulate did not make"):
        ff.adapt("pointpillars-cirrus-sim", own, out=tmp_path / "out", steps=1, frames=1, source_frames=1)


ONE_CLASS = "detector.anchors={vehicle: {size_m: [4.6, 1.9, 1.7], z_m: -1.1}}"


def folder_of_sweeps(root: Path, frames: int, rng: np.random.Generator) -> Path:
    """Own sweeps of one drive, a vehicle in each."""
    rows = ["frame,label,x,y,z,l,w,h,yaw_rad"]
    root.mkdir()
    for frame in range(frames):
        points = rng.uniform((2, -8, -2, 0), (40, 8, 1, 1), (500, 4)).astype(np.float32)
        np.save(root / f"{frame:04}.npy", points)
        rows.append(f"{frame:04},vehicle,20,0,-1,4.5,1.9,1.6,0.1")
    (root / "labels.csv").write_text("\n".join(rows) + "\n")
    return root


def words(own: Path, *others: str) -> list[str]:
    base = ["training.steps=2", "augmentation.pasted={}", "training.batch_size=1", "data.clouds=[lidar]"]
    return [*base, ONE_CLASS, f"data.path={own}", *others]


def test_frames_that_are_validated_on_are_not_trained_on(
    experiment: Path, tmp_path: Path, rng: np.random.Generator
) -> None:
    """`validation.split` without `data.split` kept the best of what is trained on, and called it held out."""
    own = folder_of_sweeps(tmp_path / "mine", 10, rng)
    data = ff.open_dataset(own)
    validated = data.split("time-val")
    assert 0 < len(validated) < len(data)
    settings = words(own, "training.validation={every_steps: 1, split: time-val}")
    report, folder = Lines(), tmp_path / "run"
    Plan(load_experiment(experiment, settings), folder).run(report)
    provenance = load_weights(folder / "weights.safetensors")[1]
    assert provenance["frames"] == len(data) - len(validated)
    learnt = set(provenance["streams"]["labelled"]["frame_digests"].split())
    assert learnt == set(frame_digests(data)) - set(frame_digests(validated))
    taken = f"{len(validated)} {'frame' if len(validated) == 1 else 'frames'} of the split time-val"
    assert any(f"{taken} w" in line for line in report.lines)
    assert f"{taken} w" in course_of(folder).read_text()


def test_a_split_that_is_all_that_is_trained_on_is_refused(
    experiment: Path, tmp_path: Path, rng: np.random.Generator
) -> None:
    own = folder_of_sweeps(tmp_path / "mine", 10, rng)
    settings = words(own, "data.split=time-val", "training.validation={every_steps: 1, split: time-val}")
    with pytest.raises(ConfigError, match=r"training\.validation: all . frames? that are trained on.*data\.split"):
        Plan(load_experiment(experiment, settings), tmp_path / "run").run()


def test_copies_of_held_out_frames_are_not_trained_on(
    experiment: Path, tmp_path: Path, rng: np.random.Generator
) -> None:
    own = folder_of_sweeps(tmp_path / "mine", 6, rng)
    shutil.copy(own / "0005.npy", own / "0000.npy")
    settings = words(own, "training.validation={every_steps: 1, frames: 2}")
    Plan(load_experiment(experiment, settings), tmp_path / "run").run()
    provenance = load_weights(tmp_path / "run" / "weights.safetensors")[1]
    held = ff.open_dataset(own).select([4, 5])
    digests = " ".join(frame_digests(held))
    assert provenance["held_out"] == {"frames": 2, "split": "", "taken_out": 1, "frame_digests": digests}
    learnt = provenance["streams"]["labelled"]["frame_digests"].split()
    assert learnt == list(frame_digests(ff.open_dataset(own))[1:4])


def test_labels_of_copied_sweeps_are_not_scored_as_held(tmp_path: Path, rng: np.random.Generator) -> None:
    """`adapt --labels` left out what is learnt from by its name in the same folder alone."""
    own = folder_of_sweeps(tmp_path / "mine", 4, rng)
    shutil.copytree(own, tmp_path / "copy")
    labels, learnt = ff.open_dataset(tmp_path / "copy"), ff.open_dataset(own)
    assert held_frames(labels, learnt.select([0, 2])).frames.keys == labels.select([1, 3]).keys
    with pytest.raises(ConfigError, match="all 4 are learnt from"):
        held_frames(labels, learnt)


def test_a_score_on_the_frames_that_chose_the_weights_says_so(
    experiment: Path, tmp_path: Path, rng: np.random.Generator
) -> None:
    """The best weights, scored on the frames by which they were chosen, "learnt from none of the frames"."""
    own = folder_of_sweeps(tmp_path / "mine", 6, rng)
    settings = words(own, "training.validation={every_steps: 1, frames: 2}")
    folder = tmp_path / "run"
    Plan(load_experiment(experiment, settings), folder).run()
    data = ff.open_dataset(own).select([3, 4, 5])
    chosen = [index for index in range(3) if frame_digests(data)[index] in _held(folder)]
    assert chosen
    best = ff.detect(ff.load_detector(folder / "best.safetensors", device="cpu"), data)
    assert f"chosen by {len(chosen)} of 3 frames" in best.seen_in_training
    assert any("too good" in note for note in best.score("dds", label=best.classes[0]).notes)
    last = ff.detect(ff.load_detector(folder / "weights.safetensors", device="cpu"), data)
    assert "chosen" not in last.seen_in_training


def _held(folder: Path) -> list[str]:
    provenance = load_weights(folder / "best.safetensors")[1]
    return str(provenance["held_out"]["frame_digests"]).split()
