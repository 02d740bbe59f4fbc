"""What the calibration pages work on: the frames' evidence, values and picks with undo, solvers as jobs, saving."""
