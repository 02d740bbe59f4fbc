"""What a plan says, against sums worked out by hand from round numbers."""

import math

import pytest
from made_rates import machine, rate

from farfield.datasets.kradar.store import PUBLISHED_BYTES
from farfield.errors import ConfigError
from farfield.sizing import Fleet, PlannedWork, ResourcePlan, parse_workload, plan_work
from farfield.sizing.planning import (
    EVERYTHING,
    computing_hours,
    dollars_of,
    moving_hours,
    parallel_efficiency,
)

SECOND = 0.36
"""A frame: 100,000 frames are ten core hours."""


def row_of(plan: PlannedWork, name: str) -> ResourcePlan:
    (row,) = (row for row in plan.rows if row.name == name)
    return row


def test_many_workers_slow_each_other_as_two_do() -> None:
    """0.8 of two: each further worker costs a quarter, 1 / (1 + 0.25 (n - 1))."""
    assert parallel_efficiency(1, 0.8) == 1
    assert parallel_efficiency(2, 0.8) == pytest.approx(0.8)
    assert parallel_efficiency(4, 0.8) == pytest.approx(1 / 1.75)
    assert parallel_efficiency(64, 1.0) == 1


def test_hours_of_computing_and_of_moving() -> None:
    assert computing_hours(100_000, SECOND, workers=4) == pytest.approx(2.5)
    assert computing_hours(100_000, SECOND, workers=4, efficiency=0.5) == pytest.approx(5.0)
    assert moving_hours(16e12, 200, 1) == pytest.approx(22.2222, abs=1e-4)  # reference: 22 h on one disk
    assert moving_hours(16e12, 1000, 1) == pytest.approx(4.4444, abs=1e-4)
    assert moving_hours(16e12, 200, 4) == pytest.approx(22.2222 / 4, abs=1e-4)


def test_dollars_are_machines_storage_and_egress() -> None:
    fleet = Fleet(machines=3, price_per_hour=2, price_per_tb_month=20, months=12, price_per_tb_egress=90)
    assert dollars_of(fleet, 10.0, 16.0, 1.0) == pytest.approx(10 * 3 * 2 + 17 * 12 * 20 + 16 * 90)
    assert dollars_of(Fleet(price_per_hour=2), 10.0, 16.0, 1.0) == pytest.approx(20)
    assert dollars_of(Fleet(), 10.0, 16.0, 1.0) is None


def test_all_of_k_radar_is_read_no_faster_than_the_disk_gives_it() -> None:
    """35,000 frames, 16 TB at 200 MB a second, decoding at 0.25 s a tensor: the disk binds by a factor of nine."""
    rates = machine(rate("convert --to radar-store", 0.25, reads=["tesseract"], bytes_out=329e3), cores=1)
    plan = plan_work(parse_workload("35000-frames-kradar"), rates, Fleet(disk_mb_s=200))
    whole = row_of(plan, EVERYTHING)
    assert (whole.tb_in, whole.hours, whole.bottleneck) == (
        pytest.approx(16.0),
        pytest.approx(22.2222, abs=1e-4),
        "disk",
    )
    store = row_of(plan, "convert --to radar-store")
    assert store.core_hours == pytest.approx(35_000 * 0.25 / 3600)
    assert store.tb_in == pytest.approx(35_000 * 360e9 / 1195 / 1e12)
    assert store.tb_out == pytest.approx(0.0115, abs=1e-4)
    assert whole.hours / store.hours_by["processor"] == pytest.approx(9.1, abs=0.1)
    assert store.bottleneck == "disk"
    assert store.hours == store.hours_by["disk"] == pytest.approx((store.tb_in + store.tb_out) * 1e12 / 200e6 / 3600)


def test_packed_tensors_take_the_time_of_inflating_them_too() -> None:
    work = rate("convert --to radar-store", 0.25, reads=["tesseract"])
    plan = plan_work(parse_workload("36000-frames-kradar"), machine(work, inflate_mb_s=259.457024), Fleet())
    assert row_of(plan, work.name).core_hours == pytest.approx(36_000 * (0.25 + 2.0) / 3600)
    assert not [note for note in plan.notes if "packed" in note]
    unpacked = plan_work(parse_workload("36000-frames-kradar"), machine(work), Fleet())
    assert row_of(unpacked, work.name).core_hours == pytest.approx(36_000 * 0.25 / 3600)
    assert [note for note in unpacked.notes if "packed tensors are taken as unpacked" in note]


def test_each_resource_binds_where_it_is_the_slowest() -> None:
    """100,000 frames of 2 MB: 10 core hours, 0.2 TB."""
    work = rate("convert --to cirrus", SECOND, frames_of="cirrus", reads=["cloud"], bytes_out=1e6)
    workload = parse_workload("100_000-frames-cirrus")
    alone = plan_work(workload, machine(work, cores=1), Fleet(disk_mb_s=1000)).rows[0]
    assert alone.hours_by == pytest.approx({"processor": 10.0, "disk": 0.3e12 / 1e9 / 3600})
    assert alone.bottleneck == "processor"
    crowd = plan_work(workload, machine(work), Fleet(machines=10, disk_mb_s=1)).rows[0]
    assert crowd.hours_by == pytest.approx({"processor": 10 * 1.75 / 40, "disk": 0.3e12 / 1e6 / 3600 / 10})
    assert (crowd.bottleneck, crowd.core_hours) == ("disk", pytest.approx(10.0))
    # over a network the disk takes what is written alone
    remote = plan_work(workload, machine(work), Fleet(machines=10, network_mb_s=1, disk_mb_s=1)).rows[0]
    assert remote.hours_by["network"] == pytest.approx(0.2e12 / 1e6 / 3600 / 10)
    assert remote.hours_by["disk"] == pytest.approx(0.1e12 / 1e6 / 3600 / 10)
    assert remote.bottleneck == "network"


def test_measured_disks_count_unless_others_are_named() -> None:
    work = rate("convert --to cirrus", SECOND, frames_of="cirrus", reads=["cloud"], bytes_out=1e6)
    workload, rates = parse_workload("cirrus"), machine(work, disk_read_mb_s=500, disk_write_mb_s=100)
    hours = plan_work(workload, rates).rows[0].hours_by["disk"]
    assert hours == pytest.approx(6285 * (2e6 / 500e6 + 1e6 / 100e6) / 3600)
    named = plan_work(workload, rates, Fleet(disk_mb_s=50)).rows[0].hours_by["disk"]
    assert named == pytest.approx(6285 * 3e6 / 50e6 / 3600)
    unknown = plan_work(workload, machine(work))
    assert "disk" not in unknown.rows[0].hours_by
    assert [note for note in unknown.notes if "--disk-mb-s" in note]


def test_a_gpu_is_one_a_machine_and_takes_no_core_hours() -> None:
    work = rate("second-cirrus-sim", 0.036, frames_of="cirrus", kind="detector", precision="bf16", on="GPU")
    row = plan_work(parse_workload("1000000-frames-cirrus"), machine(work), Fleet(machines=2)).rows[0]
    assert row.hours_by == pytest.approx({"GPU": 5.0})
    assert (row.bottleneck, row.core_hours) == ("GPU", 0.0)


def test_verbs_measured_on_other_frames_grow_with_points_and_pixels() -> None:
    """An os2-64 has 131,072 points where a Gaussian cloud has 38,255; detectors of another sensor are left out."""
    odometry = rate("odometry", 0.1, frames_of="cirrus", reads=["cloud", "cloud"], bytes_out=100.0)
    other = rate("second-cirrus-sim", 0.1, frames_of="cirrus", kind="detector", precision="fp32", reads=["cloud"])
    plan = plan_work(parse_workload("kradar"), machine(odometry, other))
    row = row_of(plan, "odometry")
    assert row.scaled
    assert row.core_hours == pytest.approx(34_994 * 0.1 * 131_072 / 38_255 / 3600)
    assert row.tb_in == pytest.approx(2 * PUBLISHED_BYTES["os2-64"] / 1e12)  # bytes are the published ones, twice
    assert [row.name for row in plan.rows] == [EVERYTHING, "odometry"]
    assert [note for note in plan.notes if note.startswith("~")]


def test_the_part_that_grows_most_decides() -> None:
    """Clouds have 3.4 times the points, pictures 1.5 times the pixels."""
    work = rate("convert --to kitti", 0.1, frames_of="cirrus", reads=["cloud", "camera", "labels"], bytes_out=1e6)
    row = row_of(plan_work(parse_workload("36000-frames-kradar"), machine(work)), work.name)
    scale = 131_072 / 38_255
    assert row.core_hours == pytest.approx(scale)
    assert row.tb_out == pytest.approx(0.036 * scale)


def test_of_frames_of_two_data_sets_the_workload_s_own_count() -> None:
    both = [rate("stats", 0.1, frames_of="cirrus", reads=["clouds"]), rate("stats", 0.5, reads=["cloud"])]
    for dataset, seconds in (("cirrus", 0.1), ("kradar", 0.5)):
        plan = plan_work(parse_workload(f"3600-frames-{dataset}"), machine(*both))
        assert row_of(plan, "stats").core_hours == pytest.approx(seconds)
        assert not row_of(plan, "stats").scaled


def test_cirrus_has_no_tensors() -> None:
    rates = machine(rate("convert --to radar-store", 0.25, reads=["tesseract"]), rate("simulate", 1.0))
    plan = plan_work(parse_workload("cirrus"), rates)
    assert [row.name for row in plan.rows] == ["simulate"]
    assert [note for note in plan.notes if note.endswith("without convert --to radar-store")]


def test_rates_of_a_busy_machine_are_no_secret() -> None:
    notes = plan_work(parse_workload("cirrus"), machine(rate("simulate", 1.0), load=9.0)).notes
    assert [note for note in notes if "busy" in note]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("machines", 0),
        ("cores", 0),
        ("disk_mb_s", 0.0),
        ("network_mb_s", -1.0),
        ("price_per_hour", -1.0),
        ("months", -1.0),
        ("price_per_tb_month", math.inf),
        ("price_per_tb_egress", math.nan),
    ],
)
def test_a_number_that_is_none_is_refused(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"--{name.replace('_', '-')}: expected a number from"):
        Fleet(**{name: value})
