"""Disk to Frame and back, one module a data set: its reader and its writer side by side."""
