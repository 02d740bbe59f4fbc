"""The papers' tables: against one another and against what the papers say of them in words."""

import pytest

from farfield.errors import ConfigError
from farfield.figures.tables import PUBLISHED_TABLE_4
from farfield.vocabulary.conditions import WEATHERS
from farfield.vocabulary.published_tables import CIRRUS_TABLES, KRADAR_TABLES, PUBLISHED_TABLES, PublishedTable


def shares(table: PublishedTable) -> list[float | None]:
    return [table.at(row, part, m) for row, parts in table.figures.items() for part in parts for m in parts[part]]


def test_all_tables_are_there() -> None:
    assert [*CIRRUS_TABLES] == ["I", "II", "III", "IV", "V", "VI"]
    assert [*KRADAR_TABLES] == ["3", "4", "9"]
    found = [share for tables in PUBLISHED_TABLES.values() for table in tables.values() for share in shares(table)]
    assert all(share is not None and (0 < share < 1 or share > 100) for share in found)  # megabytes are above 100


def test_a_row_that_stands_in_two_tables_is_the_same_in_both() -> None:
    one, two = CIRRUS_TABLES["I"], CIRRUS_TABLES["II"]
    for metric in ("dds", "wdds"):
        assert one.at("gaussian", "overall", metric) == two.at("voxelnet", "overall", metric)
    three, four, nine = KRADAR_TABLES.values()
    assert three.at("rtn", "overall", "ap_bev") == nine.at("rtn_resnext101", "overall", "ap_bev")
    again = nine.at("rtn_resnext101", "overall", "ap3d")
    assert four.at("rtn", "overall", "ap3d") == pytest.approx(again, abs=5e-4)


def test_table_1_widens_with_epsilon_and_falls_with_range() -> None:
    table = CIRRUS_TABLES["I"]
    for part in ("near", "mid", "far", "overall"):
        scores = [table.at("gaussian", part, metric) or 0 for metric in ("dds", "wdds_0.003", "wdds", "wdds_0.009")]
        assert scores == sorted(scores)
    assert table.bins_m == {"near": (0.0, 70.0), "mid": (70.0, 150.0), "far": (150.0, 250.0)}
    assert table.at("uniform", "near", "wdds_0.003") is None


def test_table_4_goes_through_the_weathers_in_their_order() -> None:
    table = KRADAR_TABLES["4"]
    assert [*table.figures["rtnh"]] == ["overall", *(f"weather/{name}" for name in WEATHERS)]
    assert table.at("pointpillars", "weather/sleet", "ap3d") == pytest.approx(0.227)
    assert PUBLISHED_TABLE_4["PointPillars (os2-64)"][5] == 22.7
    with pytest.raises(ConfigError, match="expected a row among rtnh"):
        table.at("second", "overall", "ap3d")
