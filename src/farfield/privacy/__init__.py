"""Faces and number plates covered, in pictures that may then be shown."""

from typing import TYPE_CHECKING

from farfield.privacy.anonymising import AnonymizeOptions, PictureSummary, anonymise, check_apart
from farfield.privacy.frames import Anonymized
from farfield.privacy.image_boxes import ImageBoxes
from farfield.registry import old_names

__all__ = ["AnonymizeOptions", "Anonymized", "ImageBoxes", "PictureSummary", "anonymise", "check_apart"]

if not TYPE_CHECKING:
    __getattr__ = old_names(
        __name__, Anonymising="AnonymizeOptions", Covered="PictureSummary", Hits="ImageBoxes", Private="Anonymized"
    )
