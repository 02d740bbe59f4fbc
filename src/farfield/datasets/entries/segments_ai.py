"""The entry of the format segments_ai."""

from farfield.datasets.formats import NO_REAL_FILE, Format, FormatFacts

FORMAT = Format(
    name="segments_ai",
    looked_for="a release's *.json of the task pointcloud-cuboid or pointcloud-cuboid-sequence, with clouds below it",
    recognises="farfield.datasets.segments_ai:is_segments_ai",
    reader="farfield.datasets.segments_ai:SegmentsAi",
    facts=FormatFacts(
        title="Segments.ai, releases",
        read="clouds, cuboids with tracks and attributes brought into each cloud by its ego pose; no images, no "
        "segmentation, no multi-sensor samples",
        real_files=NO_REAL_FILE,
        opens="farfield doctor release",
        source="https://docs.segments.ai/reference/label-types",
    ),
)
