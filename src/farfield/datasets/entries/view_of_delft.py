"""The entry of the format view_of_delft."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="view_of_delft",
    looked_for="[lidar|radar|radar_3frames|radar_5frames]/training/velodyne/*.bin, with training/pose/*.json",
    recognises="farfield.datasets.view_of_delft.layout:is_view_of_delft",
    reader="farfield.datasets.view_of_delft.reader:ViewOfDelft",
    facts=FormatFacts(
        title="View-of-Delft",
        read="LiDAR, 3+1D radar of one, three and five sweeps, camera, boxes, tracks, poses; the official split by"
        " clip",
        real_files="two frames with LiDAR, radar, image, labels and pose",
        opens="farfield doctor view_of_delft_PUBLIC",
        source="https://github.com/tudelft-iv/view-of-delft-dataset",
        licence="research use, on request",
    ),
)
