"""The entry of the format cirrus."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="cirrus",
    looked_for="dataset<N>_gaussian/*.xyz or dataset<N>_uniform/*.xyz, or the authors' dataset/raw_data/lidar/*.xyz",
    recognises="farfield.datasets.recognition:is_cirrus",
    reader="farfield.datasets.cirrus.reader:Cirrus",
    facts=FormatFacts(
        title="Cirrus (Volvo)",
        read="two LiDARs (Gaussian and uniform), front camera, boxes, classes, calibration; the authors' raw "
        "layout and others by a mapping",
        real_files="its layout with three sweeps of a sister sensor and 286 boxes; of Cirrus itself no real file seen",
        opens="farfield doctor Cirrus_dataset1",
        source="Wang et al., Cirrus: A Long-range Bi-pattern LiDAR Dataset, ICRA 2021, "
        "https://arxiv.org/abs/2012.02938",
        download="one segment, Cirrus_dataset1",
    ),
)
