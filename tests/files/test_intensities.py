"""What is advised about an intensity cures it: a scale where one is beyond, no scale where one is impossible."""

import numpy as np
import pytest

from farfield.errors import FileFormatError
from farfield.files.intensities import scaled_intensity


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -0.5])
def test_no_scale_is_advised_for_what_no_scale_cures(value: float) -> None:
    strength = np.array([0.2, value, 0.9], dtype=np.float32)
    with pytest.raises(FileFormatError, match=f"1 of 3.*such as {value:g}.*Write 0 where.*not known") as error:
        scaled_intensity("a.pcd", strength, 1.0)
    assert "scale" not in str(error.value)


def test_a_scale_is_advised_that_holds_all() -> None:
    strength = np.array([0.2, 3.0, 0.9], dtype=np.float32)
    with pytest.raises(FileFormatError, match="--intensity-scale 3 "):
        scaled_intensity("a.pcd", strength, 1.0)
    assert scaled_intensity("a.pcd", strength, 3.0).max() == 1
