"""Cards beside derived files: source, licence, what may be passed on, commands; no path of the machine."""

from pathlib import Path

import numpy as np
import pytest

from farfield.cli import main
from farfield.cli._output import leave_card
from farfield.datasets.cards import CARD_NAME, TERMS, UNKNOWN_TERMS, terms_of, write_card
from farfield.datasets.formats import DATASETS, find_format


def test_every_licence_that_is_known_has_terms() -> None:
    licences = {name: find_format(name).facts for name in DATASETS.builtin}
    terms = {name: terms_of(facts.licence) for name, facts in licences.items() if facts and facts.licence}
    assert "no derivatives" in terms["kradar"]
    assert "non-commercial" in terms["kitti"]
    assert "non-commercial" in terms["astyx"]
    assert "consent" in terms["view_of_delft"]
    assert terms_of(None) == UNKNOWN_TERMS
    assert len({words for _, words in TERMS}) == len(TERMS)


def test_a_card_names_source_licence_and_commands_without_paths(tmp_path: Path) -> None:
    out = tmp_path / "store"
    out.mkdir()
    words = ["convert", str(tmp_path / "K-Radar"), str(out), "--to", "radar-store", "--workers", "2"]
    path = write_card(out, what="A radar store", sources=[("kradar", tmp_path / "K-Radar")], command=words)
    again = write_card(out, what="A radar store", sources=[("kradar", tmp_path / "K-Radar")], command=words[:-2])
    text = path.read_text("utf-8")
    assert path == again == out / CARD_NAME
    assert str(tmp_path) not in text
    assert "CC BY-NC-ND" in text
    assert text.count("    farfield convert K-Radar OUT --to radar-store\n") == 1
    write_card(out, what="A radar store", sources=[("kradar", tmp_path / "K-Radar")], command=["convert", "b", "c"])
    assert path.read_text("utf-8").count("    farfield ") == 2


def test_converting_leaves_a_card(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "own").mkdir()
    np.save(tmp_path / "own" / "0001.npy", np.random.default_rng(0).uniform(1, 30, (50, 4)).astype(np.float32))
    arguments = ["convert", str(tmp_path / "own"), str(tmp_path / "out"), "--to", "kitti", "--workers", "1"]
    assert main(arguments) == 0, capsys.readouterr().err
    text = (tmp_path / "out" / CARD_NAME).read_text("utf-8")
    assert "a folder of one's own" in text
    assert "    farfield convert own OUT --to kitti\n" in text


def test_sweeps_that_ship_and_data_in_a_tool_s_layout_are_told_apart(tmp_path: Path) -> None:
    """A card called the sweeps that ship somebody's own, and one's own clouds OpenPCDet's."""
    leave_card(tmp_path, "Weights", Path("open-sweeps"), weights=str(tmp_path / "first" / "weights.safetensors"))
    text = (tmp_path / CARD_NAME).read_text("utf-8")
    assert "Open Sweeps (open-sweeps)" in text
    assert "Apache-2.0 and BSD-3-Clause" in text
    assert "with its authors' licences and notices" in text
    assert "Weights at the start: weights.safetensors" in text
    assert str(tmp_path) not in text
    own = write_card(tmp_path, what="Boxes", sources=[("openpcdet", tmp_path / "mine")], command=["predict"])
    assert "- Source: mine, data of one's own in the layout of " in own.read_text("utf-8")
    owners = write_card(tmp_path, what="Boxes", sources=[("cirrus", tmp_path / "c")], command=["predict"])
    assert "- Source: Cirrus (Volvo) (c)" in owners.read_text("utf-8")
