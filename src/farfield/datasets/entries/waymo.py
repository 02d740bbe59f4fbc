"""The entry of the format waymo."""

from farfield.datasets.formats import NO_REAL_FILE, Format, FormatFacts

FORMAT = Format(
    name="waymo",
    looked_for="[training/]vehicle_pose/<segment>.parquet with lidar/ or lidar_box/ beside it",
    recognises="farfield.datasets.recognition:is_waymo",
    reader="farfield.datasets.waymo:Waymo",
    facts=FormatFacts(
        title="Waymo Open Dataset v2 (Parquet)",
        read="five LiDARs with both returns and the top one's rolling shutter, boxes with tracks, speeds and official "
        "counts of points, five cameras, poses, weather; no segmentation, no maps",
        real_files=f"vehicle_pose of one segment, from the authors' tests; of all other components {NO_REAL_FILE}",
        opens="farfield doctor waymo_open_dataset_v_2_0_1",
        source="https://github.com/waymo-research/waymo-open-dataset/tree/master/src/waymo_open_dataset/v2",
        download="one segment: its file in each component, of which lidar and camera_image are large",
        extra="argoverse2",
        licence="Waymo's own, non-commercial",
    ),
)
