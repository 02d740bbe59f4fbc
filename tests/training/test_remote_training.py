"""A training whose frames lie in a store, read by workers of its own: the steps of one that reads a folder."""

import json
from pathlib import Path

import pytest
from small_s3 import SmallS3

pytest.importorskip("torch")
pytest.importorskip("obstore")

from farfield.experiments.plan import Plan
from farfield.experiments.schema import load_experiment
from farfield.files.remote_paths import list_anew
from farfield.files.remote_stores import find_store, may_be_copied

pytestmark = pytest.mark.slow


def test_workers_read_frames_from_a_store(
    experiment: Path, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = SmallS3()
    server.objects = {
        f"bucket/{data.name}/{path.relative_to(data).as_posix()}": path.read_bytes()
        for path in data.rglob("*")
        if path.is_file()
    }
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for name, value in server.environment.items():
        monkeypatch.setenv(name, value)
    find_store.cache_clear()
    list_anew()
    assert may_be_copied()
    settings = ["training.steps=6", "training.workers=1"]
    try:
        Plan(load_experiment(experiment, settings), tmp_path / "folder").run()
        remote = [*settings, f"data.path=s3://bucket/{data.name}"]
        Plan(load_experiment(experiment, remote), tmp_path / "store").run()
        assert not may_be_copied()
    finally:
        server.shutdown()
        server.server_close()
        find_store.cache_clear()
        list_anew()
    one, other = (
        [json.loads(line)["loss"] for line in (tmp_path / run / "log.jsonl").read_text().splitlines()]
        for run in ("folder", "store")
    )
    assert one == other
    assert len(one) == 6
