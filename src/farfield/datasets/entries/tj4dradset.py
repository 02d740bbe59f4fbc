"""The entry of the format tj4dradset."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="tj4dradset",
    looked_for="training/velodyne/*.bin, eight columns of which the fifth is the range",
    recognises="farfield.datasets.kitti.object:is_tj4dradset",
    reader="farfield.datasets.kitti.object:Tj4dRadSet",
    facts=FormatFacts(
        title="TJ4DRadSet",
        read="4D radar in KITTI's folders, boxes",
        real_files="the authors' sample: 41 frames of radar, 152 boxes; of LiDAR and images no real file seen",
        opens="farfield doctor TJ4DRadSet_4DRadar",
        source="https://github.com/TJRadarLab/TJ4DRadSet",
        download="the authors' sample of 41 frames, in their repository",
        licence="non-commercial research; the full set requires a signed agreement",
    ),
)
