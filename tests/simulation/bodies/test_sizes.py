"""Size priors against the published means they are named after."""

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.frame import Boxes
from farfield.simulation.bodies.actors import (
    KRADAR_LABEL_M,
    draw_car,
    draw_size_m,
    draw_truck,
    inflated,
    label_inflation,
    mean_size_m,
)


def _cars(prior: str, rng: np.random.Generator, *, vans: bool) -> np.ndarray:
    kinds = [draw_car(rng, prior) for _ in range(3000)]
    return np.array([draw_size_m(kind, rng, prior) for kind in kinds if vans or kind != "van"])


def test_us_cars_are_near_the_means_of_nuscenes_and_lyft(rng: np.random.Generator) -> None:
    """4.62 x 1.96 x 1.74 and 4.76 x 1.92 x 1.72 m."""
    np.testing.assert_allclose(_cars("us", rng, vans=True).mean(axis=0), [4.78, 1.92, 1.69], atol=0.12)
    trucks = np.array([draw_size_m(draw_truck(rng, long_haul=False), rng) for _ in range(1000)])
    assert 7 < trucks[:, 0].mean() < 12
    assert 2.3 < trucks[:, 1].mean() < 2.85


def test_kitti_cars_have_the_mean_and_spread_of_its_labels(rng: np.random.Generator) -> None:
    """Cars 3.88 x 1.63 x 1.53 m, deviations 0.43, 0.10 and 0.14 m; vans 5.07 x 1.90 x 2.21 m."""
    sizes = _cars("kitti", rng, vans=False)
    np.testing.assert_allclose(sizes.mean(axis=0), [3.88, 1.63, 1.53], atol=0.03)
    assert (np.abs(sizes.std(axis=0) - [0.43, 0.10, 0.14]) < [0.12, 0.04, 0.05]).all()
    vans = np.array([draw_size_m("van", rng, "kitti") for _ in range(500)])
    np.testing.assert_allclose(vans.mean(axis=0), [5.07, 1.90, 2.21], rtol=0.03)


def test_korean_bodies_times_their_inflation_are_the_labels(rng: np.random.Generator) -> None:
    np.testing.assert_allclose(_cars("korea", rng, vans=False).mean(axis=0), [4.6, 1.9, 1.65], atol=0.03)
    body = _cars("korea", rng, vans=True)
    np.testing.assert_allclose(body.mean(axis=0) * label_inflation("vehicle"), KRADAR_LABEL_M["vehicle"], rtol=0.04)
    boxes = Boxes(
        centre_m=np.zeros((2, 3)),
        size_m=np.tile([4.6, 1.9, 1.65], (2, 1)),
        yaw_rad=np.zeros(2),
        label=["vehicle", "animal"],
    )
    grown = inflated(boxes).size_m / boxes.size_m
    assert 1.1 < grown[0, 1] < 1.25
    assert 1.1 < grown[0, 2] < 1.25
    np.testing.assert_allclose(grown[1], 1.15)


@pytest.mark.parametrize("prior", ["us", "kitti", "korea"])
def test_lengths_correlate_with_widths_and_heights(prior: str, rng: np.random.Generator) -> None:
    logs = np.log([draw_size_m("box", rng, prior) for _ in range(4000)])
    correlation = np.corrcoef(logs.T)
    assert correlation[0, 1] == pytest.approx(0.6, abs=0.05)
    assert correlation[0, 2] == pytest.approx(0.3, abs=0.05)
    assert (np.exp(logs) > 0.5 * np.array(mean_size_m("box", prior))).all()


def test_an_unknown_prior_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"sizes: expected one of us, kitti, korea; got 'mars'"):
        mean_size_m("sedan", "mars")
