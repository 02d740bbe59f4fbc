"""Fixtures that all tests share."""

from collections.abc import Iterator
from pathlib import Path

import jaxtyping
import numpy as np
import pytest


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20260101)


@pytest.fixture(scope="session")
def shared_real() -> Path:
    """The folder of real frames beside the project; tests that need it skip where it is absent."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "real"
    if not folder.is_dir():
        pytest.skip("no real data beside the project")
    return folder


@pytest.fixture
def without_shape_checks() -> Iterator[None]:
    """Let the errors that users meet answer, not the shape checks that only tests run."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)
