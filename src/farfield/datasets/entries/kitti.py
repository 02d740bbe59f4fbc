"""The entry of the format kitti."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="kitti",
    looked_for="training/velodyne/*.bin",
    recognises="farfield.datasets.recognition:is_kitti",
    reader="farfield.datasets.kitti.object:Kitti",
    facts=FormatFacts(
        title="KITTI, object benchmark",
        read="LiDAR, left colour camera, calibration, boxes, occlusion and truncation, DontCare regions",
        real_files="17 frames with calibration and labels, 13 of them with images",
        opens="farfield doctor KITTI/object",
        source="https://www.cvlibs.net/datasets/kitti/eval_object.php",
        download="velodyne, calib and label_2 of training; images wait",
        licence="CC BY-NC-SA 3.0",
    ),
)
