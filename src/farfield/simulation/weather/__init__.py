"""What the weather does to light, radio waves, the ground and the sensors' windows."""
