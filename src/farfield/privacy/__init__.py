"""Faces and number plates covered, in pictures that may then be shown."""

from farfield.privacy.anonymising import anonymise, check_apart
from farfield.privacy.hits import ImageBoxes
from farfield.privacy.looking import AnonymizeOptions, PictureSummary
from farfield.privacy.private import Anonymized

__all__ = ["AnonymizeOptions", "Anonymized", "ImageBoxes", "PictureSummary", "anonymise", "check_apart"]
