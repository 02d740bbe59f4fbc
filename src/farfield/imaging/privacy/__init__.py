"""Faces and number plates covered, in pictures that may then be shown."""

from farfield.imaging.privacy.anonymising import anonymise, check_apart
from farfield.imaging.privacy.hits import ImageBoxes
from farfield.imaging.privacy.looking import AnonymizeOptions, PictureSummary
from farfield.imaging.privacy.private import Anonymized

__all__ = ["AnonymizeOptions", "Anonymized", "ImageBoxes", "PictureSummary", "anonymise", "check_apart"]
