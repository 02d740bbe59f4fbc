"""Check a release: version, changelog, sdist and wheel, clean environments, each extra alone; ``make release-check``.

    python tools/release_check.py                       # whole: half an hour, 6 GB of disk
    python tools/release_check.py --only version builds
    python tools/release_check.py --only extras --extras onnx ray
    python tools/release_check.py --only extras --pythons 3.13 --torch-flags="--index-url URL"

Each environment is made, used and removed; a line says what held. A Python that this machine lacks is named, not passed
over. torch comes in its pinned version from the index that pip uses; without one of CPU builds that is gigabytes:
--no-torch 3.12 3.13 leaves torch and what needs it out for these and says so.
"""

import argparse
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from packaging.utils import canonicalize_name
from packaging.version import Version
from platforms import pins

ROOT = Path(__file__).resolve().parents[1]
PYTHONS = ("3.11", "3.12", "3.13")
NEED_TORCH = ("detect", "export", "all")
HEADINGS = ("Added", "Changed", "Deprecated", "Removed", "Fixed", "Security")
SMOKE = {
    "": "import farfield as ff; assert len(ff.open_dataset('open-sweeps')) == 12",
    "detect": "import farfield as ff; ff.load_detector('pointpillars-cirrus-sim')",
    "simulate": "from farfield.simulation import simulate_sequence as s; next(s('cirrus-sim', sequence=0, frames=1))",
    "argoverse2": "import pyarrow.feather",
    "bags": "import rosbags.highlevel",
    "las": "import lazrs",
    "privacy": "import cv2",
    "video": "import av",
    "sensors": "import zstandard",
    "export": "import onnx, onnxscript, onnxruntime, torch",
    "onnx": "import onnxruntime",
    "ray": "import ray.exceptions",
    "remote": "import aiohttp, fsspec, obstore.store",
    "studio": "import starlette, uvicorn, websockets, zstandard, cv2",
    "all": "import torch, embreex, numba, pyarrow, rosbags, lazrs, cv2, av, onnx, starlette",
}
"""A line a part that works with this extra and nothing else."""
COMMANDS = (
    "--version",
    "detectors",
    "new-dataset own",
    "doctor own",
    "evaluate pointpillars-cirrus-sim open-sweeps --out run",
)
"""With all extras and no data."""


class FailedCheckError(Exception):
    """Something does not hold."""


def run(*words: str | Path, cwd: Path = ROOT) -> str:
    """What a command prints.

    Raises:
        FailedCheckError: If it fails, with the end of what it printed.
    """
    done = subprocess.run([str(word) for word in words], cwd=cwd, capture_output=True, text=True, check=False)
    if done.returncode:
        raise FailedCheckError(f"{' '.join(map(str, words))[:200]}: {(done.stdout + done.stderr)[-1500:]}")
    return done.stdout


def held(holds: bool, words: str) -> None:
    """Go on if something holds.

    Raises:
        FailedCheckError: If it does not.
    """
    if not holds:
        raise FailedCheckError(words)


# Version and changelog


def check_version(options: argparse.Namespace) -> str:
    """The version is that of the tag, and the changelog has its section; between tags it is a development version."""
    del options
    version = run(sys.executable, "-m", "setuptools_scm").strip()
    tags = [tag for tag in run("git", "tag", "--points-at", "HEAD").split() if re.fullmatch(r"v\d+\.\d+\.\d+", tag)]
    sections = changelog_sections((ROOT / "CHANGELOG.md").read_text("utf-8"))
    if not tags:
        held(Version(version).is_devrelease, f"{version}: no tag vX.Y.Z here, so expected a development version")
        held("Unreleased" in sections, "CHANGELOG.md: expected a section [Unreleased]")
        return f"{version}: no tag here, a development version"
    held(tags == [f"v{version}"], f"tags {tags} and version {version}")
    held(version in sections, f"CHANGELOG.md: expected a section [{version}] with its date")
    return f"{version}, as the tag and the changelog say"


def changelog_sections(text: str) -> list[str]:
    """Names of the changelog's sections; its form is that of Keep a Changelog.

    Raises:
        FailedCheckError: If a heading is of another form.
    """
    sections: list[str] = []
    for line in text.splitlines():
        if line.startswith("## "):
            heading = re.fullmatch(r"## \[(Unreleased|\d+\.\d+\.\d+)\](?: - (\d{4}-\d\d-\d\d))?", line)
            dated = heading is not None and (heading[1] == "Unreleased") == (heading[2] is None)
            held(dated, f"CHANGELOG.md: expected ## [X.Y.Z] - YYYY-MM-DD or ## [Unreleased], got {line!r}")
            sections += [heading[1]] if heading else []
        elif line.startswith("### "):
            held(line[4:] in HEADINGS, f"CHANGELOG.md: expected a heading of {', '.join(HEADINGS)}, got {line!r}")
    numbers = [Version(name) for name in sections if name != "Unreleased"]
    held(numbers == sorted(numbers, reverse=True), "CHANGELOG.md: expected the newest version first")
    return sections


# Sdist and wheel


def check_builds(options: argparse.Namespace) -> str:
    """The wheel that is built from the sdist holds what the wheel of the tree holds, to the byte."""
    out: Path = options.out
    run(sys.executable, "-m", "build", "--no-isolation", "--sdist", "--outdir", out, ".")
    run(sys.executable, "-m", "build", "--no-isolation", "--wheel", "--outdir", out, ".")
    (sdist,), (wheel,) = out.glob("*.tar.gz"), out.glob("*.whl")
    source = out / "source"
    with tarfile.open(sdist) as archive:
        archive.extractall(source, filter="data")
    (tree,) = source.iterdir()
    run(sys.executable, "-m", "build", "--no-isolation", "--wheel", "--outdir", out / "again", ".", cwd=tree)
    (again,) = (out / "again").glob("*.whl")
    digests = [content_of(path) for path in (wheel, again)]
    differing = sorted({name for name, _ in set(digests[0].items()) ^ set(digests[1].items())})
    held(wheel.name == again.name and not differing, f"the wheel of the sdist differs in {differing[:5]}")
    with tarfile.open(sdist) as archive:
        rooms = {name.split("/")[1] for name in archive.getnames() if "/" in name}
    held("tests" not in rooms and "docs" not in rooms, f"the sdist holds {sorted(rooms)}")
    shutil.rmtree(source)
    sizes = [f"{path.stat().st_size / 1e6:.1f} MB" for path in (sdist, wheel)]
    return f"{sdist.name} ({sizes[0]}) and {wheel.name} ({sizes[1]}) hold the same {len(digests[0]):,} files"


def content_of(wheel: Path) -> dict[str, str]:
    """SHA-256 of each file of a wheel, but of the list of these."""
    with zipfile.ZipFile(wheel) as archive:
        names = [name for name in archive.namelist() if not name.endswith(".dist-info/RECORD")]
        return {name: hashlib.sha256(archive.read(name)).hexdigest() for name in names}


# Environments


def wheel_of(options: argparse.Namespace) -> Path:
    """The built wheel."""
    if not list(options.out.glob("*.whl")):
        run(sys.executable, "-m", "build", "--no-isolation", "--wheel", "--outdir", options.out, ".")
    (wheel,) = options.out.glob("*.whl")
    return wheel


def installed(options: argparse.Namespace, python: str, extra: str, work: Callable[[Path, Path], None]) -> str:
    """Install the wheel with an extra into a clean environment, work there, remove it; what came with it in words.

    Raises:
        FailedCheckError: If something is missing, is not pinned, or does not work.
    """
    with tempfile.TemporaryDirectory(dir=options.out) as folder:
        environment, empty = Path(folder) / "environment", Path(folder) / "empty"
        empty.mkdir()
        run(f"python{python}", "-m", "venv", environment)
        program = environment / ("Scripts" if sys.platform == "win32" else "bin") / "python"
        pip = (program, "-m", "pip", "--disable-pip-version-check")
        flags = options.torch_flags.split() if extra in NEED_TORCH else []
        if flags:
            run(*pip, "install", "--quiet", "-c", ROOT / "constraints.txt", *flags, "torch")
        name = f"farfield[{extra}]" if extra else "farfield"
        run(*pip, "install", "--quiet", "-c", ROOT / "constraints.txt", f"{name} @ {wheel_of(options).as_uri()}")
        run(*pip, "check")
        versions = dict(row.split("==") for row in run(*pip, "freeze").splitlines() if "==" in row)
        pinned = pins()
        other = [
            f"{name} {version}"
            for name, version in versions.items()
            if pinned.get(canonicalize_name(name)) != version.split("+")[0]
        ]
        held(not other, f"not as pinned: {', '.join(other)}")
        work(program, empty)
        return f"{len(versions)} packages, all as pinned"


def readme_blocks() -> list[str]:
    """The blocks of Python in README."""
    return re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL | re.MULTILINE)


def works(python: Path, folder: Path) -> None:
    """Run README's blocks, in one session as one would, and the commands that need no data."""
    blocks = "import matplotlib\nmatplotlib.use('Agg')\n" + "\n".join(readme_blocks())
    run(python, "-c", blocks, cwd=folder)
    farfield = python.with_name("farfield")
    for line in COMMANDS:
        run(farfield, *line.split(), cwd=folder)


def check_environments(options: argparse.Namespace) -> str:
    """With all extras under each Python: what is installed is pinned, and README's blocks run."""
    lines = []
    for python in options.pythons:
        held(shutil.which(f"python{python}") is not None, f"python{python} is not on this machine")
        if python in options.no_torch:
            lines.append(f"{python}: left out with torch")
            continue
        lines.append(f"{python}: {installed(options, python, 'all', works)}, README's blocks run")
        print(f"  {lines[-1]}", flush=True)
    return "; ".join(lines)


def smoke(extra: str, python: Path, folder: Path) -> None:
    """Run the line of an extra."""
    run(python, "-c", SMOKE[extra], cwd=folder)


def check_extras(options: argparse.Namespace) -> str:
    """Each extra alone, under each Python."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    held(set(SMOKE) == {"", *extras}, f"a line each in SMOKE: {sorted(set(SMOKE) ^ {'', *extras})}")
    count = 0
    for python in options.pythons:
        held(shutil.which(f"python{python}") is not None, f"python{python} is not on this machine")
        for extra in sorted(set(options.extras or SMOKE) - {"all"}):
            if extra in NEED_TORCH and python in options.no_torch:
                print(f"  {python} [{extra}]: left out with torch", flush=True)
                continue
            words = installed(options, python, extra, partial(smoke, extra))
            print(f"  {python} [{extra}]: {words}", flush=True)
            count += 1
    return f"{count} environments"


CHECKS = {
    "version": check_version,
    "builds": check_builds,
    "environments": check_environments,
    "extras": check_extras,
}


def main() -> int:
    """Run the checks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=CHECKS, default=list(CHECKS), help="these checks")
    parser.add_argument("--pythons", nargs="+", default=list(PYTHONS), help="under these Pythons")
    parser.add_argument("--extras", nargs="+", choices=sorted(set(SMOKE) - {"", "all"}), help="these extras")
    parser.add_argument("--no-torch", nargs="*", default=[], help="Pythons under which torch is left out")
    parser.add_argument("--torch-flags", default="", help="flags of pip for torch, such as an index of CPU builds")
    options = parser.parse_args()
    failures = 0
    # one version for all builds, whatever is committed meanwhile
    os.environ["SETUPTOOLS_SCM_PRETEND_VERSION"] = run(sys.executable, "-m", "setuptools_scm").strip()
    with tempfile.TemporaryDirectory(prefix="farfield-release-") as folder:
        options.out = Path(folder)
        for name in options.only:
            try:
                print(f"{name}: {CHECKS[name](options)}", flush=True)
            except FailedCheckError as error:
                failures += 1
                print(f"{name}: FAILED: {error}", flush=True)
    return int(failures > 0)


if __name__ == "__main__":
    raise SystemExit(main())
