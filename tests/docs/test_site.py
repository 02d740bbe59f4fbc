"""The documentation site: builds without a warning, has every public name, and no link that leads nowhere."""

import re
import subprocess
import sys
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def make_site() -> ModuleType:
    spec = spec_from_file_location("make_site", ROOT / "docs" / "make_site.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def python_of_docs() -> str | None:
    own = ROOT / ".venv-docs" / "bin" / "python"
    return sys.executable if find_spec("zensical") else str(own) if own.is_file() else None


def test_no_page_has_brackets_that_read_as_a_reference() -> None:
    """``[<id>/][<version>/]`` of a format's layout is a link of Markdown, and the site's build fails at it."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    for page in pages:
        text = re.sub(r"```.*?```|`[^`]*`", "", page.read_text("utf-8"), flags=re.DOTALL)
        assert re.findall(r"(?<!\\)\[[^\]\n]*\]\[[^\]\n]*\]", text) == [], page.name


def test_faults_of_links_are_found(make_site: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text('<h1 id="top">A</h1><a href="b.html#here">b</a><a href="#top">up</a>')
    (tmp_path / "b.html").write_text('<p id="here"></p><a href="a.html">a</a>')
    assert make_site.faults(tmp_path) == []
    (tmp_path / "b.html").write_text('<a href="c.html">c</a><script src="https://cdn.example/x.js"></script>')
    found = " ".join(make_site.faults(tmp_path))
    assert "b.html#here leads nowhere" in found
    assert "c.html leads nowhere" in found
    assert "fetches https://cdn.example/x.js" in found


def test_every_page_is_on_the_site(make_site: ModuleType, tmp_path: Path) -> None:
    settings = make_site.stage(tmp_path / "site").read_text("utf-8")
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")}
    assert {name for name in pages if f"docs/{name}.md" not in settings} == set()
    assert {*make_site.TASKS, *make_site.COMING_FROM} <= pages
    assert all(settings.count(f"docs/{name}.md") == 1 for name in pages)


def test_what_pages_link_to_is_on_the_site(make_site: ModuleType, tmp_path: Path) -> None:
    make_site.stage(tmp_path / "site")
    pages = tmp_path / "site" / "pages"
    lost = []
    for page in (page for page in pages.rglob("*.md") if not page.is_relative_to(pages / "benchmarks")):
        text = re.sub(r"```.*?```|`[^`]*`", "", page.read_text("utf-8"), flags=re.DOTALL)
        links = (link for link in re.findall(r"\]\(([^)#\s]+)", text) if "://" not in link)
        lost += [f"{page.relative_to(pages)}: {link}" for link in links if not (page.parent / link).exists()]
    assert not lost


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_has_every_public_name(tmp_path: Path) -> None:
    python = python_of_docs()
    if python is None:
        pytest.skip("no documentation tools: make docs")
    words = [python, str(ROOT / "docs" / "make_site.py"), "--out", str(tmp_path / "docs")]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    shown = "".join(path.read_text("utf-8") for path in (tmp_path / "docs" / "site" / "api").glob("*.html"))
    names = re.findall(
        r"^(?:class|def) (\w+)", (ROOT / "tests" / "api" / "public_api.txt").read_text("utf-8"), re.MULTILINE
    )
    assert names
    absent = [name for name in names if not re.search(rf'id="[\w.]*\.{name}"', shown)]
    assert not absent
