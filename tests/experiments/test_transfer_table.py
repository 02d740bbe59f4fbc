"""The table of transfer: what is declared, that a tiny one runs, resumes and decides, and its text."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("embreex")

from farfield.cli import main
from farfield.errors import FileFormatError
from farfield.experiments.reproduce.scoring import json_of_sample
from farfield.experiments.reproduce.transfer import Transfer, cells_of, lines_of, load_table, runs_of
from farfield.experiments.reproduce.transfer.deciding import by_row
from farfield.experiments.reproduce.transfer.declared import experiment_tree
from farfield.experiments.schema import experiment_of
from farfield.metrics.deciding import Sample

SHIPPED, ANY = load_table(), Path("any")


def test_what_is_declared_comes_to_runs_in_two_waves():
    first, rest = runs_of(SHIPPED)
    assert {run.row for run in first} == {"radiate", "kradar_source", "left_still"}
    assert len(first) == 9
    assert len(first) + len(rest) == 3 * (8 * 3 + 2)
    assert len({run.folder for run in first + rest}) == len(first) + len(rest)
    assert [run.seed for run in rest] == sorted(run.seed for run in rest), "seed by seed"
    for run in first + rest:
        experiment_of(experiment_tree(SHIPPED, run, data=ANY, start=ANY if run in rest else None))


def test_the_sides_rows_are_not_flipped_and_their_control_is():
    tree = {run.row: experiment_tree(SHIPPED, run, data=ANY, start=None) for wave in runs_of(SHIPPED) for run in wave}
    flips = {name: each["augmentation"]["flip_probability"] for name, each in tree.items()}
    assert {name for name, flip in flips.items() if flip == 0} == {
        "left_still",
        "right",
        "right_from_left",
        "right_from_flipped",
    }
    assert flips["radiate"] == 0.5, "what right_from_flipped starts from"


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
    one = Sample(value=value, draws=draws, drawn="the same", grouped_by="sequences", groups=groups)
    said = {"row": row, "share": share, "seed": seed, "clock": {"processor_s": 30.0}}
    return {**said, "value": value, "sample": json_of_sample(one)}


def test_a_gain_is_decided_and_no_gain_is_not():
    scores = []
    for seed in range(3):
        noise = 0.004 * (seed - 1)
        scores += [scored("radiate", s, seed, 0.3 + noise) for s in SHIPPED.shares]
        scores += [scored("radiate_from_kradar", s, seed, (0.5 if s < 0.1 else 0.301) - noise) for s in SHIPPED.shares]
    cells = {(cell.compared.id, cell.share): cell.decision for cell in cells_of(SHIPPED, by_row(scores))}
    assert cells["T1", 0.05].verdict == "holds"
    assert cells["T1", 1.0].verdict == "undecided"
    assert set(cells) == {("T1", share) for share in SHIPPED.shares}
    text = "\n".join(lines_of(SHIPPED, scores))
    assert "0.300 (0.296 0.300 0.304)" in text
    assert SHIPPED.digest[:12] in text


def tiny(out):
    few = {"sequences": 2, "frames": 2, "stride_s": 0.25}
    worlds = {name: world.model_dump() for name, world in SHIPPED.worlds.items() if name != "right"}
    for name, world in worlds.items():
        mini = "kradar-sim-mini" if name == "kradar" else "radiate-sim-mini"
        for number, part in enumerate(("train", "val")):
            world[part] |= {**few, "preset": mini, "seed": number}
    rows = {name: SHIPPED.rows[name].model_dump() for name in ("radiate", "kradar_source", "radiate_from_kradar")}
    rows["radiate_from_kradar"]["reestimate_batches"] = 2
    changes = {
        "worlds": worlds,
        "rows": rows,
        "seeds": 2,
        "shares": [0.5, 1.0],
        "replicates": 20,
        "floor_frames": 2,
        "comparisons": [{"id": "T1", "words": "over none", "a": "radiate_from_kradar", "b": "radiate"}],
        "training": {**SHIPPED.training, "steps": 3, "batch_size": 1},
    }
    return Transfer(table=load_table(changes=changes), out=out)


@pytest.mark.slow
def test_a_tiny_table_runs_and_is_not_done_again(tmp_path):
    transfer = tiny(tmp_path)
    transfer.run()
    assert len(transfer.scores()) == 2 * (2 + 1 + 2)
    lines = transfer.write()
    assert any(line.startswith("T1 over none") for line in lines)
    stored = json.loads((tmp_path / "transfer.json").read_text())
    assert {(each["id"], each["share"]) for each in stored["comparisons"]} == {("T1", 0.5), ("T1", 1.0)}
    start = json.loads((transfer.runs_folder / "s0-radiate_from_kradar-050" / "start.json").read_text())
    assert start["share"] == 1.0, "one form, one network"
    weights = transfer.runs_folder / "s1-radiate-100" / "weights.safetensors"
    before = weights.stat().st_mtime_ns
    transfer.run()
    assert weights.stat().st_mtime_ns == before


def test_the_command_plans_and_knows_its_paper(capsys):
    assert main(["reproduce", "kradar", "--transfer", "--plan"]) == 0
    assert "78 runs of 300 steps, 9 of them to start from" in capsys.readouterr().out
    assert main(["reproduce", "cirrus", "--transfer", "--plan"]) == 1
    assert "kradar" in capsys.readouterr().err
