"""Annotations as they are edited: journal, undo, store, tracks and checks."""
