"""The formulas that turn rates into hours, dollars and terabytes for many machines, and name what binds.

All of them stand here. Of a work of F frames on N machines, of which each has C cores, one GPU and a disk of D bytes a
second, and reads over a network of W bytes a second:

    efficiency of C workers side by side    e(C) = 1 / (1 + a (C - 1)),   a = 1 / e(2) - 1, where e(2) is measured
    processor, hours                        F s / (N C e(C)) / 3600,      s: seconds a frame of one core
    GPU, hours                              F s / N / 3600,               s: seconds a frame of one GPU
    network, hours                          F b_in / (N W) / 3600
    disk, hours                             F (b_in / D_read + b_out / D_write) / N / 3600; b_in not, where a network
                                            brings it
    hours                                   the largest of them: that resource is the bottleneck
    dollars                                 hours N p_hour + T M p_TB-month + T_in p_TB-egress
                                            T: terabytes read and written, M: months for which they are stored

All stages are taken to overlap, and machines not to disturb each other. b_in and b_out are bytes a frame, s is the
median of ``farfield bench``. Where frames of another data set were measured, s and b_out grow with the points or
pixels of what is read, as the part that grows most; where published files are packed and simulated ones are not, s
grows by the time that unpacking takes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from farfield.errors import ConfigError
from farfield.sizing.rates import MachineRates, MeasuredRate
from farfield.sizing.workloads import DATASET_SIZES, Workload

HOUR_S, MB, TB = 3600.0, 1e6, 1e12
RESOURCES = ("processor", "GPU", "disk", "network")
EVERYTHING = "reading every file once"
"""The row of the whole data set, whatever is done with it."""


@dataclass(frozen=True, kw_only=True)
class Fleet:
    """The machines that do a work, each like the one whose rates are known, and what they cost.

    Args:
        machines: How many.
        cores: Cores of each (default: as many as the measured machine has).
        network_mb_s: Megabytes a second at which each reads data that stand elsewhere; None: on its own disk.
        disk_mb_s: Megabytes a second of each one's disk (default: as measured).
        price_per_hour: Dollars an hour of a machine.
        price_per_tb_month: Dollars for storing a terabyte for a month.
        months: For how long what is read and written is stored.
        price_per_tb_egress: Dollars for taking a terabyte out of where it is stored.

    Raises:
        ConfigError: If a number is not above 0 (prices and months: below 0), or none.
    """

    machines: int = 1
    cores: int | None = None
    network_mb_s: float | None = None
    disk_mb_s: float | None = None
    price_per_hour: float | None = None
    price_per_tb_month: float | None = None
    months: float = 1.0
    price_per_tb_egress: float | None = None

    def __post_init__(self) -> None:
        least = {"machines": 1.0, "cores": 1.0, "network_mb_s": 1e-3, "disk_mb_s": 1e-3}
        for name, value in vars(self).items():
            low = least.get(name, 0.0)
            if value is not None and not low <= value <= 1e9:
                raise ConfigError(f"--{name.replace('_', '-')}: expected a number from {low:g} to 1e9, got {value:g}")

    @property
    def priced(self) -> bool:
        """Whether any price is known."""
        return any(
            price is not None for price in (self.price_per_hour, self.price_per_tb_month, self.price_per_tb_egress)
        )


@dataclass(frozen=True, kw_only=True)
class ResourcePlan:
    """What one verb or detector takes for a workload.

    Args:
        name: Its name.
        precision: Number type of the network; empty where there is none.
        frames_of: The data set whose simulated frames were measured; empty where nothing was.
        scaled: Whether the times were scaled from frames of another data set.
        core_hours: Hours of one core; 0 on a GPU.
        hours_by: Hours of each resource that it needs, as if that were alone: processor or GPU, disk, network.
        tb_in: Terabytes read.
        tb_out: Terabytes written.
        dollars: None where no price is known.
    """

    name: str
    precision: str = ""
    frames_of: str = ""
    scaled: bool = False
    core_hours: float = 0.0
    hours_by: Mapping[str, float]
    tb_in: float = 0.0
    tb_out: float = 0.0
    dollars: float | None = None

    @property
    def hours(self) -> float:
        """How long it takes: as long as the resource that takes longest."""
        return max(self.hours_by.values(), default=0.0)

    @property
    def bottleneck(self) -> str:
        """The resource that takes longest."""
        return max(self.hours_by, key=lambda name: self.hours_by[name]) if self.hours_by else ""


@dataclass(frozen=True, kw_only=True)
class PlannedWork:
    """A workload on a fleet, a row a verb or detector.

    Args:
        workload: What is done.
        fleet: Who does it.
        cores: Cores of each machine.
        efficiency: Of that many workers side by side.
        disk_mb_s: Reading and writing rates that were taken; empty where none is known.
        rows: What each takes.
        notes: What was assumed or left out.
    """

    workload: Workload
    fleet: Fleet
    cores: int
    efficiency: float
    disk_mb_s: tuple[float, float] | tuple[()]
    rows: Sequence[ResourcePlan]
    notes: Sequence[str] = field(default_factory=tuple)


def parallel_efficiency(workers: int, two_at_once: float) -> float:
    """What many workers do side by side, as a share of as many times what one does alone.

    Args:
        workers: How many.
        two_at_once: The same of two, as measured.
    """
    slowing = 1 / two_at_once - 1
    return 1 / (1 + slowing * (workers - 1))


def computing_hours(frames: float, seconds: float, workers: float, efficiency: float = 1.0) -> float:
    """Hours of so many workers for frames of so many seconds."""
    return frames * seconds / (workers * efficiency) / HOUR_S


def moving_hours(size_bytes: float, mb_s: float, machines: int) -> float:
    """Hours for moving bytes at so many megabytes a second of each machine."""
    return size_bytes / (mb_s * MB * machines) / HOUR_S


def dollars_of(fleet: Fleet, hours: float, tb_in: float, tb_out: float) -> float | None:
    """What it costs; prices that are not known count nothing, None where none is."""
    if not fleet.priced:
        return None
    machines = hours * fleet.machines * (fleet.price_per_hour or 0.0)
    stored = (tb_in + tb_out) * fleet.months * (fleet.price_per_tb_month or 0.0)
    return machines + stored + tb_in * (fleet.price_per_tb_egress or 0.0)


def plan_work(workload: Workload, rates: MachineRates, fleet: Fleet = Fleet()) -> PlannedWork:
    """Turn rates into what each verb and detector takes for a workload.

    Of a verb that was measured on frames of several data sets, the workload's own count. Detectors count where they
    were measured on frames of the workload's data set: others learnt from another sensor.

    Args:
        workload: What is to be done.
        rates: Of one machine.
        fleet: Machines like it, and their prices.

    Returns:
        A row for each, after one for the whole data set where its size is published.
    """
    cores = fleet.cores or rates.cores
    efficiency = 1.0 if cores == 1 else parallel_efficiency(cores, rates.two_at_once or 1.0)
    disk: tuple[float, float] | tuple[()] = ()
    if fleet.disk_mb_s is not None:
        disk = (fleet.disk_mb_s, fleet.disk_mb_s)
    elif rates.disk_read_mb_s is not None and rates.disk_write_mb_s is not None:
        disk = (rates.disk_read_mb_s, rates.disk_write_mb_s)
    size, rows, left_out = workload.size, list[ResourcePlan](), list[str]()
    if size.whole_frame_bytes:
        whole = workload.frames * size.whole_frame_bytes
        moved = _moving(fleet, disk, whole, 0.0)
        dollars = dollars_of(fleet, max(moved.values(), default=0.0), whole / TB, 0.0)
        rows.append(ResourcePlan(name=EVERYTHING, hours_by=moved, tb_in=whole / TB, dollars=dollars))
    for rate in _of_workload(rates, workload):
        needed = _needed(rate, rates, workload)
        if needed is None:
            left_out.append(rate.name)
            continue
        seconds, bytes_in, bytes_out, scaled = needed
        total_in, total_out = workload.frames * bytes_in, workload.frames * bytes_out
        if rate.on == "GPU":
            computing = {"GPU": computing_hours(workload.frames, seconds, fleet.machines)}
        else:
            workers = fleet.machines * cores
            computing = {"processor": computing_hours(workload.frames, seconds, workers, efficiency)}
        hours_by = computing | _moving(fleet, disk, total_in, total_out)
        rows.append(
            ResourcePlan(
                name=rate.name,
                precision=rate.precision,
                frames_of=rate.frames_of,
                scaled=scaled,
                core_hours=0.0 if rate.on == "GPU" else workload.frames * seconds / HOUR_S,
                hours_by=hours_by,
                tb_in=total_in / TB,
                tb_out=total_out / TB,
                dollars=dollars_of(fleet, max(hours_by.values()), total_in / TB, total_out / TB),
            )
        )
    return PlannedWork(
        workload=workload,
        fleet=fleet,
        cores=cores,
        efficiency=efficiency,
        disk_mb_s=disk,
        rows=rows,
        notes=tuple(_notes(workload, rates, fleet, disk, cores, rows, left_out)),
    )


def _of_workload(rates: MachineRates, workload: Workload) -> list[MeasuredRate]:
    """The rates that count for a workload: its own data set's, and those of verbs that another's frames alone have."""
    own = {(rate.name, rate.precision) for rate in rates.rates if rate.frames_of == workload.dataset}
    return [
        rate
        for rate in rates.rates
        if rate.frames_of == workload.dataset or (rate.kind == "verb" and (rate.name, rate.precision) not in own)
    ]


def _needed(rate: MeasuredRate, rates: MachineRates, workload: Workload) -> tuple[float, float, float, bool] | None:
    """Seconds, bytes read and bytes written a frame of the workload, and whether they were scaled.

    None where the data set has not what the verb reads.
    """
    size, measured = workload.size, rates.sizes.get(rate.frames_of, {})
    own = rate.frames_of == workload.dataset
    if not own and any(part in ("cells", "tesseract") for part in rate.reads) and workload.dataset == "cirrus":
        return None
    simulated = next((parts for name, parts in rates.sizes.items() if name == workload.dataset), {})
    bytes_in = sum(size.frame_bytes.get(part, simulated.get(part, measured.get(part, 0.0))) for part in rate.reads)
    scale = 1.0
    if not own:
        here, there = size.items, DATASET_SIZES[rate.frames_of].items
        scale = max((here[part] / there[part] for part in rate.reads if part in here and part in there), default=1.0)
    seconds = rate.median_s * scale
    if rates.inflate_mb_s is not None:
        seconds += sum(size.packed_bytes.get(part, 0.0) for part in rate.reads) / (rates.inflate_mb_s * MB)
    return seconds, bytes_in, rate.bytes_out * scale, not own


def _moving(fleet: Fleet, disk: tuple[float, float] | tuple[()], total_in: float, total_out: float) -> dict[str, float]:
    """Hours of network and disk for bytes that are read and written, as far as their rates are known."""
    hours = {}
    if fleet.network_mb_s is not None:
        hours["network"] = moving_hours(total_in, fleet.network_mb_s, fleet.machines)
    if disk:
        read, write = disk
        from_disk = 0.0 if fleet.network_mb_s is not None else moving_hours(total_in, read, fleet.machines)
        hours["disk"] = from_disk + moving_hours(total_out, write, fleet.machines)
    return hours


def _notes(
    workload: Workload,
    rates: MachineRates,
    fleet: Fleet,
    disk: tuple[float, float] | tuple[()],
    cores: int,
    rows: Sequence[ResourcePlan],
    left_out: Sequence[str],
) -> list[str]:
    """What the plan takes for granted or leaves out, a sentence each."""
    notes = []
    if not workload.named:
        notes.append(f"no data set is named: frames are {workload.size.title}'s, {workload.size.rate_hz:g} a second")
    if not disk:
        notes.append("no rate of the disk is known, and it is left out: --disk-mb-s")
    if cores > 1 and rates.two_at_once is None:
        notes.append("how much workers slow each other down was not measured: they are taken not to")
    elif cores > 2 and rates.two_at_once is not None:
        notes.append(f"workers side by side were measured for two alone; {cores} are extrapolated from that")
    if workload.size.packed_bytes and rates.inflate_mb_s is None:
        notes.append(f"{workload.size.title}'s packed tensors are taken as unpacked: inflating was not measured")
    if any(row.scaled for row in rows):
        notes.append("~: measured on frames of another data set, scaled by the points or pixels that are read")
    if left_out:
        notes.append(f"{workload.size.title} has no 4D radar: without {', '.join(left_out)}")
    if rates.load > 0.5 * rates.cores:
        notes.append(
            f"the machine was busy as its rates were measured (load {rates.load:.1f} on {rates.cores} cores): they are "
            "too low, and all hours too many"
        )
    if not fleet.priced:
        notes.append("no price is known: --price-per-hour, --price-per-tb-month")
    return notes
