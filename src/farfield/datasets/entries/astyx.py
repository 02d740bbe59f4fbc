"""The entry of the format astyx."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="astyx",
    looked_for="[dataset_astyx_hires2019/]radar_6455/*.txt",
    recognises="farfield.datasets.recognition:is_astyx",
    reader="farfield.datasets.astyx:Astyx",
    facts=FormatFacts(
        title="Astyx HiRes2019",
        read="4D radar, LiDAR, camera, calibration, boxes with occlusion and certainty",
        real_files="ten frames with all sensors, 121 boxes",
        opens="farfield doctor dataset_astyx_hires2019",
        source="Meyer and Kuschk, Automotive Radar Dataset for Deep Learning Based 3D Object Detection, EuRAD 2019",
        licence="CC BY-NC-SA 4.0",
    ),
)
