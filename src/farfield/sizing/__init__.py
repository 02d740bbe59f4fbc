"""What this machine does in a second, and what a whole data set takes on many: hours, dollars, terabytes, bottlenecks.

rates = measure_rates(minutes=2)   # every bulk verb and every detector that ships, on simulated frames
plan = plan_work(parse_workload("35000-frames-kradar"), rates, Fleet(machines=4, disk_mb_s=500))
"""

from farfield.sizing.planning import Fleet, PlannedWork, ResourcePlan, plan_work
from farfield.sizing.rates import MachineRates, MeasuredRate, read_rates
from farfield.sizing.workloads import DATASET_SIZES, DatasetSize, Workload, parse_workload

__all__ = [
    "DATASET_SIZES",
    "DatasetSize",
    "Fleet",
    "MachineRates",
    "MeasuredRate",
    "PlannedWork",
    "ResourcePlan",
    "Workload",
    "parse_workload",
    "plan_work",
    "read_rates",
]
