"""The entry of the format truckscenes."""

from farfield.datasets.formats import NO_REAL_FILE, Format, FormatFacts

FORMAT = Format(
    name="truckscenes",
    looked_for="v1.*-{mini,trainval,test}/sample_data.json and the other tables, without map.json",
    recognises="farfield.datasets.nuscenes.dialects:is_truckscenes",
    reader="farfield.datasets.nuscenes.reader:TruckScenesData",
    facts=FormatFacts(
        title="MAN TruckScenes",
        read="LiDARs with times of points, 4D radars, cameras, boxes with velocities, tracks, attributes and official "
        "counts of points, ego poses in UTM; motion of the cabin and weather are named as not read",
        real_files=NO_REAL_FILE,
        opens="farfield doctor man-truckscenes",
        source="https://github.com/TUMFTM/truckscenes-devkit/blob/main/docs/schema_truckscenes.md",
        download="v1.0-mini (ten scenes)",
        licence="CC BY-NC-SA 4.0",
    ),
)
