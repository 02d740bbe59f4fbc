"""Which of the kit's variants take a version of the labels."""

import pytest

from farfield.errors import ConfigError
from farfield.metrics.kradar.settings import VARIANTS, kradar_settings


def test_a_variant_of_other_labels_names_those_that_take_them():
    with pytest.raises(ConfigError) as caught:
        kradar_settings("kradar-compat:rtnh_wide", label_version="v2.1")
    said = str(caught.value)
    assert "label_version=v2.0" in said
    assert "old_as_shipped, old_yaw_fixed, revised_as_shipped, revised_yaw_fixed" in said
    assert "@0.3" in said
    assert "rtnh_narrow" not in said


def test_what_is_named_takes_them():
    taking = [name for name, fixed in VARIANTS.items() if "label_version" not in fixed]
    assert len(taking) == 16
    for name in taking:
        assert kradar_settings(f"kradar-compat:{name}", label_version="v2.1").label_version == "v2.1"


def test_where_no_variant_fits_none_is_named():
    with pytest.raises(ConfigError, match="no variant takes"):
        kradar_settings("kradar-compat:rtnh_wide", recall_points=7)


def test_a_bare_name_says_which_take_any_labels():
    with pytest.raises(ConfigError, match=r"any labels: old_as_shipped.*v2\.0 labels: rtnh_wide"):
        kradar_settings("kradar-compat:")
