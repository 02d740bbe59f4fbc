"""The entry of the format zod."""

from farfield.datasets.formats import NO_REAL_FILE, Format, FormatFacts

FORMAT = Format(
    name="zod",
    looked_for="[single_frames/]<number>/lidar_velodyne/*_<time>Z.npy",
    recognises="farfield.datasets.recognition:is_zod",
    reader="farfield.datasets.zod:Zod",
    facts=FormatFacts(
        title="Zenseact Open Dataset, single frames",
        read="key sweeps and those round them with times of points and poses, boxes, objects of the picture alone as "
        "such, pictures without projection (fisheye); no oxts.hdf5, no drives, no sequences",
        real_files=NO_REAL_FILE,
        opens="farfield doctor zod",
        source="https://github.com/zenseact/zod",
        download="frames_mini",
        licence="CC BY-SA 4.0",
    ),
)
