"""Outlines of cars, vans, buses and cabs: families of centre lines, windows, wheels, by published proportions.

Wheelbases, overhangs, heights of bonnet, belt and boot and the angles of the screens are those that makers publish for
common models of each family: wheelbase over length 0.58 for saloons and estates to 0.63 for small hatchbacks, screens
at 27 to 35 degrees (45 in vans), cowls at 0.95 to 1.15 m, belts at 0.93 to 1.1 m. How round the corners are, and how
far sides, belts and roofs lean in, is measured at nine parked cars in Ouster's openly licensed sweeps: the edges of
a front lie 0.25 to 0.35 m behind its middle, a belt 0.05 m and the roof's edge 0.3 to 0.4 m within the doors.
"""

from dataclasses import dataclass
from typing import NamedTuple


class Point(NamedTuple):
    """A point of the centre line over the body, and how the body falls off towards its edges there.

    Args:
        u: From the front (0) to the rear (1), as a share of the length.
        v: Height as a share of the height.
        half: Half width of the upper skin's edge as a share of half the width.
        drop: How much lower the edge is, as a share of the height; negative where it is higher (a load bed).
        bow: How much nearer to the middle of the car the edge is, as a share of the length.
        part: What follows: "apron", "face", "grille", "lamps", "bonnet", "screen", "roof", "boot" or "bed".
    """

    u: float
    v: float
    half: float
    drop: float
    bow: float
    part: str


@dataclass(frozen=True)
class Outline:
    """One family's shape.

    Args:
        points: The centre line, from the lower edge of the front bumper over the roof to that of the rear bumper.
        windows: Spans (from, to) of the side windows along the length.
        belt: Lower edge of the windows at the front and at the rear, as shares of the height.
        axles: Where the axles are along the length.
        seats: Where the backs of the rows of seats are along the length.
        floor: Height of floor and sills, as a share of the height.
        wheel: Radius of the wheels in metres.
        cover: Whether a shelf or a cover hides what lies behind the last seats.
        rails: Share of bodies with rails on the roof.
        rounding: How round the corners are beside a car's.
    """

    points: tuple[Point, ...]
    windows: tuple[tuple[float, float], ...]
    belt: tuple[float, float]
    axles: tuple[float, ...]
    seats: tuple[float, ...]
    floor: float = 0.155
    wheel: float = 0.32
    cover: bool = True
    rails: float = 0.0
    rounding: float = 1.0


def _nose(lip_v: float, bonnet_v: float, cowl_u: float, cowl_v: float, bow: float = 0.075) -> tuple[Point, ...]:
    """From the front bumper's lower edge to the foot of the windscreen."""
    middle_u, middle_v = 0.45 * cowl_u, bonnet_v + 0.52 * (cowl_v - bonnet_v)
    return (
        Point(0.012, lip_v, 0.84, 0.0, 0.9 * bow, "apron"),
        Point(0.0, lip_v + 0.14, 0.88, 0.0, bow, "face"),
        Point(0.010, bonnet_v - 0.10, 0.89, 0.0, bow, "grille"),
        Point(0.032, bonnet_v, 0.87, 0.030, 0.95 * bow, "bonnet"),
        Point(middle_u, middle_v, 0.90, 0.055, 0.35 * bow, "bonnet"),
        Point(cowl_u, cowl_v, 0.86, 0.040, 0.35 * bow, "screen"),
    )


def _tail(deck_v: float, lip_v: float, lip_u: float = 0.965, bow: float = 0.045) -> tuple[Point, ...]:
    """From the upper edge of the tail to the rear bumper's lower edge."""
    return (
        Point(lip_u, deck_v, 0.86, 0.030, bow, "lamps"),
        Point(lip_u + 0.35 * (1 - lip_u), deck_v - 0.16, 0.90, 0.0, bow, "face"),
        Point(1.0, lip_v + 0.18, 0.90, 0.0, bow, "apron"),
        Point(0.986, lip_v + 0.05, 0.82, 0.0, bow, "apron"),
    )


def _upright_tail(roof_u: float, roof_v: float, foot_v: float, lip_v: float, half: float) -> tuple[Point, ...]:
    """A tail with a hatch: from the roof's end down a steep screen to the bumper."""
    return (
        Point(roof_u, roof_v, half, 0.045, 0.02, "screen"),
        Point(0.970, foot_v, 0.87, 0.010, 0.040, "lamps"),
        Point(0.982, foot_v - 0.15, 0.90, 0.0, 0.040, "face"),
        Point(1.0, lip_v + 0.18, 0.90, 0.0, 0.045, "apron"),
        Point(0.988, lip_v + 0.05, 0.84, 0.0, 0.040, "apron"),
    )


_SALOON = Outline(
    (
        *_nose(0.145, 0.49, 0.255, 0.655),
        Point(0.43, 0.965, 0.635, 0.038, 0.02, "roof"),
        Point(0.53, 1.0, 0.650, 0.056, 0.0, "roof"),
        Point(0.68, 0.965, 0.625, 0.045, 0.015, "screen"),
        Point(0.845, 0.735, 0.74, 0.025, 0.025, "boot"),
        *_tail(0.715, 0.145),
    ),
    ((0.30, 0.500), (0.520, 0.680), (0.695, 0.765)),
    (0.645, 0.690),
    (0.195, 0.780),
    (0.52, 0.72),
)
_FASTBACK = Outline(
    (
        *_nose(0.140, 0.485, 0.260, 0.650),
        Point(0.44, 0.970, 0.630, 0.041, 0.02, "roof"),
        Point(0.54, 1.0, 0.640, 0.060, 0.0, "roof"),
        Point(0.70, 0.950, 0.610, 0.049, 0.015, "screen"),
        Point(0.905, 0.745, 0.76, 0.020, 0.025, "boot"),
        *_tail(0.735, 0.150, 0.972),
    ),
    ((0.31, 0.510), (0.530, 0.700), (0.715, 0.785)),
    (0.645, 0.695),
    (0.190, 0.785),
    (0.53, 0.73),
    wheel=0.335,
)
_SMALL_HATCH = Outline(
    (
        *_nose(0.140, 0.49, 0.215, 0.640, 0.080),
        Point(0.40, 0.955, 0.655, 0.034, 0.02, "roof"),
        Point(0.53, 1.0, 0.665, 0.053, 0.0, "roof"),
        *_upright_tail(0.895, 0.950, 0.640, 0.150, 0.620),
    ),
    ((0.265, 0.525), (0.545, 0.760), (0.775, 0.830)),
    (0.610, 0.665),
    (0.200, 0.822),
    (0.54, 0.78),
    wheel=0.30,
)
_HATCH = Outline(
    (
        *_nose(0.140, 0.485, 0.245, 0.645, 0.075),
        Point(0.425, 0.960, 0.645, 0.038, 0.02, "roof"),
        Point(0.545, 1.0, 0.660, 0.056, 0.0, "roof"),
        *_upright_tail(0.900, 0.940, 0.650, 0.150, 0.610),
    ),
    ((0.295, 0.530), (0.550, 0.745), (0.762, 0.820)),
    (0.625, 0.670),
    (0.205, 0.815),
    (0.545, 0.77),
    wheel=0.315,
)
_ESTATE = Outline(
    (
        *_nose(0.145, 0.49, 0.250, 0.650),
        Point(0.425, 0.965, 0.640, 0.038, 0.02, "roof"),
        Point(0.53, 1.0, 0.655, 0.053, 0.0, "roof"),
        Point(0.75, 0.985, 0.650, 0.049, 0.0, "roof"),
        *_upright_tail(0.915, 0.940, 0.655, 0.145, 0.625),
    ),
    ((0.295, 0.495), (0.512, 0.670), (0.690, 0.865)),
    (0.635, 0.670),
    (0.192, 0.775),
    (0.515, 0.70),
    rails=0.6,
)
_CROSSOVER = Outline(
    (
        *_nose(0.170, 0.53, 0.245, 0.665, 0.075),
        Point(0.40, 0.965, 0.675, 0.034, 0.02, "roof"),
        Point(0.52, 1.0, 0.690, 0.049, 0.0, "roof"),
        Point(0.74, 0.985, 0.680, 0.045, 0.0, "roof"),
        *_upright_tail(0.915, 0.945, 0.660, 0.165, 0.645),
    ),
    ((0.285, 0.495), (0.512, 0.685), (0.705, 0.840)),
    (0.635, 0.680),
    (0.197, 0.788),
    (0.515, 0.72),
    0.190,
    0.355,
    rails=0.5,
)
_LARGE_SUV = Outline(
    (
        *_nose(0.190, 0.575, 0.250, 0.680, 0.060),
        Point(0.375, 0.965, 0.745, 0.030, 0.015, "roof"),
        Point(0.48, 1.0, 0.755, 0.041, 0.0, "roof"),
        Point(0.76, 0.990, 0.750, 0.038, 0.0, "roof"),
        *_upright_tail(0.935, 0.955, 0.655, 0.185, 0.720),
    ),
    ((0.280, 0.460), (0.478, 0.645), (0.665, 0.895)),
    (0.640, 0.655),
    (0.180, 0.785),
    (0.49, 0.67, 0.84),
    0.205,
    0.39,
    cover=False,
    rails=0.6,
)
_MINIVAN = Outline(
    (
        *_nose(0.125, 0.455, 0.190, 0.590, 0.075),
        Point(0.375, 0.955, 0.715, 0.034, 0.02, "roof"),
        Point(0.50, 1.0, 0.730, 0.045, 0.0, "roof"),
        Point(0.76, 0.990, 0.725, 0.041, 0.0, "roof"),
        *_upright_tail(0.935, 0.955, 0.600, 0.135, 0.700),
    ),
    ((0.255, 0.455), (0.472, 0.675), (0.692, 0.885)),
    (0.560, 0.585),
    (0.185, 0.775),
    (0.46, 0.65, 0.82),
    0.110,
    0.335,
    cover=False,
    rails=0.4,
)
_COMPACT_MPV = Outline(
    (
        *_nose(0.135, 0.470, 0.205, 0.615, 0.080),
        Point(0.395, 0.955, 0.675, 0.034, 0.02, "roof"),
        Point(0.53, 1.0, 0.690, 0.049, 0.0, "roof"),
        *_upright_tail(0.905, 0.950, 0.620, 0.145, 0.670),
    ),
    ((0.255, 0.500), (0.518, 0.725), (0.742, 0.850)),
    (0.585, 0.620),
    (0.190, 0.805),
    (0.515, 0.74),
    0.125,
    0.325,
    rails=0.3,
)


def _pickup(cab_end: float, windows: tuple[tuple[float, float], ...], seats: tuple[float, ...]) -> Outline:
    """A pickup whose cab ends at a share of the length."""
    return Outline(
        (
            *_nose(0.205, 0.570, 0.245, 0.650, 0.045),
            Point(0.355, 0.965, 0.730, 0.030, 0.015, "roof"),
            Point(0.43, 1.0, 0.740, 0.041, 0.0, "roof"),
            Point(cab_end - 0.02, 0.970, 0.735, 0.050, 0.0, "screen"),
            Point(cab_end, 0.640, 0.90, 0.010, 0.0, "bed"),
            Point(cab_end + 0.012, 0.440, 0.95, -0.185, 0.0, "bed"),
            Point(0.978, 0.440, 0.95, -0.185, 0.0, "bed"),
            Point(0.982, 0.615, 0.94, 0.0, 0.004, "lamps"),
            Point(0.986, 0.455, 0.95, 0.0, 0.008, "face"),
            Point(1.0, 0.320, 0.92, 0.0, 0.014, "apron"),
            Point(0.990, 0.250, 0.86, 0.0, 0.014, "apron"),
        ),
        windows,
        (0.625, 0.640),
        (0.165, 0.780),
        seats,
        0.230,
        0.385,
        cover=False,
        rounding=0.7,
    )


_DOUBLE_CAB = _pickup(0.640, ((0.275, 0.440), (0.455, 0.590)), (0.435, 0.565))
_SINGLE_CAB = _pickup(0.500, ((0.275, 0.440),), (0.425,))


def _van(
    bonnet_v: float, cowl: tuple[float, float], header: tuple[float, float], windows: tuple[tuple[float, float], ...]
) -> Outline:
    """A van: a short nose, an upright body with a high roof, a flat tail."""
    return Outline(
        (
            *_nose(0.115, bonnet_v, *cowl, 0.065),
            Point(header[0], header[1], 0.800, 0.035, 0.02, "roof"),
            Point(header[0] + 0.10, 0.995, 0.835, 0.035, 0.0, "roof"),
            Point(0.60, 1.0, 0.850, 0.026, 0.0, "roof"),
            Point(0.968, 0.985, 0.845, 0.026, 0.004, "roof"),
            Point(0.978, 0.880, 0.890, 0.0, 0.008, "rear" if len(windows) < 2 else "screen"),
            Point(0.982, cowl[1], 0.95, 0.0, 0.012, "lamps"),
            Point(0.984, cowl[1] - 0.16, 0.96, 0.0, 0.012, "face"),
            Point(1.0, 0.230, 0.93, 0.0, 0.020, "apron"),
            Point(0.990, 0.140, 0.88, 0.0, 0.020, "apron"),
        ),
        windows,
        (cowl[1] - 0.02, cowl[1]),
        (0.178, 0.790),
        (0.36,) if len(windows) < 2 else (0.36, 0.55, 0.74),
        0.115,
        0.345,
        cover=False,
        rounding=0.6,
    )


_PANEL_VAN = _van(0.41, (0.150, 0.545), (0.300, 0.950), ((0.225, 0.370),))
_WINDOW_VAN = _van(0.43, (0.155, 0.560), (0.310, 0.955), ((0.230, 0.375), (0.400, 0.620), (0.645, 0.900)))
_HIGH_VAN = _van(0.36, (0.130, 0.480), (0.270, 0.860), ((0.195, 0.330),))

_BUS = Outline(
    (
        Point(0.006, 0.090, 0.92, 0.0, 0.014, "apron"),
        Point(0.0, 0.170, 0.95, 0.0, 0.016, "face"),
        Point(0.0, 0.250, 0.95, 0.0, 0.016, "grille"),
        Point(0.003, 0.300, 0.95, 0.0, 0.016, "face"),
        Point(0.004, 0.360, 0.95, 0.0, 0.016, "screen"),
        Point(0.020, 0.880, 0.94, 0.0, 0.012, "roof"),
        Point(0.045, 0.985, 0.93, 0.030, 0.004, "roof"),
        Point(0.50, 1.0, 0.93, 0.035, 0.0, "roof"),
        Point(0.975, 0.985, 0.93, 0.030, 0.0, "rear"),
        Point(0.990, 0.900, 0.95, 0.0, 0.006, "screen"),
        Point(0.994, 0.520, 0.96, 0.0, 0.008, "face"),
        Point(0.996, 0.340, 0.96, 0.0, 0.008, "lamps"),
        Point(1.0, 0.230, 0.95, 0.0, 0.010, "apron"),
        Point(0.996, 0.110, 0.94, 0.0, 0.010, "apron"),
    ),
    ((0.040, 0.165), (0.185, 0.560), (0.580, 0.940)),
    (0.385, 0.400),
    (0.215, 0.740),
    (0.09, 0.30, 0.46, 0.62, 0.86),
    0.095,
    0.48,
    cover=False,
    rounding=0.25,
)
_MINIBUS = _van(0.36, (0.110, 0.470), (0.225, 0.870), ((0.165, 0.265), (0.285, 0.560), (0.575, 0.920)))


def cab(bonnet: bool) -> Outline:
    """A lorry's cab by itself, over its engine or behind a bonnet; its rear is flat."""
    nose = (
        Point(0.020, 0.110, 0.90, 0.0, 0.05, "apron"),
        Point(0.0, 0.200, 0.94, 0.0, 0.06, "face"),
        Point(0.0, 0.300, 0.95, 0.0, 0.06, "grille"),
        Point(0.006, 0.400, 0.95, 0.0, 0.06, "face"),
        Point(0.015, 0.500, 0.95, 0.0, 0.06, "screen"),
        Point(0.130, 0.880, 0.93, 0.010, 0.04, "roof"),
    )
    long_nose = (
        Point(0.020, 0.140, 0.86, 0.0, 0.05, "apron"),
        Point(0.0, 0.240, 0.88, 0.0, 0.05, "grille"),
        Point(0.015, 0.430, 0.86, 0.0, 0.05, "face"),
        Point(0.040, 0.480, 0.84, 0.030, 0.04, "bonnet"),
        Point(0.380, 0.580, 0.86, 0.035, 0.01, "screen"),
        Point(0.470, 0.860, 0.84, 0.020, 0.01, "roof"),
    )
    start = 0.50 if bonnet else 0.16
    return Outline(
        (
            *(long_nose if bonnet else nose),
            Point(start + 0.15, 0.965, 0.93, 0.020, 0.0, "roof"),
            Point(0.930, 1.0, 0.92, 0.020, 0.0, "roof"),
            Point(0.980, 0.985, 0.93, 0.010, 0.0, "rear"),
            Point(1.0, 0.600, 0.96, 0.0, 0.0, "face"),
            Point(1.0, 0.300, 0.96, 0.0, 0.0, "apron"),
            Point(0.995, 0.200, 0.95, 0.0, 0.0, "apron"),
        ),
        ((start + 0.01, start + 0.35),),
        (0.50, 0.52),
        (0.22 if bonnet else 0.52,),
        (start + 0.36,),
        0.13,
        0.50,
        cover=False,
        rounding=0.5,
    )


OUTLINES: dict[str, tuple[tuple[float, Outline], ...]] = {
    "sedan": ((0.7, _SALOON), (0.3, _FASTBACK)),
    "hatch": ((0.45, _SMALL_HATCH), (0.55, _HATCH)),
    "estate": ((1.0, _ESTATE),),
    "suv": ((0.7, _CROSSOVER), (0.3, _LARGE_SUV)),
    "mpv": ((0.5, _MINIVAN), (0.5, _COMPACT_MPV)),
    "pickup": ((0.75, _DOUBLE_CAB), (0.25, _SINGLE_CAB)),
    "bus": ((1.0, _BUS),),
    "minibus": ((1.0, _MINIBUS),),
    "van": ((0.4, _PANEL_VAN), (0.3, _WINDOW_VAN), (0.3, _HIGH_VAN)),
}
"""Families of each kind and their shares."""
