"""The two measuring cars: which sensors stand where, and the frame they give together."""
