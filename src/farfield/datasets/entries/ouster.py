"""The entry of the format ouster."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="ouster",
    looked_for="*.pcap of an Ouster with the sensor's metadata beside it, *.json",
    recognises="farfield.datasets.recognition:is_ouster",
    reader="farfield.datasets.ouster:Ouster",
    facts=FormatFacts(
        title="Ouster captures",
        read="sweeps of a .pcap with rings, reflectivity and times of points; no boxes",
        real_files="five captures in three profiles, equal to the manufacturer's decoder; of dual returns and of "
        "firmware from 3.2 on no real file seen",
        opens="farfield doctor captures",
        source="https://static.ouster.dev/sensor-docs",
        download="captures of ouster-sdk's tests, some MB each",
    ),
)
