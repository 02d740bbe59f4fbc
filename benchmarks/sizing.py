"""What whole data sets take: plans beside sums worked out by hand; this machine's rates and its plan of K-Radar."""

from collections.abc import Sequence
from typing import Any

from _report import Part, load_printed, part_parser, run_parts

from farfield.sizing import (
    Fleet,
    MachineRates,
    MeasuredRate,
    PlannedWork,
    ResourcePlan,
    Workload,
    parse_workload,
    plan_work,
)
from farfield.sizing.measuring import measure_rates

ALL_OF_KRADAR = "35000-frames-kradar"
RAW_S, PACKED_S = 0.250, 2.144  # scipy's loadmat of a tensor of doubles, unpacked and packed
TENSOR_BYTES, FILE_BYTES = 64 * 256 * 37 * 107 * 8, 360e9 / 1195
STORE_BYTES = 329e3
LIDAR_BYTES, DETECTOR_S = 2e6, 0.15
STORAGE, HOURLY = (
    20.0,
    0.5,
)  # dollars for a terabyte and month, and for an hour of a machine: examples, no prices of ours
EQUAL = 1e-3


def assumed(rates: Sequence[MeasuredRate], **fields: Any) -> MachineRates:
    """Rates of a machine of one core that nobody measured."""
    sizes = {"cirrus": {"cloud": LIDAR_BYTES}}
    stated = {"version": "0", "date": "assumed", "processor": "assumed", "cores": 1, "sizes": sizes} | fields
    return MachineRates(**stated, rates=tuple(rates))


def row(plan: PlannedWork, name: str) -> ResourcePlan:
    """The row of a name."""
    return next(row for row in plan.rows if row.name.startswith(name))


def run_hand(arguments: Sequence[str]) -> int:
    """Plans from assumed rates, beside the same sums written out; exit status 1 if one differs by a thousandth.

        python benchmarks/sizing.py hand

    Nothing is measured. Prices are examples.
    """
    part_parser(run_hand.__doc__).parse_args(arguments)
    store = MeasuredRate(
        name="store",
        kind="verb",
        frames_of="kradar",
        reads=("tesseract",),
        seconds=(RAW_S,),
        bytes_out=STORE_BYTES,
    )
    fleet = Fleet(disk_mb_s=200, price_per_tb_month=STORAGE, months=12)
    kradar = parse_workload(ALL_OF_KRADAR)
    slow, fast = (plan_work(kradar, assumed([store]), Fleet(disk_mb_s=rate)) for rate in (200, 1000))
    four = plan_work(kradar, assumed([store]), Fleet(disk_mb_s=200, machines=4))
    packed = plan_work(kradar, assumed([store], inflate_mb_s=TENSOR_BYTES / 1e6 / (PACKED_S - RAW_S)))
    stored = plan_work(kradar, assumed([store]), fleet)
    computed = plan_work(kradar, assumed([store]), Fleet(disk_mb_s=200, price_per_hour=HOURLY))
    detector = MeasuredRate(
        name="detector", kind="detector", frames_of="cirrus", precision="fp32", reads=("cloud",), seconds=(DETECTOR_S,)
    )
    drives = parse_workload("1000h")
    driven = plan_work(drives, assumed([detector]), Fleet(disk_mb_s=200))
    day = plan_work(drives, assumed([detector]), Fleet(machines=63))
    whole = "reading"
    lines = [
        ("K-Radar, 35,000 frames: TB", 16e12 / 1e12, row(slow, whole).tb_in),
        ("  read once at 200 MB a s: h", 16e12 / 200e6 / 3600, row(slow, whole).hours),
        ("  read once at 1000 MB a s: h", 16e12 / 1e9 / 3600, row(fast, whole).hours),
        ("  read once by 4 machines at 200 MB a s: h", 16e12 / 800e6 / 3600, row(four, whole).hours),
        ("  decode unpacked doubles, 0.25 s: core h", 35_000 * RAW_S / 3600, row(slow, "store").core_hours),
        ("  decode packed doubles, 2.144 s: core h", 35_000 * PACKED_S / 3600, row(packed, "store").core_hours),
        ("  tesseracts alone: TB", 35_000 * FILE_BYTES / 1e12, row(slow, "store").tb_in),
        ("  their store: GB", 35_000 * STORE_BYTES / 1e9, row(slow, "store").tb_out * 1e12 / 1e9),
        ("  16 TB for a year at 20 dollars a TB month", 16 * 12 * STORAGE, row(stored, whole).dollars or 0.0),
        ("  reading at 0.5 dollars an hour", 16e12 / 200e6 / 3600 * HOURLY, row(computed, whole).dollars or 0.0),
        ("1,000 h at 10 Hz: million frames", 1000 * 3600 * 10 / 1e6, drives.frames / 1e6),
        ("  LiDAR of 2 MB a frame: TB", 36e6 * LIDAR_BYTES / 1e12, row(driven, "detector").tb_in),
        ("  detector of 0.15 s a frame: core h", 36e6 * DETECTOR_S / 3600, row(driven, "detector").core_hours),
        ("  the same by 63 cores: h", 36e6 * DETECTOR_S / 63 / 3600, row(day, "detector").hours),
    ]
    print(f"{'':<46}{'by hand':>12}{'plan':>12}")
    for what, by_hand, planned in lines:
        print(f"{what:<46}{by_hand:>12,.4g}{planned:>12,.4g}")
    reading, decoding = row(slow, whole).hours, row(slow, "store").core_hours
    print(f"\nreading takes {reading / decoding:.1f} times as long as decoding unpacked doubles on one core")
    held = all(abs(planned - by_hand) <= EQUAL * by_hand for _, by_hand, planned in lines)
    print("equal" if held else "DIFFERENT")
    return int(not held)


def run_machine(arguments: Sequence[str]) -> None:
    """This machine's rates, as farfield bench measures them, and its plan of all of K-Radar on a disk of 200 MB a s.

        python benchmarks/sizing.py machine [--minutes 2] [--only NAME ...] [--disk-mb-s 200]

    Let nothing else run meanwhile: the load before and after stands below.
    """
    parser = part_parser(run_machine.__doc__)
    parser.add_argument("--minutes", type=float, default=2.0)
    parser.add_argument("--only", nargs="+", default=[])
    parser.add_argument("--disk-mb-s", type=float, default=200.0)
    options = parser.parse_args(arguments)
    with load_printed():
        rates = measure_rates(minutes=options.minutes, only=options.only)
        print(f"{'measured':<28}{'frames of':<10}{'type':<6}{'frames a s':>11}{'spread':>8}{'MB a s':>9}{'repeats':>9}")
        for rate in rates.rates:
            figures = f"{1 / rate.median_s:>11.3g}{rate.spread:>8.0%}{rates.bytes_in(rate) / 1e6 / rate.median_s:>9.3g}"
            print(f"{rate.name:<28}{rate.frames_of:<10}{rate.precision:<6}{figures}{len(rate.seconds):>9}")
        for name, why in rates.left_out.items():
            print(f"left out: {name}: {why}")
        side = "-" if rates.two_at_once is None else f"{2 * rates.two_at_once:.2f}"
        print(f"two workers side by side: {side} times one; inflating: {rates.inflate_mb_s or 0:.0f} MB a s")
        _print_plan(parse_workload(ALL_OF_KRADAR), rates, options.disk_mb_s)


def _print_plan(workload: Workload, rates: MachineRates, disk_mb_s: float) -> None:
    plan = plan_work(workload, rates, Fleet(disk_mb_s=disk_mb_s))
    print(f"\n{workload.text} on this machine, {plan.cores} cores, a disk of {disk_mb_s:g} MB a s")
    print(
        f"{'':<30}{'type':<6}{'core h':>8}{'processor h':>13}{'disk h':>8}{'TB read':>9}{'TB written':>12}  bottleneck"
    )
    for row in plan.rows:
        hours = "".join(
            f"{row.hours_by.get(name, 0.0):>{width}.3g}" for name, width in (("processor", 13), ("disk", 8))
        )
        sizes = f"{row.tb_in:>9.3g}{row.tb_out:>12.3g}"
        name = f"{row.name}{' ~' * row.scaled}"
        print(f"{name:<30}{row.precision:<6}{row.core_hours:>8.3g}{hours}{sizes}  {row.bottleneck}")
    print("~: measured on frames of the Cirrus car, scaled by points or pixels")


if __name__ == "__main__":
    parts = {
        "hand": Part(run_hand, exact=True),
        "machine": Part(run_machine, "--minutes 0.01 --only boxes-csv"),
    }
    raise SystemExit(run_parts(__doc__, parts))
