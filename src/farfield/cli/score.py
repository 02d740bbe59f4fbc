"""``farfield score``: score the files of any detector, without a model."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from farfield.cli._flags import AS_THEY_ARE, OWN_SCORING, Reading, Scoring
from farfield.cli._output import OUTPUT, check_outputs, write_json

if TYPE_CHECKING:
    pass


def run(
    predictions: tyro.conf.Positional[Path],
    labels: tyro.conf.Positional[Path],
    *,
    protocol: Annotated[
        str,
        tyro.conf.arg(
            metavar="{dds,nuscenes,nuscenes-detection,argoverse2,waymo,waymo-let,kitti,kradar,kradar-compat:VARIANT,"
            "tracking,nuscenes-tracking}"
        ),
    ] = "dds",
    format: Literal[
        "boxes-csv",
        "kitti",
        "kitti-tracking",
        "nuscenes",
        "argoverse2",
        "waymo",
        "kradar",
        "openpcdet",
        "mmdetection3d",
    ] = "boxes-csv",
    axes: Literal["exchanged", "exchanged-turned", "camera", "lidar"] | None = None,
    class_names: Annotated[str, tyro.conf.arg(metavar="NAME,NAME,...")] = "",
    scoring: Scoring = OWN_SCORING,
    conditions: str | None = None,
    reference: str = "",
    reading: Reading = AS_THEY_ARE,
    json: Path | None = None,
) -> int:
    """Score the boxes of any detector against annotated boxes, without a model.

    examples:
      farfield score predictions.csv labels.csv --protocol dds --json scores.json
      farfield score predictions.csv K-Radar --protocol kradar
      farfield score detections/ label/ --protocol nuscenes --format kitti-tracking --label Car
      farfield score results/data label_2 --protocol kitti --format kitti --label Car
      farfield score detections.feather argoverse2/val --protocol argoverse2 --format argoverse2
      farfield score detections.feather labels.feather --protocol argoverse2 --format argoverse2 --range-bins-m 0,150
      farfield score predictions.bin ground_truths.bin --protocol waymo --format waymo
      farfield score predictions.bin ground_truths.bin --protocol waymo-let --format waymo
      farfield score test_kitti/epoch_10_total/0.3 test_kitti/epoch_10_total/0.3 --protocol kradar --format kradar
      farfield score output/eval/final_result kitti --protocol kitti --format openpcdet --label Car
      farfield score outputs/preds kitti --format mmdetection3d --class-names Pedestrian,Cyclist,Car
      farfield score tracks/ label/ --protocol tracking --format kitti-tracking --label Car --iou 0.25
      farfield score predictions.csv labels.csv --protocol kradar --conditions K-Radar --label-version v2.1
      farfield score predictions.csv labels.csv --protocol kradar-compat:revised_as_shipped@0.3 --label-version v2.0
      farfield score predictions.csv labels.csv --range-bins-m 0,50,100 --options ap=area distance=bev

    Exit status 1 where nothing was scored: no frame with predicted and annotated boxes, no class that both have, or no
    annotated box counts.

    boxes-csv has the columns sequence (may be absent), frame, label, x, y, z, l, w, h, yaw_rad, score (empty for
    labels), and optionally reference, the sensor in whose coordinates the boxes are. Predictions of kitti-tracking are
    KITTI tracking text or 15 comma-separated columns.

    Args:
        predictions: File, or folder of files, of predicted boxes.
        labels: File, or folder of files of equal stems, of annotated boxes; or a data set's folder, whose annotation is
            then seen in the coordinates of the predictions.
        protocol: dds (DDS and wDDS of Cirrus), nuscenes (AP, translation, scale, orientation), nuscenes-detection (its
            task whole: ten classes, five errors, NDS), argoverse2 (CDS, AP, ATE, ASE, AOE of all categories), waymo
            (AP and APH at levels 1 and 2), waymo-let (the same tolerant of errors along the line of sight), kitti (AP
            in space, from above and in the image, AOS; R11, R40), kradar (AP3D and AP_BEV, R40), or
            kradar-compat:VARIANT, as K-Radar's kit computes it: old_as_shipped, old_yaw_fixed, revised_as_shipped,
            revised_yaw_fixed, each also with @0.3, @0.5, @0.7 as score cut; rtnh_narrow, rtnh_wide, lidar_wide,
            asf_narrow, asf_wide; tracking (MOTA, sAMOTA, HOTA, identity F1 of tracks in 3D), nuscenes-tracking
            (AMOTA, AMOTP). A protocol of an
            installed package by its name.
        format: Format of both; argoverse2 and waymo are their leaderboards' submissions, and labels in the same form;
            kradar the folders of K-Radar's kit, predictions, labels and conditions in one; openpcdet its KITTI texts;
            mmdetection3d its inferencer's JSON or its KITTI texts.
        axes: Of --format kradar: exchanged (x y z hold left, up, ahead, and rotation_y the yaw, as the kit ships),
            exchanged-turned (the same with yaw - 90 degrees), camera (KITTI's own) or lidar (x y z ahead, left, up)
            (default: decided from the boxes and printed; refused where they do not decide it).
        class_names: Of --format mmdetection3d: the model's classes in the order of their numbers, where its files do
            not name them.
        scoring: How the boxes are scored; without a label every class is, each for itself, the most annotated one
            first.
        conditions: For kradar: a CSV with the columns sequence, road, time, weather; a K-Radar tree with its
            description.txt files; or the word published for the table of K-Radar's 58 sequences.
        reference: Coordinates of boxes whose files do not name them (column reference), such as radar.
        reading: How the files of a data set in the place of the labels are read.
        json: Write the result as JSON into this file; - prints it instead of the tables.
    """
    from farfield.evaluation import read_detections, with_conditions
    from farfield.metrics import PROTOCOLS
    from farfield.metrics.result import tables_of

    check_outputs((predictions, labels, conditions, *reading.paths), files={"--json": json})
    chosen = PROTOCOLS[protocol]
    settings = scoring.settings(chosen)
    if format != "boxes-csv" and chosen.default("region") == "window":
        settings.setdefault("region", "none")  # KITTI's ranges are a camera's
    detections = replace(
        read_detections(
            predictions,
            labels,
            format=format,
            reference=reference,
            axes=axes or "",
            class_names=tuple(name.strip() for name in class_names.split(",") if name.strip()),
            **reading.options,
        ),
        detector=predictions.name,
        data=labels.name,
    )
    if conditions is not None:
        detections = with_conditions(detections, chosen, conditions)
    results = detections.score_each(chosen, label=scoring.label, **settings)
    notes = list(dict.fromkeys(note for result in results for note in result.notes))
    results = [replace(result, notes=()) for result in results]
    if json is not None:
        tree = {**results[0].to_json(), "notes": notes}
        if len(results) > 1:
            tree["labels"] = {result.label: result.to_json() for result in results}
        write_json(json, tree)
    if json != OUTPUT:
        print("".join(f"note: {note}\n" for note in notes), end="")
        print(tables_of(results) + (f"\n\nwritten: {json}" if json is not None else ""))
    fault = ""
    if not detections.paired:
        fault = "no frame has both predicted and annotated boxes"
    elif not detections.shared_classes(results[0].settings.get("relabel") or {}):
        fault = "no predicted box is of a class that is annotated (--options relabel=PREDICTED:ANNOTATED says which is)"
    if fault:
        print(f"exit status 1: {fault}", file=sys.stderr if json == OUTPUT else sys.stdout)
    return int(bool(fault) or not any(result.known for result in results))
