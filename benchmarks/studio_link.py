"""The studio over a link of 20 Mbit/s and 50 ms there and back: frame changes, dragging, edits.

    python benchmarks/studio_link.py [--work data/studio] [--seconds 3] [--output benchmarks/results/studio_link.txt]

The link is a proxy of our own that slows WebSockets too; the browser's throttling does not. Its rate holds for all
connections together. Times also hold as ratios to a whole render of the same run, waited for.
"""

import argparse
import statistics
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from _report import ROOT
from _studio_client import window
from _studio_link import slow_link
from _studio_process import Started, started
from _studio_scenes import write_folder
from _studio_screen import chromium_path, screen
from _studio_table import Table, reported
from studio_page import SIZES, drag_box, frame_changes, reference_ms

LIMITS = {"131k": (600, 5.0, 200, 2.0), "262k": (1000, 4.5, 300, 2.0)}  # cold ms, renders; prefetched ms, renders
REST_MS = {"131k": 2500, "262k": 4000}


def changes(table: Table, chromium: Any, live: Started, name: str, seconds: float, *, drag: bool) -> None:
    """Rows of frame changes, and of dragging a box."""
    cold_ms, cold_ratio, warm_ms, warm_ratio = LIMITS[name]
    with screen(chromium, live) as page:
        whole = reference_ms(page)
        cold = statistics.median(frame_changes(page, "Shift+ArrowRight", 4, rest_ms=REST_MS[name]))
        warm = statistics.median(frame_changes(page, "ArrowRight", 6, rest_ms=REST_MS[name]))
        for kind, ms, limit, ratio in (
            ("not prefetched", cold, cold_ms, cold_ratio),
            ("prefetched", warm, warm_ms, warm_ratio),
        ):
            said = f"{ms:.0f} ms = {ms / whole:.1f} x (reference render {whole:.0f} ms)"
            held = ms <= max(limit, ratio * whole)
            table.add(f"link: frame change {name}, {kind}", said, f"<= {limit} ms or {ratio} x", held)
        if drag:
            drag_box(table, page, seconds, name="link: drag a box, 131k")


def edits(table: Table, live: Started) -> None:
    """Edits through the link."""
    with window(live) as client:
        over = client.edits_ms(0, 60)
    middle, late = statistics.median(over), sorted(over)[int(0.95 * len(over))]
    table.add("link: edit acknowledged", f"median {middle:.0f}, p95 {late:.0f} ms", "median <= 120 ms", middle <= 120)


def run(work: Path, seconds: float) -> Table:
    """All rows."""
    from playwright.sync_api import sync_playwright

    table = Table()
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=chromium_path())
        for name, frames in (("131k", 80), ("262k", 60)):
            folder = write_folder(work / name, frames, SIZES[name])
            with (
                started("annotate", str(folder), "--edits", str(work / f"edits-{name}")) as live,
                slow_link(int(live.origin.rpartition(":")[2])) as port,
            ):
                far = replace(live, origin=f"http://127.0.0.1:{port}")
                changes(table, chromium, far, name, seconds, drag=name == "131k")
                if name == "131k":
                    edits(table, far)
        chromium.close()
    return table


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, default=ROOT / "data" / "studio")
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    return reported(partial(run, options.work, options.seconds), options.output)


if __name__ == "__main__":
    raise SystemExit(main())
