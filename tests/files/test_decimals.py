"""Plain decimals parsed many at a time are Python's own floats to the last bit; anything else is left to numpy."""

import numpy as np
import pytest

from farfield.files.ascii_table import parse_decimals


def bits(values: np.ndarray) -> list[int]:
    return np.asarray(values, dtype=np.float64).view(np.uint64).ravel().tolist()


def test_every_number_is_pythons_own_to_the_last_bit() -> None:
    draws = np.random.default_rng(4)
    texts = []
    for _ in range(6000):
        digits = int(draws.integers(1, 16))
        number = "".join(draws.choice(list("0123456789"), digits))
        point = int(draws.integers(0, digits + 2))
        number = number if point > digits else number[:point] + "." + number[point:]
        texts.append(("-" if draws.random() < 0.5 else "") + number)
    data = "\n".join(",".join(texts[index : index + 5]) for index in range(0, len(texts), 5)).encode()
    parsed = parse_decimals(data, columns=5, separator=b",")
    assert parsed is not None
    assert parsed.shape == (1200, 5)
    assert bits(parsed) == bits(np.array([float(text) for text in texts]))


def test_minus_zero_stays_minus_zero() -> None:
    parsed = parse_decimals(b"-0.000 0", columns=2, separator=b" ")
    assert parsed is not None
    assert np.signbit(parsed).tolist() == [[True, False]]


@pytest.mark.parametrize(
    "text",
    [
        "1e3 2",
        "+1 2",
        "1  2",
        "1\t2",
        " 1 2",
        "1 2 ",
        "1 2 3",
        "1",
        "1 2\n3 4 5",
        "1\n2 3 4",
        "1 2\n\n3 4",
        "- 2",
        ". 2",
        "-. 2",
        "1-2 3",
        "1.2.3 4",
        "--1 2",
        "nan 2",
        "1_0 2",
        "1234567890123456 2",
        "0.1234567890123456 2",
        "1,5 2",
        "\u0661 2",
    ],
)
def test_anything_but_plain_decimals_in_rows_is_left_alone(text: str) -> None:
    assert parse_decimals(text.encode(), columns=2, separator=b" ") is None
