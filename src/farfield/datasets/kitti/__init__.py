"""KITTI: object and tracking benchmarks, their boxes, and a writer."""
