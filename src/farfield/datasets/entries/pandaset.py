"""The entry of the format pandaset."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="pandaset",
    looked_for="[<scene>/]lidar/<number>.pkl.gz with lidar/poses.json",
    recognises="farfield.datasets.recognition:is_pandaset",
    reader="farfield.datasets.pandaset:PandaSet",
    facts=FormatFacts(
        title="PandaSet",
        read="both LiDARs with times of points and classes of points, boxes with tracks, six cameras, poses, GPS; "
        "pickles of pandas 1.0 to 1.2 and 1.5 to 2, which are not run; others are refused by name",
        real_files="scene 002, once in the devkit's repository (pickles of protocol 3): eleven sweeps, all boxes and "
        "classes of points, equal to pandas' own reading, and the cameras; files of pandas 1.0.3, 1.2.5, 1.5.3 and "
        "2.2.3 in protocols 3, 4 and 5",
        opens="farfield doctor pandaset",
        source="https://github.com/scaleapi/pandaset-devkit",
        download="one scene",
        licence="CC BY 4.0 and terms of its own",
    ),
)
