"""Open Sweeps: how well the two passes of their annotation agree, and what the shipped detectors score on them."""

import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from _report import Part, part_parser, run_parts

from farfield.api import detect, load_detector
from farfield.datasets.folder import read_boxes
from farfield.datasets.open_sweeps import PASSES, ROOT, OpenSweeps
from farfield.detectors.info import describe
from farfield.evaluation.leakage import seen_in_training
from farfield.frame import Boxes
from farfield.geometry.boxes import wrap_angle_rad
from farfield.geometry.iou import pairwise_iou
from farfield.metrics.centre.objects import object_intervals
from farfield.metrics.centre.open_sweeps import OpenSweepsSettings

DETECTORS = (
    "pointpillars-cirrus-sim",
    "voxelnet-cirrus-sim",
    "second-cirrus-sim",
    "sparsecentre-cirrus-sim",
    "pointrcnn-cirrus-sim",
)
RANGES_M = ((0.0, 15.0), (15.0, 30.0), (30.0, 70.0), (0.0, 70.0))
GROUPS = {"vehicles": ("vehicle", "large_vehicle"), "people, bicycles": ("pedestrian", "bicycle")}
MATCH_M = 2.0


def matches(first: Boxes, second: Boxes) -> np.ndarray:
    """Pairs of boxes nearest to each other and at most 2 m apart: rows of the one, rows of the other."""
    if not len(first) or not len(second):
        return np.zeros((0, 2), dtype=int)
    apart_m = np.linalg.norm(first.centre_m[:, None, :2] - second.centre_m[None, :, :2], axis=2)
    nearest = apart_m.argmin(axis=1)
    mutual = apart_m.argmin(axis=0)[nearest] == np.arange(len(first))
    rows = np.flatnonzero(mutual & (apart_m.min(axis=1) <= MATCH_M))
    return np.column_stack([rows, nearest[rows]])


def run_agreement(arguments: Sequence[str]) -> None:
    """Share of boxes that both passes have, and how far apart these are, by class and range.

    python benchmarks/open_sweeps.py agreement

    A share is 2 m / (a + b): m boxes of one class in both passes, a and b in each. Yaw differences are those of the
    axes (0 to 90 degrees); reversed says how often the headings are opposite. People have no heading here.
    """
    part_parser(run_agreement.__doc__).parse_args(arguments)
    print(
        "                            first second  both  share   BEV IoU         centre (m)    yaw (deg)     reversed"
    )
    print("                                                        median  10 %    median 90 %   median  90 %")
    for group, labels in GROUPS.items():
        for low_m, high_m in RANGES_M:
            counts, rows = np.zeros(2, dtype=int), []
            for sweep in OpenSweeps().sweeps:
                passes = [read_boxes(ROOT / "labels" / name / f"{sweep.name}.json") for name in PASSES]
                first, second = (boxes[np.isin(boxes.label, labels)] for boxes in passes)
                inside = [(boxes.range_m >= low_m) & (boxes.range_m < high_m) for boxes in (first, second)]
                counts += [int(mask.sum()) for mask in inside]
                pairs = matches(first, second)
                pairs = pairs[inside[0][pairs[:, 0]]] if len(pairs) else pairs
                overlap = pairwise_iou(first, second, kind="bev") if len(pairs) else np.zeros((0, 0))
                for one, other in pairs:
                    apart_m = np.linalg.norm(first.centre_m[one, :2] - second.centre_m[other, :2])
                    turn = abs(float(wrap_angle_rad(first.yaw_rad[one] - second.yaw_rad[other])))
                    axis_deg = np.rad2deg(min(turn, np.pi - turn))
                    rows.append((overlap[one, other], apart_m, axis_deg, turn > np.pi / 2))
            table = np.array(rows, dtype=float).reshape(-1, 4)
            share = 2 * len(table) / max(int(counts.sum()), 1)
            line = (
                f" {group:<17}{low_m:3.0f}-{high_m:<3.0f} m {counts[0]:6d}{counts[1]:7d}{len(table):6d}   {share:.2f}"
            )
            if len(table):
                iou, centre, yaw = (np.percentile(table[:, column], (50, 10, 90)) for column in range(3))
                line += f"    {iou[0]:.2f}   {iou[1]:.2f}    {centre[0]:.2f}   {centre[2]:.2f}"
                line += f"    {yaw[0]:5.1f}  {yaw[2]:5.1f}   {table[:, 3].mean():.2f}" if group == "vehicles" else ""
            print(line)


def run_scores(arguments: Sequence[str]) -> None:
    """AP of vehicles within 2 m and 70 m, of five points and more, by place, with intervals over drawn objects.

    python benchmarks/open_sweeps.py scores [--detectors NAME_OR_RUN ...] [--only PLACE]

    The interval is that of these places: three of them are too few to be drawn.
    """
    parser = part_parser(run_scores.__doc__)
    parser.add_argument("--detectors", nargs="+", default=list(DETECTORS))
    parser.add_argument("--only", help="of the places")
    options = parser.parse_args(arguments)
    data = OpenSweeps() if options.only is None else OpenSweeps().split(options.only)
    parts = {"all": data, **{place: data.split(place) for place in dict.fromkeys(data.sequences)}}
    print(
        " detector                  place   sweeps  objects   AP    [95 % of objects]  0-30   30-70   seen in training"
    )
    for name in options.detectors:
        detector = load_detector(name)
        everywhere, provenance = detect(detector, data), describe(detector).provenance
        for place, part in parts.items():
            keys = set(part.keys)
            boxes = {key: one for key, one in everywhere.boxes.items() if key in keys}
            annotations = {key: one for key, one in everywhere.annotations.items() if key in keys}
            detections = replace(everywhere, boxes=boxes, annotations=annotations)
            result = detections.score("open-sweeps")
            objects = object_intervals(detections.boxes, detections.annotated, OpenSweepsSettings())
            interval = objects.intervals.get("ap/2.0")
            shown = "" if interval is None else f"[{interval[0]:.3f}, {interval[1]:.3f}]"
            bins = [result.ranges[edges]["ap/2.0"] for edges in ("0-30", "30-70")]
            by_range = "  ".join("    -" if value is None else f"{value:.3f}" for value in bins)
            print(
                f" {name:<26}{place:<10}{len(part) // 2:4d}{result.counts['annotated']:9d}   "
                f"{result.figures['ap/2.0']:.3f} {shown:<18}{by_range}   {seen_in_training(part, provenance, keys)[0]}",
                flush=True,
            )


if __name__ == "__main__":
    scores = Part(run_scores, "--detectors pointpillars-cirrus-sim --only avenue")
    sys.exit(run_parts(__doc__, {"agreement": Part(run_agreement), "scores": scores}))
