"""The entry of the format supervisely."""

from farfield.datasets.formats import NO_REAL_FILE, Format, FormatFacts

FORMAT = Format(
    name="supervisely",
    looked_for="[<data set>/]annotation.json with frame_pointcloud_map.json, or ann/*.json with pointcloud/",
    recognises="farfield.datasets.supervisely:is_supervisely",
    reader="farfield.datasets.supervisely:Supervisely",
    facts=FormatFacts(
        title="Supervisely, point clouds and episodes",
        read="clouds, boxes, objects over time, tags of objects; CVAT's Sly Point Cloud exports, "
        "whose other axes the boxes' longer sides or --label-axes tell; no images",
        real_files=NO_REAL_FILE,
        opens="farfield annotate project",
        source="https://developer.supervisely.com/getting-started/supervisely-annotation-format/point-cloud-episodes",
    ),
)
