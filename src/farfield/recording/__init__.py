"""Simulated and converted frames in bulk."""
