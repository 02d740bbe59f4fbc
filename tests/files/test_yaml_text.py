"""One loader for all YAML: bounded, with the values that the file shows."""

import time
from typing import Any

import pytest
import yaml

from farfield.errors import plain
from farfield.files.yaml_text import MAX_BYTES, MAX_DEPTH, MAX_NODES, plain_yaml

LAUGHS = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{name}: &{name} [{','.join(['*' + before] * 9)}]\n" for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)
MERGES = (
    "a: &a {"
    + ", ".join(f"k{n}: {n}" for n in range(9))
    + "}\n"
    + "".join(
        f"{name}: &{name} {{v: [{', '.join(['{<<: *' + before + '}'] * 9)}]}}\n"
        for before, name in zip("abcdefgh", "bcdefghi", strict=True)
    )
)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (LAUGHS, "more than 100000 values"),
        (MERGES, "more than 100000 values"),
        ("a: &a [1, *a]", "within its own value"),
        ("a: &a {<<: *a}", "within its own value"),
        ("[" * 5000, "nested deeper than 64"),
        ("\n".join(" " * level + "a:" for level in range(900)), "nested deeper than 64"),
        ("- " * 5000, "nested deeper than 64"),
        ("a: 1\nb: 2\na: 3", "the key 'a' twice in one group, in lines 1 and 3"),
        ("{a: 1, b: {c: 1, c: 2}}", "the key 'c' twice"),
        (f"a: {'9' * 5000}", "beyond 64 bits"),
        (f"seed: {1 << 64}", "beyond 64 bits"),
        (f"seed: {-(1 << 63) - 1}", "beyond 64 bits"),
        ("a: 0x" + "f" * 17, "beyond 64 bits"),
        ("a: .inf", "no finite number"),
        ("a: -.INF", "no finite number"),
        ("a: .nan", "no finite number"),
        ("a: 1.0e999", "no finite number"),
        ('a: "\\U7fffffff"', "chr()"),
        ('a: "\\ud800"', "surrogates not allowed"),
        ("!!int abc", "abc"),
        ('!!int ""', "invalid literal"),
        ('!!float ""', "could not convert"),
        ("!!bool x", "true or false"),
        ("!!timestamp x", "no YAML in line 1"),
        ("!!python/object/apply:os.system [ls]", "no YAML in line 1"),
        ("!!binary aGVsbG8=", "no YAML in line 1"),
        ("!!set {a, b}", "no YAML in line 1"),
        ("? [a]\n: b", "no YAML in line 1"),
        ("a: <<", "no YAML in line 1"),
        ("x: 1\n<<: 5", "no YAML in line"),
        ("a: 1\n---\nb: 2", "no YAML in line"),
        ("a: \x00", "unacceptable character"),
        (b"\xff\xfea\x00", "UTF-16"),
        (b"a: \xff", "no UTF-8"),
        ("a: !!int 1_000", "'1_000' as a number, in line 1"),
        ("a: !!float 1_0.5", "'1_0.5' as a number"),
        ("a: !!int ٣", "as a number"),
        ("#" * (MAX_BYTES + 1), "more than 1048576 bytes"),
    ],
)
def test_hostile_yaml_is_refused_in_one_sentence(text: str | bytes, fault: str) -> None:
    began = time.process_time()
    with pytest.raises(yaml.YAMLError) as caught:
        plain_yaml(text)
    assert fault in plain(caught.value)
    assert time.process_time() - began < 10


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1:30:00", "1:30:00"),
        ("190:20:30.15", "190:20:30.15"),
        ("010", "010"),
        ("0o17", "0o17"),
        ("0b101", "0b101"),
        ("00033_00001", "00033_00001"),
        ("no", "no"),
        ("Yes", "Yes"),
        ("on", "on"),
        ("2026-11-27", "2026-11-27"),
        ("2026-99-99 10:00:00", "2026-99-99 10:00:00"),
        ("=", "="),
        ("1e3", 1000.0),
        ("-12E-2", -0.12),
        ("012e5", "012e5"),
        ("12e", "12e"),
        ("33_00001", "33_00001"),
        ("20_000", "20_000"),
        ("1_0.5", "1_0.5"),
        ("0x1F", 31),
        ("-7", -7),
        ("0", 0),
        (str((1 << 64) - 1), (1 << 64) - 1),
        ("1.5e3", 1500.0),
        ("-.5", -0.5),
        ("1.", 1.0),
        ("true", True),
        ("FALSE", False),
        ("~", None),
        ("", None),
        ("!!str 5", "5"),
        ("!!opencv-matrix {rows: 3}", {"rows": 3}),
        (
            "{a: &a {x: 1, y: 2}, b: {<<: *a, y: 3}, c: *a}",
            {"a": {"x": 1, "y": 2}, "b": {"x": 1, "y": 3}, "c": {"x": 1, "y": 2}},
        ),
        ("{z: {<<: &b {<<: &a {x: 1}, x: 2}}, b: *b}", {"z": {"x": 2}, "b": {"x": 2}}),
        ("{0: a, no: b, 1e3: c, 1:30: d}", {"0": "a", "no": "b", "1e3": "c", "1:30": "d"}),
    ],
)
def test_values_are_what_they_seem(text: str, value: Any) -> None:
    assert plain_yaml(text) == value
    assert type(plain_yaml(text)) is type(value)


def test_the_largest_file_takes_seconds_and_what_fits_is_read() -> None:
    began = time.process_time()
    assert len(plain_yaml("[" + "1," * (MAX_NODES - 2) + "1]")) == MAX_NODES - 1
    assert time.process_time() - began < 20
    assert plain_yaml("[" * (MAX_DEPTH - 1) + "1" + "]" * (MAX_DEPTH - 1))
