"""Detection beside the server: one process that holds the networks, one frame at a time, cancelled at once."""
