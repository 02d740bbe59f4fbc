"""Lines of the journal: what is written is read, what is damaged is found."""

import json
import zlib
from array import array
from pathlib import Path

import pytest

from farfield.datasets.edits import (
    CellEdit,
    Edited,
    EditState,
    Record,
    box_cell,
    decode,
    encode,
    journal_folder,
    read_journal,
)
from farfield.datasets.edits.journal import check_values, user_folder
from farfield.errors import DatasetError, FileFormatError

CELL = box_cell(("a", "0001"), "4")


def _edit(seq: int, old: int | None, new: int | None, **more: object) -> Record:
    return Record(seq, f"w-{seq}", 5, "ann", "w", "box.set", (CellEdit(CELL, 0, old, new),))._replace(**more)


def _written(path: Path, records: list[Record]) -> bytes:
    path.write_bytes(b"".join(map(encode, records)))
    return path.read_bytes()


def test_a_line_is_its_edit() -> None:
    record = _edit(1, None, 3, group="g", undoes=(2, 3), data={"files": ["ä\n"]})
    line = encode(record)
    assert line.count(b"\n") == 1
    assert line.isascii()
    assert decode(line) == record
    assert int(line[:8], 16) == zlib.crc32(line[9:-1])
    assert list(json.loads(encode(_edit(1, None, 3))[9:])) == ["seq", "id", "time_ns", "by", "window", "op", "changes"]


def test_numbers_that_json_lacks_are_refused() -> None:
    with pytest.raises(ValueError, match="Out of range"):
        encode(_edit(1, None, float("nan")))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "text", [b"[]", b"7", b"[[1]]", b"{}", b'{"seq":"1"}', b"[" * 100_000, b"\xff", b'{"seq":true,"id":1}']
)
def test_sound_checksums_of_nonsense_are_refused(text: bytes) -> None:
    with pytest.raises(ValueError, match=r"line that is no edit|decode|Expecting|codec|nested deeper"):
        decode(b"%08x %s\n" % (zlib.crc32(text), text))


def test_every_flipped_bit_is_found() -> None:
    line = encode(_edit(1, None, 3))
    for place in range(len(line)):
        for bit in range(8):
            damaged = bytearray(line)
            damaged[place] ^= 1 << bit
            with pytest.raises(ValueError):  # noqa: PT011
                decode(bytes(damaged))


def test_read_back_in_order(tmp_path: Path) -> None:
    records = [_edit(1, None, 3), _edit(2, 3, 4), _edit(3, 4, None)]
    data = _written(tmp_path / "edits.jsonl", records)
    seen: list[Record] = []
    starts, end, torn = read_journal(tmp_path / "edits.jsonl", seen.append)
    assert seen == records
    assert (end, torn) == (len(data), b"")
    assert starts == array("q", [0, len(encode(records[0])), len(encode(records[0])) + len(encode(records[1]))])


@pytest.mark.parametrize("cut", range(1, 60, 7))
def test_a_torn_end_is_left_out(tmp_path: Path, cut: int) -> None:
    data = _written(tmp_path / "edits.jsonl", [_edit(1, None, 3), _edit(2, 3, 4)])
    (tmp_path / "edits.jsonl").write_bytes(data[:-cut])
    seen: list[Record] = []
    starts, end, torn = read_journal(tmp_path / "edits.jsonl", seen.append)
    assert [record.seq for record in seen] == [1] == [len(starts)]
    assert data[:end] + torn == data[:-cut]


def test_a_last_line_with_a_wrong_checksum_is_left_out(tmp_path: Path) -> None:
    data = _written(tmp_path / "edits.jsonl", [_edit(1, None, 3), _edit(2, 3, 4)])
    (tmp_path / "edits.jsonl").write_bytes(data[:-3] + b"x" + data[-2:])
    assert len(read_journal(tmp_path / "edits.jsonl", lambda record: None).starts) == 1


@pytest.mark.parametrize(
    ("records", "message"),
    [
        ([_edit(1, None, 3), _edit(3, 3, 4), _edit(4, 4, 5)], "line 2: expected edit number 2, found number 3"),
        ([_edit(1, None, 3), _edit(2, 9, 4), _edit(3, 4, 5)], "line 2: .*starts from another value"),
    ],
)
def test_edits_that_do_not_follow_are_found(tmp_path: Path, records: list[Record], message: str) -> None:
    _written(tmp_path / "edits.jsonl", records)
    with pytest.raises(FileFormatError, match=message):
        read_journal(tmp_path / "edits.jsonl", EditState().apply)


def test_a_bad_line_in_the_middle_stops_with_its_number(tmp_path: Path) -> None:
    data = _written(tmp_path / "edits.jsonl", [_edit(1, None, 3), _edit(2, 3, 4), _edit(3, 4, 5)])
    lines = data.split(b"\n")
    lines[1] = lines[1].replace(b"ann", b"eve")
    (tmp_path / "edits.jsonl").write_bytes(b"\n".join(lines))
    with pytest.raises(FileFormatError, match=r"line 2: .*checksum.*head -n 1"):
        read_journal(tmp_path / "edits.jsonl", lambda record: None)


def test_state_knows_version_and_birth() -> None:
    state = EditState()
    for record in (_edit(1, 2, 3), _edit(2, 3, None, by="eve")):
        state.apply(record)
    standing = state.get(CELL)
    assert standing is not None
    assert standing == (None, 2, "eve", 1, True)
    assert state.touched(("a", "0001")) == {"4": standing}
    assert state.frames() == (("a", "0001"),)
    with pytest.raises(ValueError, match="3 is due"):
        state.apply(_edit(5, None, 1))


def test_edits_stand_beside_the_labels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "mine"))
    assert journal_folder(tmp_path) == tmp_path.resolve() / ".farfield-studio"
    blocked = tmp_path / "data"
    blocked.mkdir()
    (blocked / ".farfield-studio").write_text("a file where the folder should be")
    there = journal_folder(blocked)
    assert there == user_folder(blocked)
    assert there.parent == tmp_path / "mine" / "farfield" / "studio"


def test_edits_that_cannot_be_gone_on_with_are_not_forgotten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (journal_folder(tmp_path) / "edits.jsonl").write_bytes(encode(_edit(1, None, 3)))
    monkeypatch.setattr("farfield.datasets.edits.journal._writable", lambda folder: False)
    with pytest.raises(DatasetError, match="holds edits"):
        journal_folder(tmp_path)


@pytest.mark.parametrize("count", [255, 256, 257, 512])
def test_a_torn_or_damaged_line_is_found_wherever_the_blocks_end(tmp_path: Path, count: int) -> None:
    path = tmp_path / "edits.jsonl"
    lines = [encode(Record(seq, f"e{seq}", seq, "ann", "w1", "box.set")) for seq in range(1, count + 1)]
    path.write_bytes(b"".join(lines))
    taken: list[Record] = []
    whole = read_journal(path, taken.append)
    assert [record.seq for record in taken] == list(range(1, count + 1))
    assert (len(whole.starts), whole.end, whole.torn) == (count, path.stat().st_size, b"")
    path.write_bytes(b"".join(lines)[:-3])
    taken.clear()
    assert read_journal(path, taken.append).torn == lines[-1][:-3]
    assert len(taken) == count - 1
    for place in (0, count // 2, count - 2):
        damaged = [*lines]
        damaged[place] = damaged[place].replace(b"ann", b"bob")
        path.write_bytes(b"".join(damaged))
        with pytest.raises(FileFormatError, match=f"line {place + 1}"):
            read_journal(path, taken.append)


def test_lines_that_make_sense_only_together_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "edits.jsonl"
    fields = encode(Record(1, "e1", 1, "ann", "w1", "box.set"))[9:-1]
    texts = [fields + b"," + fields.replace(b'"seq":1', b'"seq":2'), b"", fields.replace(b'"seq":1', b'"seq":3')]
    path.write_bytes(b"".join(b"%08x %s\n" % (zlib.crc32(text), text) for text in texts))
    with pytest.raises(FileFormatError, match="line 1"):
        read_journal(path, lambda record: None)


_BOX = {"label": "vehicle", "box": [1.0, 2.0, 3.0, 4.0, 2.0, 1.5, 0.3]}
_TIMING = {"frame": ["a", "0001"], "box": "4", "seconds": 3.5, "edits": 2}


@pytest.mark.parametrize(
    ("cell", "value", "data"),
    [
        (("box", "a"), _BOX, {}),
        ((), _BOX, {}),
        (("box", "a", "0001", "4"), 3, {}),
        (("box", "a", "0001", "4"), ["x"], {}),
        (("box", "a", "0001", "4"), {"label": "vehicle"}, {}),
        (("box", "a", "0001", "4"), {**_BOX, "box": 7}, {}),
        (("box", "a", "0001", "4"), {**_BOX, "box": [True] * 7}, {}),
        (("box", "a", "0001", "4"), {**_BOX, "label": 5}, {}),
        (("box", "a", "0001", "4"), {**_BOX, "track": None}, {}),
        (("box", "a", "0001", "4"), {**_BOX, "attributes": [1]}, {}),
        (("box", "a", "0001", "4"), {**_BOX, "attributes": {"a": []}}, {}),
        (("box", "a", "0001", "4"), {**_BOX, "score": "high"}, {}),
        (("box", "a", "0001", "4"), {**_BOX, "proposal": [1.0]}, {}),
        (("track", "a", "7"), {"size": [4.0, 2.0]}, {}),
        (("track", "a", "7"), {"size": [4.0, 2.0, -1.0]}, {}),
        (("track", "a", "7"), {"ends": 5}, {}),
        (("track", "a", "7"), {"colour": "red"}, {}),
        (("track", "a"), {}, {}),
        (("extent",), "half", {}),
        (("bookmark", "a", "0001"), {"note": "x"}, {}),
        (("ignored", "x"), 5, {}),
        (("extent",), None, {"files": ["a.json"]}),
        (("extent",), None, {"files": {"a.json": 5}}),
        (("extent",), None, {**_TIMING, "frame": ["a"]}),
        (("extent",), None, {**_TIMING, "seconds": "3"}),
        (("extent",), None, {**_TIMING, "edits": None}),
    ],
)
def test_values_of_another_form_are_refused_where_a_journal_is_read(
    tmp_path: Path, cell: tuple[str, ...], value: object, data: dict[str, object]
) -> None:
    record = Record(1, "a", 5, "ann", "w", "box.set", (CellEdit(cell, 0, None, value),), data=data)
    (tmp_path / "edits.jsonl").write_bytes(encode(record))
    with pytest.raises(FileFormatError, match=r"line 1: expected an edit"):
        read_journal(tmp_path / "edits.jsonl", check_values)
    with pytest.raises(FileFormatError, match=r"line 1: expected an edit"):
        Edited(edits=tmp_path / "edits.jsonl")


def test_values_as_the_studio_writes_them_are_read(tmp_path: Path) -> None:
    values = (
        (("box", "a", "0001", "4"), {**_BOX, "track": "7", "attributes": {"a": "b"}, "score": 0.5, "state": "edited"}),
        (("box", "a", "0001", "5"), {**_BOX, "proposal": [1.0] * 7, "source": "detector"}),
        (("track", "a", "7"), {"locked": True, "size": [4.0, 2.0, 1.5], "ends": "0005", "label": "vehicle"}),
        (("bookmark", "a", "0001"), "look"),
        (("ignored", "x"), "parked"),
        (("extent",), "full"),
        (("of a later version", "x"), [1, 2]),
    )
    changes = tuple(CellEdit(cell, 0, None, value) for cell, value in values)
    record = Record(1, "a", 5, "ann", "w", "save", changes, data={**_TIMING, "files": {"a.json": "0f"}})
    (tmp_path / "edits.jsonl").write_bytes(encode(record))
    read_journal(tmp_path / "edits.jsonl", check_values)
