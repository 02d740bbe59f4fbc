"""Arrays whose header Python 2 wrote."""

from pathlib import Path

import numpy as np

from farfield.files.npy import read_npy


def test_a_header_with_long_integers_is_read_in_silence(tmp_path: Path) -> None:
    header = "{'descr': '<f8', 'fortran_order': False, 'shape': (2L, 3L), }"
    head = b"\x93NUMPY\x01\x00" + (118).to_bytes(2, "little") + header.ljust(117).encode() + b"\n"
    (tmp_path / "a.npy").write_bytes(head + np.arange(6.0).tobytes())
    np.testing.assert_array_equal(read_npy(tmp_path / "a.npy"), np.arange(6.0).reshape(2, 3))
