"""The entry of the format aimotive."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="aimotive",
    looked_for="[<split>/<condition>/]<session>/dynamic/raw-revolutions/*.{laz,las} or dynamic/box/3d_body/*.json",
    recognises="farfield.datasets.aimotive:is_aimotive",
    reader="farfield.datasets.aimotive:Aimotive",
    facts=FormatFacts(
        title="aiMotive Multimodal Dataset",
        read="LiDAR (LAZ, LAS), two radars with velocity, cameras, boxes with tracks and relative velocity, "
        "calibration of pinhole cameras; egomotion*.json and the calibration of fisheyes (model mei) are left out",
        real_files="one session of 50 frames with all sensors, 391 boxes; of egomotion*.json and LAS no real file seen",
        opens="farfield doctor aimotive/data/train",
        source="https://github.com/aimotive/aimotive-dataset-loader (its data)",
        download="the session in the loader's repository, 120 MB",
        extra="las",
        licence="CC BY-NC-SA 4.0",
    ),
)
