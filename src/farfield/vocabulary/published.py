"""Figures of real data that a comparison prints beside its own, as text, since a figure's digits are part of it.

The shares are those of three sweeps of a Luminar sensor that is a sister of Cirrus'. The radar's are read off the one
range-azimuth map that K-Radar's repository shows (``plot_tes_ra.png``), except 0.693: that is ln 2, the median over the
mean of single looks.
"""

SHARES_NEAR_HORIZON = {"2": "0.31", "5": "0.68", "10": "0.955"}
"""Share of the Gaussian pattern's returns beyond 8 m within so many degrees of the horizon."""

RADAR_LEVELS = {
    "floor_db": "109.1",
    "floor_std_db": "0.30",
    "leakage_db": "42 to 50",
    "ring_db": "6 to 8",
    "dip_db": "-2",
    "rolloff_db": "-5",
    "wrap_db": "2 to 6",
    "cell_median_to_mean": "0.693",
}
"""Noise floor of a K-Radar map and what stands above it near the ends of its range, dB."""

RAISED_SHARES = {
    "6-12": "0.006",
    "12-20": "0.091",
    "20-30": "0.002",
    "30-45": "0.000",
    "45-75": "0.006",
    "75-107": "0.004",
}
"""Share of the map's cells 2 dB above its floor, by range in metres."""

ROW_QUANTILES_DB = {"5": "0.5", "25": "0.8", "50": "1.2", "75": "2.0", "95": "4.2"}
"""Quantiles of the strongest object's azimuth row, in per cent, above the floor."""
