"""Annotation without a browser: boxes and tracks edited, fitted, checked, undone and saved, each edit in a journal.

:class:`~farfield.annotation.annotator.Annotator` opens a data set for it.
"""
