"""Cards beside derived files: source, licence, what may be passed on, commands; no path of the machine."""

from pathlib import Path

import numpy as np
import pytest

from farfield.cli import main
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
