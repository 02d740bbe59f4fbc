"""Label files that can be edited: read with the place of every object, and written so that what did not change keeps
its bytes. One format, one file.
"""

from farfield.datasets.labels.contract import BoxLabel, LabelFormat, Numbers, Value
from farfield.datasets.labels.csv_boxes import CsvLabels

__all__ = ["BoxLabel", "CsvLabels", "LabelFormat", "Numbers", "Value"]
