"""Zip archives as downloads: listed without unpacking, hostile members refused, unpacked whole or not at all."""

import stat
import zipfile
from pathlib import Path

import pytest

from farfield.errors import FileFormatError
from farfield.files.archives import list_zip, unpack


def archive(path: Path, members: dict[str, bytes], *, how: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", how) as file:
        for name, data in members.items():
            file.writestr(zipfile.ZipInfo(name), data, how)
    return path


def test_a_member_is_unpacked_as_it_was(tmp_path: Path) -> None:
    listing = list_zip(archive(tmp_path / "a.zip", {"1/info_calib/x.txt": b"word " * 500, "1/": b""}))
    assert not listing.fault
    assert [(member.name, member.bytes) for member in listing.members] == [("1/info_calib/x.txt", 2500)]
    unpack(listing.members[0], tmp_path / "out" / "x.txt")
    assert (tmp_path / "out" / "x.txt").read_bytes() == b"word " * 500


@pytest.mark.parametrize("name", ["../out.txt", "/etc/out.txt", "a/../../out", "C:\\out.txt", "a\\..\\out", "a/b\x01c"])
def test_a_name_that_leads_out_is_refused(tmp_path: Path, name: str) -> None:
    listing = list_zip(archive(tmp_path / "a.zip", {"placeholder": b"", "sound.txt": b"x"}))
    assert len(listing.members) == 2
    data = archive(tmp_path / "b.zip", {name: b"x", "sound.txt": b"y"})
    listing = list_zip(data)
    assert [member.name for member in listing.members] == ["sound.txt"]
    assert "leads out" in listing.refused[0]


def test_links_bombs_doubles_and_shared_bytes_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        link = zipfile.ZipInfo("link")
        link.external_attr = (stat.S_IFLNK | 0o777) << 16
        file.writestr(link, "/etc/passwd")
        file.writestr("twice", b"1")
        with pytest.warns(UserWarning, match="Duplicate"):
            file.writestr("twice", b"2")
        file.writestr("bomb", bytes(64 << 20))
    listing = list_zip(path)
    assert [member.name for member in listing.members] == ["twice"]
    reasons = " ".join(listing.refused)
    assert all(word in reasons for word in ("link", "stands twice", "would unpack to 67108864"))
    data = bytearray(archive(tmp_path / "s.zip", {"a": b"x" * 90, "b": b"y"}, how=zipfile.ZIP_STORED).read_bytes())
    entry = data.index(b"PK\x01\x02", data.index(b"PK\x01\x02") + 4)
    data[entry + 20 : entry + 24] = data[entry + 24 : entry + 28] = (5000).to_bytes(4, "little")
    (tmp_path / "s.zip").write_bytes(data)
    assert "share their bytes" in list_zip(tmp_path / "s.zip").fault


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "empty file"),
        (b"<!DOCTYPE html><html>quota</html>", "a page in HTML"),
        (b"PK\x03\x04" + bytes(900), "cut"),
        (b"something else", "no zip archive"),
    ],
)
def test_what_is_no_whole_archive_is_named(tmp_path: Path, data: bytes, words: str) -> None:
    (tmp_path / "a.zip").write_bytes(data)
    listing = list_zip(tmp_path / "a.zip")
    assert words in listing.fault
    assert not listing.members


def test_a_damaged_member_leaves_nothing(tmp_path: Path) -> None:
    path = archive(tmp_path / "a.zip", {"x.bin": bytes(range(256)) * 40}, how=zipfile.ZIP_STORED)
    data = bytearray(path.read_bytes())
    data[2000] ^= 1
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match=r"x\.bin"):
        unpack(list_zip(path).members[0], tmp_path / "out" / "x.bin")
    assert not list((tmp_path / "out").iterdir())
