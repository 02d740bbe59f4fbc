"""The entry of the format kitti_tracking."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="kitti_tracking",
    looked_for="training/velodyne/<sequence>/*.bin, or label_02/*.txt or label/*.txt in KITTI's tracking format",
    recognises="farfield.datasets.recognition:is_kitti_tracking",
    reader="farfield.datasets.kitti.tracking:KittiTracking",
    facts=FormatFacts(
        title="KITTI, tracking benchmark",
        read="LiDAR, camera, calibration, boxes with tracks; labels alone too",
        real_files="labels and detections of ten sequences; sweeps those of the object set",
        opens="farfield doctor KITTI/tracking",
        source="https://www.cvlibs.net/datasets/kitti/eval_tracking.php",
        download="label_02 of training: tracks are scored without sweeps",
        licence="CC BY-NC-SA 3.0",
    ),
)
