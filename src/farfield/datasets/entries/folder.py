"""The entry of the format folder."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="folder",
    looked_for="*.pcd, *.ply, *.bin, *.npy, *.npz, *.xyz, *.las, *.laz or *.ffcloud, directly in the folder",
    recognises="farfield.datasets.recognition:is_folder",
    reader="farfield.datasets.folder:Folder",
    facts=FormatFacts(
        title="own folders",
        read="clouds (see below), labels.csv, images, calibration.yaml, times in names",
        real_files="PCD of SensorsCalibration, PandaSet and SUSTechPOINTS, .bin of KITTI, .xyz of Luminar sweeps, PLY "
        "of Argoverse 1, LAZ of aiMotive; of other LAS files and of npz no real file seen; "
        "of calibrations of ROS, OpenCV and Kalibr no real file seen",
        opens="farfield doctor my-sweeps",
        source="docs/own-data.md",
    ),
)
