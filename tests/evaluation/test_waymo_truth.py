"""Submissions to Waymo beside a tree of its version 2: levels are the annotators', and signs are scored."""

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.evaluation import read_detections
from farfield.files.waymo_objects import write_waymo_objects
from farfield.metrics.submissions import waymo_part
from tests.datasets.generators.waymo import write_waymo

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")
BOX = "[LiDARBoxComponent]"


def test_a_tree_of_version_2_has_its_own_levels_and_signs(tmp_path):
    write_waymo(tmp_path, frames=1)
    for path in tmp_path.rglob("lidar_box/*.parquet"):  # all hard by their annotators, though they hold many points
        table = pq.read_table(path)
        columns = table.to_pydict()
        columns[f"{BOX}.difficulty_level.detection"] = [2] * len(table)
        columns[f"{BOX}.num_lidar_points_in_box"] = [50] * len(table)
        columns[f"{BOX}.num_top_lidar_points_in_box"] = [40] * len(table)
        columns[f"{BOX}.type"][0] = 3
        pq.write_table(pa.table(columns), path)
    data = open_dataset(tmp_path, classes="waymo")
    details = data[0].annotation.details
    assert set(details["detection_level"].tolist()) == {2}
    assert set(details["top_points"].tolist()) == {40}
    names = {"Vehicle": "vehicle", "Pedestrian": "pedestrian", "Sign": "sign", "Cyclist": "cyclist"}
    boxes = [frame.boxes.relabel(names) for frame in data]
    scored = [part.replace(score=np.full(len(part), 0.5)) for part in boxes]
    write_waymo_objects(tmp_path / "all.bin", map(waymo_part, data.keys, scored))
    result = read_detections(tmp_path / "all.bin", tmp_path, format="waymo").score("waymo")
    signs = sum(int((part.label == "sign").sum()) for part in boxes)
    assert result.counts["classes"]["sign"]["annotated"] == signs == 2
    for name in ("vehicle", "sign"):
        assert result.figures[f"ap/{name}/level_2/ap"] == pytest.approx(1.0)
        assert result.figures[f"ap/{name}/level_1/ap"] is None
