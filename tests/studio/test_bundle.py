"""The built page: small, self-contained, without inline code, and of the sources that stand beside it."""

import gzip
import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
STATIC = ROOT / "src" / "farfield" / "studio" / "static"


def test_the_bundle_is_small():
    sizes = [(len(data), len(gzip.compress(data))) for data in (path.read_bytes() for path in STATIC.iterdir())]
    assert sum(size for size, _ in sizes) <= 1_000_000
    assert sum(packed for _, packed in sizes) <= 300_000


@pytest.mark.parametrize(("name", "own"), [("index", "studio"), ("calibrate", "calibrate")])
def test_the_page_has_no_inline_code_and_fetches_nothing_from_elsewhere(name: str, own: str):
    page = (STATIC / f"{name}.html").read_text()
    assert re.findall(r"<script(?![^>]*\bsrc=)", page) == []
    assert "<style" not in page
    assert not re.search(r"\s(style|on[a-z]+)=", page)
    assert re.findall(r'(?:src|href)="([^"]+)"', page) == ["data:,", f"./{own}.js", f"./{own}.css"]
    assert "url(http" not in (STATIC / f"{own}.css").read_text()


def test_the_bundle_has_what_the_sources_have():
    script = (STATIC / "studio.js").read_text() + (STATIC / "calibrate.js").read_text()
    keys = json.loads((ROOT / "web" / "src" / "keys.json").read_text())
    assert all(key["title"] in script for key in keys)
    words = set()
    for path in (ROOT / "web" / "src").glob("*.ts"):
        words |= set(re.findall(r'report\("[a-z]+", "([^"\\]+)"', path.read_text()))
    assert words
    assert all(word in script for word in words), "run `npm run build` in web/"


def test_the_lock_file_names_no_private_registry():
    lock = json.loads((ROOT / "web" / "package-lock.json").read_text())
    found = [entry.get("resolved", "") for entry in lock["packages"].values()]
    assert all(not url or url.startswith("https://registry.npmjs.org/") for url in found)
    package = json.loads((ROOT / "web" / "package.json").read_text())
    exact = {**package["dependencies"], **package["devDependencies"]}
    assert all(re.fullmatch(r"\d+\.\d+\.\d+", version) for version in exact.values())
