"""Every class that the detector knows has a row, and all their mean one, in line, JSON and page; pages on demand."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

from farfield.cli import main
from farfield.datasets.folder import write_boxes
from farfield.frame import Boxes

PLACES = np.array([[12.0, 0.0, -1.2], [25.0, 4.0, -1.2], [9.0, -3.0, -1.1]])
NAMES = ["vehicle", "vehicle", "pedestrian"]


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """Two frames with two cars and a pedestrian each."""
    folder, random = tmp_path / "own", np.random.default_rng(4)
    folder.mkdir()
    sizes = np.array([[4.4, 1.8, 1.5], [4.4, 1.8, 1.5], [0.7, 0.7, 1.7]])
    boxes = Boxes(centre_m=PLACES, size_m=sizes, yaw_rad=np.zeros(3), label=NAMES)
    for name in ("0", "1"):
        ground = np.column_stack(
            [random.uniform(3, 60, 4000), random.uniform(-12, 12, 4000), random.normal(-2, 0.03, 4000)]
        )
        objects = [random.uniform(-0.5, 0.5, (400, 3)) * size + at for at, size in zip(PLACES, sizes, strict=True)]
        points = np.concatenate([ground, *objects])
        np.save(folder / f"{name}.npy", np.column_stack([points, np.full(len(points), 0.3)]).astype(np.float32))
        write_boxes(folder / f"{name}.json", boxes)
    return folder


def test_all_classes_and_their_mean_stand_in_line_json_and_page(
    own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = ["evaluate", "pointpillars-cirrus-sim", str(own), "--out", str(out), "--replicates", "0"]
    assert main([*words, "--range-bins-m", "0,30,60", "--no-report"]) == 0
    said = capsys.readouterr().out
    assert not (out / "report.html").exists()
    parts = json.loads((out / "evaluation.json").read_text())["parts"]["lidar"]
    rows = {name: row for name, row in parts["classes"].items() if row["figures"]}
    assert {name: row["annotated"] for name, row in rows.items()} == {"vehicle": 4, "pedestrian": 2}
    mean = parts["mean_of_classes"]
    assert (mean["of"], mean["annotated"]) == (["vehicle", "pedestrian"], 6)
    each = [row["figures"]["dds/0/map"] for row in rows.values()]
    assert mean["figures"]["dds/0/map"] == pytest.approx(sum(each) / 2)
    lines = {"vehicle": 4, "pedestrian": 2, "mean of 2 classes": 6}
    for name, number in lines.items():
        (line,) = re.findall(rf"^\W*{name}\s+{number}\s.*$", said, flags=re.MULTILINE)
        figures = (rows.get(name) or mean)["figures"]
        assert f"{figures['dds/0/map']:.3f}" in line
    assert main(["report", str(out)]) == 0, "the page is drawn when it is asked for"
    page = (out / "report.html").read_text()
    _, _, table = page.partition("<h2>All classes</h2>")
    for name in ("vehicle", "pedestrian", "mean of vehicle, pedestrian"):
        assert f'<th scope="row"><span>{name}</span></th>' in table


def test_the_bar_goes_on_while_the_page_is_drawn(own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from farfield.cli import evaluate
    from farfield.pages import evaluation_page

    events: list[str] = []

    def counted(items: object, what: str, **_: object) -> object:
        for each in items:  # type: ignore[attr-defined]
            events.append(what)
            yield each

    monkeypatch.setattr(evaluate, "bar", counted)
    monkeypatch.setattr(evaluation_page, "frame_pictures", lambda *_: events.append("a frame's pictures") or [])
    words = ["evaluate", "pointpillars-cirrus-sim", str(own), "--out", str(tmp_path / "out"), "--replicates", "0"]
    assert main([*words, "--shown-frames", "2"]) == 0
    assert events == ["drawing", "a frame's pictures"] * 2
