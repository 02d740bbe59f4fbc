"""The entry of the format radiate."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="radiate",
    looked_for="[<sequence>/]Navtech_Polar/*.png or [<sequence>/]Navtech_Cartesian/*.png",
    recognises="farfield.datasets.recognition:is_radiate",
    reader="farfield.datasets.radiate:Radiate",
    facts=FormatFacts(
        title="RADIATE",
        read="turning radar (polar and Cartesian), LiDAR, stereo cameras, boxes with tracks, times",
        real_files="the SDK's sample: nine turns with sweeps and images, annotations of 18",
        opens="farfield doctor radiate/tiny_foggy",
        source="https://github.com/marcelsheeny/radiate_sdk",
        download="the SDK's sample, tiny_foggy",
        licence="CC BY-NC-SA 4.0",
    ),
)
