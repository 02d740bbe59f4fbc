"""The entry of the format open_sweeps."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="open_sweeps",
    looked_for="sweeps.json with *.sweep; those that ship go by the name open-sweeps in the place of a folder",
    recognises="farfield.datasets.open_sweeps:is_open_sweeps",
    reader="farfield.datasets.open_sweeps:OpenSweeps",
    facts=FormatFacts(
        title="Open Sweeps",
        read="real sweeps with boxes of what can be seen, ships with the package",
        real_files="all six sweeps, with 76 vehicles and 19 people and bicycles",
        opens="farfield doctor open-sweeps",
        source="docs/open-sweeps.md",
        download="none: 2.4 MB in the package",
        licence="Apache-2.0 and BSD-3-Clause, by sweep",
    ),
)
