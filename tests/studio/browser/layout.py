"""What a page may not look like: cut texts, controls off the screen or under others, and what axe-core refuses."""

from pathlib import Path
from typing import Any

import pytest

AXE = Path(__file__).resolve().parents[3] / "web" / "node_modules" / "axe-core" / "axe.min.js"
SIZES = ((1280, 720), (1440, 900), (1920, 1080), (820, 1180))
"""Laptops, a screen, a tablet: width and height, px."""


def layout_faults(page: Any) -> list[str]:
    """What of a page is cut, covered or off the screen, in words."""
    return page.evaluate(Path(__file__).with_name("layout.js").read_text(encoding="utf-8"))


def axe_faults(page: Any) -> list[str]:
    """What axe-core refuses, a line an element; skips where it is not installed (``npm ci`` in web/)."""
    if not AXE.is_file():
        pytest.skip("no axe-core: run `npm ci` in web/")
    page.evaluate(AXE.read_text(encoding="utf-8"))  # not as a script of the page: its policy refuses inline ones
    results = page.evaluate("async () => (await axe.run(document, { resultTypes: ['violations'] })).violations")
    return [
        f"{row['id']}: {node['target']} {node['html'][:160]} {node['failureSummary'][:300]}"
        for row in results
        for node in row["nodes"]
    ]
