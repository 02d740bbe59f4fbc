"""``farfield simulate``: the files, resuming, workers, refusals."""

import json
from pathlib import Path

import numpy as np
import pytest

from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.simulation import simulate_frame


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("simulate") / "mini"
    assert main(["simulate", "cirrus-sim-mini", str(out), "--frames", "4", "--workers", "1", "--cache"]) == 0
    return out


def test_data_set_reads_back_as_simulated(written: Path) -> None:
    dataset = open_dataset(written)
    assert dataset.name == "cirrus"
    assert list(dataset.sequences) == ["segment_00", "segment_00", "segment_01", "segment_01"]
    frame, expected = dataset[3], simulate_frame("cirrus-sim-mini", sequence=1, index=1)
    assert frame.key == expected.key
    for name in ("gaussian", "uniform"):
        np.testing.assert_allclose(frame.clouds[name].points_m, expected.clouds[name].points_m, atol=1e-4)
        np.testing.assert_allclose(frame.clouds[name].intensity, expected.clouds[name].intensity, atol=1e-5)
    assert frame.boxes is not None
    assert expected.boxes is not None
    np.testing.assert_allclose(frame.boxes.centre_m, expected.boxes.centre_m, atol=1e-5)
    np.testing.assert_array_equal(frame.boxes.label, expected.boxes.label)
    np.testing.assert_array_equal(frame.boxes.point_count, expected.boxes.point_count)


def test_resumes_to_the_same_bytes_with_two_workers(
    written: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    out = tmp_path / "again"
    assert main(["simulate", "cirrus-sim-mini", str(out), "--frames", "4", "--workers", "2"]) == 0
    whole = contents(out)
    expected = {name: data for name, data in contents(written).items() if ".farfield_cache" not in name}
    assert whole == expected
    lost = sorted(name for name in whole if "uniform" in name)[1]
    (out / lost).unlink()
    capsys.readouterr()
    assert main(["simulate", "cirrus-sim-mini", str(out), "--frames", "4", "--workers", "1"]) == 0
    assert "4 frames in 2 sequences, 1 still to write" in capsys.readouterr().out
    assert contents(out) == expected


def test_cache_is_added_to_complete_frames(written: Path) -> None:
    assert len(list(written.rglob("*.ffcloud"))) == 8


def test_refuses_a_folder_with_other_things(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    assert main(["simulate", "cirrus-sim-mini", str(tmp_path)]) == 1
    assert "expected an empty or absent folder" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_refuses_other_settings_in_the_same_folder(written: Path, capsys: pytest.CaptureFixture) -> None:
    before = contents(written)
    assert main(["simulate", "cirrus-sim-mini", str(written), "--seed", "9"]) == 1
    assert "differs in: seed" in capsys.readouterr().err
    assert contents(written) == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["cirrus-sim-mini", "OUT", "--stride-s", "2"], "at most 1 s, got 2"),
        (["cirrus-sim-mini", "OUT", "--frames", "500"], "have room for 40 frames, got 500"),
        (["cirrus-sim-mini", "OUT", "--frames", "0"], "expected at least 1, got 0"),
        (["cirrus-sim-val-v2", "OUT", "--seed", "1"], "is frozen"),
        (["cirrus-sim-val-v2", "OUT", "--frames", "500"], "is frozen"),
        (["snowstorm", "OUT"], "expected one of cirrus-sim"),
    ],
)
def test_wrong_arguments(arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    out = tmp_path / "out"
    assert main(["simulate", *[str(out) if word == "OUT" else word for word in arguments]]) == 1
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_full_disk_is_noticed_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda _: type("Usage", (), {"free": 1000})())
    assert main(["simulate", "cirrus-sim-mini", str(tmp_path / "out")]) == 1
    assert "GB are free" in capsys.readouterr().err


def test_frozen_split_is_compared_with_its_record(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert main(["simulate", "cirrus-sim-val-v2", str(tmp_path / "val"), "--frames", "2", "--workers", "1"]) == 0
    said = capsys.readouterr().out
    assert "checksums: " in said
    assert "0 different" in said
    settings = json.loads((tmp_path / "val" / "simulation.json").read_text())
    assert settings["seed"] == 731002
