"""The entry of the format nuscenes."""

from farfield.datasets.formats import NO_REAL_FILE, Format, FormatFacts

FORMAT = Format(
    name="nuscenes",
    looked_for="v1.0-*/sample_data.json and the other tables, map.json among them",
    recognises="farfield.datasets.nuscenes.dialects:is_nuscenes",
    reader="farfield.datasets.nuscenes.reader:NuScenesData",
    facts=FormatFacts(
        title="nuScenes",
        read="LiDAR, radars, cameras, sweeps by prev, boxes with velocities, tracks, attributes, visibility and "
        "official counts of points, ego poses; lidarseg, panoptic and maps are named as not read",
        real_files=NO_REAL_FILE,
        opens="farfield doctor nuscenes",
        source="https://github.com/nutonomy/nuscenes-devkit/blob/master/docs/schema_nuscenes.md",
        download="v1.0-mini (ten scenes, some 4 GB)",
        licence="CC BY-NC-SA 4.0",
    ),
)
