"""Zenseact's single frames by a generator that has not seen the reader."""

from .generators.truth import check_dataset, open_recognised, published_part
from .generators.zod import FRAMES, write_zod


def test_a_tree_is_read_as_it_was_written(tmp_path):
    write_zod(tmp_path / "probe")
    sweeps = len(open_recognised(tmp_path / "probe")) > len(FRAMES)
    truth = write_zod(tmp_path / "set", sweeps=sweeps)
    check_dataset(open_recognised(tmp_path / "set"), truth)


def test_the_published_split_is_kept(tmp_path):
    write_zod(tmp_path)
    data = open_recognised(tmp_path)
    names = list(FRAMES)
    train = {" ".join(key) for key in published_part(data, "train").keys}
    assert all(any(name in key for key in train) for name in names[:2])
    assert not any(names[2] in key for key in train)


def test_the_camera_looks_forward(tmp_path):
    write_zod(tmp_path)
    frame = next(frame for frame in open_recognised(tmp_path) if frame.has_annotation)
    (name,) = frame.images
    assert frame.images[name].shape == (18, 32, 3)
    place = frame.sensors[name].frame_T_sensor
    assert place[0, 2] > 0.99  # its z looks ahead
    assert place[1, 0] < -0.99  # its x to the right
    lidar = frame.sensors[next(iter(frame.clouds))].frame_T_sensor
    assert 1.2 < place[0, 3] - (0.0 if lidar is None else lidar[0, 3]) < 1.4
