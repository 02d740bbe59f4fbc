"""Conditions from tables and trees, their spellings, and files that are neither."""

from pathlib import Path

import numpy as np
import pytest

from farfield.errors import ConfigError, FarfieldError, FileFormatError
from farfield.metrics.kradar.conditions import read_conditions
from farfield.vocabulary.conditions import CONDITIONS, condition_name

KEYS = [("1", "00033_00001"), ("1", "00034_00002"), ("58", "00040_00035")]
TABLE = "sequence,road,time,weather\n1,urban,night,normal\n58,countryside,day,heavysnow\n\n"


def test_there_are_the_18_subsets_of_the_kit() -> None:
    assert [len(values) for values in CONDITIONS.values()] == [7, 8, 2]
    words = ["normal", "overcast", "fog", "rain", "sleet", "lightsnow", "heavysnow"]
    roads = ["urban", "highway", "countryside", "alleyway", "parkinglots", "shoulder", "mountain", "university"]
    assert [condition_name(word) for word in words] == list(CONDITIONS["weather"])
    assert [condition_name(word) for word in roads] == list(CONDITIONS["road"])


def test_a_table_and_a_tree_tell_the_same(tmp_path: Path) -> None:
    table = tmp_path / "conditions.csv"
    table.write_text(TABLE)
    for name, line in (("1", "urban,night,normal"), ("58", "countryside,day,heavysnow\n")):
        (tmp_path / "tree" / name).mkdir(parents=True)
        (tmp_path / "tree" / name / "description.txt").write_text(line)
    found = read_conditions(table, KEYS)
    assert found == read_conditions(tmp_path / "tree", KEYS)
    assert found[KEYS[0]] == found[KEYS[1]] == {"road": "urban", "time": "night", "weather": "normal"}
    assert found[KEYS[2]] == {"road": "suburban", "time": "day", "weather": "heavy_snow"}
    assert read_conditions(table, [*KEYS, ("7", "x")]).keys() == set(KEYS)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "sequence,road,time\n1,urban,day\n",
        "sequence,road,time,weather\n1,urban,day\n",
        "sequence,road,time,weather\n1,urban,day,\n",
        "sequence,road,time,weather\n1,urban,day,fog\n1,urban,day,rain\n",
        'sequence,road,time,weather\n1,"urban,day,fog\n',
        "sequence,road,time,weather\n1,urban,day,fog,x\n",
    ],
)
def test_damaged_tables_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "conditions.csv").write_text(text)
    with pytest.raises(FileFormatError):
        read_conditions(tmp_path / "conditions.csv", KEYS)


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="found nothing"):
        read_conditions(tmp_path / "nothing", KEYS)
    with pytest.raises(ConfigError, match="sequences of the labels"):
        read_conditions(tmp_path, KEYS)
    (tmp_path / "1").mkdir()
    (tmp_path / "1" / "description.txt").write_text("urban,night")
    with pytest.raises(FileFormatError, match="road,time,weather"):
        read_conditions(tmp_path, KEYS)
    (tmp_path / "1" / "description.txt").write_bytes(b"\xff\xfe,a,b")
    with pytest.raises(FileFormatError, match="UTF-8"):
        read_conditions(tmp_path, KEYS)


def test_a_sequence_s_name_does_not_lead_out_of_the_tree(tmp_path: Path) -> None:
    (tmp_path / "tree").mkdir()
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "description.txt").write_text("urban,day,fog")
    with pytest.raises(ConfigError, match="sequences of the labels"):
        read_conditions(tmp_path / "tree", [("../outside", "1")])


def test_mutated_tables_give_clear_errors_or_conditions(tmp_path: Path, rng: np.random.Generator) -> None:
    path, refused, known = tmp_path / "conditions.csv", 0, []
    for _ in range(300):
        data = bytearray(TABLE.encode())
        for place in rng.integers(0, len(data), int(rng.integers(1, 4))):
            data[place] = int(rng.integers(0, 256))
        path.write_bytes(bytes(data[: int(rng.integers(1, len(data) + 1))]))
        try:
            known.append(read_conditions(path, KEYS))
        except FarfieldError:
            refused += 1
    assert refused > 100  # the damage was real
    assert known  # and some tables were still read
    assert all(set(found) <= set(KEYS) for found in known)
