"""K-Radar's published facts: 58 sequences, Ousters, regions, and how ``description.txt`` spells conditions."""

from collections.abc import Mapping
from dataclasses import dataclass

from farfield.vocabulary.conditions import condition_name, fits_kind

KRADAR_ORIGIN_M = (2.54, -0.3, -0.7)
"""Where K-Radar's radar stands in the frame of its os2-64, without rotation, in all sequences: x and y are in every
``calib_radar_lidar.txt``, z is in the development kit's configuration."""

OUSTER_LINES = {"os2-64": 64, "os1-128": 128}
"""Lines of each LiDAR."""

STEREO_CAMERAS = ("cam-front", "cam-right", "cam-rear", "cam-left")
"""Cameras, and folders of their pictures: each picture holds both eyes, the left one on the left."""

Bounds = tuple[float, float, float, float, float, float]

REGIONS_M: dict[str, Bounds] = {
    "narrow": (0.0, 72.0, -6.4, 6.4, -2.0, 6.0),
    "wide": (0.0, 72.0, -16.0, 16.0, -2.0, 7.6),
}
"""x, y and z from and to in the radar's frame: the driving corridor of benchmark v1.0, and that of v2.0."""

DESCRIPTION_ORDER = ("road", "time", "weather")
"""The order of the words in ``description.txt``."""

DESCRIPTIONS = ("description.txt", "info_condition/description.txt")
"""Where a sequence's description may stand below its folder."""

UTC_OFFSET_H = 9
"""Hours of Korea's time before UTC; the drives were there."""

HOURS: dict[str, tuple[int, int]] = {"day": (6, 16), "night": (20, 4)}
"""From which hour to which a drive counts as one by day or by night; between them it may be either (Table 8)."""

MEAN_SPEEDS_KMH: dict[str, tuple[float, float]] = {
    "urban": (0.0, 100.0),
    "highway": (40.0, 160.0),
    "alleyway": (0.0, 70.0),
    "university": (0.0, 70.0),
    "parking_lot": (0.0, 40.0),
    "shoulder": (0.0, 40.0),
}
"""Mean speeds that do not contradict a road. Table 8 says about 60 km/h in town and about 100 km/h on a highway; the
bounds are guesses wide enough for a jam in town and a slow lane, and of the other roads for what their words allow."""

_SPELLINGS = {
    "road": {"suburban": "countryside", "parking_lot": "parkinglots"},
    "weather": {"light_snow": "lightsnow", "heavy_snow": "heavysnow"},
}

# Sequence, frames, weather, road, time: K-Radar supplement, Table 5.
_TABLE = """
1 597 normal urban night
2 462 normal highway night
3 597 normal highway night
4 588 normal highway night
5 597 normal urban day
6 594 normal urban night
7 595 normal alleyway night
8 567 normal university night
9 833 normal highway day
10 1130 normal highway day
11 1195 normal highway day
12 888 normal highway day
13 227 overcast highway day
14 595 normal urban day
15 591 normal urban day
16 578 normal university day
17 593 normal university day
18 594 normal urban day
19 592 normal alleyway day
20 595 normal urban day
21 597 rain alleyway night
22 598 overcast urban night
23 598 rain urban night
24 598 rain urban night
25 597 rain urban night
26 597 rain suburban day
27 598 sleet suburban day
28 597 sleet mountain day
29 597 sleet mountain day
30 470 sleet parking_lot day
31 598 sleet suburban day
32 597 rain suburban day
33 598 rain suburban day
34 598 rain suburban night
35 597 sleet parking_lot night
36 597 sleet parking_lot night
37 597 sleet suburban night
38 597 fog mountain day
39 597 fog mountain day
40 598 fog mountain day
41 597 fog mountain day
42 598 light_snow urban day
43 598 light_snow urban day
44 597 fog shoulder day
45 592 fog shoulder day
46 598 heavy_snow highway night
47 266 heavy_snow highway night
48 443 light_snow highway night
49 598 light_snow highway night
50 597 sleet highway night
51 597 sleet highway night
52 598 sleet highway night
53 597 sleet highway day
54 601 heavy_snow urban day
55 494 heavy_snow urban day
56 598 heavy_snow urban day
57 598 heavy_snow urban day
58 598 heavy_snow urban day
"""

# Index of the radar's frame minus that of the LiDAR's, sequences 1 to 58, as every label file has it.
FRAME_DIFFERENCES = (
    *(32, 30, 30, 41, 31, 34, 33, 31, 23, 26, 33, 36, 39, 33, 37, 38, 35, 35, 37, 33, 4, 2, 2, 3, -1, 5, 4, 3, 0, 5),
    *(6, 5, 5, 3, 5, 5, 5, 8, 7, 4, 7, 9, 5, 9, 21, 5, 5, 5, 6, 7, 6, 2, 4, 6, 5, 6, 5, 5),
)


@dataclass(frozen=True, kw_only=True)
class PublishedSequence:
    """One row of the supplement's table; names are ours (``"light_snow"``, ``"parking_lot"``)."""

    frames: int
    weather: str
    road: str
    time: str

    @property
    def conditions(self) -> dict[str, str]:
        """Road, time and weather, as ``description.txt`` gives them."""
        return {"road": self.road, "time": self.time, "weather": self.weather}


def _parse() -> dict[str, PublishedSequence]:
    rows = (line.split() for line in _TABLE.strip().splitlines())
    return {
        name: PublishedSequence(frames=int(frames), weather=weather, road=road, time=time)
        for name, frames, weather, road, time in rows
    }


SEQUENCES = _parse()
"""The published sequences by name, ``"1"`` to ``"58"``; their frames sum to 34,994."""


def published_conditions(sequence: str) -> dict[str, str]:
    """Conditions of a published sequence, for trees without ``description.txt``; nothing for any other.

    >>> published_conditions("58")
    {'road': 'urban', 'time': 'day', 'weather': 'heavy_snow'}
    >>> published_conditions("59")
    {}
    """
    sequence_row = SEQUENCES.get(sequence)
    return {} if sequence_row is None else sequence_row.conditions


def frame_difference(sequence: str) -> int:
    """Radar index minus LiDAR index of a published sequence; 0 for any other."""
    number = int(sequence)
    return FRAME_DIFFERENCES[number - 1] if number <= len(FRAME_DIFFERENCES) else 0


def spelled(kind: str, name: str) -> str:
    """Our name of a road, time or weather in the spelling of ``description.txt``.

    >>> spelled("road", "suburban"), spelled("weather", "light_snow"), spelled("weather", "fog")
    ('countryside', 'lightsnow', 'fog')
    """
    return _SPELLINGS.get(kind, {}).get(name, name)


def format_description(conditions: Mapping[str, str]) -> str:
    """``road,time,weather`` in K-Radar's spelling."""
    return ",".join(spelled(kind, conditions[kind]) for kind in DESCRIPTION_ORDER) + "\n"


def parse_description(line: str) -> dict[str, str] | None:
    """Conditions by kind from the line of ``description.txt``, in our names; None where it is no three words.

    >>> parse_description("Parking Lot, day, light snow")
    {'road': 'parking_lot', 'time': 'day', 'weather': 'light_snow'}
    """
    names = [condition_name(word) for word in line.split(",")]
    if len(names) != len(DESCRIPTION_ORDER) or not all(names):
        return None
    conditions = dict(zip(DESCRIPTION_ORDER, names, strict=True))
    return conditions if all(fits_kind(name, kind) for kind, name in conditions.items()) else None


DESC_ORDER = ("time", "road", "weather")
"""The words of a ``desc`` text of the kit's results, a line each."""

CELLS_IN_VIEW = {"narrow": 102_966, "wide": 295_798, "cube": 7_732_075}
"""Cells of each region, and of the whole cube, that the radar's field of view holds."""
