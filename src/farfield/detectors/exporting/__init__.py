"""Trained detectors as ONNX files: graphs of their networks, checked against the networks as they are written."""
