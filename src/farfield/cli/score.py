"""``farfield score``: score the files of any detector, without a model."""

import json as json_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

if TYPE_CHECKING:
    from farfield.metrics import Result
    from farfield.metrics.reading import ScoreInputs

_FLAGS = ("range_bins_m", "epsilons", "region", "label", "label_version", "bootstrap")
_LISTS = ("thresholds_m", "window_m", "ious", "origin_m")
_WHOLE = ("min_points", "max_boxes", "recall_points", "decimals")
_NUMBERS = ("min_overlap", "aiou_threshold_m", "azimuth_deg", "score_cut", "z_center")


def run(
    predictions: tyro.conf.Positional[Path],
    labels: tyro.conf.Positional[Path],
    *,
    protocol: Annotated[str, tyro.conf.arg(metavar="{dds,nuscenes,kitti,kradar,kradar-compat:VARIANT}")] = "dds",
    format: Literal["boxes-csv", "kitti", "kitti-tracking"] = "boxes-csv",
    label: str | None = None,
    range_bins_m: str | None = None,
    epsilon: str = "0,0.003,0.006,0.009",
    region: str | None = None,
    conditions: str | None = None,
    label_version: str | None = None,
    options: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE ...")] = (),
    replicates: int = 200,
    seed: int = 0,
    json: Path | None = None,
) -> int:
    """Score the boxes of any detector against annotated boxes, without a model.

    examples:
      farfield score predictions.csv labels.csv --protocol dds --json scores.json
      farfield score detections/ label/ --protocol nuscenes --format kitti-tracking --label Car
      farfield score results/data label_2 --protocol kitti --format kitti --label Car
      farfield score predictions.csv labels.csv --protocol kradar --conditions K-Radar --label-version v2.1
      farfield score predictions.csv labels.csv --protocol kradar-compat:revised_as_shipped@0.3 --label-version v2.0
      farfield score predictions.csv labels.csv --range-bins-m 0,50,100 --options ap=area distance=bev

    boxes-csv has the columns sequence (may be absent), frame, label, x, y, z, l, w, h, yaw_rad, score (empty for
    labels). Predictions of kitti-tracking are KITTI tracking text or 15 comma-separated columns.

    Args:
        predictions: File, or folder of files, of predicted boxes.
        labels: File, or folder of files of equal stems, of annotated boxes.
        protocol: dds (DDS and wDDS of Cirrus), nuscenes (AP, translation, scale, orientation), kitti (AP R11, R40),
            kradar (AP3D and AP_BEV, R40), or kradar-compat:VARIANT, as K-Radar's kit computes it: old_as_shipped,
            old_yaw_fixed, revised_as_shipped, revised_yaw_fixed, each also with @0.3, @0.5, @0.7 as score cut;
            rtnh_narrow, rtnh_wide, lidar_wide, asf_narrow, asf_wide.
        format: Format of both.
        label: The class that is scored; without it every class is, each for itself, the most annotated one first.
        range_bins_m: Edges of the range bins; without it 0,70,150,250, for kradar 0,20,40,60,80.
        epsilon: Values of epsilon in wDDS' omega = exp(epsilon d); 0 is DDS.
        region: window: x 0..250, |y| <= 50 and the outermost bin edges; range: the outermost bin edges; none: all.
            Without it: window for dds on boxes-csv, none otherwise. For kradar: wide (without it), narrow, none or
            six bounds x,x,y,y,z,z in the radar's frame.
        conditions: For kradar: a CSV with the columns sequence, road, time, weather; a K-Radar tree with its
            description.txt files; or the word published for the table of K-Radar's 58 sequences.
        label_version: For kradar: the annotation's version, which stands beside the result.
        options: Further settings of the protocol, such as ap=area distance=bev relabel=truck:vehicle,bus:vehicle, for
            kradar boxes_in=os2-64 classes=vehicle,pedestrian score_cut=0.3.
        replicates: Bootstrap replicates of the 95 % intervals; 0 for none.
        seed: Seed of the bootstrap.
        json: Where to write the result as JSON.
    """
    from farfield.errors import ConfigError
    from farfield.files.atomic import write_text
    from farfield.metrics import Bootstrap
    from farfield.metrics.reading import read_inputs

    of_kradar = protocol.partition(":")[0] in ("kradar", "kradar-compat")
    chosen: dict[str, Any] = {"bootstrap": Bootstrap(replicates=replicates, seed=seed), **_parse_options(options)}
    if range_bins_m is not None:
        chosen["range_bins_m"] = _numbers("range-bins-m", range_bins_m)
    if region is not None or not of_kradar:
        chosen["region"] = region or ("window" if (protocol, format) == ("dds", "boxes-csv") else "none")
    if protocol == "dds":
        chosen["epsilons"] = _numbers("epsilon", epsilon)
    if label_version is not None:
        chosen["label_version"] = label_version
    if conditions is not None and not of_kradar:
        raise ConfigError(f"--conditions: only kradar scores by condition, not {protocol}")
    inputs = read_inputs(predictions, labels, format=format)
    notes = list(inputs.notes)
    if of_kradar:
        results = [_score_kradar(inputs, protocol, label, conditions, chosen, notes)]
    else:
        results = _score_classes(inputs, protocol, label, chosen)
    if json is not None:
        tree = {**results[0].to_json(), "notes": notes}
        if len(results) > 1:
            tree["labels"] = {result.label: result.to_json() for result in results}
        write_text(json, json_module.dumps(tree, indent=1, allow_nan=False) + "\n")
    print("".join(f"note: {note}\n" for note in notes), end="")
    print("\n\n".join(map(str, results)) + (f"\n\nwritten: {json}" if json is not None else ""))
    return 0


def _score_classes(inputs: "ScoreInputs", protocol: str, label: str | None, chosen: dict[str, Any]) -> "list[Result]":
    """One result a class."""
    from farfield.errors import ConfigError
    from farfield.metrics import score, scored_labels

    present = scored_labels(inputs.annotations, protocol, **chosen)
    found = set(present) | set(scored_labels(inputs.predictions, protocol, **chosen))
    if label is not None and found and label not in found:
        raise ConfigError(f"label: expected a class that occurs, one of {', '.join(sorted(found))}; got {label!r}")
    return [
        score(
            inputs.predictions,
            inputs.annotations,
            protocol=protocol,
            label=name,
            prediction_details=inputs.prediction_details,
            annotation_details=inputs.annotation_details,
            **chosen,
        )
        for name in ([label] if label is not None else present or (None,))
    ]


def _score_kradar(
    inputs: "ScoreInputs",
    protocol: str,
    label: str | None,
    conditions: str | None,
    chosen: dict[str, Any],
    notes: list[str],
) -> "Result":
    """All classes in one result."""
    from farfield.errors import ConfigError
    from farfield.metrics import kradar_settings, score
    from farfield.metrics.centre.scene import labels_of
    from farfield.vocabulary.classes import CIRRUS_FROM_ANY_KRADAR

    if label is not None:
        chosen = {**chosen, "classes": (chosen.get("relabel", CIRRUS_FROM_ANY_KRADAR).get(label, label),)}
    settings = kradar_settings(protocol, **chosen)
    found = [name for name, _ in labels_of(inputs.annotations, settings.relabel)]
    if found and not set(found) & set(settings.classes):
        raise ConfigError(
            f"{protocol}: expected annotated boxes of {' or '.join(settings.classes)}, got {', '.join(found[:8])}. "
            "Choose with --label, --options classes=a,b or rename with --options relabel=old:new"
        )
    known = _conditions(inputs, conditions)
    if conditions is not None and len(known) < len(inputs.annotations):
        missing = sorted({key[0] for key in inputs.annotations if key not in known})
        notes.append(f"no conditions for sequences {', '.join(missing[:8])}: their frames count in the whole alone")
    return score(inputs.predictions, inputs.annotations, protocol=protocol, conditions=known or None, **chosen)


def _conditions(inputs: "ScoreInputs", conditions: str | None) -> dict[tuple[str, str], dict[str, str]]:
    """Weather, road and time by frame."""
    if conditions is None:
        return {}
    if conditions == "published":
        from farfield.vocabulary.kradar import published_conditions

        told = {key: published_conditions(key[0]) for key in inputs.annotations}
        return {key: values for key, values in told.items() if values}
    from farfield.metrics.kradar.conditions import read_conditions

    return read_conditions(conditions, inputs.annotations)


def _numbers(flag: str, text: str) -> tuple[float, ...]:
    from farfield.errors import ConfigError

    try:
        return tuple(float(word) for word in text.split(","))
    except ValueError:
        raise ConfigError(f"--{flag}: expected comma-separated numbers, got {text!r}") from None


def _parse_options(options: tuple[str, ...]) -> dict[str, Any]:
    """Turn ``name=value`` words into settings: numbers, comma lists and ``a:b`` pairs as the setting asks."""
    from farfield.errors import ConfigError

    parsed: dict[str, Any] = {}
    for option in options:
        name, equals, text = option.partition("=")
        if not equals or name in parsed:
            raise ConfigError(f"--options: expected each name=value once, got {option!r}")
        if name in _FLAGS:
            raise ConfigError(f"--options: {name} has a flag of its own")
        parsed[name] = _value(name, text)
    return parsed


def _value(name: str, text: str) -> Any:
    from farfield.errors import ConfigError

    words = [word for word in text.split(",") if word]
    if name in ("ignore", "classes"):
        return tuple(words)
    if name == "relabel":
        pairs = [word.split(":") for word in words]
        if any(len(pair) != 2 for pair in pairs):
            raise ConfigError(f"--options relabel: expected old:new,old:new, got {text!r}")
        return dict(pairs)
    if name in _LISTS:
        return _numbers(f"options {name}", text)
    if name in ("azimuth_deg", "decimals") and text == "none":
        return None
    if name in (*_WHOLE, *_NUMBERS) and text != "all":
        number = _numbers(f"options {name}", text)
        if len(number) != 1 or (name in _WHOLE and not number[0].is_integer()):
            raise ConfigError(f"--options {name}: expected one number, got {text!r}")
        return int(number[0]) if name in _WHOLE else number[0]
    return text
