"""Depth maps of a whole data set: one PNG a frame, in a folder that an interrupted run goes on in."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from farfield.datasets.base import Dataset
from farfield.depth.maps import MAX_GAP_DEG, Method, cloud_and_camera, frame_depth, rows_ahead
from farfield.depth.raster import NEAREST_M
from farfield.errors import ConfigError
from farfield.files.atomic import write_text
from farfield.files.depth_png import FAR_SCALE, KITTI_SCALE, farthest_m, write_depth
from farfield.jobs import HERE, JobJournal, JobOptions, Outcome, Unit, UnitResult, run
from farfield.jobs.folders import held

JOURNAL_NAME, SURVEY_NAME, SUMMARY_NAME = ".farfield_depth.jsonl", ".farfield_depth_ends.jsonl", "depth.json"
Scale = Literal["auto", "256", "128"]


@dataclass(frozen=True, kw_only=True)
class DepthSettings:
    """What decides the maps besides the data.

    Args:
        cloud: Name of the cloud (default: the first of a LiDAR).
        camera: Name of the camera (default: the first calibrated one).
        method: As of :func:`~farfield.depth.maps.depth_map`.
        scale: Steps a metre: 256 is KITTI's and ends at 255.996 m, 128 ends at 511.992 m; auto takes 256 for all frames
            unless a point before the camera of any lies beyond its end, and then 128 for all.
        max_uncertainty_m: Pixels that are less sure are left out; 0 keeps all.
        uncertainty: Write the uncertainty too, in the same convention.
        max_gap_deg: As of :func:`~farfield.depth.maps.depth_map`.
    """

    cloud: str | None = None
    camera: str | None = None
    method: Method = "auto"
    scale: Scale = "auto"
    max_uncertainty_m: float = 0.0
    uncertainty: bool = False
    max_gap_deg: float = MAX_GAP_DEG


@dataclass(frozen=True)
class DepthSummary:
    """Frames written, and what ``depth.json`` says.

    Args:
        outcome: Frames written now, and frames that were there.
        summary: What ``depth.json`` says.
    """

    outcome: Outcome
    summary: dict[str, Any]


def write_depth_maps(
    dataset: Dataset,
    out: Path | str,
    settings: DepthSettings | None = None,
    *,
    survey: JobOptions = HERE,
    bulk: JobOptions = HERE,
    overwrite: bool = False,
) -> DepthSummary:
    """Write ``depth/SEQUENCE/FRAME.png`` for every frame, ``uncertainty/...`` if asked, and ``depth.json`` at the end.

    Args:
        dataset: The frames.
        out: Folder to write into.
        settings: How.
        survey: How the farthest points are looked for, with scale auto.
        bulk: How the maps are made.
        overwrite: Make every map anew.

    Raises:
        ConfigError: If the folder is the data set's own, or two frames would get one file.
        DatasetError: As of :func:`~farfield.depth.maps.frame_depth`.
    """
    settings, out = settings or DepthSettings(), Path(out)
    if out.resolve() == dataset.root.resolve():
        raise ConfigError(f"{out}: expected a folder apart from the data set's own, to keep its files as they are")

    # 1. A unit of work a frame.
    names = file_names(dataset)
    units = [
        Unit("/".join(key), tuple(dataset.files(index)), (index, name))
        for index, (key, name) in enumerate(zip(dataset.keys, names, strict=True))
    ]

    with held(out):
        # 2. The scale of all files: by the farthest point of any frame, unless it is fixed.
        scale = (
            int(settings.scale) if settings.scale != "auto" else _fitting_scale(dataset, out, settings, units, survey)
        )

        # 3. The maps, from where an interrupted run stopped.
        setting = f"{dataset.name} {json.dumps(dataset.recipe, sort_keys=True, default=str)} {settings} {scale}"
        journal = JobJournal(out / JOURNAL_NAME, setting, overwrite=overwrite)
        outcome = run(_MapWriting(dataset, out, settings, scale), units, bulk, journal=journal)

        # 4. The summary.
        values = list(journal.values(unit.name for unit in units))
        summary = _summary(dataset, settings, scale, values)
        write_text(out / SUMMARY_NAME, json.dumps(summary, indent=1) + "\n")
    return DepthSummary(outcome, summary)


def file_names(dataset: Dataset) -> list[str]:
    """``SEQUENCE/FRAME`` of every frame, with letters that file names may have; no two alike.

    Raises:
        ConfigError: If two frames would get one name.
    """
    names = ["/".join(filter(None, map(_safe, key))) for key in dataset.keys]
    first: dict[str, int] = {}
    for index, name in enumerate(names):
        if first.setdefault(name.lower(), index) != index:
            keys = dataset.keys
            raise ConfigError(f"depth: frames {keys[first[name.lower()]]} and {keys[index]} would both be {name}.png")
    return names


def _safe(text: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in text).lstrip(".")


def _fitting_scale(
    dataset: Dataset, out: Path, settings: DepthSettings, units: Sequence[Unit], bulk: JobOptions
) -> int:
    setting = f"{dataset.name} {settings.cloud} {settings.camera}"
    journal = JobJournal(out / SURVEY_NAME, setting, files=False)
    run(_Farthest(dataset, settings.cloud, settings.camera), units, bulk, journal=journal)
    ends = [float(value) for value in journal.values(unit.name for unit in units)]
    return KITTI_SCALE if max(ends, default=0.0) <= farthest_m(KITTI_SCALE) else FAR_SCALE


@dataclass(frozen=True)
class _Farthest:
    """The largest depth among the points before the camera: no depth map holds a larger one."""

    dataset: Dataset
    cloud: str | None
    camera: str | None
    memory_bytes = 500_000_000

    def __call__(self, unit: Unit) -> UnitResult:
        points, camera = cloud_and_camera(self.dataset[unit.parameters[0]], self.cloud, self.camera)
        rows = rows_ahead(points.points_m, camera)
        pose = camera.camera_T_lidar
        depth = points.points_m[rows].astype(np.float64) @ pose[2, :3] + pose[2, 3]
        return UnitResult(value=round(float(depth.max(initial=NEAREST_M)), 6))


@dataclass(frozen=True)
class _MapWriting:
    """Writes the map of one frame."""

    dataset: Dataset
    out: Path
    settings: DepthSettings
    scale: int
    memory_bytes = 700_000_000

    def __call__(self, unit: Unit) -> UnitResult:
        index, name = unit.parameters
        settings, frame = self.settings, self.dataset[index]

        # 1. The map, without the pixels that are too unsure.
        depth = frame_depth(
            frame,
            cloud=settings.cloud,
            camera=settings.camera,
            method=settings.method,
            max_gap_deg=settings.max_gap_deg,
        )
        if settings.max_uncertainty_m:
            depth = depth.surer_than(settings.max_uncertainty_m)

        # 2. Its files.
        notes = {"method": depth.method, "source": "/".join(frame.key)}
        path = self.out / "depth" / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        beyond = write_depth(path, depth.depth_m, scale=self.scale, notes={**notes, "depth_kind": "z"})
        files = [path]
        if settings.uncertainty:
            files.append(self.out / "uncertainty" / f"{name}.png")
            files[1].parent.mkdir(parents=True, exist_ok=True)
            end = np.float32(farthest_m(self.scale))  # less sure than that is not sure at all, but it is not nothing
            write_depth(files[1], np.minimum(depth.uncertainty_m, end), scale=self.scale, notes=notes)

        # 3. What the summary takes.
        filled = round(float(np.isfinite(depth.depth_m).mean()), 6)
        value = {"method": depth.method, "filled": filled, "measured": int(depth.measured.sum()), "beyond": beyond}
        return UnitResult(files=tuple(files), value=value)


def _summary(dataset: Dataset, settings: DepthSettings, scale: int, values: Sequence[dict[str, Any]]) -> dict[str, Any]:
    methods = sorted({value["method"] for value in values})
    return {
        "depth_scale": scale,
        "depth_unit": "metre",
        "depth_kind": "z",
        "none": 0,
        "end_m": round(farthest_m(scale), 3),
        "beyond_end": sum(value["beyond"] for value in values),
        "frames": len(values),
        "filled": round(sum(value["filled"] for value in values) / max(len(values), 1), 6),
        "methods": {method: sum(value["method"] == method for value in values) for method in methods},
        "cloud": settings.cloud,
        "camera": settings.camera,
        "max_uncertainty_m": settings.max_uncertainty_m,
        "format": dataset.name,
    }
