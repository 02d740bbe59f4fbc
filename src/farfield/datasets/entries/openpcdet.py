"""The entry of the format openpcdet."""

from farfield.datasets.formats import NO_REAL_FILE, Format, FormatFacts

FORMAT = Format(
    name="openpcdet",
    looked_for="points/*.npy or points/*.bin, with labels/*.txt or ImageSets/*.txt beside them",
    recognises="farfield.datasets.openpcdet:is_openpcdet",
    reader="farfield.datasets.openpcdet:OpenPcdet",
    facts=FormatFacts(
        title="Custom sets of OpenPCDet and mmdetection3d",
        read="LiDAR with all columns, images, boxes (z told from the points in them, or by --label-axes), the lists of "
        "ImageSets; no calibration, whose form no page says",
        real_files=NO_REAL_FILE,
        opens="farfield doctor data/custom",
        source="https://github.com/open-mmlab/OpenPCDet/blob/master/docs/CUSTOM_DATASET_TUTORIAL.md and "
        "https://github.com/open-mmlab/mmdetection3d/blob/main/docs/en/advanced_guides/customize_dataset.md",
    ),
)
