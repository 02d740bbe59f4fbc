"""The entry of the format cvat."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="cvat",
    looked_for="[<task>/]annotations/*.json with point_clouds/, or tracklet_labels.xml with velodyne_points/data",
    recognises="farfield.datasets.recognition:is_cvat",
    reader="farfield.datasets.cvat:Cvat",
    facts=FormatFacts(
        title="CVAT, point cloud tasks",
        read="clouds with Datumaro's boxes or KITTI raw's tracklets; a Sly Point Cloud export is of the format "
        "supervisely",
        real_files="KITTI's own tracklets; of Datumaro's boxes no real file seen",
        opens="farfield annotate task",
        source="https://docs.cvat.ai/docs/manual/advanced/formats/",
    ),
)
