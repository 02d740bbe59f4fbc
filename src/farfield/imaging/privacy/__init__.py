"""Faces and number plates covered, in pictures that may then be shown."""

from farfield.imaging.privacy.anonymising import anonymise, check_apart
from farfield.imaging.privacy.hits import Hits
from farfield.imaging.privacy.looking import Anonymising, Covered
from farfield.imaging.privacy.private import Private

__all__ = ["Anonymising", "Covered", "Hits", "Private", "anonymise", "check_apart"]
