"""Whether the frames that are scored were learnt from, by fingerprints and splits."""

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np

import farfield as ff
from farfield.datasets import open_dataset
from farfield.datasets.contents import frame_digests
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
    assert seen_in_training(data, whole.provenance, keys) == (
        f"all {len(data)} frames, by names and sizes of their files",
        len(data),
    )
    part = data.select([0])
    assert seen_in_training(part, whole.provenance, {part.keys[0]}) == (
        "all 1 frame, by names and sizes of their files",
        1,
    )
    some = Trained(data_fingerprint=part.fingerprint(), frames=1)
    assert seen_in_training(part, some.provenance, {part.keys[0]})[1] == 1
    other = Trained(data_fingerprint="0" * 64, frames=len(data))
    assert seen_in_training(data, other.provenance, keys) == ("not known", 0), "names and sizes tell no other data"
    assert seen_in_training(data, {}, keys) == ("not known", 0)
    assert seen_in_training(in_memory([data[0]]), whole.provenance, keys) == ("not known", 0)


def test_a_score_on_learnt_frames_says_so(simulated_cirrus: Path) -> None:
    data = open_dataset(simulated_cirrus)
    found = detect(Trained(data_fingerprint=data.fingerprint(), frames=3), data, cloud="gaussian")
    result = found.score()
    assert any("learnt from all 3 frames" in note for note in result.notes)
    assert result.subject is not None
    assert result.subject.seen_in_training == "all 3 frames, by names and sizes of their files"
    assert (result.subject.detector, result.subject.data) == ("nothing", simulated_cirrus.name)
    assert result.subject.fingerprint == data.fingerprint()
    turned = detect(Trained(), data.turned(180), cloud="gaussian").score()
    assert turned.subject is not None
    assert not result.subject.same_data(turned.subject)
    assert "learnt from" not in " ".join(turned.notes)


def learnt(*digests: str, **others: Any) -> dict[str, Any]:
    """A provenance as trainings leave it."""
    return {"streams": {"labelled": {"frame_digests": " ".join(digests)}}, **others}


def own_folder(root: Path, names: tuple[str, ...], rng: np.random.Generator) -> Path:
    """Sweeps of one size: their names and sizes tell nothing."""
    root.mkdir()
    for name in names:
        np.save(root / f"{name}.npy", rng.normal(0, 20, (400, 4)).astype(np.float32))
    return root


def test_frames_are_compared_by_their_contents(simulated_cirrus: Path, tmp_path: Path) -> None:
    data = open_dataset(simulated_cirrus)
    digests = frame_digests(data)
    assert len(set(digests)) == len(data) == 3
    assert all(re.fullmatch(r"xyz:[0-9a-f]{12}(\+xyz:[0-9a-f]{12})*", digest) for digest in digests)
    shutil.copytree(simulated_cirrus, tmp_path / "elsewhere" / "again")
    copy = open_dataset(tmp_path / "elsewhere" / "again")
    assert seen_in_training(copy, learnt(*digests), set(copy.keys)) == ("all 3 frames", 3)
    assert seen_in_training(copy.turned(180), learnt(*digests), set(copy.keys)) == ("all 3 frames", 3)
    assert seen_in_training(copy, learnt(digests[1]), set(copy.keys)) == ("1 of 3 frames", 1)
    none = "none of the 3 frames, by the bytes of their files"
    assert seen_in_training(copy, learnt("xyz:0123456789ab"), set(copy.keys)) == (none, 0)


def test_names_and_sizes_alone_accuse_nobody(tmp_path: Path, rng: np.random.Generator) -> None:
    """Another drive of equally named sweeps of equal size had one fingerprint, and passed for learnt from."""
    one = open_dataset(own_folder(tmp_path / "a", ("0000", "0001"), rng))
    other = open_dataset(own_folder(tmp_path / "b", ("0000", "0001"), rng))
    provenance = learnt(*frame_digests(one), data_fingerprint=one.fingerprint(), frames=2)
    assert seen_in_training(one, provenance, set(one.keys))[1] == 2
    assert seen_in_training(other, provenance, set(other.keys))[1] == 0


def test_renamed_copies_are_recognised(tmp_path: Path, rng: np.random.Generator) -> None:
    one = open_dataset(own_folder(tmp_path / "a", ("0000", "0001"), rng))
    (tmp_path / "b").mkdir()
    shutil.copy(tmp_path / "a" / "0001.npy", tmp_path / "b" / "night.npy")
    renamed = open_dataset(tmp_path / "b")
    assert seen_in_training(renamed, learnt(*frame_digests(one)), set(renamed.keys)) == ("all 1 frame", 1)


def test_what_weights_learnt_before_they_were_trained_on_counts(simulated_cirrus: Path) -> None:
    data = open_dataset(simulated_cirrus)
    digests, keys = frame_digests(data), set(data.keys)
    earlier = learnt("xyz:0123456789ab", start={"weights": "x", "frame_digests": " ".join(digests)})
    assert seen_in_training(data, earlier, keys)[1] == 3
    adapted = learnt("xyz:0123456789ab", adapted={"start": "x", "start_frame_digests": " ".join(digests)})
    assert seen_in_training(data, adapted, keys)[1] == 3
    for silent in ({"weights": "x", "frame_digests": None}, {"weights": "x"}):
        words, common = seen_in_training(data, learnt("xyz:0123456789ab", start=silent), keys)
        assert words.endswith("in the training itself; of the weights that it started from (x) not known")
        assert (words.partition(" frame")[0], common) == (f"none of the {len(keys)}", 0)


def test_a_part_of_a_frames_files_is_recognised(simulated_cirrus: Path, tmp_path: Path) -> None:
    """A copy that lacks the largest cloud passed for other frames."""
    digests = frame_digests(open_dataset(simulated_cirrus))
    shutil.copytree(simulated_cirrus, tmp_path / "again")
    whole = open_dataset(tmp_path / "again")
    clouds = sorted((path for path in whole.files(0) if path.suffix not in (".json", ".txt", ".jpg")), key=size_of)
    assert len(clouds) > 1
    for index in range(len(whole)):
        for path in whole.files(index):
            if path.parent == clouds[-1].parent:
                path.unlink()
    assert seen_in_training(open_dataset(tmp_path / "again"), learnt(*digests), set(whole.keys))[1] == 3


def size_of(path: Path) -> int:
    return path.stat().st_size


def test_what_holds_next_to_nothing_is_no_frames_alone(tmp_path: Path, rng: np.random.Generator) -> None:
    """Empty clouds, and those of zeros, are equal without being the same."""
    for name in ("a", "b"):
        own_folder(tmp_path / name, ("0000",), rng)
        np.save(tmp_path / name / "0001.npy", np.zeros((0, 4), np.float32))
        np.save(tmp_path / name / "0002.npy", np.zeros((4000, 4), np.float32))
    one, other = open_dataset(tmp_path / "a"), open_dataset(tmp_path / "b")
    assert frame_digests(one)[1:] == ("?", "?")
    assert seen_in_training(other, learnt(*frame_digests(one)), set(other.keys)) == ("not known", 0)
    full = other.select([0])
    assert seen_in_training(full, learnt(*frame_digests(one)), set(full.keys)) == ("not known", 0), "two say nothing"
    certain = learnt(frame_digests(one)[0])
    assert seen_in_training(full, certain, set(full.keys))[0].startswith("none of the 1 frame")
    assert seen_in_training(other, certain, set(other.keys)) == ("not known", 0)


def test_copies_in_another_format_are_not_known(tmp_path: Path, rng: np.random.Generator) -> None:
    own_folder(tmp_path / "a", ("0000", "0001"), rng)
    one, provenance = open_dataset(tmp_path / "a"), learnt(*frame_digests(open_dataset(tmp_path / "a")))
    for name in ("bin", "npy"):
        (tmp_path / name).mkdir()
    for path in one.files(0)[0].parent.glob("*.npy"):
        np.load(path).tofile(tmp_path / "bin" / f"{path.stem}.bin")
        np.save(tmp_path / "npy" / path.name, np.load(path).astype(np.float64))
    converted, written_anew = open_dataset(tmp_path / "bin"), open_dataset(tmp_path / "npy")
    assert seen_in_training(converted, provenance, set(converted.keys)) == ("not known", 0)
    words = "none of the 2 frames, by the bytes of their files"
    assert seen_in_training(written_anew, provenance, set(written_anew.keys)) == (words, 0)


def test_a_readers_options_make_other_data_of_a_score_and_the_same_of_what_was_learnt(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    root = own_folder(tmp_path / "own", ("a", "b"), rng)
    for name in "ab":
        np.save(root / f"{name}.npy", np.abs(np.load(root / f"{name}.npy")))
        (root / f"{name}.json").write_text('{"boxes": []}')
    plain, scaled = open_dataset(root, intensity_scale=200.0), open_dataset(root, intensity_scale=400.0)
    assert plain.fingerprint() != scaled.fingerprint()
    assert plain.fingerprint(options=False) == scaled.fingerprint(options=False)
    first, second = (ff.detect(Trained(), data).score("dds").subject for data in (plain, scaled))
    assert first is not None
    assert second is not None
    assert not first.same_data(second)
    for trained in (plain.fingerprint(), plain.fingerprint(options=False)):  # these, and those of earlier versions
        words, common = seen_in_training(plain, {"data_fingerprint": trained, "frames": 2}, set(plain.keys))
        assert (words, common) == ("all 2 frames, by names and sizes of their files", 2)
    known = learnt(*frame_digests(plain))
    assert seen_in_training(scaled, known, set(scaled.keys)) == ("all 2 frames", 2)


def test_an_option_that_names_a_file_counts_by_its_bytes(tmp_path: Path, rng: np.random.Generator) -> None:
    root = own_folder(tmp_path / "own", ("a",), rng)
    fingerprints = []
    for folder, label in (("one", "Auto"), ("two", "Auto"), ("three", "Bike")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "classes.yaml").write_text(f"classes: {{{label}: vehicle}}\n")
        fingerprints.append(open_dataset(root, mapping=tmp_path / folder / "classes.yaml").fingerprint())
    assert fingerprints[0] == fingerprints[1] != fingerprints[2]
    assert open_dataset(root, point_times="auto").fingerprint() == open_dataset(root).fingerprint()
