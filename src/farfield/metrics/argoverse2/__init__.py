"""Argoverse 2's detection metrics: AP, translation, scale and orientation errors, and the composite detection score."""
