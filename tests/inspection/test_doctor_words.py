"""What the doctor concludes, and on how much: units of clouds, headings by interval, labels against clock and road."""

from pathlib import Path

import numpy as np
import pytest

import farfield as ff
from farfield.cli.doctor import _print
from farfield.inspection.doctor import examine
from farfield.inspection.doctor.conventions import misfit_is_clear
from farfield.inspection.doctor.kradar import contradictions
from farfield.inspection.doctor.survey import DoctorReport, Finding


def road_m() -> np.ndarray:
    """A sweep from a roof 2 m above a road to 250 m, with walls beside it."""
    rng = np.random.default_rng(1)
    range_m = rng.exponential(22.0, 20_000) + 4.0
    azimuth = rng.uniform(-1.0, 1.0, len(range_m))
    flat = np.column_stack([range_m * np.cos(azimuth), range_m * np.sin(azimuth), np.full(len(range_m), -2.0)])
    flat[::5, 2] = rng.uniform(-2.0, 4.0, len(flat[::5]))
    return flat[range_m < 250]


@pytest.mark.parametrize(("scale", "unit"), [(1, ""), (100, "centimetres"), (1000, "millimetres")])
def test_a_cloud_s_unit_is_told_from_its_shape(tmp_path: Path, scale: int, unit: str) -> None:
    """A cloud to 250 m in centimetres reaches 25,000, as one to 25 m in millimetres does."""
    points = road_m() * scale
    np.save(tmp_path / "0.npy", np.column_stack([points, np.full(len(points), 0.5)]).astype(np.float32))
    found = [each for each in examine(ff.open_dataset(tmp_path)).findings if each.topic == "units"]
    assert [unit in each.what and each.severity == "fail" for each in found] == ([True] if unit else [])


@pytest.mark.parametrize(("count", "words"), [(1, "1 finding would"), (2, "2 findings would")])
def test_one_finding_is_one_finding(capsys: pytest.CaptureFixture[str], count: int, words: str) -> None:
    fault = Finding(severity="fail", topic="units", what="centimetres")
    _print(DoctorReport(path="here", format="folder", findings=(fault,) * count))
    assert words in capsys.readouterr().out


@pytest.mark.parametrize(
    ("share", "boxes", "clear"),
    [(6 / 13, 13, False), (8 / 13, 13, False), (0.5, 100, True), (0.9, 13, True), (1.0, 3, False)],
)
def test_a_heading_fault_needs_more_than_a_few_boxes(share: float, boxes: int, clear: bool) -> None:
    assert misfit_is_clear(share, boxes) == clear


@pytest.mark.parametrize(
    ("time", "hour", "said"),
    [("day", 10, False), ("day", 23, True), ("night", 23, False), ("night", 12, True), ("day", 18, False)],
)
def test_a_drive_s_clock_is_held_against_its_label(time: str, hour: int, said: bool) -> None:
    """Table 8: day 6 to 16 h, night 20 to 4 h; between them either may be right. The cars drove in Korea (UTC+9)."""
    utc_ns = int((1_640_000_000 // 86400 * 86400 + (hour - 9) * 3600) * 1e9)
    assert bool(list(contradictions({"time": time}, utc_ns, None))) == said


@pytest.mark.parametrize(
    ("road", "speed_m_s", "said"),
    [
        ("highway", 27.0, False),
        ("highway", 5.0, True),
        ("urban", 30.0, True),
        ("urban", 12.0, False),
        ("alleyway", 5.0, False),
    ],
)
def test_a_drive_s_speed_is_held_against_its_road(road: str, speed_m_s: float, said: bool) -> None:
    assert bool(list(contradictions({"road": road}, None, speed_m_s))) == said


def test_both_spellings_of_the_cube_s_folder_are_read() -> None:
    from farfield.datasets.kradar.index import spellings

    assert [path.as_posix() for path in spellings("cube", "1", 33)] == [
        "1/radar_zyx_cube/cube_00033.mat",
        "1/radar_xyz_cube/cube_00033.mat",
    ]


@pytest.mark.parametrize("place", ["description.txt", "info_condition/description.txt"])
def test_score_finds_descriptions_where_the_reader_does(tmp_path: Path, place: str) -> None:
    from farfield.metrics.kradar.conditions import read_conditions

    file = tmp_path / "7" / place
    file.parent.mkdir(parents=True)
    file.write_text("urban,night,rain\n")
    assert read_conditions(tmp_path, [("7", "0")])["7", "0"]["weather"] == "rain"
