"""Every registered format that has a small tree: opened, examined, drawn, its boxes' points counted, detected in."""

from pathlib import Path

import numpy as np
import pytest
import torch
from format_fixtures import FIXTURES, fixture_of
from small import small_detector

from farfield import load_detector
from farfield.datasets import open_dataset
from farfield.datasets.formats import DATASETS
from farfield.detectors.weights import save_weights
from farfield.errors import FarfieldError
from farfield.figures.birds_eye import birdseye
from farfield.geometry.boxes import count_points_in_boxes
from farfield.inspection.doctor import examine
from farfield.registry import PluginError


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An untrained small PointPillars that wants x, y, z and the intensity."""
    network = small_detector("pointpillars", score_threshold=0.0)
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    save_weights(path, network.state_dict(), config=network.config, provenance={})
    return path


@pytest.mark.parametrize("name", [name for name in DATASETS.builtin if name in FIXTURES])
def test_the_whole_path_takes_the_format(name: str, weights: Path, tmp_path: Path) -> None:
    from matplotlib import pyplot

    write = fixture_of(name)
    if write is None:
        pytest.skip(f"nothing writes {name} here")
    root = tmp_path / "data"
    root.mkdir()
    try:
        written = write(root)
    except ImportError as error:
        pytest.skip(str(error))
    data = open_dataset(written if isinstance(written, Path) else root)
    assert data.name == name
    report = examine(data)
    assert report.format == name
    assert not [one for one in report.findings if one.topic == "damaged"]
    frame = next((one for one in data if one.clouds and one.boxes is not None and len(one.boxes)), data[0])
    if frame.boxes is not None and len(frame.boxes) and frame.clouds:
        counts = count_points_in_boxes(frame.cloud().points_m, frame.boxes)
        assert counts.shape == (len(frame.boxes),)
    figure = birdseye(frame, None, window_m="fit")
    assert figure.axes
    pyplot.close(figure)
    lidars = [cloud for cloud in frame.clouds if frame.sensors[cloud].kind == "lidar" and frame.sensors[cloud].in_frame]
    if not lidars:
        return
    with torch.inference_mode():
        boxes = load_detector(weights).with_cloud(lidars[0])(frame)
    assert np.isfinite(boxes.centre_m).all()
    assert boxes.score is not None


def test_fixtures_are_of_names_that_a_format_has_or_gets() -> None:
    with pytest.raises((FarfieldError, PluginError, KeyError)):
        open_dataset(Path("nowhere"))
    assert fixture_of("no format") is None
    assert len([name for name in FIXTURES if name in DATASETS.builtin]) >= 8
