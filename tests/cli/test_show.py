"""show: one frame as a picture, the LiDAR's points or the radar's power, with boxes."""

import re
from pathlib import Path

import numpy as np
import pytest
from drive import frame
from PIL import Image
from street import write_street

from farfield.cli import main
from farfield.datasets.kradar import KRadarWriter
from farfield.figures.radar import radar_map
from farfield.frame import Annotation, Boxes, Cloud, Constant, Frame
from farfield.radar.axes import KRADAR_AXES
from farfield.radar.cells import cells_of_cube
from farfield.radar.products import zyx_cube
from farfield.vocabulary.kradar import KRADAR_ORIGIN_M

PAGE = Path(__file__).resolve().parents[2] / "docs" / "kradar.md"


@pytest.fixture(scope="module")
def kradar(tmp_path_factory):
    """A drive of one frame with the store's cells, and a strong echo 20 m ahead of the radar with a car round it."""
    folder = tmp_path_factory.mktemp("home")
    power = np.random.default_rng(1).exponential(10**10.9, KRADAR_AXES.shape[1:]).astype(np.float32)
    cells = cells_of_cube(zyx_cube(power), "wide")
    place = np.array([[20.0, 1.0, 0.0]])
    car = Boxes(
        centre_m=place + np.array(KRADAR_ORIGIN_M),
        size_m=np.array([[4.2, 2.0, 1.6]]),
        yaw_rad=np.zeros(1),
        label=["vehicle"],
    )
    writer = KRadarWriter(folder / "kradar")
    writer.write(frame(1, radar={"cells": cells}, load_annotation=Constant(Annotation(boxes=car, visibility=["R"]))))
    writer.finish()
    return folder / "kradar"


def colours(path: Path) -> int:
    return len(np.unique(np.asarray(Image.open(path).convert("RGB")).reshape(-1, 3), axis=0))


def test_the_radar_s_power_is_drawn(kradar, tmp_path, capsys):
    assert main(["show", str(kradar), "--radar", "--out", str(tmp_path / "map.png")]) == 0
    printed = capsys.readouterr().out
    assert f"picture: {(tmp_path / 'map.png').resolve()}" in printed
    assert "from cells" in printed
    assert colours(tmp_path / "map.png") > 200, "a map, not a blank sheet"


def test_a_lidar_frame_is_drawn(tmp_path, rng, capsys):
    root = write_street(tmp_path, rng)
    assert main(["show", str(root), "--frame", "2", "--out", str(tmp_path / "f.png")]) == 0
    assert (tmp_path / "f.png").stat().st_size > 10_000
    assert main(["show", str(root), "--frame", "3", "--out", str(tmp_path / "g.png")]) == 1
    assert "from 0 to 2" in capsys.readouterr().err
    assert main(["show", str(root), "--radar"]) == 1
    said = capsys.readouterr().err
    assert "no radar" in said
    assert "gaussian" in said


def test_the_map_shows_power_where_it_is(kradar):
    from farfield.datasets import open_dataset

    shown = open_dataset(kradar, reference="radar")[0]
    figure = radar_map(shown)
    (image,) = figure.axes[0].images
    left, right, low, high = image.get_extent()
    assert left < 0.5 < 70 < right
    assert low < -15 < 15 < high
    assert len(figure.axes[0].collections) == 2, "outline and heading of the annotated car"
    assert "dB" in figure.axes[1].get_ylabel() + figure.axes[1].get_xlabel()
    wrong = open_dataset(kradar)[0]
    with pytest.raises(Exception, match="reference='radar'"):
        radar_map(wrong)


def test_points_of_a_radar_do_where_there_is_no_product():
    points = np.random.default_rng(2).uniform([1, -10, -1], [50, 10, 1], (40, 3)).astype(np.float32)
    rcs = np.linspace(-20, 30, 40, dtype=np.float32)
    shown = Frame.of(Cloud(points, None, {"rcs_dbsm": rcs}), name="radar")
    figure = radar_map(shown)
    np.testing.assert_array_equal(figure.axes[0].collections[0].get_array(), rcs)
    assert "RCS" in figure.axes[1].get_ylabel() + figure.axes[1].get_xlabel()


def test_the_ten_lines_of_the_page_run(kradar, tmp_path, monkeypatch, capsys):
    section = PAGE.read_text(encoding="utf-8").partition("## Radar cells read back")[2]
    (block,) = re.findall(r"^```python\n(.*?)^```", section.partition("\n## ")[0], flags=re.MULTILINE | re.DOTALL)
    assert 5 <= len([line for line in block.splitlines() if line.strip()]) <= 10
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "kradar").symlink_to(kradar)
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(compile(block, PAGE.name, "exec"), names)
    assert names["cells"].points_m().shape == (len(names["cells"].power), 3)
    assert colours(tmp_path / "power.png") > 200
    assert "farfield show data/kradar --radar" in section
