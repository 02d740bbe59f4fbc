"""The studio's server: start-up, a long sequence, edits, fits, memory, one frame as a file.

    python benchmarks/studio_server.py [--work data/studio] [--output benchmarks/results/studio_server.txt]

Each is measured from outside, on the command that a user starts. On a shared machine a row also holds as a ratio to a
reference of the same run: a Python process that imports what a server needs, a line appended and fsynced, a whole
render of 131,072 points.
"""

import argparse
import http.client
import json
import shutil
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from _report import ROOT
from _studio_client import window
from _studio_process import Started, started
from _studio_scenes import write_folder
from _studio_screen import Screen, chromium_path, screen
from _studio_table import Table, reported
from studio_journal import fsyncs
from studio_page import SIZES, reference_ms

SAMPLE = ROOT / "src" / "farfield" / "studio" / "samples" / "kradar"
FRAMES = 600
IMPORTS = "import numpy, pydantic, starlette.applications, uvicorn, websockets, yaml"


def timed(work: Any) -> float:
    """Seconds that something takes."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def imports_s() -> float:
    """A Python process that imports what a server needs, and ends."""
    return timed(lambda: subprocess.run([sys.executable, "-c", IMPORTS], check=True))


def listening_s() -> float:
    """From the command to the first answer of ``/health``."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "farfield.cli", "view", "--no-browser", "--port", str(port)]
    begin = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        try:
            while not _healthy(port):
                time.sleep(0.01)
            return time.perf_counter() - begin
        finally:
            process.terminate()


def _healthy(port: int) -> bool:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    try:
        connection.request("GET", "/health")
        return connection.getresponse().status == 200
    except OSError:
        return False
    finally:
        connection.close()


def pictured_s(launch: Any, *arguments: str, browser: Any = None) -> float:
    """From the command to a canvas that is not blank; the browser is launched in it unless one is given."""
    begin = time.perf_counter()
    with started("view", *arguments) as live:
        chromium = browser or launch()
        with screen(chromium, live) as page:
            if page.tell("colours()") < 100:
                raise SystemExit("the canvas is blank")
            spent = time.perf_counter() - begin
        if browser is None:
            chromium.close()
    return spent


def sequence_of(work: Path) -> Path:
    """The sample of K-Radar as a sequence of 600 frames: its files under new numbers."""
    root = work / "kradar600"
    if (root / "made").exists():
        return root
    shutil.copytree(SAMPLE, root, dirs_exist_ok=True)
    sensors = [("os2-64", "os2-64_{:05d}.pcd"), ("cam-front", "cam-front_{:05d}.png")]
    label = next((root / "kradar_revised_label_v2_1").rglob("*.txt"))
    record = json.loads((root / "1" / "frame_record" / "00006_00001.json").read_text())
    stamps = []
    for number in range(1, FRAMES + 1):
        radar = number + 5
        for folder, pattern in sensors:
            _linked(next((SAMPLE / "1" / folder).iterdir()), root / "1" / folder / pattern.format(number))
        _linked(next((SAMPLE / "radar_cells" / "1").iterdir()), root / "radar_cells" / "1" / f"cells_{radar:05d}.h5")
        name = f"{radar:05d}_{number:05d}"
        head, _, rest = label.read_text().partition(", timestamp=")
        head = head.rpartition("=")[0] + f"={name}_{number:05d}_{number:05d}_{number:05d}"
        stamp = 1600000000 + number / 10
        if number > 1:
            (label.parent / f"{name}.txt").write_text(f"{head}, timestamp={stamp:.1f}\n" + rest.partition("\n")[2])
            indices = {"cam-front": number, "cam-lrr": number, "os1-128": number, "os2-64": number, "radar": radar}
            changed = record | {"indices": indices, "time_ns": int(stamp * 10) * 10**8}
            (root / "1" / "frame_record" / f"{name}.json").write_text(json.dumps(changed))
        stamps.append(f"os2-64_{number:05d}.pcd, {stamp:.9f}\n")
    (root / "1" / "time_info" / "os2-64.txt").write_text("".join(stamps))
    (root / "made").touch()
    return root


def _linked(source: Path, target: Path) -> None:
    if not target.exists():
        shutil.copyfile(source, target)


def start(table: Table, launch: Any, work: Path) -> None:
    """Rows of starting."""
    plain = statistics.median(imports_s() for _ in range(3))
    listening = statistics.median(listening_s() for _ in range(3))
    said = f"{listening:.2f} s = {listening / plain:.1f} x (its imports alone {plain:.2f} s)"
    table.add("command to listening", said, "<= 1.0 s or 2.5 x", listening <= max(1.0, 2.5 * plain))
    launched = timed(lambda: launch().close())
    first = statistics.median(pictured_s(launch) for _ in range(3))
    limit = max(4.0, 1.5 * (launched + listening) + 1)
    said = f"{first:.1f} s (browser's launch {launched:.1f} s of it)"
    table.add("command to the first picture, with the browser's launch", said, "<= 4 s", first <= limit)
    browser = launch()
    folder = str(sequence_of(work))
    pictured_s(launch, folder, browser=browser)
    opening = statistics.median(pictured_s(launch, folder, browser=browser) for _ in range(3))
    said = f"{opening:.1f} s = {opening / plain:.1f} x"
    table.add(
        "600 frames of K-Radar: command to the first picture", said, "<= 3 s or 6 x", opening <= max(3, 6 * plain)
    )
    browser.close()


def edits(table: Table, live: Started, work: Path) -> None:
    """Edits one after the other through the WebSocket."""
    plain = statistics.median(fsyncs(work))
    with window(live) as client:
        took = client.edits_ms(0, 200)
        size = client.html_bytes(0) / 1e6
    middle, late = statistics.median(took), late_of(took)
    said = f"median {middle:.1f}, p95 {late:.1f} ms (fsync alone {plain:.1f} ms)"
    table.add("edit acknowledged after fsync, 200", said, "median <= 15, p95 <= 50 ms", middle <= 15 and late <= 50)
    table.add("one frame of 131k as a file that opens from disk", f"{size:.2f} MB", "<= 2 MB", size <= 2)


def late_of(values: Sequence[float]) -> float:
    """The 95th percentile."""
    return sorted(values)[int(0.95 * len(values))]


def fits(table: Table, page: Screen, frames: int) -> None:
    """One click on each vehicle of some frames, from the gesture to the drawn box."""
    whole = reference_ms(page)
    for frame in range(frames):
        page.go(frame)
        for row in sorted(page.boxes, key=lambda row: row["distance_m"])[:12]:
            page.look(*row["box"][:2], 25)
            before = page.tell("fitTimes.length")
            page.page.mouse.move(*page.pixel(row["box"][:3]))
            page.press("c")
            page.until(f"fitTimes.length > {before}")
            page.press("Delete")
            page.settled()
    took = page.tell("fitTimes")
    middle, late = statistics.median(took), late_of(took)
    said = f"median {middle:.0f}, p95 {late:.0f} ms = {late / whole:.1f} x ({whole:.0f} ms)"
    table.add(
        f"fit on a click, to the drawn box, {len(took)}", said, "p95 <= 150 ms or 2 x", late <= max(150, 2 * whole)
    )


def memory(table: Table, page: Screen, live: Started) -> None:
    """The server after 60 frames were looked at."""
    page.press("Home")
    for _ in range(60):
        page.settled()
        page.press("ArrowRight")
    page.settled()
    lines = Path(f"/proc/{live.pid}/status").read_text().splitlines()
    rss = int(next(line for line in lines if line.startswith("VmRSS")).split()[1]) / 1e3
    table.add("memory of the server after 60 frames of 131k", f"{rss:.0f} MB", "<= 900 MB", rss <= 900)


def run(work: Path) -> Table:
    """All rows."""
    from playwright.sync_api import sync_playwright

    table = Table()
    work.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        launch = partial(playwright.chromium.launch, executable_path=chromium_path())
        start(table, launch, work)
        folder, journal = write_folder(work / "131k", 80, SIZES["131k"]), work / "edits-server"
        shutil.rmtree(journal, ignore_errors=True)
        chromium = launch()
        with started("annotate", str(folder), "--edits", str(journal)) as live:
            edits(table, live, work)
            with screen(chromium, live) as page:
                fits(table, page, 2)
                memory(table, page, live)
        chromium.close()
    return table


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, default=ROOT / "data" / "studio")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    return reported(partial(run, options.work), options.output)


if __name__ == "__main__":
    raise SystemExit(main())
