"""Follow the page of own data literally in an environment that has nothing but the wheel, and three more layouts.

    python benchmarks/own_data.py                     # builds the wheel, installs it and what it needs
    python benchmarks/own_data.py --site FOLDER       # packages of another environment instead of downloads

Layouts: KITTI-like .bin with a table of boxes, nuScenes-like .bin of 5 columns, an organised .pcd with NaN.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

import numpy as np
from _report import header

ROOT = Path(__file__).resolve().parents[1]
BLOCK = re.compile(r"^```(bash|python)\n(.*?)^```", flags=re.MULTILINE | re.DOTALL)


def install(folder: Path, site: Path | None) -> Path:
    """A fresh environment with the wheel; its ``bin``."""
    words = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", str(folder / "dist"), str(ROOT)]
    subprocess.run(words, check=True)
    (wheel,) = (folder / "dist").glob("*.whl")
    venv.create(folder / "env", with_pip=True)
    python = folder / "env" / "bin" / "python"
    if site is not None:
        (own,) = (folder / "env" / "lib").glob("python*/site-packages")
        (own / "others.pth").write_text(f"{site}\n")
    wanted = ["--ignore-installed", "--no-deps", str(wheel)] if site is not None else [f"{wheel}[detect]"]
    subprocess.run([str(python), "-m", "pip", "install", "--quiet", *wanted], check=True)
    return python.parent


def say(bin_folder: Path, place: Path, block: str, *, python: bool = False) -> str:
    """Run a block of a page; what it printed.

    Raises:
        RuntimeError: If it fails.
    """
    path = f"{bin_folder}{os.pathsep}{os.environ['PATH']}"
    words = [str(bin_folder / "python"), "-c", block] if python else ["bash", "-euo", "pipefail", "-c", block]
    known = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(words, cwd=place, env={**known, "PATH": path}, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{block}\n{done.stdout[-1500:]}\n{done.stderr[-1500:]}")
    return done.stdout


def layouts(example: Path, place: Path) -> None:
    """The example's sweeps in three other forms, each with its table."""
    sweeps = {path.stem: np.load(path) for path in sorted(example.glob("*.npy"))}
    for name in ("kitti-like", "nuscenes-like", "organised"):
        (place / name).mkdir()
        (place / name / "labels.csv").write_bytes((example / "labels.csv").read_bytes())
    for stem, points in sweeps.items():
        (place / "kitti-like" / f"{stem}.bin").write_bytes(points.astype("<f4").tobytes())
        ring = (np.arange(len(points)) % 32).astype("<f4")
        five = np.column_stack([points[:, :3], (points[:, 3] * 255).round(), ring]).astype("<f4")
        (place / "nuscenes-like" / f"{stem}.bin").write_bytes(five.tobytes())
        grid = np.full((2, len(points), 4), np.nan, dtype="<f4")
        grid[0] = points
        (place / "organised" / f"{stem}.pcd").write_bytes(_pcd(grid))


def _pcd(grid: np.ndarray) -> bytes:
    rows, columns, _ = grid.shape
    lines = ["VERSION 0.7", "FIELDS x y z intensity", "SIZE 4 4 4 4", "TYPE F F F F", "COUNT 1 1 1 1"]
    lines += [
        f"WIDTH {columns}",
        f"HEIGHT {rows}",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {rows * columns}",
        "DATA binary",
    ]
    return "\n".join(lines).encode() + b"\n" + grid.tobytes()


def main() -> None:
    """Follow the page, then evaluate each layout; print what each said."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--site", type=Path)
    site = parser.parse_args().site
    sys.argv[1:] = ["--site", "FOLDER"] if site else []
    print(header())
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        tools = install(place, site)
        home = say(tools, place, "import farfield; print(farfield.__file__)", python=True).strip()
        print(f"farfield of the wheel: {Path(home).is_relative_to(place)}")
        for language, block in BLOCK.findall((ROOT / "docs" / "own-data.md").read_text("utf-8")):
            told = say(tools, place, block, python=language == "python")
            print(f"-- {language}: {len(block.splitlines())} lines run, {len(told.splitlines())} lines said")
        layouts(place / "my-sweeps", place)
        for name in ("kitti-like", "nuscenes-like", "organised"):
            told = say(tools, place, f"farfield doctor {name}")
            cloud = next(re.sub(r"[\s│]+", " ", line) for line in told.splitlines() if "points a sweep" in line)
            score = say(tools, place, f"farfield evaluate pointpillars-cirrus-sim {name} --replicates 0 --out {name}-e")
            print(f"-- {name}:{cloud}")
            subject = next(line for line in score.splitlines() if line.startswith("of: "))
            print(f"   {subject}")


if __name__ == "__main__":
    main()
