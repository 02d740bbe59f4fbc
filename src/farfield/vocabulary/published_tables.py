"""The tables of the two papers as numbers: by table, row, part of the data and metric.

Cirrus: Wang et al., "Cirrus: A Long-range Bi-pattern LiDAR Dataset", ICRA 2021, Tables I to VI; class vehicle with
large vehicle; DDS is ``dds``, wDDS ``wdds`` where epsilon is 0.006, else ``wdds_EPSILON``; VoxelNet and the Gaussian
pattern unless a row says otherwise. K-Radar: Paek et al., "K-Radar: 4D Radar Object Detection for Autonomous Driving in
Various Weather Conditions", NeurIPS 2022, Tables 3, 4 and 9; class Sedan, IoU 0.3, in per cent.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from farfield.errors import ConfigError
from farfield.vocabulary.conditions import WEATHERS

CIRRUS_PAPER = "Cirrus (Wang et al., ICRA 2021)"
KRADAR_PAPER = "K-Radar (Paek et al., NeurIPS 2022)"
OVERALL = "overall"
Figures = Mapping[str, Mapping[str, Mapping[str, float]]]


@dataclass(frozen=True, eq=False, kw_only=True)
class PublishedTable:
    """One table of a paper.

    Args:
        paper: The paper.
        number: The table's number as the paper prints it.
        title: What it shows.
        figures: By row, part (``"overall"``, ``"near"``, ``"weather/fog"``) and metric.
        names: What its rows are called.
        bins_m: From and to which range its parts reach, where they are ranges.
        per_cent: Metrics that stand in per cent.
    """

    paper: str
    number: str
    title: str
    figures: Figures
    names: Mapping[str, str] = field(default_factory=dict)
    bins_m: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    per_cent: frozenset[str] = frozenset()

    def at(self, row: str, part: str, metric: str) -> float | None:
        """A figure, scores as shares of 1; None where the paper prints none.

        Raises:
            ConfigError: If the table has no such row.
        """
        if row not in self.figures:
            raise ConfigError(
                f"{self.paper}, Table {self.number}: expected a row among {', '.join(self.figures)}; got {row!r}"
            )
        value = self.figures[row].get(part, {}).get(metric)
        return value if value is None or metric not in self.per_cent else value / 100


def _by_part(parts: tuple[str, ...], rows: Mapping[str, Mapping[str, tuple[float, ...]]]) -> Figures:
    """Rows that give each metric part by part."""
    return {
        row: {part: {metric: values[column] for metric, values in metrics.items()} for column, part in enumerate(parts)}
        for row, metrics in rows.items()
    }


def _overall(metrics: tuple[str, ...], rows: Mapping[str, tuple[float, ...]]) -> Figures:
    """Rows of one part, metric by metric."""
    return {row: {OVERALL: dict(zip(metrics, values, strict=True))} for row, values in rows.items()}


_DDS = ("dds", "wdds")
_RANGES_M = {"near": (0.0, 70.0), "mid": (70.0, 150.0), "far": (150.0, 250.0)}

CIRRUS_TABLES: dict[str, PublishedTable] = {
    table.number: table
    for table in (
        PublishedTable(
            paper=CIRRUS_PAPER,
            number="I",
            title="VoxelNet by scan pattern and range",
            figures=_by_part(
                (*_RANGES_M, OVERALL),
                {
                    "gaussian": {
                        "dds": (0.6954, 0.5594, 0.3412, 0.6444),
                        "wdds_0.003": (0.7112, 0.5612, 0.3517, 0.6546),
                        "wdds": (0.7232, 0.5885, 0.3884, 0.6630),
                        "wdds_0.009": (0.7421, 0.5904, 0.3908, 0.6691),
                    },
                    "uniform": {
                        "dds": (0.6297, 0.4888, 0.3012, 0.5672),
                        "wdds": (0.6618, 0.5013, 0.3234, 0.5908),
                    },
                },
            ),
            bins_m=_RANGES_M,
        ),
        PublishedTable(
            paper=CIRRUS_PAPER,
            number="II",
            title="Three detectors",
            figures=_overall(
                _DDS, {"voxelnet": (0.6444, 0.6630), "second": (0.6621, 0.6819), "pointrcnn": (0.6672, 0.6788)}
            ),
        ),
        PublishedTable(
            paper=CIRRUS_PAPER,
            number="III",
            title="Adapted across ranges, near 0-100 m to far 100-250 m",
            figures=_by_part(
                ("near", "far", OVERALL),
                {"adapted": {"dds": (0.7237, 0.6018, 0.6543), "wdds": (0.7291, 0.6098, 0.6825)}},
            ),
            bins_m={"near": (0.0, 100.0), "far": (100.0, 250.0)},
        ),
        PublishedTable(
            paper=CIRRUS_PAPER,
            number="IV",
            title="Adapted across devices, KITTI to Cirrus, by the share of Cirrus' labels",
            figures=_overall(
                _DDS,
                {
                    "pretrained": (0.6506, 0.6612),
                    "adapted_25": (0.6511, 0.6606),
                    "adapted_50": (0.6609, 0.6824),
                    "adapted_100": (0.6688, 0.6904),
                },
            ),
        ),
        PublishedTable(
            paper=CIRRUS_PAPER,
            number="V",
            title="Trained on one pattern, scored on the other",
            figures=_overall(_DDS, {"gaussian_to_uniform": (0.5492, 0.5523), "uniform_to_gaussian": (0.5514, 0.5713)}),
        ),
        PublishedTable(
            paper=CIRRUS_PAPER,
            number="VI",
            title="One model for both patterns: joint training on pairs, and adaptation without pairs",
            figures=_overall(
                _DDS,
                {
                    "joint_gaussian": (0.6692, 0.6770),
                    "joint_uniform": (0.5914, 0.6107),
                    "adapted_gaussian": (0.6865, 0.6991),
                    "adapted_uniform": (0.6057, 0.6212),
                },
            ),
        ),
    )
}
"""Cirrus, Tables I to VI."""

_BY_WEATHER = (OVERALL, *(f"weather/{name}" for name in WEATHERS))

KRADAR_TABLES: dict[str, PublishedTable] = {
    table.number: table
    for table in (
        PublishedTable(
            paper=KRADAR_PAPER,
            number="3",
            title="With and without height",
            figures=_overall(("ap_bev",), {"rtnh": (58.4,), "rtn": (50.67,)}),
            per_cent=frozenset({"ap_bev"}),
        ),
        PublishedTable(
            paper=KRADAR_PAPER,
            number="4",
            title="By weather: labels v1.0, narrow region, the development kit's first evaluation",
            figures=_by_part(
                _BY_WEATHER,
                {
                    "rtnh": {"ap3d": (47.4, 49.9, 56.7, 52.8, 42.0, 41.5, 50.6, 44.5)},
                    "rtn": {"ap3d": (40.1, 45.6, 48.8, 46.9, 32.9, 22.6, 36.8, 36.8)},
                    "pointpillars": {"ap3d": (45.4, 52.3, 61.0, 42.2, 44.5, 22.7, 40.6, 29.7)},
                },
            ),
            names={"rtnh": "RTNH (4D radar)", "rtn": "RTN (4D radar)", "pointpillars": "PointPillars (os2-64)"},
            per_cent=frozenset({"ap3d"}),
        ),
        PublishedTable(
            paper=KRADAR_PAPER,
            number="9",
            title="Two backbones of RTN, with their GPU memory in MB",
            figures=_overall(
                ("ap3d", "ap_bev", "memory_mb"),
                {"rtn_resnext101": (40.12, 50.67, 520.0), "rtn_resnet50": (39.86, 49.37, 257.0)},
            ),
            names={"rtn_resnext101": "2D-DCB-ResNext101", "rtn_resnet50": "2D-DCB-ResNet50"},
            per_cent=frozenset({"ap3d", "ap_bev"}),
        ),
    )
}
"""K-Radar, Tables 3, 4 and 9."""

PUBLISHED_TABLES: dict[str, dict[str, PublishedTable]] = {"cirrus": CIRRUS_TABLES, "kradar": KRADAR_TABLES}
"""The tables of each paper by number."""

# Figures of real data that a comparison prints beside its own, as text, since a figure's digits are part of it.
#
# The shares are those of three sweeps of a Luminar sensor that is a sister of Cirrus'. The radar's are read off the one
# range-azimuth map that K-Radar's repository shows (``plot_tes_ra.png``), except 0.693: that is ln 2, the median over
# the mean of single looks.

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
