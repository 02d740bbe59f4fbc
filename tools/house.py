"""Measure the house: files, lines, arrows between rooms, circles, doubles, functions used once, modules loaded.

Imports are read by grimp, which import-linter brings; definitions by ``ast``. Run from anywhere:

    python tools/house.py              # the figures of this checkout
    python tools/house.py --list once  # the functions, classes or modules behind a figure
    python tools/house.py --json
"""

import argparse
import ast
import json
import statistics
import subprocess
import sys
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src"
GROUND = {"errors", "vocabulary", "registry", "geometry", "frame", "files"}
"""Rooms that everybody imports: arrows to and from them say nothing."""

SHORT = 4
"""Lines of a function that is counted as short."""


@cache
def trees() -> dict[Path, ast.Module]:
    """Each source file of the package and its syntax tree."""
    paths = sorted((SOURCE / "farfield").rglob("*.py"))
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in paths}


def logical_lines(path: Path) -> int:
    """Statements, as the tokenizer ends them with NEWLINE; docstrings are statements too."""
    with tokenize.open(path) as stream:
        return sum(token.type == tokenize.NEWLINE for token in tokenize.generate_tokens(stream.readline))


def room(module: str) -> str:
    """First folder or file beneath ``farfield``."""
    return module.split(".")[1] if "." in module else ""


def import_arrows(*, typing: bool = True) -> set[tuple[str, str]]:
    """Pairs (importer, imported) of modules."""
    import grimp

    graph = grimp.build_graph("farfield", exclude_type_checking_imports=not typing)
    return {(a, b) for a in graph.modules for b in graph.find_modules_directly_imported_by(a)}


def circles(arrows: set[tuple[str, str]]) -> list[list[str]]:
    """Groups of modules that import one another in a circle (Tarjan's strongly connected components)."""
    targets = defaultdict(list)
    for a, b in arrows:
        targets[a].append(b)
    order: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    components: list[list[str]] = []

    for root in sorted({name for pair in arrows for name in pair}):
        if root in order:
            continue
        order[root] = lowest[root] = len(order)
        stack.append(root)
        work = [(root, iter(targets[root]))]
        while work:
            node, children = work[-1]
            for child in children:
                if child not in order:
                    order[child] = lowest[child] = len(order)
                    stack.append(child)
                    work.append((child, iter(targets[child])))
                    break
                if child in stack:
                    lowest[node] = min(lowest[node], order[child])
            else:
                work.pop()
                if work:
                    lowest[work[-1][0]] = min(lowest[work[-1][0]], lowest[node])
                if lowest[node] == order[node]:
                    component = stack[stack.index(node) :]
                    del stack[stack.index(node) :]
                    if len(component) > 1:
                        components.append(sorted(component))
    return components


def classes_defined_twice(*, private: bool) -> dict[str, list[str]]:
    """Class names that stand in more than one file, or twice in one."""
    places = defaultdict(list)
    for path, tree in trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef) and (private or not node.name.startswith("_")):
                places[node.name].append(f"{path.relative_to(SOURCE)}:{node.lineno}")
    return {name: files for name, files in sorted(places.items()) if len(files) > 1}


def _uses(tree: ast.Module) -> Counter[str]:
    names = Counter(node.id for node in ast.walk(tree) if isinstance(node, ast.Name))
    names.update(node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute))
    return names


def functions_used_once(*, longest: int | None = None) -> list[str]:
    """Private functions of modules that are named once beside their definition."""
    rows = []
    for path, tree in trees().items():
        uses = _uses(tree)
        for node in tree.body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith("_") and uses[node.name] == 1:
                lines = node.end_lineno - node.lineno + 1
                if longest is None or lines <= longest:
                    rows.append(f"{path.relative_to(SOURCE)}:{node.lineno} {node.name} ({lines})")
    return rows


def imported_by_one(arrows: set[tuple[str, str]]) -> list[str]:
    """Modules that a single other one imports; packages are left out."""
    importers = defaultdict(set)
    for a, b in arrows:
        importers[b].add(a)
    packages = {a.rpartition(".")[0] for a in importers}
    return [f"{b} <- {next(iter(a))}" for b, a in sorted(importers.items()) if len(a) == 1 and b not in packages]


def modules_loaded() -> dict[str, int]:
    """Modules of ours that a simple job loads, each in a process of its own."""
    prelude = "import tempfile, sys, pathlib, numpy as np, farfield as ff\n"
    epilogue = "\nprint(sum(n.split('.')[0] == 'farfield' for n in sys.modules))"
    jobs = {
        "open KITTI": _KITTI,
        "open K-Radar": _KRADAR,
        "score with DDS": _DDS,
        "detect with PointPillars": _DETECT,
    }
    counts = {}
    for name, body in jobs.items():
        done = subprocess.run(
            [sys.executable, "-c", prelude + body + epilogue],
            capture_output=True,
            text=True,
            check=False,
            env={"PYTHONPATH": str(SOURCE), "PATH": "", "HOME": str(ROOT)},
        )
        counts[name] = int(done.stdout.split()[-1]) if done.returncode == 0 else -1
        if done.returncode:
            sys.stderr.write(f"{name}: {done.stderr.strip().splitlines()[-1]}\n")
    return counts


_KITTI = """
root = pathlib.Path(tempfile.mkdtemp())
for folder in ("velodyne", "label_2", "calib"):
    (root / "training" / folder).mkdir(parents=True)
np.zeros((5, 4), "<f4").tofile(root / "training" / "velodyne" / "000000.bin")
(root / "training" / "label_2" / "000000.txt").write_text("Car 0 0 0 10 10 50 50 1.5 1.6 4.0 1 1.6 20 0.0\\n")
eye = "1 0 0 0 0 1 0 0 0 0 1 0"
calib = "".join(f"P{i}: {eye}\\n" for i in range(4)) + "R0_rect: 1 0 0 0 1 0 0 0 1\\n"
calib += f"Tr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\\nTr_imu_to_velo: {eye}\\n"
(root / "training" / "calib" / "000000.txt").write_text(calib)
from farfield.datasets.kitti.object import Kitti
frame = Kitti(root)[0]
frame.clouds, frame.annotation
"""

_KRADAR = """
from farfield.studio import samples
data = ff.open_dataset(pathlib.Path(samples.__file__).parent / "kradar")
data[0].clouds, data[0].annotation
"""

_DDS = """
from farfield.geometry.boxes import Boxes
from farfield.metrics import score
boxes = Boxes(centre_m=np.zeros((1, 3)), size_m=np.ones((1, 3)), yaw_rad=np.zeros(1), label="vehicle", score=np.ones(1))
score({("a", "0"): boxes}, {("a", "0"): boxes})
"""

_DETECT = (
    _KITTI
    + """
ff.load_detector("pointpillars-cirrus-sim")(frame)
"""
)


def rooms(arrows: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """Pairs of rooms with an import between them, the ground left out."""
    pairs = {(room(a), room(b)) for a, b in arrows}
    return {(a, b) for a, b in pairs if a != b and "" not in (a, b) and not {a, b} & GROUND}


def measured() -> dict[str, object]:
    """Every figure of this checkout by name."""
    paths = list(trees())
    lengths = [len(path.read_text(encoding="utf-8").splitlines()) for path in paths]
    arrows = import_arrows()
    return {
        "files": len(paths),
        "lines": sum(lengths),
        "logical lines": sum(logical_lines(path) for path in paths),
        "median lines of a file": statistics.median(lengths),
        "longest file": max(lengths),
        "arrows between modules": len(arrows),
        "arrows between rooms": len(rooms(arrows)),
        "circles": len(circles(arrows)),
        "class names defined twice": len(classes_defined_twice(private=False)),
        "class names defined twice, private too": len(classes_defined_twice(private=True)),
        "functions used once": len(functions_used_once()),
        f"functions used once, {SHORT} lines or fewer": len(functions_used_once(longest=SHORT)),
        "modules imported by one other": len(imported_by_one(arrows)),
        **{f"modules loaded: {name}": count for name, count in modules_loaded().items()},
    }


def listing(what: str) -> Iterator[str]:
    """The rows behind a figure."""
    arrows = import_arrows()
    match what:
        case "once":
            yield from functions_used_once(longest=SHORT)
        case "twice":
            yield from (f"{name}: {', '.join(files)}" for name, files in classes_defined_twice(private=True).items())
        case "single":
            yield from imported_by_one(arrows)
        case "circles":
            yield from (" ".join(group) for group in circles(arrows))
        case "rooms":
            yield from (f"{a} -> {b}" for a, b in sorted(rooms(arrows)))


def main() -> None:
    """Print the figures, or the rows behind one."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", choices=("once", "twice", "single", "circles", "rooms"))
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    if arguments.list:
        print(*listing(arguments.list), sep="\n")
        return
    figures = measured()
    if arguments.json:
        print(json.dumps(figures, indent=1))
        return
    for name, value in figures.items():
        print(f"{name:45} {value:>10,}")


if __name__ == "__main__":
    main()
