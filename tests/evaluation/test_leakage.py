"""Whether the frames that are scored were learnt from, by fingerprints and splits."""

from pathlib import Path
from typing import Any

from farfield.datasets import open_dataset
from farfield.datasets.memory import in_memory
from farfield.evaluation import detect
from farfield.evaluation.leakage import seen_in_training
from farfield.frame import Boxes, Frame


class Trained:
    """A detector that finds nothing, and says what it learnt from."""

    name, class_names = "nothing", ("vehicle",)

    def __init__(self, **provenance: Any) -> None:
        self.provenance = provenance

    def __call__(self, frame: Frame) -> Boxes:
        return Boxes.empty(scored=True)


def test_frames_of_the_training_are_named(simulated_cirrus: Path) -> None:
    data = open_dataset(simulated_cirrus)
    keys = set(data.keys)
    whole = Trained(data_fingerprint=data.fingerprint(), frames=len(data))
    assert seen_in_training(data, whole.provenance, keys) == (f"all {len(data)} frames", len(data))
    part = data.select([0])
    assert seen_in_training(part, whole.provenance, {part.keys[0]}) == ("all 1 frames", 1)
    some = Trained(data_fingerprint=part.fingerprint(), frames=1)
    assert seen_in_training(part, some.provenance, {part.keys[0]})[1] == 1
    other = Trained(data_fingerprint="0" * 64, frames=len(data))
    assert seen_in_training(data, other.provenance, keys) == ("not found, it learnt from other data", 0)
    assert seen_in_training(data, {}, keys) == ("not known", 0)
    assert seen_in_training(in_memory([data[0]]), whole.provenance, keys) == ("not known", 0)


def test_a_score_on_learnt_frames_says_so(simulated_cirrus: Path) -> None:
    data = open_dataset(simulated_cirrus)
    found = detect(Trained(data_fingerprint=data.fingerprint(), frames=3), data, cloud="gaussian")
    result = found.score()
    assert any("learnt from all 3 frames" in note for note in result.notes)
    assert result.subject is not None
    assert result.subject.seen_in_training == "all 3 frames"
    assert (result.subject.detector, result.subject.data) == ("nothing", simulated_cirrus.name)
    assert result.subject.fingerprint == data.fingerprint()
    turned = detect(Trained(), data.turned(180), cloud="gaussian").score()
    assert turned.subject is not None
    assert not result.subject.same_data(turned.subject)
    assert "learnt from" not in " ".join(turned.notes)
