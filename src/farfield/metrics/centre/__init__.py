"""Scores by centre distance: DDS, wDDS and nuScenes."""
