"""One file: what our readers would make of it, and which expectation of which reader fails."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from farfield.datasets.calibration import read_calibration_file
from farfield.datasets.cirrus.labels import read_labels as read_cirrus_labels
from farfield.datasets.cirrus.layout import Labels
from farfield.datasets.kitti.boxes import camera_of
from farfield.datasets.kradar.labels import read_labels as read_kradar_labels
from farfield.datasets.kradar.layout import RADAR_PRODUCTS
from farfield.datasets.kradar.products import read_moments, read_radar
from farfield.datasets.kradar.texts import read_radar_calibration
from farfield.datasets.unread import advice_on
from farfield.errors import FarfieldError
from farfield.files.atomic import read_bytes
from farfield.files.boxes_csv import read_boxes_csv
from farfield.files.images import image_size
from farfield.files.kitti import (
    read_calib,
    read_labels,
    read_raw_calib,
    read_record,
    read_tracking,
)
from farfield.files.poses_csv import read_poses
from farfield.files.sizes import sized
from farfield.files.stamps import recognise_stamps
from farfield.files.sustechpoints import parse_sustechpoints
from farfield.frame.cloud import CLOUD_SUFFIXES, read_cloud
from farfield.inspection.bundle.file_facts import PICTURES, file_facts, words_of
from farfield.inspection.doctor.survey import DoctorReport, Finding


class FileReader(NamedTuple):
    """A reader of single files.

    Args:
        name: What it reads, in words.
        suffixes: Of which files.
        read: Reads one; what it gives is thrown away.
        hint: Words of a path whose file is meant for it.
    """

    name: str
    suffixes: tuple[str, ...]
    read: Callable[[Path], Any]
    hint: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Product:
    """Reads a product of K-Radar's radar."""

    product: str

    def __call__(self, path: Path) -> Any:
        return read_moments(path) if self.product == "tesseract" else read_radar(path, self.product)


def _stamps(path: Path) -> Any:
    if recognise_stamps(path) is None:
        raise ValueError("line 1: expected a stamp")


def _kitti_calibration(path: Path) -> Any:
    return camera_of(read_calib(path))


def _cirrus(path: Path) -> Any:
    return read_cirrus_labels(path, Labels())


def _sustechpoints(path: Path) -> Any:
    return parse_sustechpoints(read_bytes(path), path)


_MATLAB = {"tesseract": ".mat", "cube": ".mat", "cells": ".h5"}
_FOLDERS = {"sparse": "rtnh", "sparse_1p": "rtnh_wider_1p", "corridor": "sp_rdr", "polar3d": "polar3d"}
READERS: tuple[FileReader, ...] = (
    FileReader("a picture", PICTURES, image_size),
    *(
        FileReader(f"K-Radar's {name}", (_MATLAB.get(name, ".npy"),), _Product(name), (_FOLDERS.get(name, name),))
        for name in RADAR_PRODUCTS
        if name not in ("sparse_1p",) and not name.startswith("polar_cloud_")
    ),
    FileReader("a cloud", CLOUD_SUFFIXES, read_cloud),
    FileReader("labels of KITTI's objects", (".txt",), read_labels, ("label_2",)),
    FileReader("labels of KITTI's tracking", (".txt",), read_tracking, ("label_02",)),
    FileReader("a calibration of KITTI's objects", (".txt",), _kitti_calibration, ("calib/",)),
    FileReader("a calibration of KITTI's raw data", (".txt",), read_raw_calib, ("calib_",)),
    FileReader("a record of KITTI's GPS and IMU", (".txt",), read_record, ("oxts",)),
    FileReader("labels of K-Radar", (".txt",), read_kradar_labels, ("info_label", "visibility", "uwipl")),
    FileReader("K-Radar's calibration of the radar", (".txt",), read_radar_calibration, ("calib_radar_lidar",)),
    FileReader("a list of stamps", (".txt", ".csv"), _stamps, ("time",)),
    FileReader("boxes as CSV", (".csv",), read_boxes_csv, ("box", "label")),
    FileReader("poses as CSV", (".csv",), read_poses, ("pose",)),
    FileReader("annotations of Cirrus", (".json",), _cirrus, ("annotation",)),
    FileReader("labels of SUSTechPOINTS", (".json",), _sustechpoints, ("label",)),
    FileReader("a calibration", (".json", ".yaml", ".yml"), read_calibration_file, ("calib",)),
)
"""Readers in the order in which they are tried, those that a file's path hints at first."""


def examine_file(path: Path) -> DoctorReport:
    """Say what our readers make of one file.

    Args:
        path: The file.

    Returns:
        Its size and form; for each reader of its suffix whether it takes the file, and which expectation fails. The
        report has failed where no reader takes it.
    """
    facts = file_facts(path)
    takers, refusals = [], []
    for reader in _ordered(path):
        try:
            reader.read(path)
        except (FarfieldError, OSError, ValueError, MemoryError) as error:
            refusals.append((reader.name, words_of(error, path)))
        else:
            takers.append(reader.name)
    findings = [Finding(severity="ok", topic="file", what=f"{sized(facts.bytes)}, {facts.form}")]
    if facts.figures:
        shown = ", ".join(f"{name} {value:g}" for name, value in facts.figures.items())
        findings.append(Finding(severity="ok", topic="figures", what=shown))
    if facts.ranges:
        shown = ", ".join(f"{name} {low:g} to {high:g}" for name, (low, high) in list(facts.ranges.items())[:12])
        findings.append(Finding(severity="ok", topic="ranges", what=shown))
    findings += _verdicts(path, takers, refusals)
    if not takers and facts.fault and facts.fault not in {words for _, words in refusals}:
        findings.append(Finding(severity="fail", topic="form", what=facts.fault))
    figures = {"bytes": facts.bytes, "form": facts.form, "figures": dict(facts.figures), "ranges": dict(facts.ranges)}
    return DoctorReport(
        path=str(path), format="one file", findings=tuple(findings), facts=figures | {"read_as": takers}
    )


def _ordered(path: Path) -> list[FileReader]:
    """Readers of a file's suffix, those that its path hints at first."""
    tail = "/".join(path.absolute().parts[-3:]).lower()
    able = [reader for reader in READERS if path.suffix.lower() in reader.suffixes]
    return sorted(able, key=lambda reader: not any(hint in tail for hint in reader.hint))


def _verdicts(path: Path, takers: list[str], refusals: list[tuple[str, str]]) -> Iterator[Finding]:
    for name in takers:
        yield Finding(severity="ok", topic="read", what=f"taken as {name}")
    tail = "/".join(path.absolute().parts[-3:]).lower()
    meant = {reader.name for reader in READERS if any(hint in tail for hint in reader.hint)}
    for name, words in refusals:
        if not takers or name in meant:
            yield Finding(severity="warn" if takers else "fail", topic="refused", what=f"not taken as {name}: {words}")
    if not takers and not refusals:
        advice = advice_on(path)
        fix = f"It is {advice}." if advice else "Name the data set's folder, if it is a part of one."
        yield Finding(severity="fail", topic="read", what=f"no reader takes files *{path.suffix} alone", fix=fix)
