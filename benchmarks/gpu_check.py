"""One command that proves and measures on a GPU what can be; on a CPU it runs whole and says what needs a GPU.

usage: python benchmarks/gpu_check.py [--only PART ...] [--minutes 10] [--json FILE] [--archive FILE] [--list]
       python benchmarks/gpu_check.py --join FILE ... [--json FILE]

Each part runs in a process of its own, so that one that breaks off, even with the GPU's context, leaves the others be.
No network and no data but what is simulated here, or a cloud made beforehand: ``--archive`` makes it where there is the
simulator, and reads it where there is none. At the end comes one table; it becomes the section of its device in
benchmarks/results/gpu_check.txt, or goes beside the JSON. The exit status is 1 if anything failed. ``--tiny`` runs two
parts of seconds and keeps their table only in ``--output``.
"""

import argparse
import importlib
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any, NamedTuple

from _report import RESULTS, ROOT, header, keep_section

OUT_OF_TIME = "out of time"
ARCHIVE = ROOT / "data" / "gpu_check_cloud.npz"
TINY = ("copies", "full")
"""The parts of the tiny setting."""


class Part(NamedTuple):
    """One part of the check.

    Args:
        title: What it looks at.
        place: ``module:function`` that gives its rows.
    """

    title: str
    place: str


PARTS = {
    "kernels": Part("operators with a Triton kernel against their plain version", "_gpu_kernels:run"),
    "outputs": Part("raw outputs before suppression, GPU against CPU", "_gpu_outputs:raw"),
    "boxes": Part("boxes after suppression, on the device against on the host", "_gpu_outputs:boxes"),
    "copies": Part("copies between host and GPU, from points to boxes", "_gpu_outputs:copies"),
    "full": Part("what is said where memory is not enough", "_gpu_speed:full"),
    "speed": Part("milliseconds and peak memory from 60,000 points to boxes", "_gpu_speed:speed"),
    "backbone": Part("SECOND's sparse backbone, beside spconv where it is at hand", "_gpu_speed:backbone"),
    "range": Part("cost as the range grows from 50 to 250 m, 30,000 points", "_gpu_speed:ranges"),
    "memory": Part("peak memory of RTN and RTNH beside the paper's", "_gpu_speed:radar"),
    "loader": Part("frames a second with a loader", "_gpu_speed:loader"),
    "resume": Part("a checkpoint of one device, gone on from on the other", "_gpu_training:resume"),
    "training": Part("training steps of every detector", "_gpu_training:train"),
    "compiled": Part("dense trunks by torch.compile", "_gpu_speed:compiled"),
}
"""The parts in the order of what a short loan of a GPU should show first."""


def serve(place: str, archive: Path) -> None:
    """Print the rows of a part as JSON, one a line, as they come."""
    import torch
    from _gpu_common import Site

    site = Site(torch.device("cuda" if torch.cuda.is_available() else "cpu"), archive)
    module, function = place.split(":")
    for row in getattr(importlib.import_module(module), function)(site):
        print(row.to_json(), flush=True)


def run_part(name: str, archive: Path, seconds: float) -> dict[str, Any]:
    """Run a part in a process of its own for so many seconds at most.

    Returns:
        ``rows``, ``seconds`` and ``cpu_seconds``.
    """
    part, rows, began = PARTS[name], list[dict[str, Any]](), time.monotonic()
    cpu_before_s = _children_cpu_s()
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as errors:
        command = [sys.executable, __file__, "--serve", part.place, "--archive", str(archive)]
        options = {"stdout": subprocess.PIPE, "stderr": errors, "text": True, "env": _environment()}
        with subprocess.Popen(command, **options, start_new_session=True) as process:
            late = threading.Timer(max(seconds, 0.0), process.kill)
            late.start()
            for line in process.stdout or ():
                if line.startswith("{"):
                    rows.append(json.loads(line))
                    print(f"  {_line(rows[-1])}", file=sys.stderr, flush=True)
            status, in_time = process.wait(), late.is_alive()
            late.cancel()
        errors.seek(0)
        said = errors.read()
    if not in_time:
        rows.append(_row(part.title, f"stopped after {seconds:.0f} s", OUT_OF_TIME))
    elif status:
        last = (said.strip().splitlines() or ["no word"])[-1]
        rows.append(_row(part.title, f"broke off with status {status}: {last[:150]}", "FAILED", {"said": said[-4000:]}))
    elif not rows:
        rows.append(_row(part.title, "gave no row", "FAILED"))
    return {"rows": rows, "seconds": time.monotonic() - began, "cpu_seconds": _children_cpu_s() - cpu_before_s}


def _row(what: str, figure: str, verdict: str, numbers: dict[str, Any] | None = None) -> dict[str, Any]:
    return {"what": what, "figure": figure, "verdict": verdict, "numbers": numbers or {}}


def _children_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _environment() -> dict[str, str]:
    """That of a part: one thread and Triton's interpreter where there is no GPU."""
    import torch

    alone = {} if torch.cuda.is_available() else {"OMP_NUM_THREADS": "1", "TRITON_INTERPRET": "1"}
    return {**alone, **os.environ}


def hardware() -> dict[str, Any]:
    """The device under test, and the versions that decide how it is used."""
    import torch

    found: dict[str, Any] = {"gpu": None, "torch": torch.__version__, "cuda": torch.version.cuda}
    try:
        found["triton"] = importlib.import_module("triton").__version__
    except Exception:
        found["triton"] = None
    if torch.cuda.is_available():
        seen = torch.cuda.get_device_properties(0)
        found |= {
            "gpu": seen.name,
            "memory_gib": round(seen.total_memory / 2**30, 1),
            "capability": f"{seen.major}.{seen.minor}",
            "multiprocessors": seen.multi_processor_count,
            "driver": _driver(),
        }
    return found


def _driver() -> str:
    command = ["nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=20).stdout.split()[0]
    except (OSError, subprocess.SubprocessError, IndexError):
        return "unknown"


def table(found: dict[str, Any]) -> str:
    """The one table: every row of every part, and what the parts took."""
    lines = []
    for name, part in found["parts"].items():
        took = f"{part['seconds']:.0f} s, {part['cpu_seconds']:.0f} s of CPU"
        lines += ["", f"{name}: {PARTS[name].title} ({took})", *(f"  {_line(row)}" for row in part["rows"])]
    verdicts = [row["verdict"] for part in found["parts"].values() for row in part["rows"]]
    counted = ", ".join(f"{verdicts.count(word)} {word}" for word in dict.fromkeys(verdicts))
    cpu_s = sum(part["cpu_seconds"] for part in found["parts"].values())
    return "\n".join([*lines, "", f"{len(verdicts)} rows: {counted}; {cpu_s / 60:.1f} minutes of CPU"])


def _line(row: dict[str, Any]) -> str:
    return f"{row['verdict']:<12} {row['what']:<52} {row['figure']}"


def check(only: list[str], minutes: float, archive: Path) -> dict[str, Any]:
    """Run the parts, the later ones for what time is left."""
    from _gpu_common import make_archive

    end = time.monotonic() + 60 * minutes
    print(header(), file=sys.stderr)
    found: dict[str, Any] = {"header": header(), "hardware": hardware(), "cloud": make_archive(archive), "parts": {}}
    for name in only:
        print(f"{name}: {PARTS[name].title}", file=sys.stderr, flush=True)
        found["parts"][name] = run_part(name, archive, end - time.monotonic())
    return found


def joined(paths: list[Path]) -> dict[str, Any]:
    """The results of several calls on one device at one commit, as one: such as checks side by side, then times alone.

    Raises:
        ValueError: If they are of different devices, versions or commits.
    """
    found = [json.loads(path.read_text("utf-8")) for path in paths]
    same = {(json.dumps(one["hardware"], sort_keys=True), _line_of(one["header"], "commit")) for one in found}
    if len(same) != 1:
        raise ValueError(f"expected results of one device and one commit; got {len(same)}")
    parts = {name: part for one in found for name, part in one["parts"].items()}
    heads = [one["header"] for one in found]
    commands = [line for head in heads for line in head.splitlines() if line.startswith("command")]
    rest = [line for line in heads[0].splitlines() if not line.startswith("command")]
    ordered = {name: parts[name] for name in PARTS if name in parts}
    return {**found[0], "header": "\n".join([*commands, *rest]), "parts": ordered}


def _line_of(header_text: str, name: str) -> str:
    return next(line for line in header_text.splitlines() if line.startswith(name))


def text(found: dict[str, Any]) -> str:
    """Header, hardware and table."""
    words = ", ".join(f"{key} {value}" for key, value in found["hardware"].items() if value is not None)
    gpu = "" if found["hardware"]["gpu"] else "no GPU: figures of the CPU, each said to be so; "
    return f"{found['header']}\ndevice   {gpu}{words}\ncloud    {found['cloud']}\n{table(found)}\n"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(PARTS), default=list(PARTS), metavar="PART")
    parser.add_argument("--minutes", type=float, default=30.0, help="of the whole check; later parts may go without")
    parser.add_argument("--json", type=Path, help="where the result goes as JSON, its table beside it as .txt")
    parser.add_argument("--tiny", action="store_true", help="two parts of seconds")
    parser.add_argument("--output", type=Path, help="where the table goes otherwise, as a section")
    parser.add_argument(
        "--archive", type=Path, default=ARCHIVE, help="a cloud made beforehand; made where it is absent"
    )
    parser.add_argument("--list", action="store_true", help="say what parts there are")
    parser.add_argument("--join", type=Path, nargs="+", metavar="FILE", help="make one table of several calls' JSON")
    parser.add_argument("--serve", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.list:
        print("\n".join(f"{name:<10} {part.title}" for name, part in PARTS.items()))
        return 0
    if options.serve:
        serve(options.serve, options.archive)
        return 0
    if options.tiny:
        options.only = list(TINY)
    found = joined(options.join) if options.join else check(options.only, options.minutes, options.archive)
    print(text(found))
    _store(found, options)
    return int(any(row["verdict"] == "FAILED" for part in found["parts"].values() for row in part["rows"]))


def _store(found: dict[str, Any], options: argparse.Namespace) -> None:
    from farfield.files.atomic import write_text

    slug = re.sub(r"[^a-z0-9]+", "-", (found["hardware"]["gpu"] or "cpu").lower()).strip("-")
    output = options.output or (None if options.tiny else RESULTS / "gpu_check.txt")
    if options.json is None:
        if output is not None:
            keep_section(output, slug, text(found))
        return
    path = options.json
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(found, indent=1) + "\n")
    write_text(path.with_suffix(".txt"), text(found))
    print(f"written to {path} and {path.with_suffix('.txt').name}", file=sys.stderr)


if __name__ == "__main__":
    raise SystemExit(main())
