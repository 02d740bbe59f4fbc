"""The rules of the house that no linter checks: light imports, public names, docstrings, small files, clean paths."""

import ast
import importlib.util
import inspect
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from sources import sources, trees

import farfield
from farfield.cli import VERBS

ROOT = Path(__file__).resolve().parents[2]
HEAVY = (
    "torch",
    "matplotlib",
    "scipy",
    "h5py",
    "pydantic",
    "tyro",
    "rich",
    "PIL",
    "jinja2",
    "embreex",
    "numba",
    "pyarrow",
    "yaml",
)
TORCH = {"torch", "lightning_fabric", "safetensors"}
TORCH_ROOMS = {"detectors", "training", "adaptation", "testing"}
TORCH_FILES = {
    "privacy/detectors.py",
    "privacy/plate_network.py",
}  # loaded when asked for
NESTED: dict[str, str] = {}
"""Functions in functions that may stay, and why."""

LINE_LIMIT = 600
TEST_LINE_LIMIT = 400


def _heavy_modules_after(statement: str) -> set[str]:
    code = f"import sys\n{statement}\nprint('LOADED', *(name for name in {HEAVY!r} if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split()[1:])


def test_import_is_light() -> None:
    assert _heavy_modules_after("import farfield") == set()


@pytest.mark.parametrize("argument", ["--help", "--version", "no-such-verb"])
def test_command_overview_is_light(argument: str) -> None:
    assert _heavy_modules_after(f"from farfield.cli import main\nmain([{argument!r}])") == set()


def test_overview_names_every_verb(capsys: pytest.CaptureFixture[str]) -> None:
    assert farfield.cli.main(["--help"]) == 0
    shown = capsys.readouterr().out
    assert all(f"\n  {verb} " in shown for verb in VERBS)


@pytest.mark.parametrize("verb", VERBS)
def test_verb_module_is_light_and_shows_examples(verb: str) -> None:
    name = f"farfield.cli.{verb.replace('-', '_')}"
    heavy = _heavy_modules_after(f"import importlib\nimportlib.import_module('{name}')")
    assert not heavy & {"torch", "matplotlib", "embreex", "pyarrow"}
    module = importlib.import_module(name)
    text = inspect.getdoc(module.run) or ""
    assert "examples:" in text
    assert f"farfield {verb}" in text


def _public_definitions(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.ClassDef]:
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield node
            if isinstance(node, ast.ClassDef):
                inside = (part for part in node.body if isinstance(part, ast.FunctionDef))
                yield from (part for part in inside if not part.name.startswith("_") and not _is_override(part))


def _is_override(node: ast.FunctionDef) -> bool:
    return any(isinstance(decorator, ast.Name) and decorator.id == "override" for decorator in node.decorator_list)


def test_public_names_have_docstrings() -> None:
    missing = [f"{name}: the module" for name, tree in trees().items() if not ast.get_docstring(tree)]
    missing += [
        f"{name}:{node.lineno} {node.name}"
        for name, tree in trees().items()
        for node in _public_definitions(tree)
        if not ast.get_docstring(node)
    ]
    assert not missing, "no docstring:\n" + "\n".join(missing)


def test_files_are_small() -> None:
    long = {name: count for name, text in sources().items() if (count := len(text.splitlines())) > LINE_LIMIT}
    assert not long


def test_shape_checks_are_on_everywhere() -> None:
    """``from __future__ import annotations`` would turn the run-time shape checks off."""
    found = [name for name, text in sources().items() if "from __future__ import annotations" in text]
    assert not found


def test_no_function_stands_in_a_function() -> None:
    """The shape checks recompile one at every call of the outer function, and it does not pickle."""
    found = {
        f"{name}: {inner.name} in {outer.name}": f"{name}:{inner.lineno}"
        for name, tree in trees().items()
        for outer in ast.walk(tree)
        if isinstance(outer, ast.FunctionDef | ast.AsyncFunctionDef)
        for inner in ast.walk(outer)
        if inner is not outer and isinstance(inner, ast.FunctionDef | ast.AsyncFunctionDef)
    }
    offenders = [f"{place} {name}" for name, place in found.items() if name not in NESTED]
    assert not offenders, "move to module level, with functools.partial:\n" + "\n".join(offenders)
    assert not NESTED.keys() - found.keys(), "these are gone: strike them from NESTED"


VERBS_CALLED = {
    ("demo", "doctor"),
    ("demo", "evaluate"),
}  # until these have a function beneath the verb


def _imports(tree: ast.Module) -> Iterator[str]:
    """Dotted names that a file imports, lazily too: modules, and what is taken from them."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_verbs_do_not_call_each_other() -> None:
    """A verb is arguments and words; what two of them share stands in a room beneath."""
    verbs = {verb.replace("-", "_") for verb in VERBS}
    found = {
        (Path(place).stem, name.split(".")[2])
        for place, tree in trees().items()
        if Path(place).parent.name == "cli"
        for name in _imports(tree)
        if name.startswith("farfield.cli.") and name.split(".")[2] in verbs
    }
    assert found <= VERBS_CALLED


def _is_private_of_another(node: ast.AST) -> bool:
    if not isinstance(node, ast.Attribute) or not node.attr.startswith("_") or node.attr.startswith("__"):
        return False
    return not (isinstance(node.value, ast.Name) and node.value.id in ("self", "cls"))


@pytest.mark.parametrize("folder", ["benchmarks", "docs", "examples"])
def test_scripts_use_public_names_and_no_test(folder: str) -> None:
    tests = {path.stem for path in (ROOT / "tests").rglob("*.py")} | {"tests"}
    for path in (ROOT / folder).rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        names = list(_imports(tree))
        hidden = [n for n in names if n.startswith("farfield.") and any(part.startswith("_") for part in n.split("."))]
        assert not hidden, f"{path.name}: {', '.join(hidden)}"
        taken = [name for name in names if name.partition(".")[0] in tests]
        assert not taken, f"{path.name}: {', '.join(taken)}"
        assert "sys.path" not in text, f"{path.name} changes where modules are found"
        private = [ast.unparse(node) for node in ast.walk(tree) if _is_private_of_another(node)]
        private = [name for name in private if not name.startswith("torch.ops.")]  # operators have no other names
        assert not private, f"{path.name}: {', '.join(private)}"


def test_test_files_are_small_too() -> None:
    long = {
        p.name: n for p in (ROOT / "tests").rglob("*.py") if (n := len(p.read_text().splitlines())) > TEST_LINE_LIMIT
    }
    assert not long


def _imported(tree: ast.Module) -> set[str]:
    """First words of the names of all imported modules."""
    found = set()
    for node in ast.walk(tree):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        found |= {name.partition(".")[0] for name in names}
    return found


def test_only_some_rooms_import_torch() -> None:
    found = [
        f"{name}: {', '.join(sorted(_imported(tree) & TORCH))}"
        for name, tree in trees().items()
        if Path(name).parts[0] not in TORCH_ROOMS and name not in TORCH_FILES and _imported(tree) & TORCH
    ]
    assert not found, "only " + ", ".join(sorted(TORCH_ROOMS)) + " may import torch:\n" + "\n".join(found)


def _tracked_texts() -> Iterator[tuple[Path, str]]:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout
    for name in listed.decode().split("\0"):
        path = ROOT / name
        if name and path.is_file() and b"\0" not in (content := path.read_bytes()):
            yield path, content.decode("utf-8", errors="replace")


def test_only_jobs_starts_workers() -> None:
    """No second mechanism for work over many frames: no pool, and no process but those named here."""
    words = re.compile(r"ProcessPool|ThreadPool|multiprocessing(?!_context)|Popen|os\.fork|joblib")
    known = {
        "jobs/local.py",
        "jobs/uploads.py",  # some that wait for a store
        "testing/processes.py",  # two processes of one training step
        "files/mat.py",  # one thread that reads ahead within a file
        "datasets/kradar/products.py",  # one that makes a table meanwhile
        "studio/threads.py",  # some beside the server's event loop
        "studio/inferring/worker.py",  # a process that holds networks and is asked frame by frame
    }
    assert {name for name, text in sources().items() if words.search(text)} == known


LOADERS = re.compile(
    r"\bjson\.loads?\((?!json\.dumps\()|yaml\.(?:safe_)?(?:full_)?load|model_validate_json|\bSafeLoader\b|JSONDecoder"
)
WITH_LOADERS = {
    "files/json_text.py": "the loader of all JSON",
    "files/yaml_text.py": "the loader of all YAML",
    "errors/wording.py": "reads what pip wrote, and stands beneath the loaders",
    "studio/messages/requests.py": "finds the name of a message that is refused, whatever else it holds",
}


def test_one_loader_reads_all_json_and_one_all_yaml() -> None:
    """Bounds, double keys and odd numbers are seen to once: nothing else parses a text, but its own just made."""
    texts = sources()
    assert {name for name, text in texts.items() if LOADERS.search(text)} == set(WITH_LOADERS)


@pytest.mark.skipif(not (ROOT / ".git").exists() or shutil.which("git") is None, reason="not a git checkout")
def test_no_machine_paths_in_tracked_files() -> None:
    machine = re.compile(r"(?<![\w.])/(?:work|home|root|Users)/\w|/tmp/\w|\.pyenv")
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()[:100]}"
        for path, text in _tracked_texts()
        if path != Path(__file__).resolve()
        for number, line in enumerate(text.splitlines(), 1)
        if machine.search(line)
    ]
    assert not found, "\n".join(found)


def test_readme_links_lead_somewhere() -> None:
    for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")):
        for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            assert re.match(r"https?://", target) or (page.parent / target).exists(), f"{page.name}: {target}"


def test_compiled_code_keeps_the_order_of_its_sums() -> None:
    """With numba's fastmath, code compiled now and code from the cache round differently: other bytes for one seed."""
    assert not [name for name, text in sources().items() if "fastmath=" in text]


def test_test_files_have_names_of_their_own() -> None:
    """Two of one name, in folders that are no packages, are one module for pytest."""
    files = [path for path in (ROOT / "tests").rglob("test_*.py") if not (path.parent / "__init__.py").exists()]
    twice = [name for name, count in Counter(path.name for path in files).items() if count > 1]
    assert not twice


def test_the_root_of_tests_holds_nothing_loose() -> None:
    assert [path.name for path in (ROOT / "tests").iterdir() if path.is_file()] == ["conftest.py"]
