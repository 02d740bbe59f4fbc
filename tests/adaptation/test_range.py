import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from small import small_detector

from farfield.detectors.weights import load_weights
from farfield.training.checkpoints import load_checkpoint

NEAR_FAR = {"name": "range", "near_m": [0, 30], "far_m": [30, 64], "half_width_m": 18, "min_range_m": 4}
EAGER = {"warmup": 0.0, "near_points": 1}


def log_of(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]


def modules_of(folder: Path, kind: str = "modules/") -> dict[str, Any]:
    state = load_checkpoint(folder / "checkpoint.pt")
    return {name: value for name, value in state.items() if name.startswith(kind)}


@pytest.mark.parametrize("detector", ["pointpillars", "second", "voxelnet", "sparsecentre"])
def test_range_trains_each_detector_and_adds_nothing_to_its_weights(planned: Any, detector: str) -> None:
    plan = planned("run", {**NEAR_FAR, "local": EAGER}, detector, steps=4)
    weights = plan.run()
    network, _ = load_weights(weights)
    assert set(network.state_dict()) == set(small_detector(detector).state_dict())
    rows = log_of(plan.folder)
    assert rows[0]["lambda"] == 0 < rows[-1]["lambda"] < 0.1
    assert rows[0]["global"] == pytest.approx(np.log(2), abs=0.1)  # a new discriminator knows nothing
    assert rows[-1]["local"] > 0
    assert rows[-1]["n_eff"] >= 1
    assert {"discriminator_accuracy", "cells_near", "cells_far", "occupied"} <= set(rows[-1])
    assert {"variance_near", "variance_far", "rank_near", "rank_far"} <= set(rows[-1])
    assert all(np.isfinite(value) for row in rows for value in row.values())
