"""The entry of the format kradar."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="kradar",
    looked_for="<sequence>/os2-64/*.pcd, <sequence>/radar_zyx_cube/*.mat, labels <radar>_<os2-64>.txt or another part",
    recognises="farfield.datasets.recognition:is_kradar",
    reader="farfield.datasets.kradar.reader:KRadar",
    facts=FormatFacts(
        title="K-Radar",
        read="os2-64 and os1-128 sweeps, 4D radar tensors, cubes, polar maps and clouds, cameras, odometry, labels"
        " of versions 1.0 to 2.1, weather, official split",
        real_files="all 34,994 label files of version 2.1, axes, splits, calibrations, three odometries; of its sweeps "
        "and tensors no real file seen",
        opens="farfield doctor kradar",
        source="https://github.com/kaist-avelab/K-Radar",
        download="the labels, 0.5 MB a sequence, then os2-64 of one sequence (at most 7 GB)",
        licence="CC BY-NC-ND",
    ),
)
