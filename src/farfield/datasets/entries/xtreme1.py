"""The entry of the format xtreme1."""

from farfield.datasets.formats import NO_REAL_FILE, Format, FormatFacts

FORMAT = Format(
    name="xtreme1",
    looked_for="[<scene>/]lidar_point_cloud_0/, or point_cloud/ with result/, camera_config/ or data/",
    recognises="farfield.datasets.xtreme1:is_xtreme1",
    reader="farfield.datasets.xtreme1:Xtreme1",
    facts=FormatFacts(
        title="Xtreme1, data sets",
        read="clouds, camera images with their parameters, boxes with tracks and attributes; objects of "
        "images are passed over",
        real_files=NO_REAL_FILE,
        opens="farfield annotate scene",
        source="https://docs.xtreme1.io/xtreme1-docs/export-data/data-annotation-result",
    ),
)
