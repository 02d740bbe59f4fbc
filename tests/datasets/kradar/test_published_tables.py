"""All annotations at once, the published table, splits, and trees of annotations alone."""

import shutil
import tarfile
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from farfield.datasets import open_dataset, recognise
from farfield.datasets.kradar import KRadar
from farfield.datasets.kradar.index import KRadarFiles
from farfield.datasets.kradar.label_table import DEFECTS, LabelTable, read_label_table
from farfield.datasets.kradar.reader import WHOLE_SEQUENCES, read_split_list, split_of_sequences
from farfield.datasets.kradar.writer import quarters, whole_sequences
from farfield.errors import DatasetError, FileFormatError
from farfield.simulation.presets import PRESETS
from farfield.vocabulary.kradar import SEQUENCES

HEADER = (
    "* idx(tesseract_os2-64_cam-front_os1-128_cam-lrr)=00033_00001_00002_00001_00004, timestamp=1643292946.710046076"
)
VALUES = "24.5, -3.25, -0.5, 90, 1.75, 0.875, 0.5"


def table_of(tmp_path: Path, *texts: str, version: str = "v2.1") -> LabelTable:
    entries = []
    for number, text in enumerate(texts):
        path = tmp_path / f"{number}.txt"
        path.write_text(text)
        entries.append(KRadarFiles(sequence="1", radar=33, lidar=1, label=path, version=version))
    return read_label_table(entries)


def test_the_published_table_is_the_simulator_s_and_sums_to_the_whole() -> None:
    driven = [(one.name, one.frames, one.road, one.condition, one.time) for one in PRESETS["kradar-sim"].segments]
    assert driven == [(name, one.frames, one.road, one.weather, one.time) for name, one in SEQUENCES.items()]
    assert list(SEQUENCES) == [str(number) for number in range(1, 59)]
    frames: Counter[str] = Counter()
    for one in SEQUENCES.values():
        frames[one.weather] += one.frames
    assert frames == {  # the supplement's Table 5, summed
        "normal": 12_781,
        "overcast": 825,
        "fog": 3_578,
        "rain": 4_780,
        "sleet": 7_040,
        "light_snow": 2_237,
        "heavy_snow": 3_753,
    }


def test_the_split_of_whole_sequences_is_what_it_says() -> None:
    frames = {name: one.frames for name, one in SEQUENCES.items()}
    weather = {name: one.weather for name, one in SEQUENCES.items()}
    parts = {part: [str(number) for number in numbers] for part, numbers in WHOLE_SEQUENCES.items()}
    assert parts == whole_sequences(frames, weather)
    assert sorted(name for names in parts.values() for name in names) == sorted(SEQUENCES)
    seen = {part: {weather[name] for name in names} for part, names in parts.items()}
    assert seen["train"] == seen["test"] == set(weather.values())
    assert seen["val"] == set(weather.values()) - {"overcast"}
    assert split_of_sequences(["58", "4", "8", "8"]) == {"train": ["58"], "val": ["8"], "test": ["4"]}
    assert split_of_sequences(["58", "4"]) == split_of_sequences(["58", "4", "8", "99"]) == {}


def test_lists_are_checked(tmp_path: Path) -> None:
    path = tmp_path / "train.txt"
    path.write_text("1,00033_00001.txt\n 2 , 00034_00002\n")
    assert read_split_list(path) == {("1", "00033_00001"), ("2", "00034_00002")}
    path.write_text("1,00033_00001.txt\n1;00034_00002.txt")
    with pytest.raises(FileFormatError, match="line 2"):
        read_split_list(path)


def test_the_fast_way_reads_what_the_tolerant_one_does(tmp_path: Path) -> None:
    """A file that the fast expression takes, and the same one with a blank that only the tolerant reader takes."""
    lines = f"*, R, 0, Sedan, {VALUES}\n*, L1, 7, Bus or Truck, {VALUES.replace('90', '-457.5')}"
    fast = table_of(tmp_path, f"{HEADER}\n{lines}", HEADER)
    slow = table_of(tmp_path, f"{HEADER}\n{lines.replace(', ', ' ,')}", f"{HEADER}\n\n")
    for name in ("indices", "time_ns", "frame", "name", "availability", "track", "centre_m", "size_m", "yaw_deg"):
        assert np.array_equal(getattr(fast, name), getattr(slow, name)), name
    assert fast.defects["blanks"] == 0
    assert slow.defects["blanks"] == 2
    assert fast.yaw_deg.tolist() == [90.0, -457.5]
    assert fast.size_m.tolist() == [[3.5, 1.75, 1.0]] * 2
    boxes = fast.boxes_by_frame()[("1", "00033_00001")]
    assert len(boxes) == 0  # the second file of that name, an empty frame
    np.testing.assert_allclose(np.rad2deg(fast.boxes().yaw_rad), [90, -97.5])


@pytest.mark.parametrize(
    ("text", "version", "defect"),
    [
        (f"{HEADER} *, 0, Sedan, {VALUES}", "v2.0", "merged_header"),
        (f"{HEADER}*, 0, Sedan, {VALUES}\n*, 1, Sedan, {VALUES}", "v2.0", "merged_header"),
        (f"{HEADER}\n*, R,  0, Sedan, {VALUES}", "v2.1", "blanks"),
        (f"{HEADER} \n*, R, 0, Sedan, {VALUES}", "v2.1", "blanks"),
        (f"{HEADER}\n*, LL, 0, Sedan, {VALUES}", "v2.1", "slip"),
        (f"{HEADER}\n*, l, 0, Sedan, {VALUES}", "v2.1", "slip"),
        (f"* radar idx: 00857, lidar idx: 00834\n*, 0, 0, Sedan, {VALUES}", "v1.0", "other_header"),
        (f"{HEADER}\n#, 0, 0, Sedan, 24.5, -3.25, 90, 1.75, 0.875", "v1.0", "without_height"),
        (f"{HEADER}\n*, 0, Sedan, {VALUES}", "v1.0", "short_line"),
        (f"{HEADER}\n*, 0, Sedan, {VALUES.replace('90', '457')}", "v2.0", "yaw_turned"),
        (f"{HEADER}\n*, 0, Sedan, {VALUES.replace('1.75', '0.05')}", "v2.0", "odd_size"),
        (f"{HEADER}\n*, 0, Pedestrian, {VALUES.replace('1.75', '0.5')}", "v2.0", None),
        (f"{HEADER}\n*, 3, Sedan, {VALUES}\n*, 3, Sedan, {VALUES}", "v2.0", "doubled_track"),
        (f"{HEADER.replace('00033_', '00034_')}\n*, 3, Sedan, {VALUES}", "v2.0", "odd_index"),
        (f"{HEADER}\r\n*, R, 0, Sedan, {VALUES}\r\n", "v2.1", None),
        (f"{HEADER}\n*, 0, 0, Sedan, {VALUES}", "v1.0", None),
    ],
)
def test_each_defect_is_counted_once_and_nothing_else(
    tmp_path: Path, text: str, version: str, defect: str | None
) -> None:
    table = table_of(tmp_path, text, version=version)
    assert {name for name, count in table.defects.items() if count} == ({defect} if defect else set())
    assert set(table.defects) == set(DEFECTS)
    assert len(table.name) == text.count(VALUES[-10:]) or defect == "without_height"


def test_damaged_files_are_named_and_left_out(tmp_path: Path) -> None:
    table = table_of(tmp_path, "nonsense", f"{HEADER}\n*, R, 0, Sedan, {VALUES}", f"{HEADER}\n*, R, 0, Sedan, 1")
    assert len(table.stem) == len(table.name) == 1
    assert ["0.txt" in table.damaged[0], "2.txt" in table.damaged[1]] == [True, True]
    zero, late = VALUES.replace("1.75", "0.000"), HEADER.replace("=1643", "=9643")
    refused = table_of(tmp_path, f"{HEADER}\n*, R, 0, Sedan, {zero}", f"{late}\n*, R, 0, Sedan, {VALUES}")
    assert ["positive sizes" in refused.damaged[0], "the header" in refused.damaged[1]] == [True, True]
    nothing = read_label_table([])
    assert (len(nothing.stem), len(nothing.boxes()), nothing.tracks()) == (0, 0, {})


def unpack(shared_real: Path, folder: Path, sequences: tuple[str, ...] = ()) -> Path:
    """The real annotations of version 2.1, of some sequences or of all."""
    with tarfile.open(shared_real / "kradar" / "labels_v2_1.tar.gz") as archive:
        wanted = (
            member for member in archive if not sequences or Path(member.name).parts[1:2] in [(s,) for s in sequences]
        )
        archive.extractall(folder, members=wanted, filter="data")
    return folder


@pytest.mark.slow
def test_the_real_annotations_have_their_published_totals(shared_real: Path, tmp_path: Path) -> None:
    """Counts of the reference report; frames by weather of the supplement's Table 5."""
    dataset = open_dataset(unpack(shared_real, tmp_path))
    table = dataset.label_table()
    assert (dataset.name, len(dataset), len(table.stem), len(table.name)) == ("kradar", 34_994, 34_994, 115_229)
    assert (table.per_frame == 0).sum() == 4_307
    assert table.per_frame.max() == 25
    assert not table.damaged
    counts = Counter(zip(table.name.tolist(), table.availability.tolist(), strict=True))
    expected = {  # R, L, L1; the three slips LL, l and LR count as L, L and L1
        "Sedan": (52_822, 16_731, 19_719),
        "Bus or Truck": (11_648, 3_908, 2_824),
        "Pedestrian": (4_483, 599, 781),
        "Bicycle": (706, 172, 77),
        "Motorcycle": (323, 96, 197),
        "Pedestrian Group": (110, 27, 0),
        "Bicycle Group": (6, 0, 0),
    }
    assert {name: tuple(counts[name, flag] for flag in ("R", "L", "L1")) for name, _ in counts} == expected
    assert table.tracks() == {
        "Sedan": 1424,
        "Bus or Truck": 246,
        "Pedestrian": 61,
        "Bicycle": 33,
        "Motorcycle": 18,
        "Pedestrian Group": 7,
        "Bicycle Group": 2,
    }
    for name, size_m in {"Sedan": (4.58, 2.15, 1.97), "Pedestrian": (0.81, 0.73, 2.09)}.items():
        np.testing.assert_allclose(table.size_m[table.name == name].mean(axis=0), size_m, atol=0.01)
    assert [table.centre_m[:, 0].min().round(), table.centre_m[:, 0].max().round()] == [-136, 210]
    assert [table.yaw_deg.min().round(), table.yaw_deg.max().round()] == [-330, 457]
    assert (table.defects["slip"], table.defects["merged_header"]) == (3, 0)
    assert table.defects["yaw_turned"] == pytest.approx(0.028 * 115_229, rel=0.01)
    assert Counter(table.sequence.tolist()) == {name: one.frames for name, one in SEQUENCES.items()}
    official = {name: read_split_list(shared_real / "kradar" / "split" / f"{name}.txt") for name in ("train", "test")}
    stems = {name: table.stem[table.sequence == name].tolist() for name in SEQUENCES}
    assert {name: set(keys) for name, keys in quarters(stems).items()} == official
    split = {name: len(dataset.split(name)) for name in ("train", "val", "test")}
    assert sum(split.values()) == 34_994
    assert {name: round(count / 34_994, 2) for name, count in split.items()} == {
        "train": 0.67,
        "val": 0.16,
        "test": 0.17,
    }
    frame = dataset.split("test")[0]
    assert (frame.sequence, frame.conditions["weather"], frame.annotation.version) == ("4", "normal", "v2.1")


def test_a_bare_tree_of_annotations_opens_at_any_height(shared_real: Path, tmp_path: Path) -> None:
    inner = unpack(shared_real, tmp_path, ("47",)) / "KRadar_revised_visibility"
    assert recognise(inner) == "kradar"
    assert [len(open_dataset(path)) for path in (inner, tmp_path)] == [266, 266]
    few = tmp_path / "elsewhere"
    for sequence in ("3", "58"):
        (few / sequence).mkdir(parents=True)
        for path in sorted((inner / "47").glob("*.txt"))[:40]:
            shutil.copy(path, few / sequence)
    dataset = KRadar(few)
    assert {entry.version for entry in dataset.entries} == {"v2.1"}  # by its lines: the folder's name says nothing
    assert [dataset[index].conditions["weather"] for index in (0, -1)] == ["normal", "heavy_snow"]
    assert len(KRadar(few, labels="v2.1")) == 80
    with pytest.raises(DatasetError, match=r"annotations v1\.0"):
        KRadar(few, labels="v1.0")
    with pytest.raises(DatasetError, match="at least 3"):
        dataset.split("train")


@pytest.mark.parametrize(
    ("line", "version"),
    [
        (f"*, 5, 4, Sedan, {VALUES}", "v1.0"),
        (f"*, R, 5, 4, Sedan, {VALUES}", "v1.1"),
        (f"*, 5, Sedan, {VALUES}", "v2.0"),
        (f"*, L, 5, Sedan, {VALUES}", "v2.1"),
        ("", "v2.0"),
    ],
)
def test_the_version_of_a_bare_folder_is_seen_in_its_lines(tmp_path: Path, line: str, version: str) -> None:
    (tmp_path / "7").mkdir()
    (tmp_path / "7" / "00034_00001.txt").write_text(f"{HEADER}\n{line}")
    dataset = open_dataset(tmp_path)
    assert dataset[0].annotation.version == version
    assert (dataset.sequences, dataset.frame_ids) == (("7",), ("00034_00001",))


def test_a_simulated_sequence_is_not_taken_for_the_published_one(tmp_path: Path) -> None:
    (tmp_path / "7").mkdir()
    (tmp_path / "7" / "00034_00001.txt").write_text(HEADER)
    assert KRadar(tmp_path)[0].conditions == SEQUENCES["7"].conditions
    (tmp_path / "simulation.json").write_text("{}")
    frame = KRadar(tmp_path)[0]
    assert (frame.conditions, "conditions_from" in frame.metadata) == ({}, False)
