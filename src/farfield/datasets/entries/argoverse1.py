"""The entry of the format argoverse1."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="argoverse1",
    looked_for="[train1/]<log>/lidar/PC_*.ply, with labels, poses or a calibration beside lidar/",
    recognises="farfield.datasets.argoverse1:is_argoverse1",
    reader="farfield.datasets.argoverse1:Argoverse1",
    facts=FormatFacts(
        title="Argoverse 1, tracking logs",
        read="LiDAR (PLY), ring and stereo cameras, boxes with tracks and occlusion, city poses",
        real_files="one sweep and one calibration; of labels and poses no real file seen",
        opens="farfield doctor argoverse-tracking/sample",
        source="https://github.com/argoverse/argoverse-api",
        download="tracking_sample.tar.gz, one log",
        licence="CC BY-NC-SA 4.0",
    ),
)
