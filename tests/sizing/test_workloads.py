"""Workloads in words, and the published sizes beneath them."""

import pytest

from farfield.errors import ConfigError
from farfield.sizing import DATASET_SIZES, parse_workload


@pytest.mark.parametrize(
    ("text", "dataset", "frames"),
    [
        ("35000-frames-kradar", "kradar", 35_000),
        ("35,000-frames-kradar", "kradar", 35_000),
        ("35_000 frames-KRadar", "kradar", 35_000),
        ("1-frame-cirrus", "cirrus", 1),
        ("40h-cirrus", "cirrus", 40 * 36_000),
        ("0.5-hours-kradar", "kradar", 18_000),
        ("1000h", "cirrus", 36_000_000),
        ("kradar", "kradar", 34_994),
        ("cirrus", "cirrus", 6_285),
    ],
)
def test_words_that_are_understood(text: str, dataset: str, frames: int) -> None:
    workload = parse_workload(text)
    assert (workload.dataset, workload.frames) == (dataset, frames)
    assert workload.named == (dataset in text.lower())


@pytest.mark.parametrize(
    "text",
    ["", "35000", "kradar-35000-frames", "-1h-cirrus", "40h-", "1e5-frames-kradar", "many-frames-kradar", "nanh"],
)
def test_words_that_are_not_say_which_are(text: str) -> None:
    with pytest.raises(ConfigError, match=r"--for: expected .*(35000-frames-kradar|kradar, cirrus)"):
        parse_workload(text)


def test_a_data_set_that_is_not_known_is_named() -> None:
    with pytest.raises(ConfigError, match="expected a data set among kradar, cirrus; got 'waymo'"):
        parse_workload("40h-waymo")


@pytest.mark.parametrize("text", ["0-frames-kradar", "0h", "1.5-frames-kradar", "9" * 30 + "h", "9" * 400 + "h"])
def test_so_many_frames_are_none(text: str) -> None:
    with pytest.raises(ConfigError, match="expected 1 to 1,000,000,000,000 whole frames"):
        parse_workload(text)


def test_k_radar_is_published_at_some_three_hundred_megabytes_a_tensor() -> None:
    size = DATASET_SIZES["kradar"]
    assert size.frame_bytes["tesseract"] == pytest.approx(360e9 / 1195, rel=1e-6)
    assert size.packed_bytes["tesseract"] == 64 * 256 * 37 * 107 * 8
    assert size.whole_frame_bytes * 35_000 == pytest.approx(16e12)
    parts = sum(size.frame_bytes[name] for name in ("tesseract", "clouds", "cameras", "labels")) + 72e9 / 1195
    assert parts * size.frames == pytest.approx(13.8e12, rel=0.01)  # 13 TB by the first readme, 16 by the last
