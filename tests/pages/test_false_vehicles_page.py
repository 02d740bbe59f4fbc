"""The page of false vehicles: its title names the sweeps where they have a name."""

import pytest

pytest.importorskip("torch")

from farfield.datasets.memory import in_memory
from farfield.evaluation.donor_trial import DonorTrial, PastedCar
from farfield.pages.false_vehicles_page import render_false_vehicles


@pytest.mark.parametrize(
    ("name", "title"), [("", "False vehicles of mine<"), ("Astyx", "False vehicles of mine on Astyx<")]
)
def test_the_title_names_the_sweeps_if_they_have_a_name(name: str, title: str) -> None:
    trial = DonorTrial(sweeps=1, cars=[PastedCar(sweep=0, range_m=30.0, points=50, score=0.9)])
    assert title in render_false_vehicles(trial, in_memory([]), detector="mine", name=name)
