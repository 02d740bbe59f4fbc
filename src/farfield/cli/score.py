"""``farfield score``: score the files of any detector, without a model."""

import json as json_module
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro


def run(
    predictions: tyro.conf.Positional[Path],
    labels: tyro.conf.Positional[Path],
    *,
    protocol: Literal["dds", "nuscenes", "kitti"] = "dds",
    format: Literal["boxes-csv", "kitti", "kitti-tracking"] = "boxes-csv",
    label: str | None = None,
    range_bins_m: str = "0,70,150,250",
    epsilon: str = "0,0.003,0.006,0.009",
    region: Literal["window", "range", "none"] | None = None,
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
      farfield score predictions.csv labels.csv --range-bins-m 0,50,100 --options ap=area distance=bev

    boxes-csv has the columns sequence (may be absent), frame, label, x, y, z, l, w, h, yaw_rad, score (empty for
    labels). Predictions of kitti-tracking are KITTI tracking text or 15 comma-separated columns.

    Args:
        predictions: File, or folder of files, of predicted boxes.
        labels: File, or folder of files of equal stems, of annotated boxes.
        protocol: dds (DDS and wDDS of Cirrus), nuscenes (AP, translation, scale, orientation) or kitti (AP R11, R40).
        format: Format of both.
        label: The class that is scored; without it every class is, each for itself, the most annotated one first.
        range_bins_m: Edges of the range bins.
        epsilon: Values of epsilon in wDDS' omega = exp(epsilon d); 0 is DDS.
        region: window: x 0..250, |y| <= 50 and the outermost bin edges; range: the outermost bin edges; none: all.
            Without it: window for dds on boxes-csv, none otherwise.
        options: Further settings of the protocol, such as ap=area distance=bev relabel=truck:vehicle,bus:vehicle.
        replicates: Bootstrap replicates of the 95 % intervals; 0 for none.
        seed: Seed of the bootstrap.
        json: Where to write the result as JSON.
    """
    from farfield.errors import ConfigError
    from farfield.files.atomic import write_text
    from farfield.metrics import Bootstrap, score, scored_labels
    from farfield.metrics.inputs import read_inputs

    chosen: dict[str, Any] = {
        "range_bins_m": _numbers("range-bins-m", range_bins_m),
        "region": region or ("window" if (protocol, format) == ("dds", "boxes-csv") else "none"),
        "bootstrap": Bootstrap(replicates=replicates, seed=seed),
        **_parse_options(options),
    }
    if protocol == "dds":
        chosen["epsilons"] = _numbers("epsilon", epsilon)
    inputs = read_inputs(predictions, labels, format=format)
    present = scored_labels(inputs.annotations, protocol, **chosen)
    found = set(present) | set(scored_labels(inputs.predictions, protocol, **chosen))
    if label is not None and found and label not in found:
        raise ConfigError(f"label: expected a class that occurs, one of {', '.join(sorted(found))}; got {label!r}")
    results = []
    for name in [label] if label is not None else present or (None,):
        result = score(
            inputs.predictions,
            inputs.annotations,
            protocol=protocol,
            label=name,
            prediction_details=inputs.prediction_details,
            annotation_details=inputs.annotation_details,
            **chosen,
        )
        results.append(result)
    if json is not None:
        tree = {**results[0].to_json(), "notes": list(inputs.notes)}
        if len(results) > 1:
            tree["labels"] = {result.label: result.to_json() for result in results}
        write_text(json, json_module.dumps(tree, indent=1, allow_nan=False) + "\n")
    print("".join(f"note: {note}\n" for note in inputs.notes), end="")
    print("\n\n".join(map(str, results)) + (f"\n\nwritten: {json}" if json is not None else ""))
    return 0


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
        if name in ("range_bins_m", "epsilons", "region", "label", "bootstrap"):
            raise ConfigError(f"--options: {name} has a flag of its own")
        parsed[name] = _value(name, text)
    return parsed


def _value(name: str, text: str) -> Any:
    from farfield.errors import ConfigError

    words = [word for word in text.split(",") if word]
    if name == "ignore":
        return tuple(words)
    if name == "relabel":
        pairs = [word.split(":") for word in words]
        if any(len(pair) != 2 for pair in pairs):
            raise ConfigError(f"--options relabel: expected old:new,old:new, got {text!r}")
        return dict(pairs)
    if name in ("thresholds_m", "window_m"):
        return _numbers(f"options {name}", text)
    if name in ("min_points", "max_boxes", "min_overlap", "aiou_threshold_m") and text != "all":
        number = _numbers(f"options {name}", text)
        if len(number) != 1 or (name in ("min_points", "max_boxes") and not number[0].is_integer()):
            raise ConfigError(f"--options {name}: expected one number, got {text!r}")
        return int(number[0]) if name in ("min_points", "max_boxes") else number[0]
    return text
