"""Faces and number plates covered, in pictures that may then be shown."""

from typing import TYPE_CHECKING

from farfield.privacy.anonymising import anonymise, check_apart
from farfield.privacy.hits import ImageBoxes
from farfield.privacy.looking import AnonymizeOptions, PictureSummary
from farfield.privacy.private import Anonymized
from farfield.registry import old_names

__all__ = ["AnonymizeOptions", "Anonymized", "ImageBoxes", "PictureSummary", "anonymise", "check_apart"]

if not TYPE_CHECKING:
    __getattr__ = old_names(
        __name__, Anonymising="AnonymizeOptions", Covered="PictureSummary", Hits="ImageBoxes", Private="Anonymized"
    )
