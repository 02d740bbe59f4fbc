"""Label files that can be edited: one format, one file. What did not change keeps its bytes."""

from farfield.datasets.labels.choosing import label_files_in, label_format
from farfield.datasets.labels.contract import BoxLabel, LabelFormat, Numbers, Value
from farfield.datasets.labels.csv_boxes import CsvLabels

__all__ = ["BoxLabel", "CsvLabels", "LabelFormat", "Numbers", "Value", "label_files_in", "label_format"]
