"""What ``import farfield`` offers: its names, the old ones, and the verbs as functions."""

import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import farfield as ff
from farfield.errors import ConfigError

HEAD = "sequence,frame,label,x,y,z,l,w,h,yaw_rad,score\n"


def test_dir_shows_what_users_use_and_nothing_else() -> None:
    assert sorted(dir(ff)) == sorted([*ff.__all__, "__version__"])
    assert {"Boxes", "Dataset", "Detections", "Result", "simulate", "score", "calibrate"} <= set(dir(ff))
    assert not {"Any", "TYPE_CHECKING", "import_module"} & set(dir(ff))
    assert all(getattr(ff, name) is not None for name in dir(ff))


@pytest.mark.parametrize(
    ("old", "new"),
    [("dataset", "register_dataset"), ("detector", "register_detector"), ("protocol", "register_protocol")],
)
def test_old_names_of_decorators_work_and_say_the_new_one(old: str, new: str) -> None:
    with pytest.warns(DeprecationWarning, match=new):
        assert getattr(ff, old) is getattr(ff, new)


def test_new_names_do_not_warn() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert callable(ff.register_dataset)


def test_score_reads_files_as_the_verb_does(tmp_path: Path) -> None:
    row = "a,1,vehicle,20,1,0,4,2,1.5,0"
    (tmp_path / "predictions.csv").write_text(f"{HEAD}{row},0.9\n")
    (tmp_path / "labels.csv").write_text(f"{HEAD}{row},\n")
    result = ff.score(tmp_path / "predictions.csv", tmp_path / "labels.csv", label="vehicle")
    assert result.figures["dds/0/map"] == 1.0
    with pytest.raises(ConfigError, match="protocol"):
        ff.score(tmp_path / "predictions.csv", tmp_path / "labels.csv", protocol="none")


def test_score_takes_a_data_set_as_the_truth(tmp_path: Path) -> None:
    np.save(tmp_path / "1.npy", np.ones((4, 3), dtype=np.float32))
    (tmp_path / "labels.csv").write_text("frame,label,x,y,z,l,w,h,yaw_rad\n1,vehicle,20,1,0,4,2,1.5,0\n")
    data = ff.open_dataset(tmp_path)
    predictions = tmp_path.with_name(f"{tmp_path.name}.csv")
    predictions.write_text("frame,label,x,y,z,l,w,h,yaw_rad,score\n1,vehicle,20,1,0,4,2,1.5,0,0.9\n")
    for labels in (data, tmp_path):
        assert ff.score(predictions, labels).figures["dds/0/map"] == 1.0


def test_simulate_says_what_it_would_write(tmp_path: Path) -> None:
    pytest.importorskip("embreex")
    lines: list[str] = []
    ff.simulate("cirrus-sim-mini", tmp_path / "data", frames=2, workers=1, dry_run=True, report=lines.append)
    assert lines
    assert not (tmp_path / "data").exists()
    with pytest.raises(TypeError, match="streets"):
        ff.simulate("cirrus-sim-mini", tmp_path / "data", streets=3)


def test_simulate_writes_a_data_set_that_opens(tmp_path: Path) -> None:
    pytest.importorskip("embreex")
    ff.simulate("cirrus-sim-mini", tmp_path / "data", frames=1, workers=1)
    assert len(ff.open_dataset(tmp_path / "data")) == 1


def test_calibrate_refuses_what_is_not_possible(simulated_cirrus: Path) -> None:
    with pytest.raises(ConfigError, match="frames"):
        ff.calibrate("lidar-camera", simulated_cirrus, frames=0)
    with pytest.raises(ConfigError, match="camera"):
        ff.calibrate("lidar-camera", simulated_cirrus, camera="none")
    with pytest.raises(ConfigError, match="folder of pictures"):
        ff.calibrate("board", ff.open_dataset(simulated_cirrus))
    with pytest.raises(ConfigError, match="K-Radar"):
        ff.calibrate("radar-lidar", simulated_cirrus)


def test_calibrate_registers_two_clouds_of_one_frame(simulated_cirrus: Path) -> None:
    found = ff.calibrate("lidar-lidar", simulated_cirrus, frames=1, lidars=("gaussian", "uniform"))
    np.testing.assert_allclose(found.target_T_source, np.eye(4), atol=0.2)


def test_a_notebook_shows_a_cloud_and_matplotlib_is_loaded_for_it_alone() -> None:
    import subprocess

    code = (
        "import sys, numpy as np, farfield as ff; cloud = ff.Cloud(np.zeros((1, 3), dtype=np.float32));"
        "assert 'matplotlib' not in sys.modules; html = cloud._repr_html_(); assert 'img' in html, html;"
        "assert 'matplotlib' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
