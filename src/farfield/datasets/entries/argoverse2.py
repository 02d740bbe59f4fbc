"""The entry of the format argoverse2."""

from farfield.datasets.formats import Format, FormatFacts

FORMAT = Format(
    name="argoverse2",
    looked_for="<log>/sensors/lidar/*.feather, or <log>/annotations.feather alone",
    recognises="farfield.datasets.recognition:is_argoverse2",
    reader="farfield.datasets.argoverse2:Argoverse2",
    facts=FormatFacts(
        title="Argoverse 2, sensor logs",
        read="LiDAR, ring cameras, boxes with tracks and official counts of points, ego poses; logs of labels alone",
        real_files="two sweeps of one log with cuboids, calibration and poses; cuboids of 157 stamps of another",
        opens="farfield doctor av2/val",
        source="https://argoverse.github.io/user-guide/datasets/lidar.html",
        download="one log",
        extra="argoverse2",
        licence="CC BY-NC-SA 4.0",
    ),
)
