"""The entry of the format dual_radar."""

from farfield.datasets.formats import NO_REAL_FILE, Format, FormatFacts

FORMAT = Format(
    name="dual_radar",
    looked_for="[training/]arbe/*.bin and ars548/*.bin, or robosense/*.bin beside one of them",
    recognises="farfield.datasets.dual_radar:is_dual_radar",
    reader="farfield.datasets.dual_radar:DualRadar",
    facts=FormatFacts(
        title="Dual-Radar",
        read="LiDAR, Arbe and ARS 548 radars with Doppler, camera, boxes with tracks whose axes are decided by the "
        "points in them or said by --label-axes",
        real_files=NO_REAL_FILE,
        opens="farfield doctor DualRadar",
        source="https://github.com/adept-thu/Dual-Radar",
        licence="CC BY-NC-ND",
    ),
)
