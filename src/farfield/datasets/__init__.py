"""Data sets: disk to :class:`Frame` and back. What users, and writers of a reader or of a map, need stands here.

``open_dataset`` recognises the format; ``in_memory`` makes a data set of frames; a reader subclasses ``Dataset`` and
builds frames of ``Lazy`` clouds; ``dataset`` registers it.
"""

from farfield.datasets.base import Dataset
from farfield.datasets.formats import DATASETS, Format, FormatFacts, dataset
from farfield.datasets.frame_maps import MAPS, FrameMap, make
from farfield.datasets.memory import InMemory, in_memory
from farfield.datasets.opening import open_dataset
from farfield.datasets.recognition import recognise
from farfield.frame import Annotation, Boxes, Cloud, Constant, Drive, Frame, Lazy, Sensor

__all__ = [
    "DATASETS",
    "MAPS",
    "Annotation",
    "Boxes",
    "Cloud",
    "Constant",
    "Dataset",
    "Drive",
    "Format",
    "FormatFacts",
    "Frame",
    "FrameMap",
    "InMemory",
    "Lazy",
    "Sensor",
    "dataset",
    "in_memory",
    "make",
    "open_dataset",
    "recognise",
]
