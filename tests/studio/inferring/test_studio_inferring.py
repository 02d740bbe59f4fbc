"""Detection beside the server: progress, cancel, failures, two detectors, proposals."""

import asyncio
import threading
from collections import deque
from functools import partial
from pathlib import Path
from typing import NoReturn

import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
pytest.importorskip("torch")  # without it no detector is on offer
from studio.inferring.fakes import load
from studio.live import studio

from farfield.datasets.base import Subset
from farfield.errors import FarfieldError
from farfield.frame import Boxes
from farfield.studio.inferring.jobs import InferJob, Jobs
from farfield.studio.inferring.worker import Worker
from farfield.studio.samples import open_samples
from farfield.studio.session import detecting


@pytest.fixture(autouse=True)
def fake(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(detecting, "Worker", partial(Worker, loader=load))


def many_frames() -> Subset:
    return Subset(open_samples(), [0] * 12)


def test_the_worker_answers_in_the_data_s_coordinates_and_starts_anew_after_its_end():
    data = open_samples()
    worker = Worker(data, load)
    try:
        assert len(worker.ask("good", 1)) == len(data[1].boxes)
        with pytest.raises(FarfieldError, match="no detector of this name"):
            worker.ask("missing", 0)
        with pytest.raises(FarfieldError, match="ZeroDivisionError: no pixels"):
            worker.ask("breaks", 0)
        with pytest.raises(FarfieldError, match="status 7"):
            worker.ask("dies", 0)
        assert len(worker.ask("good", 0)) == len(data[0].boxes)
    finally:
        worker.stop()


def test_detectors_named_at_the_start_run_on_what_is_shown(tmp_path: Path):
    with studio(detectors=("good", "slow"), threshold=0.6, notes=tmp_path) as live, live.window() as client:
        assert {row["name"] for row in client.welcome["detectors"]} >= {"good", "slow"}
        client.open(0)
        seen = {}
        while len(seen) < 2:
            told = client.until("predicted")
            seen[told["set"]["title"]] = told["predicted"]["rows"]
        assert set(seen) == {"good", "slow"}
        assert all(row["score"] >= 0.6 for rows in seen.values() for row in rows)
        assert sum(row["match"] == "matched" for row in seen["good"]) > 5
        assert len(client.open(0)["predicted"]) == 2  # known, so not detected again


def test_a_sequence_is_detected_with_progress_and_can_be_cancelled(tmp_path: Path):
    with studio(many_frames, detectors=("slow",), notes=tmp_path) as live, live.window() as client:
        client.send(op="infer.start", id="i1", detector="slow", first=0, last=11)
        running = client.until("job", wanted=lambda job: job["state"] == "running" and job["done"] > 0)
        assert (running["total"], running["id"]) == (12, "i1")
        assert running["eta_s"] > 0
        client.send(op="infer.cancel", id="c", job=running["job"])
        ended = client.until("job", wanted=lambda job: job["state"] not in ("running", "queued"))
        assert (ended["state"], ended["done"] < 12) == ("cancelled", True)
        client.send(op="infer.cancel", id="c", job=running["job"])
        assert "no such job" in client.until("refused")["sentence"]


def test_what_fails_is_told_without_paths(tmp_path: Path):
    with studio(detectors=("missing",), notes=tmp_path) as live, live.window() as client:
        client.send(op="infer.start", id="i", detector="missing", first=0, last=1)
        failed = client.until("job", wanted=lambda job: job["state"] == "failed")
        assert failed["message"] == "…/weights: there is no detector of this name"
        client.send(op="infer.start", id="i2", detector="/etc/passwd", first=0, last=1)
        assert "on offer" in client.until("refused")["sentence"]
        client.send(op="infer.start", id="i3", detector="missing", first=1, last=0)
        assert "after the first" in client.until("refused")["sentence"]
        client.send(op="infer.start", id="i4", detector="missing", first=0, last=0, propose=True)
        assert "annotate" in client.until("refused")["sentence"]


def test_a_detector_that_ships_runs_on_both_samples(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(detecting, "Worker", Worker)
    with studio(notes=tmp_path) as live, live.window() as client:
        client.open(0)
        client.send(op="infer.start", id="i", detector="pointpillars-cirrus-sim", first=0, last=1)
        told = client.until("predicted")
        assert told["predicted"]["rows"]
        done = client.until("job", wanted=lambda job: job["state"] not in ("queued", "running"))
        assert (done["state"], done["done"]) == ("done", 2)


def test_an_error_of_ours_ends_the_job_and_not_those_behind_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    answers = iter([ZeroDivisionError("a fault"), 0])

    async def found(self, job, index, boxes):
        if isinstance(answer := next(answers), Exception):
            raise answer

    monkeypatch.setattr(detecting._DetectionSink, "__call__", found)
    with studio(notes=tmp_path, detectors=("good",)) as live, live.window() as client:
        for name, wanted in (("a", "failed"), ("b", "done")):
            client.send(op="infer.start", id=name, detector="good", first=1, last=1)
            ended = client.until("job", wanted=lambda job: job["state"] not in ("queued", "running"))
            assert (ended["id"], ended["state"]) == (name, wanted)
            assert ("error of its own" in ended["message"]) == (wanted == "failed")


def test_jobs_that_ended_are_remembered_up_to_two_hundred():
    assert asyncio.run(_names_after_cancelling(203)) == [f"job-{number}" for number in range(3, 203)]


async def _names_after_cancelling(count: int) -> list[str]:
    jobs = Jobs(Worker(open_samples(), load), _delivered, lambda job: None)
    for number in range(count):
        jobs.add(InferJob(id=f"{number}", name=f"job-{number}", detector="good", frames=deque([0, 1])))
        assert jobs.cancel(f"job-{number}")
    await jobs.close()
    return list(jobs.jobs)


async def _delivered(job: InferJob, index: int, boxes: Boxes) -> None:
    """Take the boxes of a frame."""


def test_detections_are_proposed_where_nothing_stands(tmp_path: Path):
    settings = {"mode": "annotate", "detectors": ("good",), "edits": tmp_path / "edits", "notes": tmp_path}
    with studio(**settings) as live, live.window() as client:
        rows = client.open(0)["boxes"]
        for row in rows[:2]:
            client.send(op="box.delete", id=client.new_id(), frame=0, box=row["id"], base=row["version"])
            client.until("ack")
        client.send(op="infer.start", id="p1", detector="good", first=0, last=0, threshold=0.1, propose=True)
        changed = client.until("changed", wanted=lambda message: message["id"].startswith("p1"))
        made = [each["row"] for each in changed["rows"]]
        assert 1 <= len(made) <= 2
        assert all((row["state"], row["source"]) == ("proposed", "detector") for row in made)
        assert all(row["proposal"] == row["box"] for row in made)
        client.send(op="undo", id="u1")
        gone = client.until("changed", wanted=lambda message: message["show"] is not None)
        assert {each["id"] for each in gone["removed"]} == {row["id"] for row in made}


def test_the_default_detector_is_chosen_by_what_the_data_are():
    assert next(iter(detecting.shipped_detectors("kradar", tensors=True).items())) == ("rtnh-kradar-sim", "radar")
    assert next(iter(detecting.shipped_detectors("kradar", tensors=False))) == "pointpillars-kradar-sim"
    assert next(iter(detecting.shipped_detectors("kitti", tensors=False).items())) == (
        "pointpillars-cirrus-sim",
        "LiDAR",
    )
    with studio() as live, live.window() as client:
        first = client.welcome["detectors"][0]
        assert (first["name"] == "rtnh-kradar-sim") == bool(open_samples()[0].radar)


class LostFrames(Subset):
    """Frames whose files are on a disk that does not answer."""

    def __getitem__(self, index: object) -> NoReturn:
        raise OSError(5, "Input/output error", "000000.bin")


def test_a_first_frame_that_cannot_be_read_keeps_nobody_out_and_nothing_waiting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    assert detecting.has_tensors(LostFrames(open_samples(), [0, 1])) is False
    threads, read = list[str](), detecting.has_tensors
    monkeypatch.setattr(
        detecting, "has_tensors", lambda data: (threads.append(threading.current_thread().name), read(data))[-1]
    )
    with studio(notes=tmp_path) as live, live.window() as client:
        client.send(op="infer.start", id="i", detector="missing", first=0, last=1)
        assert "detectors on offer" in client.until("refused")["sentence"]
    assert len(threads) == 2  # of the welcome and of the request
    assert all(name.startswith("studio-session") for name in threads), threads
