"""Adapting a detector across range, device and scan pattern."""
