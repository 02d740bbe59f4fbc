from pathlib import Path

import numpy as np
import pytest
from street import write_street


@pytest.fixture
def street_root(tmp_path: Path, rng: np.random.Generator) -> Path:
    return write_street(tmp_path, rng)
