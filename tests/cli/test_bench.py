"""``farfield bench``: plans from a file of rates, what it prints and writes, and what it refuses."""

import json
from pathlib import Path

import pytest
from made_rates import machine, rate

from farfield.cli import main
from farfield.cli._completion import flags_of
from farfield.sizing import MachineRates, read_rates

Capsys = pytest.CaptureFixture[str]


@pytest.fixture
def rates() -> MachineRates:
    return machine(
        rate("convert --to radar-store", 0.25, reads=["tesseract"], bytes_out=329e3),
        rate("odometry", 0.1, frames_of="cirrus", reads=["cloud", "cloud"]),
        rate("rtnh-kradar-sim", 0.06, kind="detector", precision="bf16", reads=["cells"]),
        commit="abc123",
        left_out={"anonymize (cirrus)": "needs cv2"},
    )


@pytest.fixture
def file(rates: MachineRates, tmp_path: Path) -> Path:
    path = tmp_path / "rates.json"
    path.write_text(rates.model_dump_json())
    return path


def run(capsys: Capsys, *words: str | Path) -> tuple[int, str]:
    status = main(["bench", *map(str, words)])
    out, err = capsys.readouterr()
    return status, out + err


def test_all_of_k_radar_from_a_file(file: Path, tmp_path: Path, capsys: Capsys) -> None:
    words = ["--for", "35000-frames-kradar", "--rates", file, "--disk-mb-s", "200", "--price-per-hour", "0.5"]
    status, text = run(capsys, *words, "--cores", "1", "--json", tmp_path / "plan.json")
    assert status == 0, text
    assert "35,000 frames of K-Radar: 0.972 h of driving; on 1 machine of 1 core" in text
    line = next(line for line in text.splitlines() if line.startswith("reading every file once"))
    assert line.split()[-6:] == ["22.2", "22.2", "disk", "16", "0", "11.11"]  # 16e12 / 200e6 / 3600 h, at half a dollar
    assert "commit abc123; 2026-01-01" in text.replace("farfield 0, ", "")
    tree = json.loads((tmp_path / "plan.json").read_text())
    assert tree["plan"]["workload"]["frames"] == 35_000
    store = tree["plan"]["rows"][1]
    assert (store["name"], store["bottleneck"]) == ("convert --to radar-store", "disk")
    assert store["core_hours"] == pytest.approx(35_000 * 0.25 / 3600)
    assert read_rates(tmp_path / "plan.json") == read_rates(file)


def test_prices_and_disks_that_are_not_known_are_said(file: Path, capsys: Capsys) -> None:
    status, text = run(capsys, "--for", "1000h", "--rates", file)
    assert status == 0
    assert "36,000,000 frames of Cirrus: 1,000 h of driving" in text
    for words in ("no data set is named", "--disk-mb-s", "--price-per-hour", "Cirrus has no 4D radar"):
        assert words in text
    assert "dollars" not in text


def test_what_is_measured_is_printed_and_written(
    rates: MachineRates, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capsys
) -> None:
    monkeypatch.setattr("farfield.sizing.measuring.measure_rates", lambda **unused: rates)
    status, text = run(capsys, "--json", tmp_path / "rates.json", "--for", "kradar")
    assert status == 0
    assert read_rates(tmp_path / "rates.json") == rates
    line = next(line for line in text.splitlines() if line.startswith("convert --to radar-store"))
    assert line.split()[3:] == ["kradar", "4", "-", "1,040", "329", "1"]
    assert "two workers side by side do 1.60 times what one does" in text
    assert "left out: anonymize (cirrus): needs cv2" in text
    assert "34,994 frames of K-Radar" in text


def test_workloads_are_completed() -> None:
    assert {"kradar", "35000-frames-kradar"} <= set(flags_of("bench")["--for"])


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--for", "lots"], "--for: expected a data set among"),
        (["--for", "40"], "--for: expected frames or hours of a data set"),
        (["--for", "kradar", "--machines", "0"], "--machines: expected a number from 1"),
        (["--machines", "2"], "--machines: expected --for WORKLOAD too"),
        (["--months", "1"], "--months: expected --for WORKLOAD too"),
        (["--rates", "RATES"], "--rates: expected --for WORKLOAD too"),
        (["--for", "kradar", "--rates", "RATES", "--only", "stats"], "--only: expected to measure, got --rates"),
        (["--for", "kradar", "--rates", "RATES", "--device", "cpu"], "--device: expected to measure, got --rates"),
        (["--for", "kradar", "--rates", "RATES", "--json", "RATES"], "which is read"),
        (["--for", "kradar", "--rates", "RATES", "--minutes", "1"], "--minutes: expected to measure, got --rates"),
        (["--minutes", "0"], "--minutes: expected more than 0"),
        (["--only", "nothing-such"], "--only: expected verbs, detectors"),
    ],
)
def test_what_does_not_go_together_is_refused(file: Path, capsys: Capsys, words: list[str], expected: str) -> None:
    status, text = run(capsys, *(word.replace("RATES", str(file)) for word in words))
    assert status == 1
    assert expected in text
