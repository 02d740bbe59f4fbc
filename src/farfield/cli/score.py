"""``farfield score``: score the files of any detector, without a model."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from farfield.cli._words import OUTPUT, deprecated, parse_options, write_json

if TYPE_CHECKING:
    from farfield.metrics import Detections, Protocol

_FLAGS = ("range_bins_m", "epsilons", "region", "label", "label_version", "bootstrap", "iou", "least_track_score")


def run(
    predictions: tyro.conf.Positional[Path],
    labels: tyro.conf.Positional[Path],
    *,
    protocol: Annotated[
        str, tyro.conf.arg(metavar="{dds,nuscenes,kitti,kradar,kradar-compat:VARIANT,tracking,nuscenes-tracking}")
    ] = "dds",
    format: Literal["boxes-csv", "kitti", "kitti-tracking", "nuscenes"] = "boxes-csv",
    label: str | None = None,
    range_bins_m: str | None = None,
    epsilons: str = "",
    epsilon: str = "",
    region: str | None = None,
    iou: float | None = None,
    least_track_score: float | None = None,
    conditions: str | None = None,
    label_version: str | None = None,
    reference: str = "",
    options: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE ...")] = (),
    replicates: int = 200,
    seed: int = 0,
    json: Path | None = None,
) -> int:
    """Score the boxes of any detector against annotated boxes, without a model.

    examples:
      farfield score predictions.csv labels.csv --protocol dds --json scores.json
      farfield score predictions.csv K-Radar --protocol kradar
      farfield score detections/ label/ --protocol nuscenes --format kitti-tracking --label Car
      farfield score results/data label_2 --protocol kitti --format kitti --label Car
      farfield score tracks/ label/ --protocol tracking --format kitti-tracking --label Car --iou 0.25
      farfield score predictions.csv labels.csv --protocol kradar --conditions K-Radar --label-version v2.1
      farfield score predictions.csv labels.csv --protocol kradar-compat:revised_as_shipped@0.3 --label-version v2.0
      farfield score predictions.csv labels.csv --range-bins-m 0,50,100 --options ap=area distance=bev

    Exit status 1 where nothing was scored: no frame with predicted and annotated boxes, or no annotated box counts.

    boxes-csv has the columns sequence (may be absent), frame, label, x, y, z, l, w, h, yaw_rad, score (empty for
    labels), and perhaps reference, the sensor in whose coordinates the boxes stand. Predictions of kitti-tracking are
    KITTI tracking text or 15 comma-separated columns.

    Args:
        predictions: File, or folder of files, of predicted boxes.
        labels: File, or folder of files of equal stems, of annotated boxes; or a data set's folder, whose annotation is
            then seen in the coordinates of the predictions.
        protocol: dds (DDS and wDDS of Cirrus), nuscenes (AP, translation, scale, orientation), kitti (AP R11, R40),
            kradar (AP3D and AP_BEV, R40), or kradar-compat:VARIANT, as K-Radar's kit computes it: old_as_shipped,
            old_yaw_fixed, revised_as_shipped, revised_yaw_fixed, each also with @0.3, @0.5, @0.7 as score cut;
            rtnh_narrow, rtnh_wide, lidar_wide, asf_narrow, asf_wide; tracking
            (MOTA, sAMOTA, HOTA, identity F1 of tracks in 3D), nuscenes-tracking (AMOTA, AMOTP). A protocol of an
            installed package by its name.
        format: Format of both.
        label: The class that is scored; without it every class is, each for itself, the most annotated one first.
        range_bins_m: Edges of the range bins; without it the protocol's own: 0,70,150,250, for kradar 0,20,40,60,80.
        epsilons: Values of epsilon in wDDS' omega = exp(epsilon d), where 0 is DDS; for dds
            0,0.003,0.006,0.009 unless given, for nuscenes 0.
        epsilon: The old name of epsilons.
        region: window: x 0..250, |y| <= 50 and the outermost bin edges; range: the outermost bin edges; none: all.
            Without it: window for dds on boxes-csv, none otherwise. For kradar: wide (without it), narrow, none or
            six bounds x,x,y,y,z,z in the radar's frame.
        iou: For tracking: the overlap that a match needs at least; 0.25 unless given.
        least_track_score: For tracking: tracks whose mean score is lower are left out.
        conditions: For kradar: a CSV with the columns sequence, road, time, weather; a K-Radar tree with its
            description.txt files; or the word published for the table of K-Radar's 58 sequences.
        label_version: For kradar: the annotation's version, which stands beside the result.
        reference: Coordinates of boxes whose files do not name them (column reference), such as radar.
        options: Further settings of the protocol, such as ap=area distance=bev relabel=truck:vehicle,bus:vehicle, for
            kradar boxes_in=os2-64 classes=vehicle,pedestrian score_cut=0.3.
        replicates: Bootstrap replicates of the 95 % intervals; 0 for none.
        seed: Seed of the bootstrap.
        json: Write the result as JSON into this file; - prints it instead of the tables.
    """
    from farfield.evaluation import read_detections
    from farfield.metrics import PROTOCOLS, Bootstrap
    from farfield.metrics.options import numbers

    chosen = PROTOCOLS[protocol]
    given: dict[str, Any] = parse_options(chosen, options, _FLAGS)
    if "bootstrap" in chosen.options():
        given["bootstrap"] = Bootstrap(replicates=replicates, seed=seed)
    if range_bins_m is not None:
        given["range_bins_m"] = numbers(range_bins_m, "--range-bins-m")
    epsilons = deprecated("--epsilon", epsilon, "--epsilons", epsilons)
    if epsilons:
        given["epsilons"] = numbers(epsilons, "--epsilons")
    if region is not None:
        given["region"] = region
    elif format != "boxes-csv" and chosen.default("region") == "window":
        given["region"] = "none"  # KITTI's ranges are a camera's
    given |= {n: v for n, v in {"iou": iou, "least_track_score": least_track_score}.items() if v is not None}
    if label_version is not None:
        given["label_version"] = label_version
    found = replace(
        read_detections(predictions, labels, format=format, reference=reference),
        detector=predictions.name,
        data=labels.name,
    )
    if conditions is not None:
        found = _with_conditions(found, chosen, conditions)
    results = found.score_each(chosen, label=label, **given)
    notes = list(dict.fromkeys(note for result in results for note in result.notes))
    results = [replace(result, notes=()) for result in results]
    if json is not None:
        tree = {**results[0].to_json(), "notes": notes}
        if len(results) > 1:
            tree["labels"] = {result.label: result.to_json() for result in results}
        write_json(json, tree)
    if json != OUTPUT:
        print("".join(f"note: {note}\n" for note in notes), end="")
        print("\n\n".join(map(str, results)) + (f"\n\nwritten: {json}" if json is not None else ""))
    if not found.paired:
        print(
            "exit status 1: no frame has both predicted and annotated boxes",
            file=sys.stderr if json == OUTPUT else sys.stdout,
        )
    return int(not found.paired or not any(result.known for result in results))


def _with_conditions(found: "Detections", protocol: "Protocol", source: str) -> "Detections":
    """Detections with weather, road and time by frame, and a note on the sequences without."""
    from farfield.errors import ConfigError
    from farfield.metrics import PROTOCOLS
    from farfield.metrics.kradar.conditions import read_conditions

    if "conditions" not in protocol.uses:
        usable = [name for name in PROTOCOLS.names() if not PROTOCOLS.broken(name)]
        able = [name for name in usable if "conditions" in PROTOCOLS[name].uses]
        raise ConfigError(f"--conditions: only {' and '.join(able)} score by condition, not {protocol}")
    known = read_conditions(source, found.annotations)
    missing = sorted({key[0] for key in found.annotations if key not in known})
    note = f"no conditions for sequences {', '.join(missing[:8])}: their frames count in the whole alone"
    return replace(found, conditions=known, notes=(*found.notes, *([note] if missing else [])))
