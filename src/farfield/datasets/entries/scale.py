"""The entry of the format scale."""

from farfield.datasets.formats import NO_REAL_FILE, Format, FormatFacts

FORMAT = Format(
    name="scale",
    looked_for="[<task>/]*.json of a frame each with points and device_position, the answer beside or above them",
    recognises="farfield.datasets.scale:is_scale",
    reader="farfield.datasets.scale:ScaleAi",
    facts=FormatFacts(
        title="Scale, LiDAR annotation tasks",
        read="JSON frames brought from the world into the device's coordinates by its pose, with intensity, devices "
        "and times of points; the answer's cuboids with tracks and attributes; images that lie there by the ends of "
        "their addresses, cameras but for skew and fisheye; no protobuf, radar points, colours, GPS, segmentation or "
        "2D boxes",
        real_files=NO_REAL_FILE,
        opens="farfield doctor task",
        source="https://docs.scale.com/reference/lidar-callback-format",
    ),
)
