"""The browser application: view, annotate, calibrate, infer."""
