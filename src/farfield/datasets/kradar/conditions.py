"""The 58 published sequences of K-Radar: frames, weather, road and time (K-Radar supplement, Table 5).

It stands in for ``description.txt`` where a tree has none, such as one of annotations alone.
"""

from dataclasses import dataclass

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


@dataclass(frozen=True, kw_only=True)
class PublishedSequence:
    """What the supplement tells of one sequence; names are ours (``"light_snow"``, ``"parking_lot"``)."""

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


PUBLISHED = _parse()
"""The published sequences by name, ``"1"`` to ``"58"``; their frames sum to 34,994."""


def published_conditions(sequence: str) -> dict[str, str]:
    """Conditions of a published sequence; nothing for any other.

    >>> published_conditions("58")
    {'road': 'urban', 'time': 'day', 'weather': 'heavy_snow'}
    >>> published_conditions("59")
    {}
    """
    known = PUBLISHED.get(sequence)
    return {} if known is None else known.conditions
