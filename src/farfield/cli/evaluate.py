"""``farfield evaluate``."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

from farfield.cli._progress import bar

if TYPE_CHECKING:
    from farfield.datasets import Dataset


def run(
    detector: Positional[str],
    data: Positional[Path],
    *,
    clouds: str = "",
    split: str = "",
    rotate_deg: float = 0.0,
    mapping: Path | None = None,
    protocol: str = "",
    label: str | None = None,
    range_bins_m: str = "",
    epsilon: str = "0,0.003,0.006,0.009",
    region: str = "",
    precision: Literal["auto", "fp32", "bf16"] = "auto",
    device: str | None = None,
    shown_frames: int = 4,
    out: Path | None = None,
) -> int:
    """Run a detector over a data set, score it by range for every scan pattern, and write a report page.

    examples:
      farfield evaluate pointpillars-cirrus-sim Cirrus_dataset1
      farfield evaluate runs/pointpillars-cirrus-sim data/val --clouds gaussian,uniform --out runs/eval
      farfield evaluate pointpillars-cirrus-sim data/kitti --range-bins-m 0,30,50,80 --region range
      farfield evaluate runs/rtnh-kradar-sim data/kradar-val --protocol kradar --region narrow

    Args:
        detector: A bundled detector's name, a run's folder, or a weights file.
        data: The data set; its format is recognised.
        clouds: Which clouds, comma-separated; by default those of the kind that the detector learnt from.
        split: train, val or test; all frames unless given.
        rotate_deg: Turn every frame counter-clockwise about z; 180 looks backwards.
        mapping: Mapping YAML of a Cirrus copy that deviates from the documented layout.
        protocol: dds, nuscenes, kitti, kradar or kradar-compat:VARIANT; kradar on K-Radar's layout and dds on all
            others unless given. K-Radar's also scores each weather, road and time of day.
        label: The class to score; the most frequent one unless given (large_vehicle counts as vehicle), or with
            K-Radar's protocols every class that the detector knows.
        range_bins_m: Edges of the range bins; 0,70,150,250 or K-Radar's 0,20,40,60,80 unless given.
        epsilon: wDDS weights.
        region: window (x 0..250, |y| <= 50 m, the default), range, or none. K-Radar's: wide (the default), narrow,
            none, or six bounds in the radar's frame.
        precision: fp32, bf16, or what suits the processor.
        device: Where to run, such as cpu or cuda:0.
        shown_frames: Frames in the report's pictures.
        out: Folder of the evaluation and its report.html; runs/evaluation-DATA unless given.
    """
    from farfield.api import as_trained, load_detector, open_dataset
    from farfield.evaluation import evaluate_clouds
    from farfield.frame.provenance import is_simulated
    from farfield.reports.page import write_report

    options: dict[str, Any] = {"mapping": mapping} if mapping else {}
    opened = open_dataset(data, rotate_deg=rotate_deg, **options)
    opened = opened.split(split) if split else opened
    loaded = load_detector(detector, precision=precision, device=device)
    opened = as_trained(opened, loaded)
    protocol = protocol or ("kradar" if opened.name == "kradar" else "dds")
    scoring = _settings(protocol, label=label, range_bins_m=range_bins_m, epsilon=epsilon, region=region)
    if protocol.startswith("kradar"):
        scoring |= _of_kradar(opened, loaded.class_names if label is None else (label,))
    evaluation = evaluate_clouds(
        loaded,
        opened,
        clouds=[name for name in clouds.split(",") if name] or None,
        shown_frames=shown_frames,
        protocol=protocol,
        title=f"{detector} on {opened.root.name}",
        provenance={"simulated": is_simulated(opened.root)},
        progress=bar,
        **scoring,
    )
    folder = out or Path("runs") / f"evaluation-{opened.root.name}"
    evaluation.save(folder)
    for name, result in evaluation.results.items():
        print(f"{name}: {json.dumps(summary(result))}")
    page = write_report(
        folder / "report.html",
        title=evaluation.title,
        results=evaluation.results,
        frames=evaluation.frames,
        settings=evaluation.settings,
        provenance=evaluation.provenance,
        objects=evaluation.objects,
    )
    print(f"evaluation: {folder / 'evaluation.json'}\nreport: {page.resolve()}")
    return 0


def _settings(protocol: str, *, label: str | None, range_bins_m: str, epsilon: str, region: str) -> dict[str, Any]:
    """The flags that a protocol knows, as its settings; K-Radar's are left to their defaults where no flag is given."""
    from farfield.metrics import PROTOCOLS
    from farfield.metrics.options import numbers

    ours = not protocol.startswith("kradar")
    scoring: dict[str, Any] = {"label": label} if ours else {}
    if ours or range_bins_m:
        scoring["range_bins_m"] = numbers(range_bins_m or "0,70,150,250", "--range-bins-m")
    if ours or region:
        scoring["region"] = region or "window"
    scoring["epsilons"] = numbers(epsilon, "--epsilon")
    known = PROTOCOLS[protocol].options()
    return {name: value for name, value in scoring.items() if name in known}


def _of_kradar(data: "Dataset", classes: tuple[str, ...]) -> dict[str, Any]:
    """What K-Radar's protocols are told of the data: classes, the frame of the boxes, the annotations' version."""
    frame = data[0]
    version = (frame.annotation.version if frame.annotation is not None else "") or "not stated"
    frame_of_boxes = "radar" if frame.reference == "radar" else "os2-64"
    return {"classes": classes, "boxes_in": frame_of_boxes, "label_version": version}


def summary(result: Mapping[str, Any]) -> dict[str, Any]:
    """The few figures for the terminal: DDS (epsilon 0) overall and by range; AP where there is no DDS."""

    def brief(part: Mapping[str, Any] | None) -> Any:
        if part is None:
            return None
        figures = part.get("dds", {}).get("0", {}).get("dds") if part.get("dds") else part.get("ap")
        return round(figures, 4) if isinstance(figures, float) else figures

    return {"overall": brief(result), **{name: brief(part) for name, part in result.get("ranges", {}).items()}}
