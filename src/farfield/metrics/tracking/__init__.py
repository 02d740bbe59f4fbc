"""Scores of tracks: CLEAR MOT with AB3DMOT's integrals, HOTA and identity F1, in 3D."""
