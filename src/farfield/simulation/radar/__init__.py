"""A 4D radar: scatterers, virtual array, and the tensor it measures."""
