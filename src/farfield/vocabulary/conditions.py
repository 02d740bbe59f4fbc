"""Weather, road and time of day: K-Radar's values in the order of its tables, their spellings, and their colours."""

from typing import Literal, get_args

Weather = Literal["normal", "overcast", "fog", "rain", "sleet", "light_snow", "heavy_snow"]
Time = Literal["day", "night"]
Side = Literal["right", "left"]
World = Literal["v2", "v3"]

WEATHERS: tuple[Weather, ...] = get_args(Weather)
ROADS = ("urban", "highway", "suburban", "alleyway", "parking_lot", "shoulder", "mountain", "university")
TIMES: tuple[Time, ...] = get_args(Time)
SIDES: tuple[Side, ...] = get_args(Side)
WORLDS: tuple[World, ...] = get_args(World)
"""On which side traffic keeps."""

CONDITIONS: dict[str, tuple[str, ...]] = {"weather": WEATHERS, "road": ROADS, "time": TIMES}
"""The values by kind, in the order of K-Radar's tables: with the whole set 18 subsets."""

UNKNOWN = "unknown"
"""Where nothing says what the condition was."""

WEATHER_COLOURS = {
    "normal": "#8a97a5",
    "overcast": "#495057",
    "fog": "#e67700",
    "rain": "#0b6e99",
    "sleet": "#c2255c",
    "light_snow": "#2b8a3e",
    "heavy_snow": "#7048e8",
    UNKNOWN: "#d8dee5",
}
TIME_COLOURS = {"day": "#f2b84b", "night": "#2f4b6e"}

_SPELLINGS = {
    "countryside": "suburban",
    "parkinglots": "parking_lot",
    "parkinglot": "parking_lot",
    "parking_lots": "parking_lot",
    "lightsnow": "light_snow",
    "heavysnow": "heavy_snow",
}


def fits_kind(name: str, kind: str) -> bool:
    """Whether a condition may be of a kind: a word that is known as another kind's is not, nor one of control letters.

    >>> fits_kind("night", "time"), fits_kind("night", "road"), fits_kind("tunnel", "road")
    (True, False, True)
    """
    others = {other for values in CONDITIONS.values() for other in values} - {*CONDITIONS[kind], UNKNOWN}
    return name.isprintable() and name not in others


def condition_name(text: str) -> str:
    """Our name of a road, time or weather in any spelling; a word that is none of them comes back in lower case.

    >>> condition_name("lightsnow"), condition_name("Parking Lot"), condition_name("countryside")
    ('light_snow', 'parking_lot', 'suburban')
    """
    plain = "_".join(text.strip().lower().replace("-", " ").replace("_", " ").split())
    return _SPELLINGS.get(plain, plain)
