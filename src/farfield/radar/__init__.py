"""4D radar tensors to cubes to sparse clouds."""
