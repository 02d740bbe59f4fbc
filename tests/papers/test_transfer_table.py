"""The table of transfer: what is declared, that a tiny one runs, resumes and decides, and its text."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("embreex")


from farfield.cli import main
from farfield.errors import FileFormatError
from farfield.metrics.deciding import ScoreSample
from farfield.papers.jobs import TrainingJob, waves
from farfield.papers.planning import RunRate
from farfield.papers.scoring import json_of_sample
from farfield.papers.transfer import TransferExperiment, cells_of, lines_of, load_table, transfer_jobs
from farfield.papers.transfer.experiment import core_seconds
from farfield.papers.transfer.page import render, write_transfer
from farfield.papers.transfer.results import by_row, tree_of
from farfield.papers.transfer.table import share_of

SHIPPED, DATA, RUNS = load_table(), Path("data"), Path("runs")


@pytest.fixture(scope="module")
def jobs() -> list[TrainingJob]:
    return transfer_jobs(SHIPPED, DATA, RUNS)


def test_what_is_declared_comes_to_runs_in_two_waves(jobs: list[TrainingJob]):
    first, rest = waves(jobs)
    turned = {"left_turned", "power_turned", "coarse_turned"}
    assert {job.runs[0] for job in first} == {"radiate", "kradar_source", "left_still", *turned}
    assert {share_of(job) for job in first} == {1.0}
    assert len(first) == 18
    by_share, by_count = 3 * 5, 5 * 5
    assert len(jobs) == 3 * (by_share + by_count + 5 + 2 + 3)
    assert len({job.folder for job in jobs}) == len(jobs)
    assert [job.seed for job in rest] == sorted(job.seed for job in rest), "seed by seed"
    assert {job.start for job in rest} - {""} == {job.folder for job in first}


def test_jobs_are_known_by_row_share_and_seed_and_start_from_weights(jobs: list[TrainingJob]):
    by_folder = {job.folder: job for job in jobs}
    job = by_folder["s1-radiate_from_kradar-005"]
    assert (job.runs, job.seed, share_of(job), job.clouds) == (("radiate_from_kradar",), 1, 0.05, ("radar",))
    assert job.start == "s1-kradar_source-100"
    tree = job.experiment.model_dump(mode="json")
    assert tree["training"]["start"]["weights"] == "runs/s1-kradar_source-100/weights.safetensors"
    assert tree["data"]["path"] == "data/left-train"
    coarse = by_folder["s0-coarse_turned-100"]
    assert coarse.experiment.data.path == Path("data/left-train"), "the data of another world"


def test_the_sides_rows_are_not_flipped_and_their_control_is(jobs: list[TrainingJob]):
    flips = {job.runs[0]: job.experiment.augmentation.flip_probability for job in jobs}
    assert {name for name, flip in flips.items() if flip == 0} == {
        "left_still",
        "right",
        "right_from_left",
        "right_from_flipped",
        "right_from_turned",
        "right_from_power",
        "right_from_coarse",
    }
    assert flips["radiate"] == 0.5, "what right_from_flipped starts from"


def test_the_target_comes_by_share_and_by_number_of_frames(jobs: list[TrainingJob]):
    rows = ("radiate", "radiate_from_kradar", "radiate_from_kradar_statistics", "radiate_from_kradar_frozen")
    for row in rows:
        counts = {SHIPPED.frames_of(row, share) for share in SHIPPED.shares_of(row)}
        assert counts >= {25, 100, 400, 500}
        assert {0.05, 0.25, 1.0} <= set(SHIPPED.shares_of(row))
    frozen = next(job for job in jobs if job.runs == ("radiate_from_kradar_frozen",))
    assert frozen.experiment.training.start.freeze == ("trunk",)


def test_each_cause_is_switched_on_alone():
    """What the sources of right_from_... differ in from left_turned: the flip, or the form of the clouds."""
    worlds = {name: world.model_dump(exclude={"words", "of"}) for name, world in SHIPPED.worlds.items()}
    for row, part in (("power_turned", {"floor_db", "db_per_one"}), ("coarse_turned", {"cell_m"})):
        assert SHIPPED.rows[row].flip == SHIPPED.rows["left_turned"].flip == 1.0
        world, usual = worlds[SHIPPED.rows[row].world], worlds["left"]
        assert {name for name in usual if world[name] != usual[name]} == {"form"}
        forms = (world["form"], usual["form"])
        assert {name for name in forms[0] if forms[0][name] != forms[1].get(name)} == part
    assert SHIPPED.rows["left_still"].flip == 0.0
    targets = [SHIPPED.rows[f"right_from_{name}"] for name in ("left", "turned", "power", "coarse")]
    assert {(row.world, row.flip) for row in targets} == {("right", 0.0)}


def test_a_row_without_steps_starts_from_another(jobs: list[TrainingJob]):
    training = next(job for job in jobs if job.runs == ("radiate_untrained_statistics",)).experiment.training
    assert training.steps == 0
    assert SHIPPED.frames_of("radiate_untrained_statistics", 1.0) == 100
    assert SHIPPED.frames_of("radiate_untrained", 1.0) == 0
    assert training.start.statistics.reestimate_batches == 50
    rows = {name: row.model_dump() for name, row in SHIPPED.rows.items()}
    rows["kradar"]["steps"] = 0
    with pytest.raises(FileFormatError, match="without steps"):
        load_table(changes={"rows": rows})
    worlds = {name: world.model_dump() for name, world in SHIPPED.worlds.items()}
    worlds["left_power"]["train"]["seed"] = 1
    with pytest.raises(FileFormatError, match="data of another world"):
        load_table(changes={"worlds": worlds})


def test_a_row_that_is_not_there_is_refused():
    rows = {name: row.model_dump() for name, row in SHIPPED.rows.items()}
    rows["kradar_from_radiate"]["start"] = "nothing"
    with pytest.raises(FileFormatError, match="starts from none"):
        load_table(changes={"rows": rows})
    with pytest.raises(FileFormatError, match="expected rows among"):
        load_table(changes={"comparisons": [{"id": "X", "words": "x", "a": "radiate", "b": "other"}]})


def scored(row, share, seed, value, groups=20):
    rng = np.random.default_rng(seed)
    draws = value + 0.002 * rng.standard_normal(50)
    one = ScoreSample(value=value, draws=draws, drawn="the same", grouped_by="sequences", groups=groups)
    said = {"row": row, "share": share, "seed": seed, "clock": {"processor_s": 30.0}}
    return {**said, "value": value, "sample": json_of_sample(one)}


def test_a_gain_is_decided_and_no_gain_is_not():
    scores = []
    for seed in range(3):
        noise = 0.004 * (seed - 1)
        scores += [scored("radiate", s, seed, 0.3 + noise) for s in SHIPPED.shares]
        scores += [scored("radiate_from_kradar", s, seed, (0.5 if s < 0.1 else 0.301) - noise) for s in SHIPPED.shares]
    cells = {(cell.comparison.id, cell.share): cell.decision for cell in cells_of(SHIPPED, by_row(scores))}
    assert cells["T1", 0.05].verdict == "holds"
    assert cells["T1", 1.0].verdict == "undecided"
    assert set(cells) == {("T1", share) for share in SHIPPED.shares}
    text = "\n".join(lines_of(SHIPPED, scores))
    assert "(0.296 0.300 0.304)" in text
    assert re.search(r"5 % +25  0\.300 \[0\.29\d, 0\.30\d\] \(0\.296 0\.300 0\.304\)", text)
    assert "over none: the first lies above at 5 %; the interval holds 0, so neither is shown, at" in text
    assert SHIPPED.digest[:12] in text


def tiny(out):
    few = {"sequences": 2, "frames": 2, "stride_s": 0.25}
    worlds = {name: SHIPPED.worlds[name].model_dump() for name in ("kradar", "left")}
    for name, world in worlds.items():
        mini = "kradar-sim-mini" if name == "kradar" else "radiate-sim-mini"
        for number, part in enumerate(("train", "val")):
            world[part] |= {**few, "preset": mini, "seed": number}
    rows = {name: SHIPPED.rows[name].model_dump() for name in ("radiate", "kradar_source", "radiate_from_kradar")}
    rows["radiate_from_kradar"]["reestimate_batches"] = 2
    rows["radiate"]["shares"] = rows["radiate_from_kradar"]["shares"] = None
    rows["untrained"] = {**rows["radiate_from_kradar"], "steps": 0, "shares": [1.0]}
    changes = {
        "worlds": worlds,
        "rows": rows,
        "seeds": 1,
        "shares": [0.5, 1.0],
        "replicates": 20,
        "floor_frames": 2,
        "comparisons": [{"id": "T1", "words": "over none", "a": "radiate_from_kradar", "b": "radiate"}],
        "training": {**SHIPPED.training, "steps": 3, "batch_size": 1},
    }
    return TransferExperiment(table=load_table(changes=changes), out=out)


@pytest.mark.first
@pytest.mark.slow
def test_a_tiny_table_runs_and_is_not_done_again(tmp_path):
    transfer = tiny(tmp_path)
    transfer.run()
    assert len(transfer.scores()) == 2 + 1 + 2 + 1
    lines = transfer.write()
    assert any(line.startswith("T1 over none") for line in lines)
    stored = json.loads((tmp_path / "transfer.json").read_text())
    assert {(each["id"], each["share"]) for each in stored["comparisons"]} == {("T1", 0.5), ("T1", 1.0)}
    start = json.loads((transfer.runs_folder / "s0-radiate_from_kradar-050" / "start.json").read_text())
    assert start["share"] == 1.0, "one form, one network"
    weights = transfer.runs_folder / "s0-radiate-100" / "weights.safetensors"
    before = weights.stat().st_mtime_ns
    transfer.run()
    assert weights.stat().st_mtime_ns == before
    assert all(scores["clock"]["processor_s"] > 0 for scores in transfer.scores())


def test_the_table_costs_what_its_parts_do(jobs: list[TrainingJob]):
    worlds = ("kradar", "left", "right")
    rates = {name: RunRate(step_s=0.2, begin_s=1.0, frame_s=0.1) for name in worlds}
    of_seed = [job for job in jobs if job.seed == 0]
    simulating, training = core_seconds(SHIPPED, dict.fromkeys(worlds, 1.0), rates, of_seed)
    frames = {"kradar": 116 + 58, "left": 500 + 58, "right": 116 + 58}
    assert simulating == pytest.approx(sum(frames.values()))
    trained, again = 48, 11  # two runs take no step, eleven estimate their statistics anew
    assert len(of_seed) == 50
    assert training == pytest.approx(0.2 * (trained * 300 + again * 50) + 0.1 * 50 * 58)


def test_scores_of_older_runs_hold_their_clock_and_failed_runs_do_not_count(tmp_path: Path):
    transfer = TransferExperiment(table=SHIPPED, out=tmp_path)
    trees = {
        "s0-radiate-100": scored("radiate", 1.0, 0, 0.3),
        "s1-radiate-100": {name: value for name, value in scored("radiate", 1.0, 1, 0.3).items() if name != "clock"},
        "s2-radiate-100": {"runs": ["radiate"], "seed": 2, "clouds": {}, "failed": "diverged: non-finite"},
    }
    for folder, tree in trees.items():
        (transfer.runs_folder / folder).mkdir(parents=True)
        (transfer.runs_folder / folder / "scores.json").write_text(json.dumps(tree))
    lines = [{"training_s": 9.0, "processor_s": 9.0}, {"training_s": 1.0, "processor_s": 2.0, "scoring_s": 1.0}]
    clock = transfer.runs_folder / "s1-radiate-100" / "clock.jsonl"
    clock.write_text("".join(json.dumps(line) + "\n" for line in lines))
    older, newer = transfer.scores()
    assert older["clock"] == {"processor_s": 30.0}
    assert newer["clock"] == {"training_s": 1.0, "processor_s": 2.0}
    assert newer["sample"] == older["sample"] | {"draws": newer["sample"]["draws"]}


@pytest.mark.slow
@pytest.mark.whole
def test_the_command_plans_what_fits_six_core_hours(capsys):
    assert main(["reproduce", "kradar", "--transfer", "--plan", "--seeds", "0"]) == 0
    said = capsys.readouterr().out
    assert "50 runs of 300 steps, 6 of them to start from" in said
    assert re.search(
        r"RADIATE-like alone .* 1  25 \(5 %\), 100 \(20 %\), 125 \(25 %\), 400 \(80 %\), 500 \(100 %\)", said
    )
    hours = re.search(r"about ([\d.]+) core-hours", said)
    assert hours is not None
    assert float(hours.group(1)) > 0


def test_the_table_of_transfer_is_of_one_paper(capsys):
    assert main(["reproduce", "cirrus", "--transfer", "--plan"]) == 1
    assert "kradar" in capsys.readouterr().err


def test_the_page_says_what_the_table_found(tmp_path):
    scores = []
    for seed in range(3):
        for share in SHIPPED.shares_of("radiate"):
            scores.append(scored("radiate", share, seed, 0.3 + 0.004 * (seed - 1)))
            scores.append(scored("radiate_from_kradar", share, seed, 0.5 if share < 0.1 else 0.301))
    tree = json.loads(json.dumps(tree_of(SHIPPED, scores, 150)))
    text = write_transfer(tmp_path / "report.html", tree).read_text()
    assert "Of 5 comparisons the first row lies above the second in 1, below it in 0; in 4 the interval" in text
    assert "AP of vehicles, bird&#39;s-eye view, overlap of 0.3" in text
    assert "30 of 150 runs done, 3 seeds, 300 steps each" in text
    assert "T1 K-Radar to RADIATE-like over none: the first lies above at 5 %;" in text
    assert "T3 RADIATE-like to K-Radar over none: not scored yet" in text
    assert "500 frames" in text
    assert "+0.200" in text
    assert text.count("<b>holds</b>") == 1
    empty = render(tree_of(SHIPPED, [], 150))
    assert "0 of 150 runs done, 0 seeds" in empty
