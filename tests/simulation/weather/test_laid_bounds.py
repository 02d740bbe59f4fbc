"""What the presets' weathers hold, beside which laid weather is to lie, and sequences that take weathers in turn."""

import pytest

from farfield.errors import ConfigError
from farfield.simulation import find_preset
from farfield.simulation.overlay import preset_bounds


def test_bounds_hold_what_the_conditions_are_written_with():
    bounds = preset_bounds()
    assert bounds["coverage"]["sleet"][1] == pytest.approx(0.75)
    assert bounds["coverage"]["heavy_snow"][1] == pytest.approx(0.60)
    assert bounds["coverage"]["sleet"][0] == pytest.approx(0.75 * (1 - 1 / 2.71828), abs=0.02)
    assert [bounds["coverage"][name][1] for name in ("fog", "rain", "light_snow")] == pytest.approx([0.02, 0.03, 0.05])
    assert bounds["snow_mm_h"]["sleet"] == pytest.approx((1.5, 3.5), abs=0.02)
    assert bounds["rain_mm_h"]["rain"] == pytest.approx((2, 10), rel=0.02)
    assert bounds["fog_m"] == {"fog": pytest.approx((400, 1000), rel=0.02)}
    assert "normal" not in bounds["film_mm"]


def test_sequences_take_weathers_in_turn():
    conditions = [each.condition for each in find_preset("kradar-sim", weather="sleet,heavy_snow").segments]
    assert conditions == ["sleet", "heavy_snow"] * (len(conditions) // 2)
    assert {each.condition for each in find_preset("kradar-sim", weather="sleet").segments} == {"sleet"}
    plain = [each.condition for each in find_preset("kradar-sim").segments]
    assert len(set(plain)) == 7
    with pytest.raises(ConfigError, match="hail"):
        find_preset("kradar-sim", weather="sleet,hail")
