"""Label files that can be edited: one format, one file. What did not change keeps its bytes."""

from farfield.datasets.labels.formats import BoxLabel, LabelFormat, Numbers, Value, label_files_in, label_format
from farfield.datasets.labels.line_labels import CsvLabels

__all__ = ["BoxLabel", "CsvLabels", "LabelFormat", "Numbers", "Value", "label_files_in", "label_format"]
