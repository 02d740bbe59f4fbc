"""``farfield reproduce``."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, UseAppendAction

from farfield.cli._output import bar, check_outputs, console, would_write
from farfield.errors import ConfigError

if TYPE_CHECKING:
    from farfield.papers.claim_rows import ClaimRow, RecordedGrid


def run(
    paper: Positional[Literal["cirrus", "kradar"] | None] = None,
    *,
    budget: Literal["laptop", "desk", "workstation", "gpu", "table2"] = "laptop",
    minutes: float | None = None,
    plan: bool = False,
    page: bool = False,
    summary: bool = False,
    transfer: bool = False,
    seeds: tuple[int, ...] | None = None,
    data: Path | None = None,
    source: Path | None = None,
    workers: int = 0,
    engine: str = "local",
    address: str = "",
    device: Literal["auto", "cpu", "cuda"] = "auto",
    precision: Literal["auto", "fp32", "bf16"] | None = None,
    train_only: bool = False,
    out: Annotated[tuple[Path, ...], UseAppendAction] = (),
    dry_run: bool = False,
) -> int:
    """Put a paper's tables to the test: a declared grid of trainings, decisions on its claims, one page.

    examples:
      farfield reproduce cirrus --plan
      farfield reproduce cirrus
      farfield reproduce --summary
      farfield reproduce cirrus --budget workstation --plan
      farfield reproduce kradar --minutes 90
      farfield reproduce kradar --transfer --workers 2
      farfield reproduce cirrus --budget table2 --device cuda --workers 15 --train-only
      farfield reproduce cirrus --data /data/Cirrus --source /data/kitti --budget gpu

    First some steps of each kind of run are timed; the cost of the whole on this machine, and the claims that can be
    decided at this size, are printed. Then data are simulated, unless --data names real ones, and the runs are done
    seed by seed. The same command resumes at any time: finished runs are not repeated, an unfinished training
    continues. OUT holds report.html, reproduction.json with every figure and decision, plan.json, timing.json, data and
    runs.

    Args:
        paper: cirrus: Tables I to VI. kradar: the table by weather and Table 9. With --summary both unless one is
            named.
        budget: laptop: two cores, one to two hours. desk, workstation, gpu: see --plan. table2: Cirrus' Table II alone,
            15 trainings on a GPU in minutes.
        minutes: Lower the steps until it fits; refused where fewer than 200 would be left. Seeds and rows stay.
        plan: Only measure, and print what it would cost.
        page: Only write the page of the runs that are done, such as while others are at work.
        summary: Only print every claim in a row, as the finished folders runs/reproduce-*, or those that --out names,
            decided it at the largest size: the paper's figure, ours, the decision, its controls, what it took.
        transfer: Instead K-Radar's table of transfer between radar data sets (appendix G), simulated: from none, from
            the other radar, from the other side of the road, by share of the target's frames. OUT (default:
            runs/reproduce-kradar-transfer) holds report.html, transfer.txt, transfer.json, data, runs.
        seeds: With --transfer, only these seeds.
        data: The real data set; without one all is simulated.
        source: Real data of the other device for Table IV, such as KITTI (default: simulated).
        workers: Processes, one thread each, which share the GPU if there is one; 0 takes as many as there are cores.
        engine: Where the runs are done: local, ray, or an installed engine's name; costs are measured here.
        address: Ray's cluster: auto for the one that this machine is a node of, or HOST:PORT (default: a Ray of this
            machine alone, started for the command).
        device: What trains and detects; auto takes a GPU if there is one.
        precision: Number type of all trainings (default: the budget's). auto: bf16 where a GPU has it, else fp32.
        train_only: Simulate what runs learn from and train, and score nothing: the same command without it, here or
            where OUT was taken to without its data, scores. Needs no plan where the budget limits no minutes.
        out: Folder (default: runs/reproduce-PAPER-BUDGET). With --summary it may be given several times.
        dry_run: Say what would be written, and write nothing; what it costs is measured, by --plan.
    """
    if summary:
        if plan or page or transfer or train_only or minutes is not None or seeds is not None:
            raise ConfigError("--summary: expected without the flags of runs, which it does not make")
        return _summary(("cirrus", "kradar") if paper is None else (paper,), out)
    if paper is None:
        raise ConfigError("PAPER: expected cirrus or kradar; --summary alone takes both")
    if len(out) > 1:
        raise ConfigError(f"--out: expected one folder without --summary, got {len(out)}")
    own = out[0] if out else None
    from farfield.papers import Reproduction, described

    check_outputs((data, source), folders={"--out": own or Path("runs")})
    if transfer or seeds is not None:
        if train_only or device != "auto" or precision is not None:
            raise ConfigError("--train-only, --device, --precision: expected without --transfer and --seeds")
        folder = own or Path("runs") / "reproduce-kradar-transfer"
        where = {"workers": workers or 1, "engine": engine, "address": address}
        return _transfer(paper, folder, seeds, where, plan=plan, page=page, dry_run=dry_run)
    reproduction = Reproduction.of(
        paper,
        budget=budget,
        out=own or Path("runs") / f"reproduce-{paper}-{budget}",
        minutes=minutes,
        workers=workers,
        engine=engine,
        address=address,
        data=data,
        source=source,
        device=device,
        precision=precision or "",
        progress=_shown,
        report=partial(print, flush=True),
    )
    if dry_run:
        for line in reproduction.dry_run():
            print(line)
        would_write("data, runs, reproduction.json and report.html", reproduction.out)
        return 0
    if plan:
        for line in described(reproduction.outline()):
            print(line)
        return 0
    if train_only:
        left = reproduction.train()
        print(f"runs: {(reproduction.out / 'runs').resolve()}" + (f"; {len(left)} have no weights" if left else ""))
        return 0
    written = reproduction.run(page_only=page)
    print(f"summary: {(reproduction.out / 'reproduction.json').resolve()}\nreport: {written.resolve()}")
    return 0


def _shown(what: str) -> Callable[[Iterable[int]], Iterable[int]]:
    return partial(bar, what=what, transient=True)


def _summary(papers: Sequence[str], out: Sequence[Path]) -> int:
    """Every claim of the papers in a row, of the folders that were finished."""
    from farfield.papers.claim_rows import SUMMARY, claim_rows, counts_of, paper_of, read_grid
    from farfield.papers.claims import load
    from farfield.papers.grid import load_grid

    for folder in out:
        if not (folder / SUMMARY).is_file():
            raise ConfigError(f"--out {folder}: expected {SUMMARY}, which a finished farfield reproduce writes there")
    folders = out or sorted(path.parent for path in Path("runs").glob(f"reproduce-*/{SUMMARY}"))
    by_paper: dict[str, list[RecordedGrid]] = {name: [] for name in papers}
    for folder in folders:
        name = paper_of(folder)
        if name in by_paper:
            by_paper[name].append(read_grid(folder, load(name)))
    if not any(by_paper.values()):
        where = ", ".join(map(str, out)) or "runs/reproduce-*"
        runs = " or ".join(f"farfield reproduce {name}" for name in papers)
        raise ConfigError(
            f"--summary: expected a finished reproduction of {' or '.join(papers)} in {where}, found none. Run {runs}, "
            "or name its folder by --out; docs/claims.md has what was found before."
        )
    for name, decided in by_paper.items():
        rows = claim_rows(load(name), load_grid(name), decided)
        _print_claims(f"{name}: {counts_of(rows)}", rows)
    print(
        "ours: first row minus second, mean over seeds [95 % interval]; a control that holds excludes what it names\n"
        "power: how likely this size was to hold the claim, were the paper's difference the truth"
    )
    if any(one.simulated for decided in by_paper.values() for one in decided):
        print("simulated frames: figures stand for the simulation, of the paper's only the sign is compared")
    return 0


def _print_claims(title: str, rows: "Sequence[ClaimRow]") -> None:
    """A table fitted to the terminal."""
    from rich.table import Table

    screen = console(width=160)
    table = Table(title=title, title_justify="left", box=None, padding=(0, 2, 1, 0), expand=True)
    table.add_column("claim", ratio=5, overflow="fold")
    table.add_column("paper", width=6)
    table.add_column("ours, controls", ratio=8, overflow="fold")
    table.add_column("decision", width=14 if screen.width < 110 else 24, overflow="fold")
    table.add_column("size, to run it again", ratio=4, overflow="fold")
    for row in rows:
        ours = [*(row.ours() or ["-"]), *(f"control, {words}" for words in row.controls)]
        elsewhere = [f"{budget}: {verdict}" for budget, verdict in row.elsewhere]
        would = row.would_decide()
        decision = [row.decision, *elsewhere, *([f"would decide: {would}"] if would else [])]
        cells = (f"{row.claim.id} {row.claim.words}", row.published, "\n".join(ours), "\n".join(decision))
        table.add_row(*cells, f"{row.size}\n{row.again}" if row.grid else "-")
    screen.print(table)


def _transfer(
    paper: str,
    out: Path,
    seeds: tuple[int, ...] | None,
    where: dict[str, Any],
    *,
    plan: bool,
    page: bool,
    dry_run: bool,
) -> int:
    """K-Radar's table of transfer."""
    from farfield.papers.transfer import TransferExperiment, load_table

    if paper != "kradar":
        raise ConfigError("--transfer and --seeds: expected the paper kradar, whose appendix G they put to the test")
    transfer = TransferExperiment(
        table=load_table(),
        out=out,
        seeds=seeds,
        **where,
        progress=_shown,
        report=partial(print, flush=True),
    )
    if plan:
        for line in transfer.outline():
            print(line)
        return 0
    if dry_run:
        for line in transfer.dry_run():
            print(line)
        would_write("data, runs, a page, transfer.txt and transfer.json", out)
        return 0
    if not page:
        transfer.run()
    for line in transfer.write():
        print(line)
    print(f"report: {(out / 'report.html').resolve()}")
    return 0
