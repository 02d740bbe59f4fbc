"""The entry of the format labelcloud."""

from farfield.datasets.formats import NO_REAL_FILE, Format, FormatFacts

FORMAT = Format(
    name="labelcloud",
    looked_for="[<project>/]pointclouds/ with labels/*.json, or clouds with labelCloud's JSON beside them",
    recognises="farfield.datasets.labelcloud:is_labelcloud",
    reader="farfield.datasets.labelcloud:LabelCloud",
    facts=FormatFacts(
        title="labelCloud, projects",
        read="clouds with boxes in the forms centroid_rel, centroid_abs and vertices, told file by file; "
        "no tracks, no segmentation",
        real_files=NO_REAL_FILE,
        opens="farfield annotate project",
        source="https://ch-sa.github.io/labelCloud",
    ),
)
