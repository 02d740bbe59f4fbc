"""The entry of the format captures."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="captures",
    looked_for="*.pcap or *.pcapng with packets of a Velodyne, or of a Hesai with its angles beside it, *.csv",
    recognises="farfield.datasets.recognition:is_captures",
    reader="farfield.datasets.captures:Captures",
    facts=FormatFacts(
        title="Velodyne and Hesai captures",
        read="sweeps of a .pcap or .pcapng with rings, both returns, reflectivity and times of points; no boxes; "
        "Velodyne VLP-16, Puck Hi-Res, VLP-32C, HDL-32E and VLS-128; Hesai Pandar40P, Pandar64, PandarQT64, QT128, "
        "PandarXT-16, XT-32 and XT-32M",
        real_files="packets of ten sensors from nebula's tests (VLP-16, VLP-32C, VLS-128 and the seven Hesais) against "
        "the clouds that it made of them; of captures as such, Puck Hi-Res and HDL-32E no real file seen",
        opens="farfield doctor captures",
        source="https://github.com/tier4/nebula",
        download=None,
    ),
)
