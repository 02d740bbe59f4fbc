"""The table by weather: the paper's layout, dashes where nothing is annotated, one convention only."""

from typing import Any

import pytest

from farfield.errors import ConfigError
from farfield.figures.tables import (
    PUBLISHED_TABLE_4,
    conditional_markdown,
    conditional_rows,
)


def result(total: float, fog: float | None, **settings: Any) -> dict[str, Any]:
    def part(value: float | None) -> dict[str, Any] | None:
        return None if value is None else {"ap": {"vehicle": {"3d": {"0.3": value}, "bev": {"0.3": None}}}}

    return {
        "protocol": "kradar",
        "settings": {"score_cut": 0.0, "empty_frames": "counted", "region": "wide", **settings},
        **(part(total) or {}),
        "conditions": {"weather": {"fog": part(fog), "hail": part(0.5)}},
    }


def test_rows_are_detectors_and_columns_weathers() -> None:
    head, rows = conditional_rows({"RTNH": result(0.4741, 0.528), "RTN": result(0.40, None)})
    assert head[1:9] == ["total", "normal", "overcast", "fog", "rain", "sleet", "light snow", "heavy snow"]
    assert head[9:] == ["hail"]
    assert rows == [
        ["RTNH", "47.4", "-", "-", "52.8", "-", "-", "-", "-", "50.0"],
        ["RTN", "40.0", "-", "-", "-", "-", "-", "-", "-", "50.0"],
    ]
    assert all(len(values) == 8 for values in PUBLISHED_TABLE_4.values())


def test_markdown_names_the_convention() -> None:
    results = {"RTNH": result(0.4741, 0.528)}
    text = conditional_markdown(results)
    assert "AP3D of 'vehicle' at IoU 0.3" in text
    assert "score_cut=0; " in text or "score_cut=0\n" in text
    assert "| RTNH | 47.4 |" in text
    assert conditional_rows(results, measure="bev")[1][0][1] == "-"


def test_different_conventions_and_protocols_do_not_share_a_column() -> None:
    with pytest.raises(ConfigError, match=r"a and b .* score_cut \(0.0 and 0.3\)"):
        conditional_markdown({"a": result(0.5, 0.5), "b": result(0.5, 0.5, score_cut=0.3)})
    with pytest.raises(ConfigError, match="kradar"):
        conditional_markdown({"a": result(0.5, 0.5) | {"protocol": "dds"}})
    for results, options in (
        ({}, {}),
        ({"a": result(0.5, None)}, {"label": "bus"}),
        ({"a": result(0.5, None)}, {"kind": "x"}),
    ):
        with pytest.raises(ConfigError):
            conditional_rows(results, **options)
