"""A detector's pickle is refused with the line that makes a table of it."""

import pickle
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from farfield.errors import FileFormatError
from farfield.metrics.box_files import read, read_predictions


@pytest.mark.parametrize("name", ["result.pkl", "result.csv"])
def test_a_pickle_is_refused_with_a_line_that_works(tmp_path: Path, name: str) -> None:
    boxes = np.array([[10, -2, 0.5, 4.5, 2, 1.5, 0.25], [20, 3, 0.4, 4.2, 1.9, 1.6, -1.0]])
    frames = [
        {"frame_id": "000007", "name": np.array(["Car", "Car"]), "score": np.array([0.9, 0.4]), "boxes_lidar": boxes},
        {"frame_id": "000008", "name": np.zeros(0), "score": np.zeros(0), "boxes_lidar": np.zeros((0, 7))},
    ]
    path = tmp_path / name
    path.write_bytes(pickle.dumps(frames))
    with pytest.raises(FileFormatError, match="a pickle is never opened") as caught:
        read_predictions(path)
    with pytest.raises(FileFormatError, match="boxes-csv"):
        read(path, path)
    found = re.search(r'python -c "(.*)"', str(caught.value))
    assert found is not None
    (tmp_path / "result.pkl").write_bytes(path.read_bytes())
    subprocess.run([sys.executable, "-c", found[1]], cwd=tmp_path, check=True)
    table = read_predictions(tmp_path / "boxes.csv").boxes
    assert [*table] == [("", "000007")]
    np.testing.assert_array_equal(table["", "000007"].centre_m, boxes[:, :3])
    np.testing.assert_array_equal(table["", "000007"].size_m, boxes[:, 3:6])
    np.testing.assert_array_equal(table["", "000007"].yaw_rad, boxes[:, 6])
    assert table["", "000007"].score.tolist() == [0.9, 0.4]
