"""How much each open choice of DDS moves the score, on real detections.

usage: python benchmarks/dds_choices.py [DETECTIONS LABELS] [--format kitti-tracking] [--label Car]
"""

import argparse
from pathlib import Path

from _report import SHARED_REAL, header

from farfield.metrics import Bootstrap, DdsSettings, evaluate_dds
from farfield.metrics.box_files import read

TRACKING = SHARED_REAL / "kitti_tracking"
CHOICES = (
    {},
    {"distance": "bev"},
    {"omega_range": "pred"},
    {"match": "nearest_normalised"},
    {"ap": "interp101"},
    {"ap": "area"},
    {"ap": "voc"},
    {"aiou": "scale"},
    {"aiou": "bev"},
    {"aiou_threshold_m": 0.5},
    {"aiou_threshold_m": 4.0},
    {"aiou_threshold_m": "all"},
    {"aiou_mean": "tp_mean"},
    {"range_assign": "match_then_bin"},
    {"ties": "later_first"},
    {"scores": "raw"},
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("detections", type=Path, nargs="?", default=TRACKING / "detections_pointrcnn_car")
    parser.add_argument("labels", type=Path, nargs="?", default=TRACKING / "label")
    parser.add_argument("--format", default="kitti-tracking")
    parser.add_argument("--label", default="Car")
    options = parser.parse_args()
    print(header(), "\n", sep="")
    found = read(options.detections, options.labels, format=options.format)
    base = None
    print(f"{'choice':<36} {'DDS':>7} {'0.006':>7} {'50 m +':>7}   change of each")
    for choice in CHOICES:
        settings = DdsSettings(
            label=options.label,
            region="none",
            range_bins_m=(0.0, 25.0, 50.0, 1e9),
            epsilons=(0.0, 0.006),
            bootstrap=Bootstrap(replicates=0),
            **choice,
        )
        result = evaluate_dds(found.boxes, found.annotated, settings)
        far = list(result.ranges.values())[-1]
        row = (result.figures["dds/0/dds"], result.figures["dds/0.006/dds"], far["dds/0/dds"])
        base = base or row
        name = ", ".join(f"{key}={value}" for key, value in choice.items()) or "default"
        change = "  ".join(f"{value - start:+.4f}" for value, start in zip(row, base, strict=True))
        print(f"{name:<36} " + " ".join(f"{value:7.4f}" for value in row) + f"   {change}", flush=True)


if __name__ == "__main__":
    main()
