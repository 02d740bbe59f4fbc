"""The counts behind ``farfield stats``: by hand, over both ways of reading K-Radar, and over real frames."""

import json
import tarfile
from pathlib import Path

import numpy as np
import pytest
from street import write_street

from farfield.datasets import open_dataset
from farfield.datasets.kradar import KRadar
from farfield.inspection.statistics.census import Census, range_names, take_census

HEADER = (
    "* idx(tesseract_os2-64_cam-front_os1-128_cam-lrr)={0:05d}_{1:05d}_00002_00001_00004, "
    "timestamp=164329294{1}.710046076"
)
SEDAN, BUS = "Sedan, 3, 4, 0, 10, 2, 1, 0.75", "Bus or Truck, 90, -120, 0, 10, 5, 1.25, 1.5"


def write_labels(root: Path) -> None:
    """Two frames of sequence 1 (normal, night) and one of sequence 58 (heavy snow, day)."""
    files = {
        "1/00033_00001": ["*, R, 0, " + SEDAN, "*, L, 1, " + SEDAN, "*, L1, 2, " + BUS],
        "1/00034_00002": ["*, R, 0, " + SEDAN],
        "58/00006_00001": [],
        "58/00007_00002": ["*, R, 0, " + BUS],
    }
    for name, lines in files.items():
        path = root / "KRadar_revised_visibility" / f"{name}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        radar, lidar = map(int, path.stem.split("_"))
        path.write_text("\n".join([HEADER.format(radar, lidar), *lines]))


def same(first: Census, second: Census) -> bool:
    return json.dumps(first.summary()) == json.dumps(second.summary())


def test_counts_by_hand(tmp_path: Path) -> None:
    write_labels(tmp_path)
    census = take_census(open_dataset(tmp_path))
    summary = census.summary()
    assert [summary[key] for key in ("frames", "annotated_frames", "empty_frames", "sequences", "objects")] == [
        4,
        4,
        1,
        2,
        5,
    ]
    assert summary["objects_per_annotated_frame"] == 1.25
    assert summary["frames_by"] == {
        "weather": {"normal": 2, "heavy_snow": 2},
        "road": {"urban": 4},
        "time": {"night": 2, "day": 2},
    }
    assert summary["classes"]["Sedan"] == {
        "objects": 3,
        "tracks": 2,
        "farfield_class": "vehicle",
        "mean_size_m": [4.0, 2.0, 1.5],
    }
    assert census.table("name", "weather") == {
        "Sedan": {"normal": 3, "heavy_snow": 0},
        "Bus or Truck": {"normal": 1, "heavy_snow": 1},
    }
    between = ("20 to 40 m", "40 to 60 m", "60 to 80 m", "80 to 100 m", "100 to 150 m")  # empty, and in their places
    ranges = dict.fromkeys(("0 to 20 m", *between), 0) | {"150 to 200 m": 2}  # 90, -120 is 150 m off
    assert census.table("name", "range")["Bus or Truck"] == ranges
    assert [*census.table("range", "visibility")] == [*ranges]
    assert {name: row for name, row in census.table("range", "visibility").items() if any(row.values())} == {
        "0 to 20 m": {"seen by the radar": 2, "by the LiDAR only": 1, "not matched": 0},
        "150 to 200 m": {"seen by the radar": 1, "by the LiDAR only": 0, "not matched": 1},
    }
    assert census.tracks() == {"Sedan": 2, "Bus or Truck": 2}
    assert [row["objects"] for row in summary["table_5"]] == [4, 1]
    assert json.dumps(summary, allow_nan=False)


def test_the_fast_way_counts_what_frames_do(tmp_path: Path) -> None:
    write_labels(tmp_path)
    dataset = open_dataset(tmp_path)
    fast, slow = take_census(dataset), take_census(dataset.moved(np.eye(4)))
    assert same(fast, slow)
    assert np.array_equal(fast.objects, slow.objects)
    part = take_census(dataset.select([3, 0]))
    assert part.summary()["frames_by"]["weather"] == {"heavy_snow": 1, "normal": 1}


def test_damaged_files_are_named_and_the_rest_is_counted(tmp_path: Path) -> None:
    write_labels(tmp_path)
    (tmp_path / "KRadar_revised_visibility" / "1" / "00034_00002.txt").write_text("nonsense")
    for dataset in (open_dataset(tmp_path), open_dataset(tmp_path).moved(np.eye(4))):
        census = take_census(dataset)
        assert census.objects.tolist() == [3, -1, 0, 1]
        assert "00034_00002.txt" in census.damaged[0]
        assert len(census.name) == 4


def test_some_real_sequences_both_ways(shared_real: Path, tmp_path: Path) -> None:
    """Sequence 13 is the one of overcast day, 47 one of heavy snow: frames of the supplement's Table 5."""
    with tarfile.open(shared_real / "kradar" / "labels_v2_1.tar.gz") as archive:
        members = (m for m in archive if m.name.split("/")[1:2] in (["13"], ["47"]))
        archive.extractall(tmp_path, members=members, filter="data")
    census = take_census(KRadar(tmp_path))
    assert census.frames_by("weather") == {"heavy_snow": 266, "overcast": 227}
    assert same(census, take_census(KRadar(tmp_path).moved(np.eye(4))))


def test_other_formats_tell_what_they_know(shared_real: Path, tmp_path: Path, rng: np.random.Generator) -> None:
    kitti = take_census(open_dataset(shared_real / "kitti"))
    assert kitti.known == ("visibility",)
    assert kitti.names("visibility") == ["fully visible", "partly hidden", "largely hidden", "unknown"]
    assert kitti.table("name", "visibility")["Pedestrian"]["fully visible"] == 5
    data, names = open_dataset(shared_real / "kitti_tracking"), ("0000", "0004", "0017")
    tracking = take_census(data.select([row for row, name in enumerate(data.sequences) if name in names]))
    texts = [(shared_real / "kitti_tracking" / "label" / f"{name}.txt").read_text() for name in names]
    lines = [[line.split()[:3] for line in text.splitlines() if "DontCare" not in line] for text in texts]
    assert tracking.summary()["objects"] == len(tracking.name) == sum(map(len, lines))
    walkers = [len({track for _, track, label in known if label == "Pedestrian"}) for known in lines]
    assert walkers == [2, 5, 9]
    assert tracking.tracks()["Pedestrian"] == sum(walkers)
    cirrus = take_census(open_dataset(write_street(tmp_path, rng, frames=3)))
    assert (cirrus.known, len(cirrus.objects), cirrus.damaged) == ((), 3, ())
    delft = take_census(open_dataset(shared_real / "view_of_delft"))
    assert len(delft.objects) == 2
    assert len(delft.name) == delft.objects.sum() > 30


@pytest.mark.parametrize(("range_m", "name"), [(0.0, 0), (19.99, 0), (20.0, 1), (199.9, -2), (200.0, -1), (900.0, -1)])
def test_bins_hold_their_lower_edge(range_m: float, name: int) -> None:
    one = np.array([range_m])
    words = np.array(["a"])
    unknown = dict.fromkeys(("weather", "road", "time"), words)
    census = Census(
        sequence=words,
        conditions=unknown,
        objects=np.array([1]),
        frame=np.array([0]),
        name=words,
        range_m=one,
        size_m=np.ones((1, 3)),
        visibility=words,
    )
    assert census.names("range") == [range_names()[name]]
