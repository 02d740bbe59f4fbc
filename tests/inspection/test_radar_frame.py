"""A radar frame looked at: through writer and reader, with and without poses, camera, boxes and Doppler."""

from pathlib import Path

import numpy as np
import pytest
from drive import frame

from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.datasets.kradar import KRadarWriter
from farfield.errors import ConfigError, DatasetError
from farfield.figures.radar import radar_picture
from farfield.inspection.radar_frame import RadarLook, look_at
from farfield.pages.radar_page import caption, write_radar
from farfield.radar.products import zyx_cube


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames 0.1 s and 1.5 m apart with polar maps and pictures, one with a cube alone, one with no product."""
    root, rng = tmp_path_factory.mktemp("data"), np.random.default_rng(3)
    polar = np.stack([rng.gamma(63, 0.008 / 63, (256, 107, 37)), rng.normal(0, 0.1, (256, 107, 37))]).astype(np.float32)
    polar[0, 80:82, 53] = 3.0
    polar[1, 80:82, 53] = -0.4
    image = rng.integers(0, 256, (720, 1280, 3), dtype=np.uint8)
    images = {"cam-front": image, "cam-front-right": image}
    cube = zyx_cube(np.ascontiguousarray(polar[0].transpose(0, 2, 1)) * np.float32(1e13))
    writer = KRadarWriter(root, columns=512)
    for number in (1, 2):
        writer.write(frame(number, radar={"polar3d": polar}, images=images))
    writer.write(frame(1, sequence="2", radar={"cube": cube}))
    writer.write(frame(1, sequence="3"))
    writer.finish()
    return root


@pytest.fixture(scope="module")
def looks(tree: Path) -> list[RadarLook]:
    data = open_dataset(tree, reference="radar")
    return [look_at(data, 0), look_at(data, 2)]


def test_the_radars_velocity_comes_from_the_poses_or_from_the_flag(tree: Path, looks: list[RadarLook]) -> None:
    velocity = looks[0].velocity_m_s
    assert velocity is not None
    assert np.linalg.norm(velocity) == pytest.approx(15.0, rel=0.03)  # 1.5 m in 0.1 s, and a little turning
    assert velocity[0] == pytest.approx(15.0, rel=0.03)
    assert "poses of this frame and of 00034_00002" in looks[0].velocity_from
    assert looks[1].velocity_m_s is None  # alone in its sequence
    given = look_at(open_dataset(tree, reference="radar"), 0, speed_m_s=10.0, turn_deg_s=np.degrees(0.1))
    np.testing.assert_allclose(given.velocity_m_s, [10.0 + 0.03, 0.254, 0.0], atol=1e-9)  # v + w x (2.54, -0.3, -0.7)
    echoes, over_ground = given.views.echoes, given.over_ground_m_s
    assert echoes is not None
    assert over_ground is not None
    assert (np.abs(over_ground) <= 1.94).all()


def test_boxes_and_camera_stand_in_the_radars_frame(tree: Path, looks: list[RadarLook]) -> None:
    plain = open_dataset(tree)[0]
    assert looks[0].boxes is not None
    assert plain.boxes is not None
    np.testing.assert_allclose(looks[0].boxes.centre_m, plain.boxes.centre_m - [2.54, -0.3, -0.7], atol=1e-9)
    camera = looks[0].camera
    assert camera is not None
    assert not camera.distortion.any()
    assert looks[0].image is not None
    assert looks[0].image.shape == (720, 1280, 3)
    assert looks[1].image is not None
    assert looks[1].camera is None  # its picture is not of the camera's size


def test_what_cannot_be_looked_at_is_refused(tree: Path) -> None:
    data = open_dataset(tree, reference="radar")
    with pytest.raises(ConfigError, match="expected a number from 0 to 3, got 9"):
        look_at(data, 9)
    with pytest.raises(DatasetError, match="expected one of tesseract, polar3d, cube, cells, found sparse"):
        look_at(data, 3)
    with pytest.raises(DatasetError, match="expected the radar's coordinates, got os2-64's"):
        look_at(open_dataset(tree), 0)
    with pytest.raises(ConfigError, match="expected a tesseract"):
        look_at(data, 0, doppler="peak")


def test_pictures_say_what_they_lack(looks: list[RadarLook], tmp_path: Path) -> None:
    titles = [[axes.get_title("left") for axes in radar_picture(look).axes] for look in looks]
    assert titles[0][0] == "Camera with boxes and the echoes' peaks"
    assert "nothing is projected" in titles[1][0]
    assert "15.0 m/s" in caption(looks[0])
    assert "no polar map" in caption(looks[1])
    page, pictures = write_radar(tmp_path, looks, title="<Radar>")
    text = page.read_text()
    assert text.count("data:image/png;base64,") == 2
    assert "&lt;Radar&gt;" in text
    assert "Simulated data" not in text
    assert [path.name for path in pictures] == ["radar-1-00033_00001.png", "radar-2-00033_00001.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in pictures)


def test_the_command_writes_a_page_and_says_where(
    tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["radar", str(tree), "--frames", "2", "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert "no polar map: no echoes" in printed
    assert printed.splitlines()[-1] == f"report: {(tmp_path / 'out' / 'radar.html').resolve()}"
    assert main(["radar", str(tree), "--frames", "3"]) == 1
    assert main(["radar", str(tree), "--false-alarm", "2"]) == 1
    assert "--false-alarm: expected a probability" in capsys.readouterr().err
