"""Headers of Parquet pages: what lies about its length, or nests too deep, is refused at once."""

import pytest

from farfield.files import parquet


@pytest.mark.parametrize(
    "header",
    [
        b"\x19\xf1" + b"\xff" * 8 + b"\x3f" + bytes(10),  # a list of 2**62 flags
        b"\x19" * 60_000 + b"\0",  # lists in lists
        b"\x1c" * 60_000 + b"\0",  # structures in structures
        b"\x18\xff\xff\xff\x0f",  # a text beyond the end
    ],
)
def test_a_header_that_lies_is_refused_before_it_costs_anything(header: bytes) -> None:
    with pytest.raises((ValueError, IndexError)):
        parquet._struct(header, 0, 0)
