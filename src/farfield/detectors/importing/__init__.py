"""Trained weights of other codebases as networks of ours."""

from farfield.detectors.importing.openpcdet import ImportReport, import_openpcdet

__all__ = ["ImportReport", "import_openpcdet"]
