"""Cameras: pictures of the scene, by ray casting."""
