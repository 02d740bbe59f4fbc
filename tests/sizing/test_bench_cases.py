"""What is measured and how: every bulk verb, the clock of units, repeats within a time, two at once, the disk."""

import inspect
import time
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import get_type_hints

import pytest

from farfield.cli import VERBS
from farfield.cli._flags import JobFlags
from farfield.errors import ConfigError, MissingExtraError
from farfield.jobs import Unit, UnitResult, run, values
from farfield.simulation.recording import RecordingOptions
from farfield.sizing import measuring
from farfield.sizing.cases import NOT_MEASURED, BenchCase, BenchFrames, UnitClock, bytes_of, parts_of, verb_cases
from farfield.sizing.measuring import cases_of, disk_rates, inflating_rate, measure_rates, measured, share_of_two


def waits(unit: Unit) -> UnitResult:
    time.sleep(unit.parameters)
    return UnitResult(value=unit.name)


def writes(seconds: float, calls: list[Path], out: Path) -> tuple[float, float]:
    calls.append(out)
    out.mkdir()
    (out / "a").write_bytes(b"1234")
    return seconds, float(bytes_of(out))


def case(name: str, measure: Callable[[Path], tuple[float, float]]) -> BenchCase:
    return BenchCase(name=name, kind="verb", frames_of="cirrus", reads=("cloud",), measure=measure)


def test_every_verb_that_works_in_bulk_is_measured_or_has_a_reason_not_to(tmp_path: Path) -> None:
    bulk = {"simulate", "reproduce", "demo"}  # workers is a field of RecordingOptions; processes of its own; fixed
    assert "workers" in inspect.signature(RecordingOptions).parameters
    for verb in VERBS:
        function = import_module(f"farfield.cli.{verb.replace('-', '_')}").run
        if JobFlags in get_type_hints(function).values():
            bulk.add(verb)
    assert {"predict", "convert", "anonymize"} < bulk
    cases = verb_cases(BenchFrames(tmp_path), None, "")
    assert {one.name.split()[0] for one in cases} | set(NOT_MEASURED) == bulk
    assert not {one.name.split()[0] for one in cases} & set(NOT_MEASURED)
    labels = [one.label for one in cases]
    assert len(labels) == len(set(labels))
    assert not any(tmp_path.iterdir())  # frames are simulated when they are first worked on


def test_every_detector_that_ships_is_measured_in_both_number_types(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    from farfield.detectors.weights import bundled_weights

    cases = cases_of(("detectors",), BenchFrames(tmp_path))
    assert {(one.name, one.precision) for one in cases} == {
        (name, precision) for name in bundled_weights() for precision in ("fp32", "bf16")
    }


def test_the_clock_takes_units_and_nothing_else() -> None:
    """Whoever works: a run that hands its units out, and one that gives their values."""
    for work in (run, values):
        clock = UnitClock()
        done = work(waits, [Unit("a", parameters=0.02), Unit("b", parameters=0.06)], clock.options)
        if work is values:
            assert [result.value for result in done] == ["a", "b"]
        time.sleep(0.05)
        first, second = clock.seconds
        assert first >= 0.02
        assert second >= 0.06


def test_a_case_counts_once_after_one_that_does_not_however_short_its_share(tmp_path: Path) -> None:
    calls: list[Path] = []
    rate = measured(case("a", partial(writes, 0.5, calls)), tmp_path / "out", share_s=0.0)
    assert len(calls) == 2
    assert (rate.seconds, rate.bytes_out, rate.reads) == ((0.5,), 4.0, ("cloud",))
    assert not (tmp_path / "out").exists()


def test_a_case_takes_its_share_of_the_time_and_no_more_repeats_than_help(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[Path] = []
    rate = measured(case("a", partial(writes, 0.5, calls)), tmp_path / "out", share_s=1e9)
    assert len(rate.seconds) == measuring.MOST
    now = iter(range(100))
    monkeypatch.setattr("time.monotonic", lambda: float(next(now)))
    rate = measured(case("a", partial(writes, 0.5, calls)), tmp_path / "out", share_s=6.0)
    assert 3 < len(rate.seconds) < measuring.MOST


def lacks(out: Path) -> tuple[float, float]:
    del out
    raise MissingExtraError("cv2", "privacy", "covering faces")


def test_what_lacks_an_extra_is_left_out_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cases = [case("a", partial(writes, 0.5, [])), case("b", lacks)]
    monkeypatch.setattr(measuring, "cases_of", lambda *unused: cases)
    monkeypatch.setattr(measuring, "disk_rates", lambda folder: (100.0, 50.0))
    monkeypatch.setattr(measuring, "_gpu_name", lambda device: "")
    rates = measure_rates(minutes=0.001)
    assert [rate.name for rate in rates.rates] == ["a"]
    assert list(rates.left_out) == ["b (cirrus)"]
    assert "privacy" in rates.left_out["b (cirrus)"]
    assert (rates.disk_read_mb_s, rates.disk_write_mb_s, rates.two_at_once) == (100.0, 50.0, None)
    assert rates.cores >= 1
    assert rates.date.endswith("UTC")
    cases.pop(0)
    with pytest.raises(MissingExtraError, match="covering faces"):
        measure_rates(minutes=0.001)


def test_two_at_once_counts_what_both_did_together() -> None:
    """One worker starts a second later: its first second alone, the other's last one, count nothing."""
    alone = [(1, 0.0, 1.0), (1, 1.0, 2.0)]
    first = [(1, 0.0, 0.9), (1, 1.0, 2.25), (1, 2.25, 3.5), (1, 3.5, 4.75)]
    second = [(2, 1.0, 2.25), (2, 2.25, 3.5), (2, 3.5, 4.75), (2, 4.75, 5.5)]
    assert share_of_two(alone, [*first, *second]) == pytest.approx(0.8)
    assert share_of_two(alone, first) is None
    assert share_of_two(alone, [(1, 0.0, 1.0), (2, 1.0, 2.0)]) is None
    assert share_of_two([(1, 0.0, 2.0)], [(1, 0.0, 1.0), (2, 0.0, 1.0)]) == 1.0


def test_the_disk_is_measured_and_left_as_it_was(tmp_path: Path) -> None:
    read, write = disk_rates(tmp_path, size_bytes=1_000_000)
    assert write is not None
    assert write > 0
    assert read is None or read > 0
    assert not any(tmp_path.iterdir())
    assert inflating_rate() > 0


def test_parts_of_frames_are_told_by_the_names_of_their_files() -> None:
    names = {
        "Cirrus_dataset1/dataset1_gaussian/1.xyz": ("cloud", "clouds"),
        "Cirrus_dataset1/dataset1_uniform/1.xyz": ("clouds",),
        "Cirrus_dataset1/dataset1_camera/1.jpg": ("camera", "cameras"),
        "Cirrus_dataset1/dataset1_annotation/1.json": ("labels",),
        "1/os2-64/os2-64_00001.pcd": ("cloud", "clouds"),
        "1/cam-front/cam-front_00001.png": ("camera", "cameras"),
        "1/radar_tesseract/tesseract_00001.mat": ("tesseract",),
        "radar_cells/1/cells_00001.h5": ("cells",),
        "kradar_revised_label_v2_1/KRadar_revised_visibility/1/00001_00001.txt": ("labels",),
        "1/info_calib/calib_radar_lidar.txt": (),
    }
    assert {name: parts_of(name) for name in names} == names


@pytest.mark.parametrize("minutes", [0.0, -1.0, float("nan"), 1e9])
def test_a_time_that_is_none_is_refused(minutes: float) -> None:
    with pytest.raises(ConfigError, match="--minutes: expected more than 0"):
        measure_rates(minutes=minutes)


def test_words_that_fit_nothing_are_refused_with_the_names(tmp_path: Path) -> None:
    frames = BenchFrames(tmp_path)
    assert [one.name for one in cases_of(("kitti", "boxes-csv"), frames)] == [
        "convert --to kitti",
        "convert --to boxes-csv",
    ]
    with pytest.raises(ConfigError, match=r"--only: expected verbs, detectors .*convert --to kitti.*; got 'kity'"):
        cases_of(("kitti", "kity"), frames)


@pytest.mark.slow
@pytest.mark.whole
def test_every_case_works_on_its_frames_and_reads_what_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One repeat of each; whoever reads something has its size."""
    pytest.importorskip("torch")
    pytest.importorskip("embreex")
    monkeypatch.setattr(measuring, "_DISK_BYTES", 8_000_000)
    rates = measure_rates(minutes=0.001, device="cpu")
    names = {one.label for one in cases_of((), BenchFrames(tmp_path))}
    assert len(rates.rates) + len(rates.left_out) == len(names)
    for rate in rates.rates:
        assert all(rates.sizes[rate.frames_of][part] > 0 for part in rate.reads), rate.name
        assert bool(rate.bytes_out) == rate.name.startswith(
            ("simulate", "convert", "odometry", "depth", "anonymize", "report", "predict", "evaluate")
        ), rate.name
    assert rates.sizes["kradar"]["tesseract"] == pytest.approx(64 * 256 * 37 * 107 * 4, rel=1e-3)
