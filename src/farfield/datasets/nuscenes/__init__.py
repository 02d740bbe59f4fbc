"""The nuScenes schema and its dialects: nuScenes, MAN TruckScenes and Tier IV's T4, by one reader and one writer."""
