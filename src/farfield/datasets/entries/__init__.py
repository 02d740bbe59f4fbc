"""One file a format: its entry in the registry, ``FORMAT``. A file here is all that registers a format.

The file's name is the format's. An entry names its reader and its recognition as ``"module:attribute"``, so that asking
what a folder is imports no reader. In which order formats are tried, :mod:`farfield.datasets.formats` says. Every entry
has facts; which targets of ``convert`` write a format, whether labels are saved in place and what scores it are derived
from the registries of these and stand in no entry.
"""
