"""From K-Radar's downloads to a score by weather by three commands: disk and time as they are announced.

Simulated frames of two roads with weathers of their own stand in archives as K-Radar's users have them: by modality,
one of them empty, one cut. The disk is looked at while the store is made; time is the processor's, since others may be
at work: the command's own clock counts it here.
"""

import contextlib
import io
import re
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from threading import Event, Thread
from types import SimpleNamespace

from _kradar_downloads import pack_downloads
from _report import Part, Table, part_parser, run_parts

from farfield.cli import main
from farfield.datasets.kradar import downloads as announcing
from farfield.files.marks import mark_of

ERROR = 0.2
"""By how much of itself what is announced may differ from what is measured."""
_UNITS = {"bytes": 1, "kB": 1e3, "MB": 1e6, "GB": 1e9, "TB": 1e12}
_EVERY_S = 0.03
_WEATHERS = {"normal", "overcast", "fog", "rain", "sleet", "lightsnow", "heavysnow"}
"""As K-Radar's description.txt names them."""


def run_score(arguments: Sequence[str]) -> int:
    """Make archives, convert them, evaluate a shipped radar detector on the store, and write its page."""
    parser = part_parser(run_score.__doc__)
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--product", choices=("tesseract", "polar3d"), default="polar3d", help="260 or 16 MB a frame")
    parser.add_argument("--tree", type=Path, help="a tree of two sequences that farfield simulate wrote")
    options, table = parser.parse_args(arguments), Table()
    with tempfile.TemporaryDirectory() as name:
        home = Path(name)
        tree = options.tree or home / "tree"
        if options.tree is None:
            words = ["--frames", str(options.frames), "--sequences", "2", "--sensors", f"os2-64,{options.product}"]
            _said(["simulate", "kradar-sim-mini", str(tree), *words, "--workers", "1"])
        archives, store = pack_downloads(tree, home / "downloads"), home / "store"
        before = _marks(archives)
        # 1. From the archives to a store
        announcing.time = SimpleNamespace(monotonic=time.process_time)  # type: ignore[assignment]
        moments: list[tuple[str, float]] = []
        command = ["convert", str(archives), str(store), "--to", "radar-store", "--workers", "1"]
        with peak_of(store) as peak:
            words = _said(command, moments)
        end_s = time.process_time()
        whole = re.search(r"the disk needs about ([\d.,]+) (\w+)", words)
        rest = next((moment for moment in moments if "min" in moment[0] and "to convert" in moment[0]), None)
        announced = _bytes(whole)
        held = abs(announced - peak[0]) <= ERROR * peak[0]
        table.add(
            "peak of the disk, announced and measured",
            f"{announced / 1e6:.1f} and {peak[0] / 1e6:.1f} MB",
            "within 20 %",
            held,
        )
        if rest is not None:
            said_s, took_s = _seconds(rest[0]), end_s - rest[1]
            held = abs(said_s - took_s) <= ERROR * took_s + 3.0  # it is said in tenths of a minute
            table.add(
                "processor's time of the rest, the same",
                f"{said_s:.0f} and {took_s:.0f} s",
                "within 20 % and 3 s",
                held,
            )
        left = _marks(archives)
        table.add("archives", "unchanged" if left == before else "changed", "unchanged", left == before)
        stray = [path for path in store.rglob("*") if "unpacked" in path.parts or path.suffix == ".part"]
        table.add("left of what was unpacked", f"{len(stray)} files", "0 files", not stray)
        # 2. and 3. A shipped radar detector on the store, and its page: by weather
        evaluation, page = home / "evaluation", home / "weather.html"
        out = ["--out", str(evaluation), "--workers", "1"]
        _said(["evaluate", "rtnh-kradar-sim", str(store), *out])
        _said(["report", str(evaluation / "evaluation.json"), "--out", str(page)])
        conditions = {line.strip() for path in store.glob("*/description.txt") for line in path.read_text().split(",")}
        text = page.read_text(encoding="utf-8")
        weathers = sorted(word for word in conditions if word in _WEATHERS)
        names = {word: word.replace("snow", "_snow") for word in weathers}
        scored = [word for word, name in names.items() if name in text or name.replace("_", " ") in text]
        table.add("scored by weather", ", ".join(scored) or "none", ", ".join(weathers), scored == weathers)
    return table.status


@contextlib.contextmanager
def peak_of(folder: Path) -> Iterator[list[int]]:
    """The most that a folder's files take on the disk meanwhile, in bytes."""
    peak, done = [0], Event()

    def watch() -> None:
        while not done.wait(_EVERY_S):
            total = 0
            for path in folder.rglob("*") if folder.is_dir() else ():
                with contextlib.suppress(OSError):
                    total += path.lstat().st_blocks * 512
            peak[0] = max(peak[0], total)

    thread = Thread(target=watch)
    thread.start()
    try:
        yield peak
    finally:
        done.set()
        thread.join()


def _marks(folder: Path) -> dict[Path, tuple[tuple[int, int], int]]:
    """Size, checksum and time of each file."""
    return {path: (mark_of(path), path.stat().st_mtime_ns) for path in folder.iterdir()}


class _Moments(io.StringIO):
    """What is said, and when by the processor's clock."""

    def __init__(self, moments: list[tuple[str, float]]) -> None:
        super().__init__()
        self.moments = moments

    def write(self, text: str) -> int:
        self.moments.append((text, time.process_time()))
        return super().write(text)


def _said(words: list[str], moments: list[tuple[str, float]] | None = None) -> str:
    """Run a command of farfield; what it said."""
    said = _Moments([] if moments is None else moments)
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        status = main(words)
    if status:
        raise SystemExit(f"farfield {' '.join(words)}: status {status}: {said.getvalue()[-800:]}")
    print(f"$ farfield {' '.join(words)}", file=sys.stderr, flush=True)
    print(said.getvalue(), file=sys.stderr, flush=True)
    return said.getvalue()


def _bytes(match: re.Match[str] | None) -> float:
    return float(match[1].replace(",", "")) * _UNITS[match[2]] if match is not None else 0.0


def _seconds(text: str) -> float:
    hours = re.search(r"about (\d+) h (\d+) min", text)
    minutes = re.search(r"about ([\d.]+) min", text)
    return 3600.0 * int(hours[1]) + 60.0 * int(hours[2]) if hours else 60.0 * float(minutes[1]) if minutes else 0.0


if __name__ == "__main__":
    raise SystemExit(run_parts(__doc__, {"score": Part(run_score, "--frames 4")}))
