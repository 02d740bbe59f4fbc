"""How much a K-Radar frame takes on disk, as docs/simulator.md says it."""

import re
from pathlib import Path

import pytest

from farfield.simulation.recording import record

SENSORS = "os2-64,os1-128,cube,sparse,cam-front"


@pytest.mark.slow
def test_a_frame_takes_what_the_page_says(tmp_path: Path) -> None:
    pytest.importorskip("embreex")
    page = (Path(__file__).resolve().parents[3] / "docs" / "simulator.md").read_text(encoding="utf-8")
    said = re.search(r"front camera takes (\d+) MB on disk \((\d+) MB the cube, ([\d.]+) MB the sparse cloud\)", page)
    assert said is not None
    record("kradar-sim", tmp_path / "drive", frames=1, sequences=1, seed=1, sensors=SENSORS, workers=1)
    sizes = {path: path.stat().st_size / 1e6 for path in (tmp_path / "drive").rglob("*") if path.is_file()}
    cube = sum(size for path, size in sizes.items() if path.suffix == ".mat")
    sparse = sum(size for path, size in sizes.items() if path.suffix == ".npy")
    whole, of_cube, of_sparse = map(float, said.groups())
    assert sum(sizes.values()) == pytest.approx(whole, rel=0.1), sorted(sizes.values())[-5:]
    assert cube == pytest.approx(of_cube, rel=0.1)
    assert sparse == pytest.approx(of_sparse, rel=0.3)  # by road
