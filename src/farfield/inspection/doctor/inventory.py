"""What is there and what is missing: sweeps, labels, images, calibration, times, segments, pairs."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np

from farfield.datasets.cirrus import Cirrus
from farfield.datasets.folder import Folder
from farfield.inspection.doctor.findings import Finding, counted
from farfield.inspection.doctor.survey import Survey


def inventory(found: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Tell which sensors, labels and calibrations there are, and what could not be read."""
    count = len(found.dataset)
    facts |= {"frames": count, "sweeps": dict(found.sensors), "images": dict(found.images)}
    facts |= {"labelled_frames": len(found.boxes), "calibrated_cameras": sorted(found.cameras)}
    if isinstance(found.dataset.unwrapped, Cirrus):
        yield from _cirrus_folders(found, found.dataset.unwrapped)
    else:
        kinds = ", ".join(f"{number} with cloud {name}" for name, number in found.sensors.items()) or "no clouds"
        yield Finding(
            severity="ok" if found.sensors else "fail",
            topic="frames",
            what=f"{counted(count, 'frame')}: {kinds}",
            mend=""
            if found.sensors
            else "Add the clouds: without them nothing can be trained or detected. Annotations alone are enough for "
            "farfield stats and farfield score.",
        )
    yield _labels(found)
    yield from _stray_labels(found)
    images = ", ".join(f"{number} of {name}" for name, number in found.images.items())
    yield Finding(severity="ok", topic="images", what=images or "none (clouds alone are enough)")
    yield _calibration(found)
    for error in found.damaged[:5]:
        yield Finding(severity="fail", topic="damaged", what=error, mend="Mend or remove the file.")
    if len(found.damaged) > 5:
        yield Finding(severity="fail", topic="damaged", what=f"and {len(found.damaged) - 5} more")


def _calibration(found: Survey) -> Finding:
    if found.cameras or not found.images:
        what = f"cameras {', '.join(sorted(found.cameras))}" if found.cameras else "no calibration"
        return Finding(severity="ok", topic="calibration", what=what)
    mend = "Boxes cannot be drawn into the images."
    if isinstance(found.dataset.unwrapped, Cirrus | Folder):
        mend += " Put calibration.yaml (matrix, distortion, camera_T_lidar, width, height) into the root."
    return Finding(severity="warn", topic="calibration", what="no calibration", mend=mend)


def _cirrus_folders(found: Survey, reader: Cirrus) -> Iterator[Finding]:
    """Tell the files of each pattern; of a selection of frames those that belong to them."""
    whole = set(found.dataset.origins) == set(range(len(reader)))
    chosen = [reader.entries[index] for index in dict.fromkeys(found.dataset.origins)]
    for pattern, word in (("gaussian", "Gaussian"), ("uniform", "uniform")):
        files = sum(len(part.files[pattern]) for part in reader.parts)
        files = files if whole else sum(getattr(entry, pattern) is not None for entry in chosen)
        used = found.sensors.get(pattern, 0)
        if files == 0:
            yield Finding(
                severity="warn",
                topic=f"{word} sweeps",
                what=f"no {word.lower() if word == 'uniform' else word} folder",
                mend=f"Only the other pattern can be used. If it is there, name it: layout: {{{pattern}: ...}}.",
            )
            continue
        facts = counted(files, f"{word} frame")
        alone = "" if used == files or pattern == "gaussian" else f", {used} frames have one"
        yield Finding(severity="ok", topic=f"{word} sweeps", what=facts + alone)
    parts = reader.parts if whole else {(one.part.root, one.part.number): one.part for one in chosen}.values()
    stems = {path.stem for part in reader.parts for path in part.files["gaussian"]}
    orphans = [path for part in parts for path in part.files["labels"] if path.stem not in stems]
    if orphans:
        yield Finding(
            severity="fail" if not found.boxes else "warn",
            topic="labels",
            what=f"{len(orphans)} annotations have no Gaussian sweep of the same name",
            where=orphans[0].name,
            mend="Name the annotation like its Gaussian sweep.",
        )


def _labels(found: Survey) -> Finding:
    count, boxes = len(found.dataset), sum(len(some) for some in found.boxes)
    what = f"{len(found.boxes)} of {count} frames annotated, {boxes} boxes"
    if boxes == 0:
        mend = "Training and scoring need boxes; prediction does not. Check the folder's name and the stems."
        return Finding(severity="fail", topic="labels", what=what, mend=mend)
    if found.unlabelled:
        mend = "Frames without annotation are left out of training and scoring."
        return Finding(severity="warn", topic="labels", what=what, mend=mend)
    return Finding(severity="ok", topic="labels", what=what)


def _stray_labels(found: Survey) -> Iterator[Finding]:
    """Annotations of one's own folder that belong to no cloud."""
    reader = found.dataset.unwrapped
    strays = reader.strays if isinstance(reader, Folder) else ()
    if strays:
        yield Finding(
            severity="warn" if found.boxes else "fail",
            topic="labels",
            what=f"{len(strays)} annotations belong to no cloud",
            where=strays[0],
            mend=f"Name them like the clouds, such as {reader.frame_ids[0]}.",
        )


def timing(found: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Tell frame rate, segments, pauses, and how far apart the two patterns are."""
    sequences = found.dataset.sequences
    facts["sequences"] = len(set(sequences))
    times = found.times_ns
    if not times or any(time is None for time in times):
        yield Finding(severity="ok", topic="times", what=f"no times; {counted(facts['sequences'], 'sequence')}")
    else:
        yield _rate(np.array(times, dtype=np.int64), sequences, facts)
    if found.pair_dt_ms:
        yield _pairs(np.array(found.pair_dt_ms), len(found.dataset), facts)
    elif found.sensors.keys() >= {"gaussian", "uniform"}:
        yield Finding(severity="warn", topic="pairing", what="patterns paired by order: the names hold no times")


def _rate(times_ns: np.ndarray, sequences: tuple[str, ...], facts: dict[str, Any]) -> Finding:
    same = np.array(sequences[1:]) == np.array(sequences[:-1])
    steps_s = np.diff(times_ns)[same] / 1e9
    facts["segments"] = {name: sequences.count(name) for name in dict.fromkeys(sequences)}
    lengths = counted(len(facts["segments"]), "segment")
    if len(steps_s) == 0:
        return Finding(severity="ok", topic="times", what=f"single frames, {lengths}")
    if (steps_s <= 0).any():
        mend = "Times must grow within a sequence; look for doubled files."
        return Finding(severity="warn", topic="times", what="times do not grow", mend=mend)
    period = float(np.median(steps_s))
    missing = int((steps_s > 1.5 * period).sum())
    facts |= {"frame_rate_hz": round(1 / period, 3), "gaps": missing}
    what = f"{1 / period:.1f} Hz, {lengths}, {counted(missing, 'gap')} within"
    return Finding(severity="ok", topic="times", what=what)


def _pairs(dt_ms: np.ndarray, frames: int, facts: dict[str, Any]) -> Finding:
    edges = np.array([0, 10, 25, 50, 75, 100, np.inf])
    counts, _ = np.histogram(np.abs(dt_ms), edges)
    names = [f"{low:g}-{high:g}" for low, high in pairwise(edges)]
    histogram = {name: int(count) for name, count in zip(names, counts, strict=True) if count}
    facts["pair_dt_ms"] = {"median": float(np.median(dt_ms)), "histogram": histogram}
    shown = ", ".join(f"{count} at {name} ms" for name, count in histogram.items())
    what = f"{len(dt_ms)} of {frames} frames paired; |uniform - Gaussian|: {shown}"
    if len(dt_ms) < 0.9 * frames:
        mend = "Raise pairing: {max_dt_ms: ...} in the mapping, or use mode: order."
        return Finding(severity="warn", topic="pairing", what=what, mend=mend)
    slow = np.median(np.abs(dt_ms)) > 50
    mend = "Boxes belong to the Gaussian sweep: at 30 m/s an object moves 2 m in 68 ms." if slow else ""
    return Finding(severity="warn" if slow else "ok", topic="pairing", what=what, mend=mend)
