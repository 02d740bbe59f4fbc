"""Settings read from words, as the type of each field asks."""

from dataclasses import dataclass
from typing import Any

import pytest

from farfield.errors import ConfigError
from farfield.metrics import DdsSettings, KittiSettings, KRadarSettings
from farfield.metrics.options import read_option


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Of a protocol of another package."""

    distance_m: float = 2.0
    strict: bool = False


@pytest.mark.parametrize(
    ("settings", "name", "text", "value"),
    [
        (DdsSettings, "ap", "area", "area"),
        (DdsSettings, "thresholds_m", "0.5,1", (0.5, 1.0)),
        (DdsSettings, "aiou_threshold_m", "all", "all"),
        (DdsSettings, "aiou_threshold_m", "4", 4.0),
        (DdsSettings, "min_points", "5", 5),
        (DdsSettings, "relabel", "truck:vehicle,bus:vehicle", {"truck": "vehicle", "bus": "vehicle"}),
        (DdsSettings, "relabel", "", {}),
        (DdsSettings, "ignore", "a,b", ("a", "b")),
        (DdsSettings, "no_field", "1", "1"),
        (KittiSettings, "ignore", "", ()),
        (KittiSettings, "min_overlap", "0.5", 0.5),
        (KittiSettings, "dontcare", "image", "image"),
        (KRadarSettings, "azimuth_deg", "none", None),
        (KRadarSettings, "decimals", "2", 2),
        (KRadarSettings, "score_cut", "0.3", 0.3),
        (KRadarSettings, "classes", "vehicle", ("vehicle",)),
        (Settings, "distance_m", "3", 3.0),
        (Settings, "strict", "true", True),
    ],
)
def test_words_become_what_the_field_holds(settings: type, name: str, text: str, value: Any) -> None:
    found = read_option(settings, name, text)
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    ("settings", "name", "text", "message"),
    [
        (DdsSettings, "min_points", "1.5", "one number"),
        (DdsSettings, "thresholds_m", "near", "comma-separated numbers"),
        (DdsSettings, "relabel", "a", "old:new"),
        (Settings, "distance_m", "1,2", "one number"),
    ],
)
def test_other_words_are_refused(settings: type, name: str, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        read_option(settings, name, text)
