"""Slips in configuration are refused: flags and infinities as numbers, words under another header, doubled parts."""

import json
from pathlib import Path
from typing import Any

import pytest

from farfield.annotation.schema import SCHEMA, Schema, load_schema
from farfield.datasets.cirrus.layout import read_mapping
from farfield.datasets.splits import read_parts
from farfield.errors import ConfigError, DatasetError, FarfieldError, FileFormatError
from farfield.experiments.schema import load_experiment
from farfield.metrics.kradar.conditions import read_conditions


def written(path: Path, content: Any) -> Path:
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


@pytest.mark.parametrize(("key", "value"), [("steps", "true"), ("learning_rate", "true"), ("learning_rate", ".inf")])
def test_experiments_take_no_flag_for_a_number(tmp_path: Path, key: str, value: str) -> None:
    text = f"name: mine\nextends: pointpillars-cirrus-sim\ntraining: {{{key}: {value}}}\n"
    with pytest.raises(ConfigError, match="finite" if value == ".inf" else key):
        load_experiment(written(tmp_path / "a.yaml", text))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"\x1f\x8b\x08", "gzip"),
        (b"name: \xff", "UTF-8"),
        (b"[" * 5000, "YAML"),
        (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
    ],
)
def test_what_is_no_experiment_is_named(tmp_path: Path, data: bytes, words: str) -> None:
    (tmp_path / "a.yaml").write_bytes(data)
    with pytest.raises(FarfieldError, match=words):
        load_experiment(tmp_path / "a.yaml")


@pytest.mark.parametrize(
    "text",
    [
        "pairing: {max_dt_ms: true}",
        "segments: {gap_s: true}",
        "segments: {gap_s: .inf}",
        "labels: {yaw_offset_deg: yes}",
    ],
)
def test_mappings_take_no_flag_for_a_number(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError):
        read_mapping(written(tmp_path / "mapping.yaml", text))


@pytest.mark.parametrize("size", ["[true, 1, 1]", "[.inf, 1, 1]"])
def test_schemas_take_no_flag_for_a_number(tmp_path: Path, size: str) -> None:
    written(tmp_path / SCHEMA, f"classes: {{a: {{size_m: {size}}}}}")
    with pytest.raises(ConfigError, match="finite" if "inf" in size else "size_m"):
        load_schema(tmp_path, Schema(classes={}))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"train": ["a"], "val": ["a"]}', "'a' in train and in val"),
        ('{"train": ["a"], "train": ["b"]}', "twice"),
        ('{"train": [3]}', "names"),
        ("[" * 100_000, "JSON"),
    ],
)
def test_splits(tmp_path: Path, text: str, words: str) -> None:
    parts = {"train": ["a"], "val": ["b"], "small": ["a"]}
    assert read_parts(written(tmp_path / "good.json", parts), ["a", "b", "3"]) == parts
    with pytest.raises(DatasetError, match=words):
        read_parts(written(tmp_path / "a.json", text), ["a", "b", "3"])


def test_words_of_another_kind_are_no_conditions(tmp_path: Path) -> None:
    for line in ("night,urban,normal", "urban,fog,night", "ur\0ban,night,normal"):
        (tmp_path / "1").mkdir(exist_ok=True)
        written(tmp_path / "1" / "description.txt", line)
        with pytest.raises(FileFormatError, match="road,time,weather"):
            read_conditions(tmp_path, [("1", "a")])
    table = written(tmp_path / "a.csv", "sequence,weather,road,time\n1,urban,night,fog\n")
    with pytest.raises(FileFormatError, match="line 2"):
        read_conditions(table, [("1", "a")])
