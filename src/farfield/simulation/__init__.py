"""Physics to Frame: roads, traffic, meshes, ray casting, LiDAR."""
