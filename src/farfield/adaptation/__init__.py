"""Training methods that carry a detector over a gap: of range, scan pattern, device or weather. One method one file."""
