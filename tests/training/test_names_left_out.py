"""Training names the boxes that it takes for background because nobody said what they are."""

from pathlib import Path

import numpy as np
import pytest

from farfield.cli import main

torch = pytest.importorskip("torch")


def test_names_that_are_not_trained_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "own"
    folder.mkdir()
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform([8, 0, -2], [14, 4, 0], (400, 3)), np.full(400, 0.5)])
    lines = "".join(f"{n},Car,10.5,2,-1,4.4,1.8,1.5,0\n{n},Cone,20,{n},-1,1,1,1,0\n" for n in range(3))
    (folder / "labels.csv").write_text("frame,label,x,y,z,l,w,h,yaw_rad\n" + lines)
    for number in range(3):
        np.save(folder / f"{number}.npy", points.astype(np.float32))
    settings = [f"data.path={folder}", "data.split=null", "training.steps=1"]
    words = [word for setting in settings for word in ("-o", setting)]
    assert main(["train", "pointpillars-kitti", *words, "--out", str(tmp_path / "run")]) == 0
    text = " ".join(capsys.readouterr().err.split())
    assert "count as background: Cone (3)" in text
    assert "aliases={Cone: CLASS}" in text
