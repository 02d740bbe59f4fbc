"""The entry of the format t4."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="t4",
    looked_for="[<id>/][<version>/]annotation/sample_data.json and the other tables",
    recognises="farfield.datasets.nuscenes.dialects:is_t4",
    reader="farfield.datasets.nuscenes.reader:T4Data",
    facts=FormatFacts(
        title="Tier IV T4",
        read="LiDAR (.pcd.bin of four or more columns, .pcd), radars (.pcd), cameras, boxes with velocities, tracks, "
        "attributes and official counts of points, ego poses; annotations in images and the car's state are named as "
        "not read",
        real_files="the sample of three frames in the tests of t4-devkit, whose points are made up",
        opens="farfield doctor t4dataset",
        source="https://github.com/tier4/t4-devkit/tree/main/docs/schema",
    ),
)
