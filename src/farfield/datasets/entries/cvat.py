"""The entry of the format cvat."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="cvat",
    looked_for="[<task>/]annotations/*.json with point_clouds/, ann/ with pointcloud/, or tracklet_labels.xml",
    recognises="farfield.datasets.recognition:is_cvat",
    reader="farfield.datasets.cvat:Cvat",
    facts=FormatFacts(
        title="CVAT, point cloud tasks",
        read="clouds with Datumaro's or Supervisely's boxes, or KITTI raw's tracklets",
        real_files="KITTI's own tracklets; of Datumaro's and Supervisely's boxes no real file seen",
        opens="farfield annotate task",
        source="https://docs.cvat.ai/docs/manual/advanced/formats/",
    ),
)
