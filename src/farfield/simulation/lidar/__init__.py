"""LiDAR sensors: scan patterns, the ranging law, and sweeps over a scene."""
