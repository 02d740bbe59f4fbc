"""The simulator's worlds: named, chosen by a flag, and the older one named as it was."""

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.simulation import find_preset
from farfield.simulation.world.scene import WorldScene


def test_another_world_is_refused_and_the_older_one_says_nothing_new() -> None:
    with pytest.raises(ConfigError, match=r"v2, v3.*v1"):
        find_preset("cirrus-sim", world="v1")
    with pytest.raises(ConfigError, match="v1"):
        WorldScene("urban", np.random.SeedSequence(1), duration_s=5.0, world="v1")
    assert "world" not in find_preset("cirrus-sim").as_json()
    assert find_preset("cirrus-sim", world="v3").as_json()["world"] == "v3"
