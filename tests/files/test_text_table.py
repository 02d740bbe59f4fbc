"""Numbers as ASCII text, against Python's own formatting and reading."""

import numpy as np
import pytest

from farfield.files import ascii_table


def words(text: np.ndarray) -> list[str]:
    return ascii_table.join([text], " ").decode("ascii").split("\n")[:-1]


@pytest.mark.parametrize("kind", ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"])
def test_integers_of_every_size(kind: str, rng: np.random.Generator) -> None:
    limits = np.iinfo(kind)
    powers = [10**power for power in range(20) if 10**power <= limits.max]
    drawn = rng.integers(limits.min, limits.max, 500, dtype=np.dtype(kind), endpoint=True).tolist()
    values = [limits.min, limits.max, 0, *powers, *(power - 1 for power in powers), *drawn]
    assert words(ascii_table.integers(np.array(values, dtype=kind))) == [str(value) for value in values]


@pytest.mark.parametrize("places", [0, 1, 3, 4, 5, 8, 11])
def test_fixed_point_is_pythons(places: int, rng: np.random.Generator) -> None:
    values = np.concatenate([rng.normal(0, 50, 1000), [0.0, 1.0, -1.0, 99.99999999999, 1e-7, 123456.0]])
    expected = [f"{value:.{places}f}" for value in values]
    zero = [float(word) == 0 for word in expected]  # Python writes -0.00
    expected = [word.removeprefix("-") if none else word for word, none in zip(expected, zero, strict=True)]
    assert words(ascii_table.fixed_point(values, places)) == expected


def test_every_bit_of_float32_survives(rng: np.random.Generator) -> None:
    corners = 10.0 ** np.arange(-12, 12, dtype=np.float32)
    corners = np.concatenate([corners, np.nextafter(corners, np.float32(0)), np.nextafter(corners, np.float32(np.inf))])
    anything = rng.integers(0, 1 << 32, 5000, dtype=np.uint32).view(np.float32)
    usual = rng.normal(0, 50, 20_000).astype(np.float32)
    special = np.array([0.0, -0.0, np.inf, -np.inf, 0.1, 1 / 3], dtype=np.float32)
    values = np.concatenate([corners, -corners, anything[np.isfinite(anything)], usual, special])
    texts = words(ascii_table.floats(values))
    back = np.array([float(text) for text in texts]).astype(np.float32)
    np.testing.assert_array_equal(back.view(np.uint32), values.view(np.uint32))
    plain = [text.lstrip("-").replace(".", "").lstrip("0") for text in texts if "e" not in text and text[-1].isdigit()]
    assert max(map(len, plain)) == 9


def test_floats_are_short_and_not_a_number_is_nan() -> None:
    values = np.array([1.5, -2.25, 100.0, 0.0, 0.1, 1e-6, 3e12, np.nan], dtype=np.float32)
    expected = ["1.5", "-2.25", "100", "0", "0.100000001", "9.99999997e-07", "3.00000005e+12", "nan"]
    assert words(ascii_table.floats(values)) == expected
    assert words(ascii_table.floats(np.array([0.1, 1e300]))) == ["0.10000000000000001", "1.0000000000000001e+300"]


def test_columns_are_joined_and_may_be_empty() -> None:
    columns = [ascii_table.integers(np.array([1, 20])), ascii_table.fixed_point(np.array([0.5, -0.25]), 2)]
    assert ascii_table.join(columns, ",") == b"1,0.50\n20,-0.25\n"
    empty = [ascii_table.integers(np.empty(0, dtype=int)), ascii_table.floats(np.empty(0, dtype=np.float32))]
    assert ascii_table.join(empty, ",") == b""
