"""Planning: what a grid costs, how steps are lowered to fit, which claims can be decided at a size."""

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("torch")

from tinygrid import tiny_grid

from farfield.errors import ConfigError
from farfield.papers import planning
from farfield.papers.claims import load as load_claims
from farfield.papers.grid import SimulatedSet, load_grid
from farfield.papers.jobs import DataLocations, TrainingJob, jobs_of
from farfield.papers.locations import locations_of
from farfield.papers.planning import (
    PAGE_S,
    RESERVE,
    SCORING_S,
    GridCost,
    GridPlan,
    RunRate,
    StepClock,
    cost_of,
    described,
    fit_steps,
    measure_simulating,
    outline_of,
    patience_s,
    trial_experiment,
    trial_set,
)
from farfield.papers.prospects import PowerEstimate, outlooks

CIRRUS = load_grid("cirrus")
LAPTOP = CIRRUS.budgets["laptop"]


def jobs() -> list[TrainingJob]:
    data = DataLocations(locations=locations_of(CIRRUS, "laptop", Path("data")))
    return jobs_of(CIRRUS, "laptop", load_claims("cirrus"), data, Path("runs"))


def alike(listed: list[TrainingJob], step_s: float) -> dict[str, RunRate]:
    return {job.kind: RunRate(step_s=step_s, begin_s=2.0, frame_s=0.1) for job in listed}


def test_cost_is_the_sum_of_its_parts() -> None:
    listed = jobs()
    cost = cost_of(listed, 1.0, LAPTOP, alike(listed, 0.5), {"train": 0.2, "device": 1.0}, 96)
    steps = 3 * (19 * 300 + 3 * 200)
    clouds = sum(len(job.clouds) for job in listed)
    assert cost.training == pytest.approx((len(listed) * 2.0 + steps * 0.5) / 60)
    assert cost.scoring == pytest.approx((clouds * (96 * 0.1 + SCORING_S) + PAGE_S) / 60)
    assert cost.simulating == pytest.approx((160 * 0.2 + 160 * 1.0) / 60)
    assert cost.core_minutes == pytest.approx(cost.training + cost.scoring + cost.simulating)
    pictured = cost_of(listed, 1.0, LAPTOP, alike(listed, 0.5), {"train": 0.2, "device": 1.0}, 96, beside_s=90.0)
    assert pictured.simulating == pytest.approx(cost.simulating + 1.5)  # frames that only the page shows
    assert pictured.core_minutes == pytest.approx(cost.core_minutes + 1.5)


def test_steps_are_lowered_until_it_fits_and_no_further_than_the_floor() -> None:
    listed = jobs()
    rates = alike(listed, 0.5)
    whole = cost_of(listed, 1.0, LAPTOP, rates, {}, 96).core_minutes
    assert fit_steps(listed, LAPTOP, rates, {}, 96, None)[0] == 1.0
    asked = (whole + 1) / (1 - RESERVE)
    assert fit_steps(listed, LAPTOP, rates, {}, 96, asked)[0] == 1.0
    assert fit_steps(listed, LAPTOP, rates, {}, 96, whole + 1)[0] < 1.0  # nothing would be left for what rates err by
    share, cost = fit_steps(listed, LAPTOP, rates, {}, 96, (whole - 10) / (1 - RESERVE))
    assert cost.core_minutes <= whole - 10
    assert LAPTOP.lowered(share).steps < 300
    assert cost_of(listed, share + 0.05, LAPTOP, rates, {}, 96).core_minutes > whole - 10
    with pytest.raises(ConfigError, match="fewest steps") as caught:
        fit_steps(listed, LAPTOP, rates, {}, 96, whole / 3)
    assert fit_steps(listed, LAPTOP, rates, {}, 96, asked, beside_s=120.0)[0] < 1.0
    least = cost_of(listed, 0.01, LAPTOP, rates, {}, 96).core_minutes
    assert f"at least {least:.0f} core minutes" in str(caught.value)
    assert fit_steps(listed, LAPTOP, rates, {}, 96, least + 1)[1].core_minutes == pytest.approx(
        least
    )  # no reserve left


def test_many_kinds_are_tried_no_longer_than_some() -> None:
    assert patience_s(1) == patience_s(4) == 60.0
    assert 22 * patience_s(22) == pytest.approx(240.0)
    assert patience_s(0) == 60.0


def test_kinds_are_what_a_step_does_not_what_it_learns_from() -> None:
    kinds = {name: job.kind for job in jobs() for name in job.runs}
    assert kinds["gaussian"] != kinds["both_paired"] != kinds["pattern_paired"] != kinds["voxelnet"]
    assert kinds["gaussian"] == kinds["target_25"] == kinds["target_50"]
    assert kinds["device_25"] == kinds["device_50"] != kinds["device_100"]
    assert len(set(kinds.values())) == 18  # of 22 runs


def test_a_trial_needs_neither_weights_nor_many_sequences() -> None:
    by_run = {name: job.experiment for job in jobs() for name in job.runs}
    continued = trial_experiment(by_run["device_pretrained"], 5)
    assert continued.method.name == "supervised"
    assert not continued.method.settings
    adapted = trial_experiment(by_run["device_25"], 5)
    assert "start" not in adapted.method.settings
    assert adapted.method.settings["rest_share"] == 0.5
    assert {group.part for group in adapted.data.values()} == {(0.0, 1.0)}
    assert adapted.training.steps == 5
    large = trial_experiment(
        by_run["device_25"].model_copy(
            update={"training": adapted.training.model_copy(update={"batch_size": 20, "workers": 2})}
        ),
        5,
        0.25,
    )
    assert (large.training.batch_size, large.training.workers) == (5, 0)
    assert trial_set(LAPTOP.sets["train"]).sequences == 3


class SlowToBegin:
    """A simulation whose process takes ten seconds before its first frame of a preset, and one for each frame."""

    def __init__(self) -> None:
        self.now, self.known = 0.0, set[str]()

    def process_time(self) -> float:
        return self.now

    def simulate(self, wanted: SimulatedSet, path: Path, **how: Any) -> None:
        self.now += 10.0 * (wanted.preset not in self.known) + wanted.sequences * wanted.frames
        self.known.add(wanted.preset)
        path.mkdir(parents=True)


def test_seconds_of_a_frame_leave_out_what_a_process_makes_once(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    slow = SlowToBegin()
    monkeypatch.setattr(planning, "time", slow)
    monkeypatch.setattr(planning, "simulate", slow.simulate)
    seconds, small = measure_simulating(
        locations_of(CIRRUS, "laptop", tmp_path / "data"), {"train"}, tmp_path / "scratch"
    )
    assert set(seconds) == set(LAPTOP.sets)
    assert set(seconds.values()) == {1.0}
    assert small["train"].simulated == trial_set(LAPTOP.sets["train"])


@pytest.mark.parametrize(
    ("times", "step_s", "begin_s"),
    [
        ([7.0], 7.0, 0.0),
        ([5.0, 6.0], 1.0, 4.0),
        ([5.0, 9.0, 10.0, 11.0], 1.0, 4.0),
        ([2.0 * n + 3 for n in range(20)], 2.0, 1.0),
    ],
)
def test_the_pace_leaves_out_what_comes_before_the_steps_are_settled(times, step_s: float, begin_s: float) -> None:
    clock = StepClock()
    clock.began, clock.times = (0.0, 100.0), [(time, 100 + 2 * time) for time in times]
    assert clock.rate(0, 0.1) == RunRate(step_s=step_s, begin_s=begin_s, frame_s=0.1)
    assert clock.rate(1, 0.1) == RunRate(step_s=2 * step_s, begin_s=2 * begin_s, frame_s=0.1)


def test_outlooks_follow_seeds_and_published_differences() -> None:
    claims, runs = load_claims("cirrus"), tuple(CIRRUS.runs_of("laptop"))
    by_claim: dict[str, list[PowerEstimate]] = {}
    for each in outlooks(claims, runs, LAPTOP):
        by_claim.setdefault(each.claim, []).append(each)
    assert [each.words for each in by_claim["C1"]][:3] == ["yes"] * 3
    assert by_claim["C6"][0].words == "hardly"
    assert by_claim["C12"][0].words == "no published difference"
    desk = outlooks(claims, tuple(CIRRUS.runs_of("desk")), CIRRUS.budgets["desk"])
    assert {each.words for each in desk if each.claim == "C4"} == {"not run at this budget"}
    assert "C0" not in by_claim  # of the data: nothing is trained
    more = outlooks(claims, runs, LAPTOP.model_copy(update={"seeds": 8}))
    few = outlooks(claims, runs, LAPTOP)
    powers = [next(each.power for each in found if each.claim == "C7") for found in (few, more)]
    assert powers[0] < powers[1]


def test_an_outline_is_kept_and_read_again() -> None:
    outline = GridPlan(
        budget="laptop",
        steps_share=0.9,
        steps={"grid": 270},
        jobs=57,
        rows=19,
        seeds=3,
        cost=GridCost(simulating=1.0, training=100.0, scoring=20.0),
        workers=2,
        outlooks=(PowerEstimate(claim="C1", power=0.9), PowerEstimate(claim="C4", power=None, runs=False)),
        paces={"a": RunRate(step_s=0.2, begin_s=1.0, frame_s=0.1)},
        simulating_s={"train": 0.3},
    )
    assert outline_of(outline.to_json()) == outline
    text = "\n".join(described(outline))
    assert "19 runs x 3 seeds, 57 trainings; steps: grid 270 (90% of those declared)" in text
    assert "121 core minutes" in text
    assert "= 60 minutes with 2 workers" in text
    assert "C1: yes" in text
    assert "C4: not run at this budget" in text


def test_a_tiny_budget_keeps_its_steps() -> None:
    settings = tiny_grid().budgets["laptop"]
    assert settings.lowered(0.1).steps == 4
