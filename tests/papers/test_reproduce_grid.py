"""The declared grids: what runs they have, which experiments these become, and what tells one run from another."""

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("torch")

from tinygrid import RUNS, tiny_grid

from farfield.errors import ConfigError, FileFormatError
from farfield.papers.claims import load as load_claims
from farfield.papers.claims.schema import BUDGETS
from farfield.papers.grid import LEAST_SEEDS, LEAST_STEPS, ExperimentGrid, load_grid, merge_trees
from farfield.papers.jobs import DataLocations, TrainingJob, jobs_of, waves
from farfield.papers.locations import locations_of
from farfield.papers.scoring import needs_of

PAPERS = ("cirrus", "kradar")
TABLES: dict[str, tuple[str, ...]] = {"cirrus": ("table2",), "kradar": ()}
"""Budgets of single tables, which stand beside those of rising size."""
FOLDER = Path("runs")


def jobs(grid: ExperimentGrid, budget: str = "laptop", **options: Any) -> list[TrainingJob]:
    claims = load_claims(grid.paper)
    locations = locations_of(grid, budget, Path("data"))
    data = DataLocations(locations=locations, fingerprints=options.pop("fingerprints", dict.fromkeys(locations, "")))
    return jobs_of(grid, budget, claims, data, options.pop("folder", FOLDER), **options)


@pytest.mark.parametrize("paper", PAPERS)
def test_shipped_budgets_keep_the_rules(paper: str) -> None:
    grid = load_grid(paper)
    assert tuple(grid.budgets) == (*BUDGETS, *TABLES[paper])
    for settings in grid.budgets.values():
        assert settings.seeds >= LEAST_SEEDS
        assert settings.least_steps == LEAST_STEPS
        assert min(settings.steps, *settings.steps_of.values(), settings.steps) >= LEAST_STEPS
        seeds = [each.seed for name, each in settings.sets.items() if name in ("train", "device", *settings.scored_on)]
        assert len(set(seeds)) == len(seeds)  # no road is learnt from and scored on


@pytest.mark.parametrize(
    ("paper", "budget"), [(paper, budget) for paper in PAPERS for budget in (*BUDGETS, *TABLES[paper])]
)
def test_every_run_of_every_budget_is_a_valid_experiment_and_method(paper: str, budget: str) -> None:
    from farfield.detectors import build_detector
    from farfield.training.method import METHODS
    from farfield.training.samples import batch_shares

    grid, built = load_grid(paper), set()
    for job in jobs(grid, budget):
        experiment = job.experiment
        assert experiment.training.steps >= LEAST_STEPS
        assert job.clouds
        method = {name: value for name, value in experiment.method.settings.items() if name != "start"}
        said = (job.network, experiment.method.name, repr(method))
        if budget in ("laptop", *TABLES[paper]) and said not in built and experiment.method.name != "continued":
            network = build_detector(experiment.detector, seed=0)
            made = METHODS[experiment.method.name](network, **method)
            data = experiment.data
            assert set(made.streams) == ({"labelled"} if not isinstance(data, dict) else set(data))
            counts = batch_shares(experiment.training.batch_size, made.streams)
            assert counts.get("target", 2) == counts.get("source", 2) == 2  # as many as a row of the target alone
            built.add(said)


@pytest.mark.parametrize("paper", PAPERS)
def test_every_run_of_the_claims_is_in_the_grid_or_known_to_be_missing(paper: str) -> None:
    claims, grid = load_claims(paper), load_grid(paper)
    for name in claims.runs:
        assert grid.runs[name].least_budget == claims.runs[name].least_budget, name


def test_sixteen_runs_a_seed_three_controls_and_table_two() -> None:
    laptop, desk = (load_grid("cirrus").runs_of(budget) for budget in ("laptop", "desk"))
    assert len(desk) == 16 + 3
    assert laptop.keys() - desk.keys() == {"voxelnet", "second", "pointrcnn"}
    assert len(jobs(load_grid("cirrus"))) == 22 * 3


def test_settings_of_the_window_reach_the_runs_that_name_them() -> None:
    changed = {job.runs[0]: job.experiment.augmentation.sparse_near for job in jobs(load_grid("cirrus"))}
    assert {name for name, sparse in changed.items() if sparse} == {"range_density"}
    assert changed["range_density"].near_m == 64
    assert changed["range_density"].far_m == (64, 160)


def test_jobs_come_seed_by_seed_and_starts_before_those_who_take_them() -> None:
    listed = jobs(load_grid("cirrus"))
    assert [job.seed for job in listed] == sorted(job.seed for job in listed)
    first, rest = waves(listed)
    assert {name for job in first for name in job.runs} == {"device_a"}
    assert [job.seed for job in rest] == sorted(job.seed for job in rest)
    given = {job.folder for job in first}
    assert {job.start for job in rest} == {"", *given}
    started = next(job for job in rest if job.runs == ("device_50",))
    assert started.experiment.method.settings["start"] == str(FOLDER / started.start)
    assert started.seed == next(job for job in first if job.folder == started.start).seed


def test_a_key_depends_on_what_decides_a_run_and_on_nothing_else(tmp_path: Path) -> None:
    grid = tiny_grid()
    before = {job.runs: job for job in jobs(grid)}
    assert {name for runs in before for name in runs} == set(RUNS)
    keys = [job.key for job in jobs(grid)]
    assert len(set(keys)) == len(keys) == 2 * len(RUNS)
    assert [job.key for job in jobs(grid, folder=tmp_path)] == keys  # paths do not count
    slower = grid.model_copy(update={"training": {**grid.training, "checkpoint_every_s": 99.0, "workers": 3}})
    assert [job.key for job in jobs(slower)] == keys
    other_data = jobs(grid, fingerprints={"train": "x", "val": "", "device": ""})
    changed = {job.runs for job, key in zip(other_data, keys, strict=True) if job.key != key}
    assert {name for runs in changed for name in runs} == set(RUNS) - {"device_a"}
    other_device = jobs(grid, fingerprints={"train": "", "val": "", "device": "x"})
    changed = {job.runs for job, key in zip(other_device, keys, strict=True) if job.key != key}
    assert {name for runs in changed for name in runs} == {"device_a", "device_pretrained"}  # by its start alone
    assert not {job.key for job in jobs(grid, steps_share=1.0)} - set(keys)


def test_table_two_alone_shows_every_row_equally_many_frames() -> None:
    listed = jobs(load_grid("cirrus"), "table2")
    assert [job.seed for job in listed] == sorted(job.seed for job in listed)
    rows = {"voxelnet", "second", "pointrcnn", "pointpillars", "sparsecentre"}
    assert {name for job in listed for name in job.runs} == rows
    assert len(listed) == 5 * 3
    trainings = [job.experiment.training.model_dump(exclude={"seed"}) for job in listed]
    assert all(training == trainings[0] for training in trainings)
    assert {job.clouds for job in listed} == {("gaussian",)}


def test_flags_for_all_trainings_stand_over_the_budget() -> None:
    grid = load_grid("cirrus")
    plain = jobs(grid, "table2")
    elsewhere = jobs(grid, "table2", training={"accelerator": "gpu"})
    assert {job.experiment.training.accelerator for job in elsewhere} == {"gpu"}
    assert [job.key for job in elsewhere] == [job.key for job in plain]
    other = jobs(grid, "table2", training={"precision": "bf16"})
    assert {job.experiment.training.precision for job in other} == {"bf16"}
    assert not {job.key for job in other} & {job.key for job in plain}


def test_equal_experiments_are_one_training() -> None:
    grid = load_grid("cirrus")
    listed = jobs(grid, "workstation")
    shared = [job for job in listed if len(job.runs) > 1]
    assert [job.runs for job in shared] == [("gaussian", "voxelnet")] * grid.budgets["workstation"].seeds
    assert len(listed) == (len(grid.runs_of("workstation")) - 1) * grid.budgets["workstation"].seeds


def test_rows_and_twins_take_equal_steps_and_equally_many_labelled_frames() -> None:
    by_run = {name: job.experiment for job in jobs(load_grid("cirrus")) if job.seed == 0 for name in job.runs}
    for row, twin in (("device_25", "target_25"), ("device_50", "target_50"), ("device_100", "gaussian")):
        assert by_run[row].training.steps == by_run[twin].training.steps
        target = by_run[row].data["target"]
        assert target.part == by_run[twin].data.part
    assert {by_run[name].training.batch_size for name in ("gaussian", "target_25", "range", "range_shuffled")} == {2}
    assert {by_run[name].training.batch_size for name in ("both_paired", "pattern_paired", "pattern_reversal")} == {4}
    assert by_run["device_25"].training.batch_size == 5  # two of the source, two labelled, one unlabelled


def test_lowered_steps_keep_their_floor() -> None:
    settings = load_grid("cirrus").budgets["laptop"]
    half = settings.lowered(0.5)
    assert (half.steps, half.steps_of["voxelnet"]) == (200, 200)
    assert settings.lowered(0.9).steps == 270
    assert settings.lowered(2.0).steps == settings.steps
    assert settings.lowered(1.0) == settings


def test_clouds_that_runs_are_scored_on_are_those_of_the_claims() -> None:
    clouds = {name: job.clouds for job in jobs(load_grid("cirrus")) for name in job.runs}
    assert clouds["gaussian"] == clouds["uniform"] == clouds["both_paired"] == ("gaussian", "uniform")
    assert clouds["device_a"] == clouds["range"] == ("gaussian",)
    kradar = {name: job.clouds for job in jobs(load_grid("kradar")) for name in job.runs}
    assert kradar["rtnh"] == ("radar",)
    assert kradar["pointpillars"] == ("os2-64",)


def test_numbers_that_claims_compare_are_in_the_ranges_of_their_table() -> None:
    grid = load_grid("cirrus")
    needs = {need.name for need in needs_of(load_claims("cirrus"), grid, grid.budgets["laptop"].score)}
    assert "I: dds/0/dds (96-160)" in needs  # the paper's 150-250 m times 160 / 250
    assert "III: dds/0/dds (0-64)" in needs
    assert "I: dds/0.009/dds (overall)" in needs


def test_real_data_take_the_place_of_simulated_ones(tmp_path: Path) -> None:
    grid = load_grid("cirrus")
    locations = locations_of(grid, "laptop", tmp_path, data=tmp_path)
    assert (locations["train"].split, locations["val"].split) == ("train", "val")
    assert locations["train"].simulated is None
    assert locations["device"].simulated is not None  # the other device stands in, unless given
    both = locations_of(grid, "laptop", tmp_path, data=tmp_path, source=tmp_path)
    assert both["device"].simulated is None
    kradar = load_grid("kradar")
    assert set(locations_of(kradar, "laptop", tmp_path, data=tmp_path)) == {"train", "val"}
    with pytest.raises(ConfigError, match="expected a folder"):
        locations_of(grid, "laptop", tmp_path, data=tmp_path / "none")


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="expected one of cirrus, kradar"):
        load_grid("nothing")
    wrong = tmp_path / "grid.yaml"
    wrong.write_text(
        "paper: cirrus\nreal: {}\nruns: {a: {words: a, streams: {x: {set: b, clouds: [c]}}}}\nbudgets: {}\nx: 1"
    )
    with pytest.raises(FileFormatError, match="x"):
        load_grid(wrong)
    tree = tiny_grid().model_dump()
    tree["budgets"]["laptop"]["sets"].pop("device")
    with pytest.raises(ValueError, match="expected a set among"):
        ExperimentGrid.model_validate(tree)
    with pytest.raises(ConfigError, match="budget: expected one of laptop"):
        jobs_of(tiny_grid(), "desk", load_claims("cirrus"), DataLocations(locations={}), FOLDER)


def test_trees_are_laid_over_one_another() -> None:
    assert merge_trees({"a": {"b": 1, "c": 2}}, {"a": {"c": 3}, "d": None}) == {"a": {"b": 1, "c": 3}, "d": None}
    assert merge_trees({"a": {"b": 1}}, {"a": None}) == {"a": None}
