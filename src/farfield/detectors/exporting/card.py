"""The card of an exported detector: what it reads and gives, what it learnt from, its scores, what runs where."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from farfield.detectors.catalogue import figures
from farfield.detectors.exporting.parity import CloudParity
from farfield.detectors.exporting.plans import BOUNDARIES
from farfield.detectors.onnx.record import OnnxRecord


def card_text(record: OnnxRecord, provenance: Mapping[str, Any], parity: Sequence[CloudParity], *, size: int) -> str:
    """The card in Markdown.

    Args:
        record: What the file says of itself.
        provenance: The record of the training.
        parity: How far file and network agree, by cloud.
        size: Bytes of the file.
    """
    experiment = provenance.get("experiment") or {}
    data = experiment.get("data") or {}
    learnt = [
        f"Experiment: {experiment.get('name') or 'not known'}.",
        f"Family: {provenance.get('family') or 'not stated'}.",
    ]
    learnt.append(f"Data: `{json.dumps(data, sort_keys=True)[:600]}`." if data else "Data: not known.")
    columns = "\n".join(f"| {name} | {unit} |" for name, unit in record.units.items())
    rows = "\n".join(
        f"| {row.cloud} | {row.points:,} | {row.largest:.1e} | {row.boxes} | {row.same:.2%} |" for row in parity
    )
    return f"""# {record.name}

{record.network} ({record.detector}) of Farfield {record.farfield}, exported to ONNX opset {record.opset}, fp32,
{size / 1e6:.1f} MB. SHA-256 of the weights: `{record.weights_sha256}`.
Made with {", ".join(f"{name} {version}" for name, version in record.made_with.items())}.

## Reads

One cloud, rows of the columns below; {record.axes}. Coordinates: {
        record.reference or "those of the sensor that it learnt from"
    }.
It looks {record.reach_m:g} m ahead.

| column | unit |
|---|---|
{columns}

## Gives

Boxes as {record.boxes}. Classes: {", ".join(record.classes)}. Scores from {record.score_threshold:g}, overlaps up to
{record.nms_iou:g} (bird's-eye IoU), at most {record.max_boxes} boxes. Scores are {
        "calibrated by range and points" if record.score_bands else "not calibrated"
    }.

## What runs where

{BOUNDARIES[record.detector]} Suppression and calibration of scores: numpy.

## Learnt from

{" ".join(learnt)}

## Scores

{_scores(record.name)}

## Licence

Of the weights: {record.licence or "not stated by who exported them; ask them before you ship"}.

## Parity with PyTorch

Largest difference of an output over its largest number, with graph optimisation on and off; share of the boxes that
agree within 1 mm and 1e-4 rad.

| cloud | points | difference | boxes | the same |
|---|---|---|---|---|
{rows}
"""


def _scores(name: str) -> str:
    """What is recorded of shipped weights; nothing is measured here."""
    for record in figures()["detectors"].values():
        if record.get("weights") == name:
            scores = record.get("shipped", {}).get("scores") or record.get("scores", {})
            text = json.dumps(scores, sort_keys=True)[:1500]
            return f"DDS by cloud, range and epsilon on the frozen split of simulated frames: `{text}`."
    return "None recorded: `farfield evaluate FILE.onnx DATA` scores it on labelled data, with intervals."
