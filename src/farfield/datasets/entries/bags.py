"""The entry of the format bags."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="bags",
    looked_for="metadata.yaml of a ROS 2 bag, or *.mcap, *.db3 or (ROS 1) *.bag in the folder, or bags in its folders",
    recognises="farfield.datasets.recognition:is_bags",
    reader="farfield.datasets.bags.reader:Bags",
    facts=FormatFacts(
        title="ROS bags",
        read="ROS 2 (MCAP, SQLite) and ROS 1: PointCloud2 with times of points, images (raw and compressed), tf and "
        "odometry; no boxes",
        real_files="a few small bags of ROS 2; real sweeps written as bags; of ROS 1 and of an FMCW LiDAR no real file "
        "seen",
        opens="farfield doctor drive_0001",
        source="https://mcap.dev/spec, https://docs.ros.org and https://wiki.ros.org/Bags/Format/2.0",
        extra="bags",
    ),
)
