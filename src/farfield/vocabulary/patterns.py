"""The two scan patterns of Cirrus (Cirrus, section III-A): names of its clouds and of the simulator's."""

PATTERNS = ("gaussian", "uniform")

PATTERN_NOTES = dict(
    zip(
        PATTERNS,
        (
            "The Gaussian pattern packs its laser lines around the horizon, where far objects are.",
            "The uniform pattern spreads its lines evenly over the field of view.",
        ),
        strict=True,
    )
)
"""One sentence on each pattern, for readers of a report."""
