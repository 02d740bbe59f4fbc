"""The entry of the format sustechpoints."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="sustechpoints",
    looked_for="[<scene>/]lidar/*.pcd, with label/ or calib/ beside it",
    recognises="farfield.datasets.recognition:is_sustechpoints",
    reader="farfield.datasets.sustechpoints:SustechPoints",
    facts=FormatFacts(
        title="SUSTechPOINTS, scenes",
        read="PCD clouds, cameras, calibration, boxes with tracks",
        real_files="one sweep with three cameras and 21 boxes, labels of three more",
        opens="farfield annotate scene",
        source="https://github.com/naurril/SUSTechPOINTS",
    ),
)
