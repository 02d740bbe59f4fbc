"""Metrics in a loop: what update and compute give is what score gives, digit by digit, in one process and in two."""

import pickle
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import farfield as ff
from farfield.errors import ConfigError
from farfield.frame import Annotation
from farfield.metrics import PROTOCOLS, score
from farfield.metrics.running import RunningMetric, running_metric
from farfield.testing.protocols import example

NAMES = (
    *(name for name in PROTOCOLS.builtin if name != "kradar-compat"),
    "kradar-compat:old_as_shipped@0.3",
    "kradar-compat:revised_yaw_fixed",
)
ROW = [20.0, 1.0, -1.0, 4.4, 1.9, 1.6, 0.0]


def parted(protocol: str, number: int, parts: int) -> RunningMetric:
    """The metric of every other frame of an example, jittered so that figures are neither best nor worst."""
    metric = running_metric(protocol)
    detections = example()
    rng = np.random.default_rng(1)
    for index, (key, annotation) in enumerate(detections.annotations.items()):
        boxes = detections.boxes[key]
        boxes = boxes.replace(centre_m=boxes.centre_m + rng.normal(0, 0.6, boxes.centre_m.shape))
        counted = annotation.boxes.replace(point_count=np.full(len(annotation.boxes), 9))  # as open-sweeps needs them
        annotation = replace(annotation, boxes=counted)
        if index % parts == number:
            metric.update(boxes, annotation, frames=key[1], sequences=key[0])
    return metric


@pytest.mark.parametrize("protocol", NAMES)
def test_update_and_compute_give_what_score_gives(protocol: str) -> None:
    """One process, and two whose parts are pickled and merged, as all_gather_object does."""
    whole = parted(protocol, 0, 1)
    detections = whole.detections()
    expected = score(detections.boxes, detections.annotations, protocol=protocol).to_json()
    assert whole.compute().to_json() == expected
    parts = [pickle.loads(pickle.dumps(parted(protocol, number, 2))) for number in range(2)]
    by_name = sorted(detections.annotations, key=lambda key: (key[0], int(key[1])))
    ordered = {key: detections.annotations[key] for key in by_name}
    merged = parts[0].merge(parts[1]).compute().to_json()
    assert merged == score({k: detections.boxes[k] for k in by_name}, ordered, protocol=protocol).to_json()
    assert merged["subject"]["labels_fingerprint"] == expected["subject"]["labels_fingerprint"]


def test_every_built_in_protocol_has_a_class() -> None:
    classes = [getattr(ff.metrics, name) for name in ff.metrics._METRICS]
    assert {kind.protocol for kind in classes} == set(PROTOCOLS.builtin)
    assert all(issubclass(kind, RunningMetric) for kind in classes)
    assert isinstance(pickle.loads(pickle.dumps(ff.metrics.DDS(replicates=0))), ff.metrics.DDS)


def test_plain_arrays_dictionaries_and_batches_are_taken() -> None:
    rows, scored = np.array([ROW]), np.array([[*ROW, 0.9]])
    plain = ff.metrics.DDS(replicates=0)
    plain.update(scored, rows)
    batch = ff.metrics.DDS(replicates=0, classes=("vehicle", "pedestrian"))
    named = {"boxes": rows, "scores": np.array([0.9]), "labels": np.array([0])}
    batch.update([named], [{"boxes": rows, "labels": np.array([0])}])
    boxes = ff.metrics.DDS(replicates=0)
    boxes.update(
        ff.Boxes.from_numpy(rows, label="vehicle", score=np.array([0.9])),
        Annotation(boxes=ff.Boxes.from_numpy(rows, label="vehicle")),
    )
    figures = [metric.compute().figures for metric in (plain, batch, boxes)]
    assert figures[0] == figures[1] == figures[2]
    assert figures[0]["dds/0/dds"] == pytest.approx(1.0)
    plain.reset()
    with pytest.raises(ConfigError, match="Call update first"):
        plain.compute()


def test_a_frame_that_a_sampler_repeats_counts_once_and_another_is_refused() -> None:
    metric = ff.metrics.DDS(replicates=0)
    for _ in range(2):
        metric.update(np.array([[*ROW, 0.9]]), np.array([ROW]), frames="7")
    assert len(metric) == 1
    with pytest.raises(ConfigError, match="again with other boxes"):
        metric.update(np.array([[*ROW, 0.8]]), np.array([ROW]), frames="7")


@pytest.mark.parametrize(
    ("predicted", "words"),
    [
        (np.zeros((3, 5)), r"shape \(3, 5\)"),
        ("boxes.csv", "got str"),
        (np.array([ROW]), "a score for every box"),
        (np.array([[*ROW, 90.0]]), "scores in .0, 1."),
        (np.array([[20.0, 1, 0, 4, 2, 1.5, 90.0, 0.5]]), "radians"),
        (np.array([[20.0, 1, 0, -4, 2, 1.5, 0.0, 0.5]]), "positive sizes"),
        ({"boxes": np.array([ROW]), "score": np.array([0.5])}, "the keys boxes, labels, scores"),
        ({"boxes": np.array([ROW]), "scores": np.array([0.5]), "labels": np.array([1])}, "classes="),
    ],
)
def test_what_boxes_cannot_be_is_refused_by_name(predicted: object, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        ff.metrics.DDS().update(predicted, np.zeros((0, 7)))


def test_an_unknown_setting_is_refused_at_once_and_replicates_is_the_flag() -> None:
    with pytest.raises(ConfigError, match="range_bin"):
        ff.metrics.DDS(range_bin=(0, 70))
    with pytest.raises(ConfigError, match="got both"):
        _scored_with_both()


def _scored_with_both() -> None:
    metric = ff.metrics.DDS(replicates=0, bootstrap=ff.metrics.Bootstrap())
    metric.update(np.array([[*ROW, 0.9]]), np.array([ROW]))
    metric.compute()


TWO = """
import sys, torch.distributed as dist
sys.path[:0] = {paths!r}
from tests.metrics.test_running import parted
dist.init_process_group("gloo", init_method="file://" + sys.argv[1], rank=int(sys.argv[2]), world_size=2)
result = parted("dds", dist.get_rank(), 2).compute()
if dist.get_rank() == 0:
    print(repr(result.figures))
dist.destroy_process_group()
"""


@pytest.mark.slow
def test_two_processes_of_torch_compute_the_whole(tmp_path) -> None:
    pytest.importorskip("torch")
    text = TWO.format(paths=[path for path in sys.path if path])
    words = [sys.executable, "-c", text, str(tmp_path / "rendezvous")]
    both = [subprocess.Popen([*words, str(rank)], stdout=subprocess.PIPE, text=True) for rank in range(2)]
    printed = [process.communicate(timeout=500)[0] for process in both]
    assert printed[0].strip() == repr(parted("dds", 0, 1).compute().figures)
