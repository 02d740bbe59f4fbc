"""Frames to scored boxes. One paper is one file."""
