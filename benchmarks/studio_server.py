"""The studio's server and journal, and the studio over a slow link."""

import argparse
import http.client
import json
import os
import random
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Sequence
from concurrent.futures import Future, wait
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from _report import ROOT, Part, Table, child_command, load_printed, part_parser, run_parts
from _studio_hostile import run_hostile
from _studio_process import Started, slow_link, started, window
from _studio_scenes import write_folder
from _studio_screen import Screen, browser, chromium_path, screen
from studio_page import SIZES, drag_box, frame_changes, reference_ms

from farfield.annotation.edits import set_box
from farfield.annotation.schema import schema_of
from farfield.annotation.store import Author, Store, undo
from farfield.datasets.base import Dataset
from farfield.datasets.edits import Record, journal_folder
from farfield.datasets.labels import CsvLabels
from farfield.files.atomic import write_text
from farfield.frame import Frame

SAMPLE = ROOT / "src" / "farfield" / "studio" / "samples" / "kradar"
SERVER_FRAMES = 600
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
    for number in range(1, SERVER_FRAMES + 1):
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


def server_edits(table: Table, live: Started, work: Path) -> None:
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


def server_run(work: Path) -> Table:
    """All rows."""
    table = Table()
    work.mkdir(parents=True, exist_ok=True)
    with browser() as playwright:
        launch = partial(playwright.chromium.launch, executable_path=chromium_path())
        start(table, launch, work)
        folder, journal = write_folder(work / "131k", 80, SIZES["131k"]), work / "edits-server"
        shutil.rmtree(journal, ignore_errors=True)
        chromium = launch()
        with started("annotate", str(folder), "--edits", str(journal)) as live:
            server_edits(table, live, work)
            with screen(chromium, live) as page:
                fits(table, page, 2)
                memory(table, page, live)
        chromium.close()
    return table


def run_server(arguments: Sequence[str]) -> int:
    """The studio's server: start-up, a long sequence, edits, fits, memory, one frame as a file.

        python benchmarks/studio_server.py server [--work data/studio]

    Each is measured from outside, on the command that a user starts. On a shared machine a row also holds as a ratio to
    a reference of the same run: a Python process that imports what a server needs, a line appended and fsynced, a whole
    render of 131,072 points.
    """
    parser = part_parser(run_server.__doc__)
    parser.add_argument("--work", type=Path, default=ROOT / "data" / "studio")
    options = parser.parse_args(arguments)
    with load_printed():
        table = server_run(options.work)
    return table.status


JOURNAL_FRAMES, AHEAD = 20, 25
ANN = Author("ann", "w1")
_OUT = threading.Lock()


class Names(Dataset):
    """A data set of one drive that has names and labels only."""

    name = "names"

    def __init__(self, root: Path) -> None:
        self.root, self.sequences = root, ("a",) * JOURNAL_FRAMES
        self.frame_ids = tuple(f"{row:04d}" for row in range(JOURNAL_FRAMES))

    def frame(self, index: int) -> Frame:
        """A frame without anything."""
        return Frame(sequence="a", frame_id=self.frame_ids[index], time_ns=index * 10**8, reference="lidar")

    def files(self, index: int) -> Sequence[Path]:
        """No files."""
        del index
        return ()


def opened(root: Path) -> Store:
    file = root / "boxes.csv"
    if not file.exists():
        rows = (f"a,{row:04d},car,{10 + row},2,0,4.5,1.9,1.6,0.25,,3\n" for row in range(JOURNAL_FRAMES))
        write_text(file, "sequence,frame,label,x,y,z,l,w,h,yaw_rad,score,track_id\n" + "".join(rows))
    schema = schema_of({"car": (4.6, 1.95, 1.7)}, None, "full")
    return Store(Names(root), CsvLabels(file), journal_folder(root), schema)


def reopened(root: Path) -> Store:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*torn.*")
        return opened(root)


def edit(store: Store, number: int, name: str) -> "Future[Record]":
    key = ("a", f"{number % JOURNAL_FRAMES:04d}")
    row = store.row(key, "0")
    assert row is not None
    value = {"box": [100.0 + number % 3000 / 4, *row.label.box[1:]]}
    return store.edit(ANN, name, "box.set", partial(set_box, key=key, name="0", base=row.version, value=value)).saved


def acknowledge(done: "Future[Record]") -> None:
    with _OUT:
        sys.stdout.write(f"{done.result().id}\n")
        sys.stdout.flush()


def serve(root: Path) -> None:
    """Edit as the server does: edits in, acknowledgements out."""
    with opened(root) as store:
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        for line in sys.stdin:
            order = json.loads(line)
            edit(store, order["number"], order["id"]).add_done_callback(acknowledge)


def killed(root: Path, edits: int, after: int) -> tuple[int, int, int]:
    """Edits sent, acknowledged and kept of a process that is killed; raises where one is lost."""
    command = child_command("--serve", root)
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as server:
        assert server.stdin is not None
        assert server.stdout is not None
        assert server.stdout.readline() == b"ready\n"
        sent, acknowledged = 0, set()
        while len(acknowledged) < after:
            more = range(sent, min(len(acknowledged) + AHEAD, edits))
            lines = "".join(json.dumps({"id": f"e{number}", "number": number}) + "\n" for number in more)
            os.write(server.stdin.fileno(), lines.encode())
            sent = max(sent, more.stop)
            acknowledged.add(server.stdout.readline().strip().decode())
        server.kill()
        acknowledged |= {line.strip().decode() for line in server.stdout if line.endswith(b"\n")}
    with reopened(root) as store:
        kept = [store.journal.read(seq).id for seq in range(1, len(store.journal) + 1)]
    lost = acknowledged - set(kept)
    if lost or kept != [f"e{number}" for number in range(len(kept))] or len(kept) > sent:
        raise SystemExit(f"lost: {sorted(lost)}; kept {len(kept)} of {sent}")
    return sent, len(acknowledged), len(kept)


def percentiles(values: Sequence[float]) -> str:
    ordered = sorted(values)
    return f"median {statistics.median(ordered):.1f}, p95 {ordered[int(0.95 * len(ordered))]:.1f} ms"


def fsyncs(folder: Path) -> list[float]:
    """Times of appending a line and fsync alone, ms."""
    took = []
    with (folder / "plain").open("ab") as handle:
        for _ in range(200):
            begin = time.perf_counter()
            handle.write(b"x" * 300 + b"\n")
            handle.flush()
            os.fsync(handle.fileno())
            took.append(1000 * (time.perf_counter() - begin))
    return took


def acknowledged(folder: Path) -> list[float]:
    """Times from an edit to its acknowledgement, one after the other, ms."""
    took = []
    with opened(folder) as store:
        for number in range(200):
            begin = time.perf_counter()
            edit(store, number, f"e{number}").result()
            took.append(1000 * (time.perf_counter() - begin))
    return took


def burst(folder: Path, edits: int) -> float:
    """Seconds until all edits of a burst are acknowledged."""
    with opened(folder) as store:
        begin = time.perf_counter()
        wait([edit(store, number, f"e{number}") for number in range(edits)])
        return time.perf_counter() - begin


def restarted(folder: Path, edits: int, steps: int) -> tuple[float, float, float]:
    """Seconds to replay so many edits, CPU seconds of it, seconds a step taken back; the first state is checked."""
    with opened(folder) as store:
        begin = states(store)
        futures = [edit(store, number, f"e{number}") for number in range(edits)]
        wait(futures)
    start, cpu = time.perf_counter(), time.process_time()
    with opened(folder) as store:
        ready, cpu = time.perf_counter() - start, time.process_time() - cpu
        start = time.perf_counter()
        last = [undo(store, ANN, f"u{number}").saved for number in range(steps)]
        wait(last)
        step = (time.perf_counter() - start) / steps
        if steps == edits and states(store) != begin:
            raise SystemExit("taken back to the first edit, the state is another one")
    return ready, cpu, step


def states(store: Store) -> bytes:
    return repr([[row.label for row in store.rows(key)] for key in store.keys]).encode()


def report(repeats: int, many: int) -> int:
    """Times, rows and kills; 1 where a row misses its target."""
    table = Table()
    with tempfile.TemporaryDirectory() as name:
        folders = {each: Path(name, each) for each in ("fsync", "ack", "burst", "small", "large", "kill")}
        for folder in folders.values():
            folder.mkdir()
        print(f"a line and fsync, nothing else, 200:      {percentiles(fsyncs(folders['fsync']))}")
        print(f"edit acknowledged after fsync, 200:       {percentiles(acknowledged(folders['ack']))}")
        took = burst(folders["burst"], 1000)
        table.add("1,000 edits in a burst, all acknowledged", f"{took:.2f} s", "<= 3 s", took <= 3)
        for edits, steps, folder, most_s in ((1_000, 1_000, "small", 0.3), (many, 1_000, "large", 3.0)):
            ready, cpu, step = restarted(folders[folder], edits, steps)
            size_mb = (folders[folder] / ".farfield-studio" / "edits.jsonl").stat().st_size / 1e6
            print(
                f"restart with {edits:,} edits: {size_mb:.1f} MB with the undo, {cpu:.2f} s of CPU, "
                f"{1000 * step:.2f} ms a step taken back"
            )
            words = "; all taken back: the first state, byte for byte" if steps == edits else ""
            table.add(f"restart with {edits:,} edits", f"{ready:.2f} s{words}", f"<= {most_s:g} s", ready <= most_s)
        rng = random.Random(0)
        runs = []
        for repeat in range(repeats):
            folder = folders["kill"] / str(repeat)
            folder.mkdir()
            runs.append(killed(folder, 1000, rng.randrange(1, 990)))
        sent, known, kept = (sum(each) for each in zip(*runs, strict=True))
        figure = f"{sent:,} sent, {known:,} acknowledged, {kept:,} kept, 0 lost"
        table.add(f"kill -9 during 1,000 edits, {repeats} times", figure, "none acknowledged is lost", True)
    return table.status


def run_journal(arguments: Sequence[str]) -> int:
    """The studio's journal: how long an edit takes to be safe, what a kill loses, how long a restart takes.

        python benchmarks/studio_server.py journal [--repeats 20]

    Acknowledged means after fsync. A process that edits as the studio's server does gets 1,000 edits over a pipe, 25
    ahead of its acknowledgements, and is killed (SIGKILL) after a random number of these; then its journal is replayed.
    Lost is what was acknowledged and is not there. Exit status 1 where an edit is lost, or an undo back to the first
    edit after a restart does not give the same bytes. Times are of a shared machine: fsync alone is measured beside
    them.
    """
    parser = part_parser(run_journal.__doc__)
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--many", type=int, default=100_000, help="edits of the longer restart")
    parser.add_argument("--serve", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.serve is not None:
        serve(options.serve)
        return 0
    with load_printed():
        return report(options.repeats, options.many)


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


def link_edits(table: Table, live: Started) -> None:
    """Edits through the link."""
    with window(live) as client:
        over = client.edits_ms(0, 60)
    middle, late = statistics.median(over), sorted(over)[int(0.95 * len(over))]
    table.add("link: edit acknowledged", f"median {middle:.0f}, p95 {late:.0f} ms", "median <= 120 ms", middle <= 120)


def link_run(work: Path, seconds: float) -> Table:
    """All rows."""
    table = Table()
    with browser() as playwright:
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
                    link_edits(table, far)
        chromium.close()
    return table


def run_link(arguments: Sequence[str]) -> int:
    """The studio over a link of 20 Mbit/s and 50 ms there and back: frame changes, dragging, edits.

        python benchmarks/studio_server.py link [--work data/studio] [--seconds 3]

    The link is a proxy of our own that slows WebSockets too; the browser's throttling does not. Its rate holds for all
    connections together. Times also hold as ratios to a whole render of the same run, waited for.
    """
    parser = part_parser(run_link.__doc__)
    parser.add_argument("--work", type=Path, default=ROOT / "data" / "studio")
    parser.add_argument("--seconds", type=float, default=3.0)
    options = parser.parse_args(arguments)
    with load_printed():
        table = link_run(options.work, options.seconds)
    return table.status


def run_attack(arguments: Sequence[str]) -> int:
    """Attack the studio with random and malformed messages and requests: nothing foreign, nothing stuck, no wrong edit.

        python benchmarks/studio_server.py hostile [--messages 10000] [--seed 1]

    Five windows at once, a tenth as many requests of HTTP, and one person who annotates meanwhile; see
    benchmarks/_studio_hostile.py.
    """
    parser = part_parser(run_attack.__doc__)
    parser.add_argument("--messages", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    table = Table()
    with load_printed(), tempfile.TemporaryDirectory() as folder:
        run = run_hostile(Path(folder), messages=options.messages, seed=options.seed)
    answers = ", ".join(f"{count} {name}" for name, count in sorted(run.answers.items()))
    sent = f"{run.messages} messages of seed {options.seed}, {run.requests} requests, {run.windows} windows"
    table.add(sent, answers, "said only", True)
    table.add("stored edits compared with their messages", str(run.edits), "all", True)
    table.add("foreign exceptions, stuck, wrong edits", str(len(run.faults)), "0", not run.faults)
    return table.status


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "server": Part(run_server, None),
                "journal": Part(run_journal, "--repeats 1 --many 1000"),
                "link": Part(run_link, None),
                "hostile": Part(run_attack, "--messages 200", exact=True),
            },
        )
    )
