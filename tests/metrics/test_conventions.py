"""Which results share a convention: what changes a figure counts, what does not does not."""

from typing import Any

import numpy as np
import pytest

from farfield.metrics import Bootstrap, score
from farfield.metrics.comparing import convention_of, convention_text, differing_settings, protocol_family

from .scenes import NO_BOOTSTRAP, random_scene


def result(rng_seed: int = 0, **options: Any) -> dict[str, Any]:
    predictions, annotations = random_scene(np.random.default_rng(rng_seed), frames=4)
    return score(predictions, annotations, **{"bootstrap": NO_BOOTSTRAP, **options}).to_json()


@pytest.mark.parametrize(
    ("protocol", "options", "differs"),
    [
        ("dds", {"bootstrap": Bootstrap(replicates=3)}, set()),
        ("dds", {"label": "pedestrian"}, set()),
        ("dds", {"epsilons": (0.0, 0.5)}, set()),
        ("dds", {"epsilons": (0.5,)}, {"epsilons"}),
        ("dds", {"ap": "voc"}, {"ap"}),
        ("dds", {"range_bins_m": (0.0, 100.0)}, {"range_bins_m"}),
        ("nuscenes", {"range_bins_m": (0.0, 100.0)}, set()),
        ("nuscenes", {"window_m": (0.0, 1.0, 0.0, 1.0)}, set()),
        ("kitti", {"min_overlap": 0.4}, {"min_overlap"}),
        ("kradar", {"ious": (0.4,)}, set()),
        ("kradar", {"classes": ("vehicle",)}, set()),
        ("kradar", {"range_bins_m": (0.0, 30.0)}, set()),
        ("kradar", {"boxes_in": "os2-64"}, set()),
        ("kradar", {"score_cut": 0.3}, {"score_cut"}),
        ("kradar", {"label_version": "v1.0"}, {"label_version"}),
        ("kradar", {"region": "narrow", "azimuth_deg": 50.0}, {"region", "azimuth_deg"}),
        ("kradar", {"yaw": "as_shipped", "recall_points": 11}, {"yaw", "recall_points"}),
    ],
)
def test_only_what_changes_figures_counts(protocol: str, options: dict[str, Any], differs: set[str]) -> None:
    plain, changed = result(protocol=protocol), result(protocol=protocol, **options)
    assert set(differing_settings(plain, changed)) == differs
    assert set(differing_settings(changed, plain)) == differs


def test_range_bins_count_where_ranges_are_looked_at() -> None:
    a, b = result(protocol="kradar"), result(protocol="kradar", range_bins_m=(0.0, 30.0))
    assert set(differing_settings(a, b, by_range=True)) == {"range_bins_m"}


def test_classes_count_where_empty_frames_are_dropped() -> None:
    a = result(protocol="kradar", empty_frames="dropped")
    b = result(protocol="kradar", empty_frames="dropped", classes=("vehicle",))
    assert set(differing_settings(a, b)) == {"classes"}


def test_a_variant_is_of_its_family_and_differs_from_it() -> None:
    a, b = result(protocol="kradar"), result(protocol="kradar-compat:revised_yaw_fixed")
    assert protocol_family(a) == protocol_family(b) == "kradar"
    expected = {"recall_points", "empty_frames", "outside", "decimals", "sampling", "order", "classes", "range_bins_m"}
    assert set(differing_settings(a, b)) == expected - {"range_bins_m"}
    assert "recall_points=41" in convention_text(b)
    assert convention_text(b).startswith("kradar-compat:revised_yaw_fixed: label_version=")
    assert "bootstrap" not in convention_of(a)
