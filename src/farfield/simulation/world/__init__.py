"""Where things are and how they move: roads, layouts, traffic, and the scene over time."""
