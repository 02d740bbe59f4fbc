"""The entry of the format openlabel."""

from farfield.datasets.formats import NO_REAL_FILE, Format, FormatFacts

FORMAT = Format(
    name="openlabel",
    looked_for="[*/]*.json of OpenLABEL with clouds beside or below them",
    recognises="farfield.datasets.openlabel:is_openlabel",
    reader="farfield.datasets.openlabel:OpenLabel",
    facts=FormatFacts(
        title="OpenLABEL, labelled clouds",
        read="clouds by the streams' uri, the frames' names or numbers; cuboids of 9 or 10 numbers, objects over time, "
        "attributes, times; no relations, actions, or cuboids outside of frames",
        real_files=NO_REAL_FILE,
        opens="farfield annotate folder",
        source="https://www.asam.net/standards/detail/openlabel/",
    ),
)
