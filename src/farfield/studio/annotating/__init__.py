"""The annotation behind the windows: the store opened for a data set, its rows, edits, fits, checks and saves."""
