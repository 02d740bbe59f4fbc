"""The doctor: what a data set holds, what is missing, and which conventions the data themselves show."""

from typing import Any

from farfield.datasets.base import Dataset
from farfield.inspection.doctor.calibration import check_calibration as check_calibration
from farfield.inspection.doctor.companions import check_companions
from farfield.inspection.doctor.content import (
    check_cameras_upright,
    check_classes,
    check_clouds,
    check_clouds_upright,
    check_sizes,
    check_suspicious_boxes,
    check_tracks,
)
from farfield.inspection.doctor.conventions import check_conventions, check_quaternion_order
from farfield.inspection.doctor.image_marks import check_image_marks
from farfield.inspection.doctor.inventory import check_inventory, check_stamps, check_timing
from farfield.inspection.doctor.kradar import check_kradar
from farfield.inspection.doctor.survey import DoctorReport, Finding, survey
from farfield.inspection.doctor.tracks import check_motion
from farfield.jobs import HERE, JobOptions

__all__ = ["DoctorReport", "Finding", "examine"]

_CHECKS = (
    check_inventory,
    check_timing,
    check_stamps,
    check_kradar,
    check_clouds,
    check_clouds_upright,
    check_cameras_upright,
    check_image_marks,
    check_quaternion_order,
    check_conventions,
    check_classes,
    check_sizes,
    check_suspicious_boxes,
    check_tracks,
    check_companions,
    check_motion,
)


def examine(dataset: Dataset, *, max_clouds: int = 20, calibration: int = 0, bulk: JobOptions = HERE) -> DoctorReport:
    """Examine a data set.

    Args:
        dataset: What :func:`farfield.datasets.open_dataset` gave.
        max_clouds: Number of frames whose clouds are read, spread evenly; 0 reads all. Annotations are all read.
        calibration: Number of frames with which to check the calibrations that the data set gives; 0 does not.
        bulk: Who reads the frames.

    Returns:
        Findings; ``report.failed`` tells whether training would fail or score zero.
    """
    surveyed = survey(dataset, max_clouds=max_clouds, bulk=bulk)
    facts: dict[str, Any] = {}
    findings = [finding for check in _CHECKS for finding in check(surveyed, facts)]
    if calibration:
        findings += check_calibration(dataset, calibration, facts)
    return DoctorReport(path=str(dataset.root), format=dataset.name, findings=tuple(findings), facts=facts)
