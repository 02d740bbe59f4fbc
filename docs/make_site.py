"""Build the documentation site: ``make docs``.

The pages keep their places beside each other, so that a link means the same in the repository and on the site. The API
reference is read from the sources without importing them. Nothing is fetched by a reader's browser from elsewhere.
"""

import argparse
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).resolve().parents[1]
LIMIT_BYTES = 15_000_000
ROOMS = {
    "farfield": "Functions that most people need",
    "farfield.frame": "Frame, sensor, annotation",
    "farfield.geometry": "Boxes, poses, cameras, overlap",
    "farfield.datasets": "Data sets, maps, splits",
    "farfield.evaluation": "A detector over a data set",
    "farfield.metrics": "Detections, protocols, results",
    "farfield.simulation": "Simulated drives",
    "farfield.tracking": "Tracking",
    "farfield.sync": "Stamps, clocks, odometry",
    "farfield.calibration": "Calibration",
    "farfield.jobs": "Work over many units",
    "farfield.sizing": "What a whole data set takes",
    "farfield.pages": "Pictures and pages",
    "farfield.errors": "Errors",
    "farfield.testing": "Checks for other people's parts",
}
TASKS = (
    "tutorial", "cookbook", "get-the-data", "score-boxes", "own-data", "train-far", "read-kradar", "faq", "model-zoo",
)  # fmt: skip
COMING_FROM = ("from-openpcdet", "from-mmdetection3d", "from-kradar-kit", "from-nuscenes-devkit")
_COPIED = ("CONTRIBUTING.md", "CHANGELOG.md", "CITATION.cff", "LICENSE", "docs", "examples", "benchmarks/results")


def stage(folder: Path) -> Path:
    """Copy all pages and what they link to, write the API pages and the settings; the settings' path."""
    shutil.rmtree(folder, ignore_errors=True)
    pages = folder / "pages"
    pages.mkdir(parents=True)
    for name in _COPIED:
        source, target = ROOT / name, pages / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__", "make_*.py"))
        else:
            shutil.copy(source, target)
    shutil.copy(ROOT / "README.md", pages / "index.md")
    (pages / "api").mkdir()
    for room, title in ROOMS.items():
        (pages / "api" / f"{room}.md").write_text(f"# {title}\n\n::: {room}\n", encoding="utf-8")
    settings = folder / "mkdocs.yml"
    settings.write_text(_settings(pages), encoding="utf-8")
    return settings


def _settings(pages: Path) -> str:
    others = sorted(path.stem for path in (pages / "docs").glob("*.md") if path.stem not in TASKS + COMING_FROM)
    lines = ["site_name: Farfield", "docs_dir: pages", "site_dir: site", "use_directory_urls: false"]
    lines += ["theme:", "  name: material", "  font: false", "plugins:", "  - search", "  - mkdocstrings:"]
    lines += ["      handlers:", "        python:", f"          paths: ['{ROOT / 'src'}']", "          options:"]
    lines += ["            docstring_style: google", "            show_source: false", "            heading_level: 2"]
    lines += ["            members_order: source", "            show_if_no_docstring: false"]
    lines += ["markdown_extensions:", "  - tables", "  - toc", "  - pymdownx.highlight", "  - pymdownx.superfences"]
    lines += ["nav:", "  - Home: index.md", "  - Tasks:"]
    lines += [f"    - docs/{name}.md" for name in TASKS]
    lines += ["  - Coming from:", *(f"    - docs/{name}.md" for name in COMING_FROM)]
    lines += ["  - Subjects:", *(f"    - docs/{name}.md" for name in others), "    - examples/README.md"]
    lines += ["  - API:", *(f"    - {room}: api/{room}.md" for room in ROOMS)]
    lines += ["  - Project:", "    - CONTRIBUTING.md", "    - CHANGELOG.md"]
    return "\n".join(lines) + "\n"


class _Page(HTMLParser):
    """Links and anchors of a page, and what a browser would fetch from elsewhere."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.fetched: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what an element links to."""
        known = {name: value or "" for name, value in attrs}
        self.anchors |= {known[name] for name in ("id", "name") if name in known}
        if tag == "a" and "href" in known:
            self.links.append(known["href"])
        source = known.get("src", known.get("href", "") if tag == "link" else "")
        if source:
            self.links.append(source)
            if urlsplit(source).netloc and known.get("rel") != "canonical":
                self.fetched.append(source)


def faults(site: Path) -> list[str]:
    """Broken links and anchors between the site's files, and requests to elsewhere."""
    pages = {path: _Page(path.read_text("utf-8")) for path in sorted(site.rglob("*.html"))}
    found = []
    for path, page in pages.items():
        if path.name == "404.html":
            continue
        found += [f"{path.relative_to(site)}: fetches {each}" for each in page.fetched]
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            anchors = pages[target].anchors if target in pages else set()
            if not target.exists() or (parts.fragment and target in pages and unquote(parts.fragment) not in anchors):
                found.append(f"{path.relative_to(site)}: {link} leads nowhere")
    return found


def main() -> int:
    """Build, then check links, anchors, requests and size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "docs")
    out = parser.parse_args().out
    settings = stage(out)
    words = [sys.executable, "-m", "zensical", "build", "--strict", "-f", str(settings)]
    done = subprocess.run(words, cwd=out, capture_output=True, text=True, check=False)  # noqa: S603 - our own words
    told = done.stdout + done.stderr
    site = out / "site"
    wrong = faults(site) if site.is_dir() else ["no site was built"]
    size = sum(path.stat().st_size for path in site.rglob("*") if path.is_file())
    if size > LIMIT_BYTES:
        wrong.append(f"{size / 1e6:.1f} MB, more than {LIMIT_BYTES / 1e6:.0f}")
    if done.returncode or re.search(r"warning", told, re.IGNORECASE):
        wrong.insert(0, told.split("Traceback")[0].strip()[-4000:])
    print("\n".join(wrong) if wrong else f"docs: {site / 'index.html'} ({size / 1e6:.1f} MB)")
    return int(bool(wrong))


if __name__ == "__main__":
    raise SystemExit(main())
