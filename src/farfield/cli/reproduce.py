"""``farfield reproduce``."""

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from farfield.cli._output import bar, check_outputs, would_write
from farfield.errors import ConfigError


def run(
    paper: Positional[Literal["cirrus", "kradar"]],
    *,
    budget: Literal["laptop", "desk", "workstation", "gpu", "table2"] = "laptop",
    minutes: float | None = None,
    plan: bool = False,
    page: bool = False,
    transfer: bool = False,
    seeds: tuple[int, ...] | None = None,
    data: Path | None = None,
    source: Path | None = None,
    workers: int = 0,
    device: Literal["auto", "cpu", "cuda"] = "auto",
    precision: Literal["auto", "fp32", "bf16"] | None = None,
    train_only: bool = False,
    out: Path | None = None,
    dry_run: bool = False,
) -> int:
    """Put a paper's tables to the test: a declared grid of trainings, decisions on its claims, one page.

    examples:
      farfield reproduce cirrus --plan
      farfield reproduce cirrus
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
        paper: cirrus: Tables I to VI. kradar: the table by weather and Table 9.
        budget: laptop: two cores, one to two hours. desk, workstation, gpu: see --plan. table2: Cirrus' Table II alone,
            15 trainings on a GPU in minutes.
        minutes: Lower the steps until it fits; refused where fewer than 200 would be left. Seeds and rows stay.
        plan: Only measure, and print what it would cost.
        page: Only write the page of the runs that are done, such as while others are at work.
        transfer: Instead K-Radar's table of transfer between radar data sets (appendix G), simulated: from none, from
            the other radar, from the other side of the road, by share of the target's frames. OUT (default:
            runs/reproduce-kradar-transfer) holds report.html, transfer.txt, transfer.json, data, runs.
        seeds: With --transfer, only these seeds.
        data: The real data set; without one all is simulated.
        source: Real data of the other device for Table IV, such as KITTI (default: simulated).
        workers: Processes, one thread each, which share the GPU if there is one; 0 takes as many as there are cores.
        device: What trains and detects; auto takes a GPU if there is one.
        precision: Number type of all trainings (default: the budget's). auto: bf16 where a GPU has it, else fp32.
        train_only: Simulate what runs learn from and train, and score nothing: the same command without it, here or
            where OUT was taken to without its data, scores. Needs no plan where the budget limits no minutes.
        out: Folder (default: runs/reproduce-PAPER-BUDGET).
        dry_run: Say what would be written, and write nothing; what it costs is measured, by --plan.
    """
    from farfield.papers import Reproduction, described

    check_outputs((data, source), folders={"--out": out or Path("runs")})
    if transfer or seeds is not None:
        if train_only or device != "auto" or precision is not None:
            raise ConfigError("--train-only, --device, --precision: expected without --transfer and --seeds")
        folder = out or Path("runs") / "reproduce-kradar-transfer"
        return _transfer(paper, folder, seeds, workers, plan=plan, page=page, dry_run=dry_run)
    reproduction = Reproduction.of(
        paper,
        budget=budget,
        out=out or Path("runs") / f"reproduce-{paper}-{budget}",
        minutes=minutes,
        workers=workers,
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


def _transfer(
    paper: str,
    out: Path,
    seeds: tuple[int, ...] | None,
    workers: int,
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
        workers=workers or 1,
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
