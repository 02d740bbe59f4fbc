"""``farfield bench``: this machine's rates, and what a whole data set would take on many such."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from farfield.cli._output import bar, check_outputs, console, write_json

if TYPE_CHECKING:
    from farfield.sizing import Fleet, MachineRates, PlannedWork, Workload

_MINUTES = 2.0


def run(
    *,
    workload: Annotated[str, tyro.conf.arg(name="for", metavar="WORKLOAD")] = "",
    rates: Path | None = None,
    only: tuple[str, ...] = (),
    minutes: float = _MINUTES,
    device: str | None = None,
    machines: int = 1,
    cores: int | None = None,
    network_mb_s: float | None = None,
    disk_mb_s: float | None = None,
    price_per_hour: float | None = None,
    price_per_tb_month: float | None = None,
    months: float | None = None,
    price_per_tb_egress: float | None = None,
    json: Path | None = None,
) -> int:
    """Measure this machine's rates, and say what a whole data set takes: hours, dollars, terabytes, the bottleneck.

    examples:
      farfield bench
      farfield bench --json rates.json
      farfield bench --for 35000-frames-kradar --rates rates.json --machines 4 --price-per-hour 0.4
      farfield bench --for 40h-cirrus --rates rates.json --network-mb-s 100 --price-per-tb-month 20 --months 12
      farfield bench --only detectors --device cuda:0
      farfield bench --for kradar --only radar-store --disk-mb-s 200

    Every verb that works in bulk and every detector whose weights ship (fp32 and bf16) works on frames that are
    simulated on the spot, by one process with one thread as one of many workers does; median of the repeats that fit
    into the time, and how far they spread. What a command does once (imports, pages) is no part of a rate. Let the
    machine do nothing else meanwhile.

    A WORKLOAD is AMOUNT-frames-DATASET, AMOUNTh-DATASET (hours of driving at the data set's published rate), or DATASET
    for all of it; kradar or cirrus, whose frames also count where none is named. Sizes are published ones, prices are
    yours. All machines are taken to be like the measured one. docs/sizing.md has the formulas and what is assumed.

    Args:
        workload: Plan this, such as 35000-frames-kradar, 40h-cirrus, 1000h or kradar.
        rates: Plan with the rates of this file, of an earlier --json, instead of measuring.
        only: Measure these alone: verbs, detectors, or parts of their names.
        minutes: How long measuring may take; each has an equal share of it, and is measured once however long that
            takes.
        device: Where detectors run, such as cpu or cuda:0; auto, the default, takes a GPU if there is one.
        machines: Machines that share the work.
        cores: Cores of each (default: those of the measured machine).
        network_mb_s: Data stand elsewhere, and each machine reads so many megabytes a second (default: they stand on
            its disk).
        disk_mb_s: Megabytes a second of each machine's disk (default: as measured where temporary files are).
        price_per_hour: Dollars an hour of a machine.
        price_per_tb_month: Dollars a month for storing a terabyte of what is read and written.
        months: For how many months that is stored (default: 1).
        price_per_tb_egress: Dollars for taking a terabyte out of where it is stored.
        json: Write the rates, and the plan, into this file; - prints them.
    """
    from dataclasses import asdict

    from farfield.errors import ConfigError
    from farfield.sizing import Fleet, parse_workload, plan_work, read_rates

    check_outputs((rates,), files={"--json": json})
    planned = parse_workload(workload) if workload else None
    fleet = Fleet(
        machines=machines,
        cores=cores,
        network_mb_s=network_mb_s,
        disk_mb_s=disk_mb_s,
        price_per_hour=price_per_hour,
        price_per_tb_month=price_per_tb_month,
        months=1.0 if months is None else months,
        price_per_tb_egress=price_per_tb_egress,
    )
    if planned is None:
        _refuse_without_workload(fleet, rates, months)
    measuring = {"--only": bool(only), "--device": device is not None, "--minutes": minutes != _MINUTES}
    flag = next((flag for flag, changed in measuring.items() if changed), "")
    if rates is not None and flag:
        raise ConfigError(f"{flag}: expected to measure, got --rates, whose rates are taken instead")
    measured = _measured(only, minutes, device) if rates is None else read_rates(rates)
    if rates is None:
        _print_rates(measured)
    tree: dict[str, Any] = {"rates": measured.model_dump(mode="json")}
    if planned is not None:
        plan = plan_work(planned, measured, fleet)
        if rates is None:
            print()
        _print_plan(plan, measured)
        rows = [asdict(row) | {"hours": row.hours, "bottleneck": row.bottleneck} for row in plan.rows]
        tree["plan"] = asdict(plan) | {"rows": rows}
    if json is not None:
        write_json(json, tree)
    return 0


def _refuse_without_workload(fleet: "Fleet", rates: Path | None, months: float | None) -> None:
    """Refuse flags that only a plan takes."""
    from farfield.errors import ConfigError

    plain = {"machines": 1, "months": 1.0}
    flags = {name: value for name, value in vars(fleet).items() if value != plain.get(name)}
    flags |= {name: value for name, value in (("rates", rates), ("months", months)) if value is not None}
    if flags:
        flag = next(iter(flags)).replace("_", "-")
        raise ConfigError(f"--{flag}: expected --for WORKLOAD too, whose plan it changes")


def _measured(only: Sequence[str], minutes: float, device: str | None) -> "MachineRates":
    from farfield.sizing.measuring import measure_rates

    progress = partial(bar, what="measuring", transient=True)
    return measure_rates(minutes=minutes, only=only, device=device, progress=progress)


def _print_rates(rates: "MachineRates") -> None:
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for number, column in enumerate(
        ("verb or detector", "frames of", "number type", "frames a s", "spread", "MB a s", "kB written", "repeats")
    ):
        table.add_column(column, justify="right" if number > 2 else "left", no_wrap=number == 0)
    for rate in rates.rates:
        bytes_in = rates.bytes_in(rate)
        table.add_row(
            rate.name,
            rate.frames_of,
            rate.precision + (" on GPU" if rate.on == "GPU" else ""),
            _figure(1 / rate.median_s),
            f"{rate.spread:.0%}" if len(rate.seconds) > 1 else "-",
            _figure(bytes_in / 1e6 / rate.median_s) if bytes_in else "-",
            _figure(rate.bytes_out / 1e3) if rate.bytes_out else "-",
            str(len(rate.seconds)),
        )
    console(width=140).print(table)
    print("\nby one process with one thread; spread: slowest less fastest repeat, of the median; kB written: a frame")
    if rates.two_at_once is not None:
        print(f"two workers side by side do {2 * rates.two_at_once:.2f} times what one does")
    read, write = ("-" if value is None else f"{value:,.0f}" for value in (rates.disk_read_mb_s, rates.disk_write_mb_s))
    print(f"disk of the temporary files: {read} MB a s read, {write} written")
    if rates.inflate_mb_s is not None:
        print(f"inflating: {rates.inflate_mb_s:,.0f} MB a s")
    for name, why in rates.left_out.items():
        print(f"left out: {name}: {why}")
    print(_machine(rates))


def _machine(rates: "MachineRates") -> str:
    """The machine, the commit and the date of rates, in a line; with a warning where it was busy."""
    parts = [rates.processor, f"{rates.cores} {'core' if rates.cores == 1 else 'cores'}"]
    parts += [f"{rates.memory_bytes / 2**30:.0f} GiB"] if rates.memory_bytes else []
    parts += [rates.gpu] if rates.gpu else []
    source = f"farfield {rates.version}" + (f", commit {rates.commit}" if rates.commit else "")
    busy = rates.load > rates.cores / 2
    warning = f"\nwarning: the machine was busy (load {rates.load:.1f}): an idle one is faster" if busy else ""
    return f"{', '.join(parts)}; {source}; {rates.date}{warning}"


def _figure(value: float) -> str:
    """Three digits, without an exponent."""
    if value and value < 0.001:
        return "< 0.001"
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def _print_plan(plan: "PlannedWork", rates: "MachineRates") -> None:
    from rich.table import Table

    from farfield.sizing.planning import RESOURCES

    workload, fleet = plan.workload, plan.fleet
    print(_heading(workload, plan))
    resources = [name for name in RESOURCES if any(name in row.hours_by for row in plan.rows)]
    columns = ["verb or detector", "number type", "core hours", *(f"{name} h" for name in resources), "hours"]
    columns += ["bottleneck", "TB read", "TB written"] + ["dollars"] * fleet.priced
    table = Table(box=None, pad_edge=False)
    for number, column in enumerate(columns):
        table.add_column(column, justify="left" if number < 2 else "right", no_wrap=number == 0)
    for row in plan.rows:
        hours = [_figure(row.hours_by[name]) if name in row.hours_by else "-" for name in resources]
        table.add_row(
            f"{row.name}{' ~' * row.scaled}",
            row.precision,
            _figure(row.core_hours) if row.core_hours else "-",
            *hours,
            _figure(row.hours) if row.hours_by else "-",
            row.bottleneck or "not known",
            _figure(row.tb_in),
            _figure(row.tb_out),
            *(["-" if row.dollars is None else f"{row.dollars:,.2f}"] * fleet.priced),
        )
    console(width=160).print(table)
    print()
    for note in plan.notes:
        print(f"note: {note}")
    print(f"rates of {_machine(rates)}")


def _heading(workload: "Workload", plan: "PlannedWork") -> str:
    """The workload and who does it."""
    from farfield.vocabulary.counts import count_of

    fleet = plan.fleet
    frames = count_of(workload.frames, "frame", spec=",")
    lines = [f"{frames} of {workload.size.title}: {_figure(workload.driving_h)} h of driving"]
    machines = f"on {count_of(fleet.machines, 'machine')} of {count_of(plan.cores, 'core')}"
    lines[0] += f"; {machines}, which side by side do {plan.efficiency:.0%} of what each does alone"
    moving = []
    if fleet.network_mb_s is not None:
        moving.append(f"data come over {fleet.network_mb_s:,.4g} MB a s of network a machine")
    if plan.disk_mb_s:
        own = "as stated" if fleet.disk_mb_s is not None else "as measured"
        read, write = plan.disk_mb_s
        moving.append(f"disks of {read:,.4g} MB a s read, {write:,.4g} written, {own}")
    return "\n".join([*lines, *(["; ".join(moving)] if moving else [])])
