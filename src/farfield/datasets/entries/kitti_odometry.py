"""The entry of the format kitti_odometry."""

from farfield.datasets.formats import NO_REAL_FILE, Format, FormatFacts

FORMAT = Format(
    name="kitti_odometry",
    looked_for="[dataset/]sequences/<number>/velodyne/*.bin, or <number>/velodyne/*.bin with <number>/calib.txt",
    recognises="farfield.datasets.kitti.odometry:is_kitti_odometry",
    reader="farfield.datasets.kitti.odometry:KittiOdometry",
    facts=FormatFacts(
        title="KITTI odometry and SemanticKITTI",
        read="sweeps, times, poses of the LiDAR, left colour camera with calibration; no boxes: the sets have none, "
        "and SemanticKITTI's classes of points are not read",
        real_files=NO_REAL_FILE,
        opens="farfield doctor dataset",
        source="https://www.cvlibs.net/datasets/kitti/eval_odometry.php, http://www.semantic-kitti.org/dataset.html",
        licence="CC BY-NC-SA 3.0",
    ),
)
