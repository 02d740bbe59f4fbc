"""The studio's journal: how long an edit takes to be safe, what a kill loses, how long a restart takes.

    python benchmarks/studio_journal.py [--repeats 20] [--output benchmarks/results/studio_journal.txt]

Acknowledged means after fsync. A process that edits as the studio's server does gets 1,000 edits over a pipe, 25 ahead
of its acknowledgements, and is killed (SIGKILL) after a random number of these; then its journal is replayed. Lost is
what was acknowledged and is not there. Exit status 1 where an edit is lost, or an undo back to the first edit after a
restart does not give the same bytes. Times are of a shared machine: fsync alone is measured beside them.
"""

import argparse
import json
import os
import random
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Sequence
from concurrent.futures import Future, wait
from functools import partial
from pathlib import Path

from _report import header
from _studio_table import Table

from farfield.annotation.edits import set_box
from farfield.annotation.schema import schema_of
from farfield.annotation.store import Author, Store, undo
from farfield.datasets.base import Dataset
from farfield.datasets.edits import Record, journal_folder
from farfield.datasets.labels import CsvLabels
from farfield.files.atomic import write_text
from farfield.frame import Frame

FRAMES, AHEAD = 20, 25
ANN = Author("ann", "w1")
_OUT = threading.Lock()


class Names(Dataset):
    """A data set of one drive that has names and labels only."""

    name = "names"

    def __init__(self, root: Path) -> None:
        self.root, self.sequences = root, ("a",) * FRAMES
        self.frame_ids = tuple(f"{row:04d}" for row in range(FRAMES))

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
        rows = (f"a,{row:04d},car,{10 + row},2,0,4.5,1.9,1.6,0.25,,3\n" for row in range(FRAMES))
        write_text(file, "sequence,frame,label,x,y,z,l,w,h,yaw_rad,score,track_id\n" + "".join(rows))
    schema = schema_of({"car": (4.6, 1.95, 1.7)}, None, "full")
    return Store(Names(root), CsvLabels(file), journal_folder(root), schema)


def reopened(root: Path) -> Store:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*torn.*")
        return opened(root)


def edit(store: Store, number: int, name: str) -> "Future[Record]":
    key = ("a", f"{number % FRAMES:04d}")
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
    command = [sys.executable, __file__, "--serve", str(root)]
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


def report(repeats: int) -> str:
    loads = os.getloadavg()
    lines, table = [""], Table()
    with tempfile.TemporaryDirectory() as name:
        folders = {each: Path(name, each) for each in ("fsync", "ack", "burst", "small", "large", "kill")}
        for folder in folders.values():
            folder.mkdir()
        lines.append(f"a line and fsync, nothing else, 200:      {percentiles(fsyncs(folders['fsync']))}")
        lines.append(f"edit acknowledged after fsync, 200:       {percentiles(acknowledged(folders['ack']))}")
        took = burst(folders["burst"], 1000)
        table.add("1,000 edits in a burst, all acknowledged", f"{took:.2f} s", "<= 3 s", took <= 3)
        for edits, steps, folder, most_s in ((1_000, 1_000, "small", 0.3), (100_000, 1_000, "large", 3.0)):
            ready, cpu, step = restarted(folders[folder], edits, steps)
            size_mb = (folders[folder] / ".farfield-studio" / "edits.jsonl").stat().st_size / 1e6
            lines.append(
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
    load = f"load     {loads[0]:.1f} before, {os.getloadavg()[0]:.1f} after (1 minute)"
    return "\n".join([header(), load, *lines, "", table.text()]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--serve", type=Path)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    if options.serve is not None:
        serve(options.serve)
        return
    text = report(options.repeats)
    print(text, end="")
    if options.output is not None:
        write_text(options.output, text)


if __name__ == "__main__":
    main()
