"""The built wheel, away from the source tree, has its weights, pages and splits."""

import shutil
import subprocess
import sys
import zipfile
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LIMIT = 25_000_000
DATA = (".safetensors", ".html", ".css", ".json", ".yaml", ".typed")

CHECK = """
from importlib.resources import files
from pathlib import Path
import sys
import farfield
from farfield.reports.page import render
from farfield.reports.evaluation import Evaluation
from farfield.simulation.frozen import FROZEN
home = Path(farfield.__file__).parent
assert home.is_relative_to(sys.argv[1]), home
assert "<html" in render(Evaluation(results={}))
assert all((files("farfield.simulation") / f"{name}.json").is_file() for name in FROZEN)
from farfield.experiments.catalogue import find, names
assert len(names()) >= 24 and find("pointpillars-cirrus-sim").is_relative_to(home), "no experiments"
assert list(home.glob("detectors/weights_data/*.safetensors")), "no weights"
"""


def _largest(wheel: Path) -> str:
    """The heaviest files of a wheel, one a line, and what its rooms take together."""
    with zipfile.ZipFile(wheel) as archive:
        parts = {info.filename: info.compress_size for info in archive.infolist()}
    rooms: Counter[str] = Counter()
    for name, size in parts.items():
        rooms["/".join(name.split("/")[:2])] += size
    heaviest = [*Counter(parts).most_common(12), *rooms.most_common(5)]
    return "\n".join(f"{size:12,} {name}" for name, size in heaviest)


def test_the_largest_parts_are_named(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.whl", "w") as archive:
        archive.writestr("farfield/detectors/heavy.safetensors", bytes(9000))
        archive.writestr("farfield/light.py", bytes(10))
    first, *_, last = _largest(tmp_path / "a.whl").splitlines()
    assert first.split() == ["9,000", "farfield/detectors/heavy.safetensors"]
    assert last.split() == ["10", "farfield/light.py"]


@pytest.mark.slow
def test_wheel_holds_everything_and_works_elsewhere(tmp_path: Path) -> None:
    pytest.importorskip("build")
    tree = tmp_path / "tree"  # a copy, so that no stale build folder slips in
    tree.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE", "MANIFEST.in", "CHANGELOG.md", "constraints.txt"):
        shutil.copy(ROOT / name, tree / name)
    shutil.copytree(ROOT / "src", tree / "src", ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path / "dist"), str(tree)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    installed = tmp_path / "installed"
    with zipfile.ZipFile(wheel) as archive:
        inside = set(archive.namelist())
        archive.extractall(installed)
    wanted = {str(p.relative_to(ROOT / "src")) for p in (ROOT / "src" / "farfield").rglob("*") if p.suffix in DATA}
    assert wanted <= inside
    size = wheel.stat().st_size
    assert size < LIMIT, f"{size:,} bytes, at most {LIMIT:,}. The largest parts, compressed:\n{_largest(wheel)}"
    subprocess.run(
        [sys.executable, "-c", CHECK, str(installed)], check=True, cwd=tmp_path, env={"PYTHONPATH": str(installed)}
    )
