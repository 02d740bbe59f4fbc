"""The table of matches: what is written is what was matched."""

from pathlib import Path

import numpy as np

from farfield.sync import match_blocks
from farfield.sync.synchronising import match_table, read_match_table


def test_rows_names_and_empty_cells(tmp_path: Path) -> None:
    streams = {"lidar": [np.array([0, 100, -(10**15), 200])], "a,b": [np.array([-7, 203])], "none": []}
    with match_table(tmp_path / "m.csv", "lidar", {"a,b": ["x,1", "later"]}) as table:
        for rows in match_blocks(streams, reference="lidar", tolerance_ns=10):
            table.add(["a,b", "none"], rows)
    assert (tmp_path / "m.csv").read_text().splitlines() == [
        "lidar_frame,lidar_ns,a_b_frame,a_b_later_ns,none_frame,none_later_ns",
        "0,0,x_1,-7,,",
        "1,100,,,,",
        "3,200,later,3,,",
    ]
    assert read_match_table(tmp_path / "m.csv")["a_b_frame"] == ["x_1", "", "later"]
