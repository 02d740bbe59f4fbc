"""Exported detectors, run by onnxruntime: what their networks read and ask is prepared in numpy. Imports no torch."""
