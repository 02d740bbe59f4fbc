import json
from pathlib import Path

import numpy as np
import pytest
from street import write_street

from farfield.cli import doctor, stats
from farfield.cli._flags import ReadingFlags
from farfield.datasets import open_dataset
from farfield.errors import ConfigError
from farfield.inspection.doctor import examine

HEADER = (
    "* idx(tesseract_os2-64_cam-front_os1-128_cam-lrr)={0:05d}_{1:05d}_00002_00001_00004, "
    "timestamp=164329294{1}.710046076"
)


def write_labels(root, *, scale=1.0, turn=0.0, unit=1.0, frames=3, cars=80):
    rng = np.random.default_rng(3)
    for sequence, lead in (("1", 32), ("26", 5), ("58", 5)):
        folder = root / "KRadar_revised_visibility" / sequence
        folder.mkdir(parents=True, exist_ok=True)
        for number in range(1, frames + 1):
            lines = [HEADER.format(number + lead, number)]
            for track in range(cars):
                x, y, yaw = rng.uniform(5, 90), rng.uniform(-20, 20), (rng.normal(0, 8) + turn) * unit
                lines.append(
                    f"*, R, {track}, Sedan, {x}, {y}, -0.4, {yaw}, {2.3 * scale}, {1.0 * scale}, {0.8 * scale}"
                )
            (folder / f"{number + lead:05d}_{number:05d}.txt").write_text("\n".join(lines))
    return root


def findings(root, topic):
    report = examine(open_dataset(root))
    return [(one.severity, one.what) for one in report.findings if one.topic == topic]


def test_annotations_alone_make_a_page(tmp_path, capsys):
    root, out = write_labels(tmp_path / "labels"), tmp_path / "out"
    assert stats.run(root, out=out, name="K-Radar") == 0
    printed = capsys.readouterr().out
    assert printed.splitlines()[-1] == f"report: {(out / 'statistics.html').resolve()}"
    assert "weather: normal 3, rain 3, heavy_snow 3" in printed
    content = json.loads((out / "statistics.json").read_text())
    assert content["annotations"]["classes"]["Sedan"]["objects"] == 720
    assert content["sensors"] is None
    assert content["notes"] == [
        "annotations: v2.1 in 9 frames",
        "conditions come from: published table in 3 sequences",
    ]
    page = (out / "statistics.html").read_text()
    drawn = sorted(path.stem for path in (out / "figures").glob("*.png"))
    expected = ["class_tables", "classes", "frames_by_condition", "per_frame", "ranges", "sequences"]
    assert drawn == [*expected, "visibility_by_weather"]
    assert page.count('<img src="data:image/svg+xml') == len(drawn)
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "https://" not in page


def test_sensors_are_read_where_there_are_any(tmp_path, rng, capsys):
    out = tmp_path / "out"
    assert stats.run(write_street(tmp_path / "street", rng, frames=4), out=out, sweeps=2) == 0
    content = json.loads((out / "statistics.json").read_text())
    assert content["sensors"]["frames"] == 2
    assert content["annotations"]["frames"] == 4
    assert "Points in vehicle boxes over distance" in (out / "statistics.html").read_text()
    assert "vehicle" in capsys.readouterr().out
    with pytest.raises(ConfigError, match="--sweeps"):
        stats.run(tmp_path / "street", sweeps=-1)


def test_a_version_that_is_not_there_is_refused(tmp_path):
    from farfield.errors import DatasetError

    with pytest.raises(DatasetError, match=r"annotations v1\.0"):
        stats.run(write_labels(tmp_path), reading=ReadingFlags(labels="v1.0"), out=tmp_path / "out")


def test_the_doctor_tells_what_a_tree_of_annotations_has(tmp_path, capsys):
    root = write_labels(tmp_path / "labels")
    assert doctor.run(root, json=Path("-")) == 1  # without clouds nothing can be trained
    report = json.loads(capsys.readouterr().out)
    told = {}
    for one in report["findings"]:
        told.setdefault(one["topic"], []).append((one["severity"], one["what"]))
    assert told["frames"][0] == ("fail", "9 frames: no clouds")
    assert told["label versions"] == [("ok", "v2.1 in all 3 sequences; read: v2.1 (9 frames)")]
    assert told["published conditions"][0][1].startswith("in all 3 sequences")
    assert told["os2-64"] == [("ok", "none")]
    assert told["completeness"][0][1] == "0 of 3 sequences have as many frames as published; not sequences 1, 26, 58"
    assert told["frame difference"][0][0] == "ok"
    assert told["label units"] == [("ok", "half lengths: twice the median of Sedans is 4.60 m")]
    assert [severity for severity, _ in told["label yaw"]] == ["ok", "ok"]
    assert report["facts"]["kradar"]["defects"]["damaged"] == 0


def test_the_doctor_tells_wrong_units_and_a_turned_yaw(tmp_path):
    assert findings(write_labels(tmp_path / "full", scale=2.0), "label units")[0][0] == "fail"
    assert findings(write_labels(tmp_path / "rad", unit=np.pi / 180), "label yaw")[0][0] == "fail"
    turned = findings(write_labels(tmp_path / "turned", turn=90.0), "label yaw")
    assert [severity for severity, _ in turned] == ["ok", "fail"]
    few = findings(write_labels(tmp_path / "few", cars=2), "label units")
    assert few == [("ok", "18 Sedans: too few to decide units and yaw")]


def test_the_doctor_counts_defects_and_damage(tmp_path):
    root = write_labels(tmp_path / "labels", cars=30)
    folder = root / "KRadar_revised_visibility" / "1"
    good = (folder / "00033_00001.txt").read_text()
    (folder / "00033_00001.txt").write_text(good.replace("\n", " ", 1).replace("*, R, 5", "*, LL, 5"))
    (folder / "00034_00002.txt").write_text("nonsense")
    (folder / "00099_00003.txt").write_text((folder / "00035_00003.txt").read_text())
    found = findings(root, "label defects")
    assert ("ok", "1 file whose header and first object share a line; read as they are meant") in found
    assert ("ok", "1 file with an availability such as LL, LR or l; read as they are meant") in found
    assert ("warn", "1 frame whose radar and LiDAR indices differ from the file's name") in found
    assert findings(root, "frame difference") == [("warn", "the frames' names differ from it in sequence 1")]
    assert "00034_00002.txt" in findings(root, "damaged")[0][1]


def test_the_doctor_counts_modalities(tmp_path):
    root = write_labels(tmp_path / "labels")
    (root / "26" / "os2-64").mkdir(parents=True)
    (root / "26" / "os2-64" / "os2-64_00001.pcd").write_bytes(b"")
    (root / "1").mkdir()
    (root / "1" / "description.txt").write_text("urban,night,normal\n")
    lidar = findings(root, "os2-64")
    assert lidar == [
        ("warn", "1 file in 1 of 3 sequences; fewer than frames in sequence 26; missing in sequences 1, 58")
    ]
    assert findings(root, "description") == [("ok", "in 1 of 3 sequences; missing in sequences 26, 58")]
