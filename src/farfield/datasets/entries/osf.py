"""The entry of the format osf."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="osf",
    looked_for="*.osf of Ouster's tools",
    recognises="farfield.datasets.recognition:is_osf",
    reader="farfield.datasets.osf:Osf",
    facts=FormatFacts(
        title="Ouster OSF",
        read="sweeps of a .osf (version 2, packed as zpng or PNG) with rings, reflectivity, times of points and poses; "
        "no boxes",
        real_files="five captures that ouster-sdk 1.0.1 wrote as OSF, in both packings, equal to its own decoding; of "
        "recordings with several sensors, dual returns or poses no real file seen",
        opens="farfield doctor recordings",
        source="https://github.com/ouster-lidar/ouster-sdk",
        download=None,
        extra="sensors",
    ),
)
