"""The entry of the format kitti_raw."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="kitti_raw",
    looked_for="[<date>/]<drive>/velodyne_points/data/*.bin with velodyne_points/timestamps.txt",
    recognises="farfield.datasets.recognition:is_kitti_raw",
    reader="farfield.datasets.kitti.raw:KittiRaw",
    facts=FormatFacts(
        title="KITTI, raw drives",
        read="sweeps with times, cameras, calibration, poses of GPS/IMU, tracklets",
        real_files="one drive: four sweeps, the stamps of 108 frames, tracklets of 15 objects",
        opens="farfield doctor 2011_09_26",
        source="https://www.cvlibs.net/datasets/kitti/raw_data.php",
        download="one short drive with its day's calibration",
        licence="CC BY-NC-SA 3.0",
    ),
)
