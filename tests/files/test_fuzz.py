"""Damaged files give a clear error or a valid result. The benchmark of the same name tries 20,000 files a reader."""

import importlib.util
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from whole import whole_or

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "fuzz_readers.py"
WEIGHTS = (
    "weights",
    "older weights",
    "weights' record",
    "checkpoint",
    "older checkpoint",
    "best score",
    "training log",
)
READERS = (
    *("xyz", "pcd", "velodyne bin", "ffcloud", "images", "upright images", "depth png"),
    *("kitti calib", "kitti label", "kitti tracking"),
    *("kitti detections", "boxes csv", "cirrus json"),
    *("openlabel", "sustechpoints", "datumaro", "supervisely", "tracklets", "frame lists", "class mappings"),
    *("mat", "mat in blocks", "npy"),
    *("kradar labels", "kradar times", "kradar description", "kradar calib", "kradar camera", "kradar odometry"),
    *("kradar gt_rel", "kradar gps", "kradar imu", "kradar local", "kradar split", "kradar record", "radar cells"),
    *("radar cells sealed", "delft poses", "delft labels", "astyx points", "astyx objects", "astyx sensors"),
    *("radiate times", "radiate tracks", "stamps", "clock logs", "captures", "ouster metadata"),
    *(("films",) if importlib.util.find_spec("av") else ()),
    *(("bag.mcap", "bag.db3") if importlib.util.find_spec("rosbags") else ()),
    *("cloud pcd", "cloud ffcloud", "cloud npy", "cloud rows npy", "kradar lidar pcd", "kradar sparse npy"),
    *("cloud npz", "cloud ply", "cloud las", "aimotive boxes", "aimotive targets", "aimotive sensors"),
    *("argoverse1 labels", "argoverse1 pose", "dual radar labels"),
    *(WEIGHTS if importlib.util.find_spec("torch") else ()),
)

FORMS = (
    *("yaml class mapping", "yaml cirrus mapping", "yaml calibration", "json calibration", "json nuscenes"),
    *("json results", "json evaluation", "json mmdetection3d", "kit's texts", "edits", "job journal"),
    *(("yaml experiment", "weights' settings", "checkpoint's tensors") if importlib.util.find_spec("torch") else ()),
    *(("form of bag.mcap", "form of bag.db3") if importlib.util.find_spec("rosbags") else ()),
)
FILES = whole_or(1000, 200)
GROUPS = 4
"""Of readers that one command tries: each command imports all that they need."""


@pytest.fixture(scope="module")
def fuzzer() -> Iterator[ModuleType]:
    spec = importlib.util.spec_from_file_location("fuzz_readers", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules["fuzz_readers"] = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SCRIPT.parent))
        spec.loader.exec_module(module)
        yield module


@pytest.fixture(scope="module")
def targets(fuzzer: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    made: dict[str, Any] = fuzzer.targets(tmp_path_factory.mktemp("seeds"))
    return made


def test_no_reader_is_forgotten(targets: dict[str, Any]) -> None:
    assert tuple(targets) == READERS


@pytest.mark.parametrize("reader", READERS)
def test_damaged_files_never_surprise(fuzzer: ModuleType, targets: dict[str, Any], tmp_path: Path, reader: str) -> None:
    tally = fuzzer.fuzz(targets[reader], 300, tmp_path, seed=1)
    assert tally.faults == ()
    assert tally.errors > 100  # the damage was real
    assert tally.results > 0  # and the good files were read


def test_the_fuzzer_notices_what_it_is_there_for(fuzzer: ModuleType, tmp_path: Path) -> None:
    def careless(path: Path) -> np.ndarray:
        return np.array([[float(path.read_text().split(",")[0])]])

    target = fuzzer.Target(".xyz", careless, (b"1.5,2\n",), fuzzer.finite_rows)
    tally = fuzzer.fuzz(target, 300, tmp_path)
    assert any("ValueError" in fault for fault in tally.faults)
    assert list(tmp_path.glob("fault_*.xyz"))


@pytest.fixture(scope="module")
def form_targets(fuzzer: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    made: dict[str, Any] = fuzzer.form_targets(tmp_path_factory.mktemp("forms"))
    return made


@pytest.mark.parametrize(("slow_reads", "faults"), [(1, 0), (2, 1)])
def test_what_is_slow_twice_counts(
    fuzzer: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, slow_reads: int, faults: int
) -> None:
    """The first file that needs a module pays for its import."""
    clock, reads = [0.0], [0]

    def read(path: Path) -> np.ndarray:
        reads[0] += 1
        clock[0] += 3.0 if reads[0] <= slow_reads else 0.1
        return np.ones((1, 3))

    monkeypatch.setattr(fuzzer.time, "process_time", lambda: clock[0])
    tally = fuzzer.fuzz(fuzzer.Target(".xyz", read, (b"1,2\n",), fuzzer.finite_rows), 1, tmp_path)
    assert len(tally.faults) == faults


@pytest.mark.slow
def test_every_form_is_tried(form_targets: dict[str, Any]) -> None:
    assert tuple(form_targets) == FORMS


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
def test_settings_records_and_journals_changed_in_their_structure(
    fuzzer: ModuleType, form_targets: dict[str, Any], tmp_path: Path, form: str
) -> None:
    """A sample of the part ``forms``, which changes 500 of each in processes of limited memory."""
    tally = fuzzer.fuzz(form_targets[form], 60, tmp_path, seed=2)
    assert tally.faults == ()
    assert tally.errors > 20


@pytest.mark.slow
@pytest.mark.parametrize("group", range(GROUPS))
def test_hundreds_of_damaged_files_a_reader(tmp_path: Path, group: int) -> None:
    """Each in a process of its own, whose memory is limited."""
    readers = READERS[group::GROUPS]
    command = [sys.executable, str(SCRIPT), "fuzz", "--only", *readers, "--files", str(FILES)]
    command += ["--output", str(tmp_path / "table.txt"), "--keep", str(tmp_path / "faults")]
    finished = subprocess.run(command, capture_output=True, text=True, check=False)
    assert finished.returncode == 0, finished.stdout + finished.stderr
    assert [reader for reader in readers if f"\n{reader:20}{FILES:8}" not in finished.stdout] == []
