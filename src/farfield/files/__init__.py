"""Bytes to arrays and back, one module a file format. Writes are atomic."""
