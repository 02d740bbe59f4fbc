"""PointRCNN (Shi, Wang and Li, CVPR 2019)."""
