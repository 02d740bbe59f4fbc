"""The built wheel, away from the source tree, has its weights, pages and splits."""

import os
import shutil
import subprocess
import sys
import venv
import zipfile
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LIMIT = 34_000_000  # the weights of seven detectors take 27 of 31 MB
DATA = (".safetensors", ".html", ".css", ".js", ".json", ".yaml", ".typed")
SAMPLES = (".xyz", ".pcd", ".h5", ".png", ".jpg", ".txt", ".yml")

CHECK = """
from importlib.resources import files
from pathlib import Path
import sys
import farfield
from farfield.pages.evaluation_page import render_report
from farfield.evaluation.record import Evaluation
from farfield.simulation.frozen import FROZEN
home = Path(farfield.__file__).parent
assert home.is_relative_to(sys.argv[1]), home
assert "<html" in render_report(Evaluation(results={}))
assert all((files("farfield.simulation") / f"{name}.json").is_file() for name in FROZEN)
from farfield.experiments.catalogue import find, names
assert len(names()) >= 24 and find("pointpillars-cirrus-sim").is_relative_to(home), "no experiments"
assert list(home.glob("detectors/weights_data/*.safetensors")), "no weights"
from farfield.studio.samples import open_samples
samples = open_samples()
assert samples.root.is_relative_to(home) and [len(frame.boxes) > 5 for frame in samples] == [True, True], "no samples"
assert all(len(frame.cloud()) > 1000 and frame.images for frame in samples), "samples without clouds or pictures"
sweeps = farfield.open_dataset("open-sweeps")
assert sweeps.root.is_relative_to(home) and len(sweeps) == 12 and all(len(frame.boxes) > 5 for frame in sweeps)
assert all(len(frame.cloud().points_m) > 20_000 for frame in sweeps), "sweeps without clouds"
papers = ("README.md", "LICENSE-ouster", "LICENSE-velodyne")
assert all((sweeps.root / name).is_file() for name in papers), "no licences"
assert (files("farfield.studio") / "static" / "studio.js").is_file(), "no page of the studio"
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


def _wheel(project: Path, out: Path) -> Path:
    """Build a project's wheel with what this environment holds."""
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(out), str(project)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = out.glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built wheel, of a copy of the tree, so that no stale build folder slips in."""
    pytest.importorskip("build")
    place = tmp_path_factory.mktemp("wheel")
    tree = place / "tree"
    tree.mkdir()
    for name in (
        "pyproject.toml",
        "README.md",
        "LICENSE",
        "THIRD_PARTY.md",
        "MANIFEST.in",
        "CHANGELOG.md",
        "constraints.txt",
    ):
        shutil.copy(ROOT / name, tree / name)
    shutil.copytree(ROOT / "src", tree / "src", ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
    return _wheel(tree, place / "dist")


@pytest.mark.slow
def test_wheel_holds_everything_and_works_elsewhere(wheel: Path, tmp_path: Path) -> None:
    installed = tmp_path / "installed"
    with zipfile.ZipFile(wheel) as archive:
        inside = set(archive.namelist())
        archive.extractall(installed)
    wanted = {
        str(p.relative_to(ROOT / "src")) for p in (ROOT / "src" / "farfield").rglob("*") if p.suffix in DATA + SAMPLES
    }
    assert wanted <= inside
    size = wheel.stat().st_size
    assert size < LIMIT, f"{size:,} bytes, at most {LIMIT:,}. The largest parts, compressed:\n{_largest(wheel)}"
    subprocess.run(
        [sys.executable, "-c", CHECK, str(installed)], check=True, cwd=tmp_path, env={"PYTHONPATH": str(installed)}
    )


@pytest.fixture(scope="module")
def elsewhere(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., str]:
    """Runs commands in an empty folder, in a clean environment that holds the two wheels and what they depend on."""
    pytest.importorskip("torch")
    place = tmp_path_factory.mktemp("elsewhere")
    shutil.copytree(ROOT / "examples", place / "examples", ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
    example = _wheel(place / "examples", place / "dist")
    environment, folder = place / "environment", place / "empty"
    folder.mkdir()
    venv.create(environment, with_pip=False, symlinks=True)
    python = environment / "bin" / "python"
    install = ["-m", "pip", "--python", str(python), "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run([sys.executable, *install, str(wheel), str(example)], check=True)
    (site,) = environment.glob("lib/python*/site-packages")
    # numpy, torch and the rest from here; this environment's own Farfield stands behind the installed one
    (site / "dependencies.pth").write_text("\n".join(path for path in sys.path if path.endswith("site-packages")))
    shutil.copy(ROOT / "examples" / "test_example.py", folder)
    return partial(_run, environment / "bin", folder)


def _run(programs: Path, folder: Path, program: str, *words: str) -> str:
    """What a command prints; it must succeed."""
    kept = {name: os.environ[name] for name in ("OMP_NUM_THREADS",) if name in os.environ}
    settings = {**kept, "PATH": f"{programs}:/usr/bin:/bin", "HOME": str(folder)}
    command = [str(programs / program), *words]
    done = subprocess.run(command, cwd=folder, env=settings, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join([program, *words])}\n{done.stdout}\n{done.stderr}"
    return done.stdout + done.stderr


@pytest.mark.slow
def test_the_examples_are_found_beside_the_wheel(elsewhere: Callable[..., str]) -> None:
    where = elsewhere("python", "-c", "import farfield, farfield_example as e; print(farfield.__file__, e.__file__)")
    assert where.count("environment") == 2, where
    shown = elsewhere("farfield", "detectors")
    assert "mean-pillars" in shown
    assert "of farfield-example" in shown
    assert "3 passed" in elsewhere("python", "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_example.py")


@pytest.mark.slow
def test_the_examples_protocol_scores_files(elsewhere: Callable[..., str]) -> None:
    header, box = "frame,label,x,y,z,l,w,h,yaw_rad,score", "vehicle,{x},0,0,4,2,1.5,0,{score}"
    made = "import pathlib, sys; pathlib.Path(sys.argv[1]).write_text(sys.argv[2])"
    for name, x, score in (("found.csv", 21.5, 0.9), ("boxes.csv", 20.0, "")):
        elsewhere("python", "-c", made, name, f"{header}\n1,{box.format(x=x, score=score)}\n")
    words = ("score", "found.csv", "boxes.csv", "--protocol", "recall", "--options")
    assert "1.0000" in elsewhere("farfield", *words, "distance_m=2")
    assert "0.0000" in elsewhere("farfield", *words, "distance_m=1")


@pytest.mark.slow
def test_a_shipped_experiment_trains_without_a_clone(elsewhere: Callable[..., str]) -> None:
    settings = ("training.steps=10", "data.simulate.sequences=2", "data.simulate.frames=2")
    words = [word for setting in settings for word in ("-o", setting)]
    shown = elsewhere("farfield", "train", "pointpillars-cirrus-sim", *words)
    assert "step 10/10" in shown
    assert "weights: runs/pointpillars-cirrus-sim/weights.safetensors" in shown
