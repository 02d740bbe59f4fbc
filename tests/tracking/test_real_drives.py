"""Annotated boxes of real logs tracked back to their identities; skipped where these are not on the machine."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from farfield.tracking import track


@pytest.fixture
def drives(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    monkeypatch.syspath_prepend(str(request.config.rootpath / "benchmarks"))
    import tracking

    yield tracking
    for name in ("tracking", "_annotated_drives"):
        sys.modules.pop(name)


def figures(drives: Any, truth: Any, **options: Any) -> dict[str, float]:
    return dict(drives.scored(truth, track(drives.detected(truth, None), min_hits=1, **options), 2.0)["all"])


def test_argoverse2_is_tracked_whole_to_200_m(drives: Any, shared_real: Path) -> None:
    pytest.importorskip("pyarrow")
    got = figures(drives, drives.argoverse2(shared_real))
    assert (got["all_tracks/IDS"], got["tracking/IDF1"]) == (0, 1)


def test_boreas_and_radiate(drives: Any, shared_real: Path) -> None:
    assert figures(drives, drives.boreas(shared_real), max_age=10, gate_sigmas=None)["tracking/IDF1"] > 0.92
    assert figures(drives, drives.radiate(shared_real))["tracking/IDF1"] > 0.95


@pytest.mark.slow
@pytest.mark.whole
def test_kradar_is_tracked_back_to_its_identities(drives: Any, shared_real: Path) -> None:
    truth = drives.kradar(shared_real)
    assert sum(len(annotation.boxes) for annotation in truth.annotations.values()) == 114_976
    again = drives.split_identities(truth)
    assert (drives.identities(truth), drives.identities(again)) == (1699, 1993)
    assert figures(drives, again, **drives.NO_POSES)["tracking/IDF1"] >= 0.95


def test_a_simulated_road_has_radial_velocities_from_the_first_box(drives: Any) -> None:
    truth = drives.simulated("highway", sequence=0, frames=40)
    found = drives.detected(truth, drives.Noise(doppler_sigma_m_s=0.1))
    tracks = track(found, min_hits=2, unsure_hits=3, across_speed_m_s=3.0, range_sigma_m=0.3, azimuth_sigma_rad=0.009)
    errors = sorted(abs(error) for count, error in drives.radial_errors(truth, tracks) if count == 3)
    assert errors[int(0.68 * len(errors))] < 0.2
    without = drives.detected(truth, drives.Noise())
    for key, boxes in found.boxes.items():
        assert (without.boxes[key].centre_m == boxes.centre_m).all()
