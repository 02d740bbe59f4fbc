"""Structural edits whose meaning is known, to every reader: is any wrong result silent?"""

import importlib
import json
import resource
import subprocess
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from _report import MissingError, Part, child_command, part_parser, run_parts
from _structures import LIMIT_BYTES, Family, Tally, make_case, outcome, run_cases

CASES, AT_ONCE = 40_000, 1500
FAULTY = ("silent", "overrefused", "foreign", "slow")
COLUMNS = ("same", "said", "refused", "silent", "overrefused", "foreign")


def families(parts: Sequence[str] | None = None) -> dict[str, Family]:
    """All families by name, of some modules alone where they are named: ``clouds`` is ``_structures_clouds``."""
    names = sorted(path.stem for path in Path(__file__).parent.glob("_structures_*.py"))
    modules = {name.removeprefix("_structures_"): name for name in names}
    unknown = sorted({*(parts or ())} - {*modules})
    if unknown:
        raise SystemExit(f"--part {unknown[0]}: expected {', '.join(modules)}")
    chosen = []
    for name in parts or modules:
        try:
            chosen.append(importlib.import_module(modules[name]))
        except MissingError as error:
            if parts:
                raise
            print(f"left out: {name}: {error}", file=sys.stderr)
    return {family.name: family for module in chosen for family in module.FAMILIES}


def counts(chosen: Sequence[Family], cases: int) -> dict[str, int]:
    """How many cases each family gets: by their shares, one at least."""
    whole = sum(family.share for family in chosen)
    return {family.name: max(1, round(cases * family.share / whole)) for family in chosen}


def in_process(options: Sequence[object], chunk: tuple[str, int, int]) -> tuple[str, Tally]:
    """Try some cases in a process of their own, whose address space may grow by 1 GB."""
    name, first, count = chunk
    with tempfile.TemporaryDirectory() as folder:
        words = ["--format", name, "--first", first, "--cases", count, "--work", folder, *options]
        done = subprocess.run(child_command(*words), stdout=subprocess.PIPE, text=True, check=False)
        if done.returncode:
            number = (Path(folder) / "at").read_text()
            tally = Tally(cases=count, outcomes=Counter(foreign=1), faults=[f"{name} {number}: foreign: process died"])
            return name, tally
    fields = json.loads(done.stdout)
    counters = {key: Counter(fields.pop(key)) for key in ("outcomes", "oracles")}
    return name, Tally(**fields, **counters)


def child(family: Family, first: int, count: int, folder: Path) -> None:
    """What such a process does: it prints its tally."""
    warnings.simplefilter("error")  # numpy's words about damaged numbers are no answer
    run_cases(family, range(first, first + 1), folder / "case", folder / "at")  # imports come with the first use
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + LIMIT_BYTES, used + LIMIT_BYTES))
    print(json.dumps(vars(run_cases(family, range(first, first + count), folder / "case", folder / "at"))))


def show(family: Family, number: int, folder: Path) -> int:
    """One case, its files left in a folder."""
    case = make_case(family, number, folder)
    result, fault = outcome(case)
    print(f"edits    {' + '.join(case.edits)}\noracle   {case.oracle} {case.words}\noutcome  {result} {fault}")
    print(f"files    {folder}: {', '.join(sorted(str(path.relative_to(folder)) for path in folder.rglob('*')))}")
    return int(result in FAULTY)


def run_structures(arguments: Sequence[str]) -> int:
    """Structural edits whose meaning is known, to every reader: none may change a number without a word.

        python benchmarks/fuzz_structures.py [--cases 40000] [--part clouds] [--format pcd]
        python benchmarks/fuzz_structures.py --format pcd --number 17

    A model is written well-formed by a writer of the benchmark's own, and one or two edits are made whose meaning the
    format's documentation or docs/checks.md says: columns dropped, added or of another type, other units, orders of
    bytes, headers that disagree. Exit status 1 where a result differs from the model without a word (silent), a good
    file is refused (overrefused), anything but a FarfieldError came out or 1 GB was not enough (foreign), or 2 s of
    processor time were not.
    """
    parser = part_parser(run_structures.__doc__)
    parser.add_argument("--cases", type=int, default=CASES)
    parser.add_argument("--part", nargs="+", help="modules: clouds for _structures_clouds.py")
    parser.add_argument("--format", nargs="+", help="families")
    parser.add_argument("--number", type=int, help="one case of one family; its files stay")
    parser.add_argument("--first", type=int, default=0, help="number of the first case of each family")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "farfield-structures")
    options = parser.parse_args(arguments)
    chosen = [family for name, family in families(options.part).items() if name in (options.format or [name])]
    if not chosen:
        raise SystemExit(f"--format: expected {', '.join(families(options.part))}")
    if options.number is not None:
        raise SystemExit(show(chosen[0], options.number, options.work))  # no table, so that none is kept
    if "--child" in sys.argv:
        child(chosen[0], options.first, options.cases, options.work)
        return 0
    chunks = [
        (name, options.first + start, min(AT_ONCE, count - start))
        for name, count in counts(chosen, options.cases).items()
        for start in range(0, count, AT_ONCE)
    ]
    tallies = {family.name: Tally() for family in chosen}
    print(f"{'format':24}{'cases':>7}" + "".join(f"{column:>12}" for column in COLUMNS) + f"{'slowest':>12}{'peak':>9}")
    with ThreadPoolExecutor(options.workers) as pool:
        for name, tally in pool.map(partial(in_process, []), chunks):
            tallies[name].add(tally)
            if tallies[name].cases == counts(chosen, options.cases)[name]:
                print(row(name, tallies[name]), flush=True)
    whole = Tally()
    for tally in tallies.values():
        whole.add(tally)
    print(row("all", whole))
    oracles = ", ".join(f"{count} {oracle}" for oracle, count in whole.oracles.most_common())
    print(f"\nwhat had to come out: {oracles}")
    print("peak: memory of the whole process, interpreter and libraries included")
    print("\n".join(["", *whole.faults]) if whole.faults else "no faults")
    return int(any(whole.outcomes[kind] for kind in FAULTY))


def row(name: str, tally: Tally) -> str:
    """One line of the table."""
    figures = "".join(f"{tally.outcomes[column]:12}" for column in COLUMNS)
    return f"{name:24}{tally.cases:7}{figures}{tally.slowest_s * 1e3:9.1f} ms{tally.peak_bytes / 2**20:6.0f} MB"


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__, {"structures": Part(run_structures, "--cases 60 --format xyz 'npy rows' stamps", exact=True)}
        )
    )
