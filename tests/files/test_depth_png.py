"""Depth maps as 16-bit PNG: KITTI's convention, its end, a second scale, hostile files."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from farfield.errors import ConfigError, FileFormatError
from farfield.files.depth_png import FAR_SCALE, KITTI_SCALE, farthest_m, read_depth, write_depth

DEPTHS = np.array([[0.5, 255.99, 256.0, 349.9], [np.nan, 1e-4, 80.123, 511.99]], dtype=np.float32)


def test_values_survive_within_half_a_step_where_the_scale_reaches(tmp_path: Path) -> None:
    assert write_depth(tmp_path / "far.png", DEPTHS, scale=FAR_SCALE) == 0
    found = read_depth(tmp_path / "far.png")
    assert found.scale == 128
    assert np.array_equal(np.isnan(found.depth_m), np.isnan(DEPTHS))
    errors = np.abs(found.depth_m - DEPTHS)[np.nan_to_num(DEPTHS) > 0.1]
    assert errors.max() <= 0.5 / 128 * 1.01
    assert found.depth_m[1, 1] == 1 / 128  # 0.1 mm becomes one step: 0 would say that nothing is there


def test_what_lies_beyond_the_end_is_left_out_and_counted(tmp_path: Path) -> None:
    assert farthest_m(KITTI_SCALE) == pytest.approx(255.996, abs=1e-3)
    assert write_depth(tmp_path / "near.png", DEPTHS, scale=KITTI_SCALE) == 3
    found = read_depth(tmp_path / "near.png")
    assert np.isnan(found.depth_m[0, 2:]).all()  # 256.0 would wrap to 0, 349.9 to 93.9
    assert np.isnan(found.depth_m[1, 3])
    assert found.depth_m[0, 1] == pytest.approx(255.99, abs=0.5 / 256)


def test_a_file_without_our_chunk_is_kitti_s(tmp_path: Path) -> None:
    Image.fromarray(np.array([[0, 256, 65535]], dtype=np.uint16)).save(tmp_path / "kitti.png")
    found = read_depth(tmp_path / "kitti.png")
    assert found.scale == 256
    assert np.array_equal(found.depth_m[0, 1:], np.float32([1, 65535 / 256]))
    assert np.isnan(found.depth_m[0, 0])


def test_other_tools_read_the_values_and_notes_come_back(tmp_path: Path) -> None:
    write_depth(tmp_path / "a.png", np.full((3, 5), 10.0, np.float32), notes={"camera": "front"})
    with Image.open(tmp_path / "a.png") as image:
        assert image.mode == "I;16"
        assert (np.array(image) == 2560).all()
        assert image.info["depth_scale"] == "256"
    assert read_depth(tmp_path / "a.png").notes["camera"] == "front"


def test_equal_maps_give_equal_bytes(tmp_path: Path) -> None:
    for name in "ab":
        write_depth(tmp_path / f"{name}.png", DEPTHS, scale=128)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


@pytest.mark.parametrize("scale", [0, -1, 65536])
def test_a_scale_that_no_value_can_have(tmp_path: Path, scale: int) -> None:
    with pytest.raises(ConfigError, match="scale"):
        write_depth(tmp_path / "a.png", DEPTHS, scale=scale)
    assert not list(tmp_path.iterdir())


def test_eight_bits_are_refused(tmp_path: Path) -> None:
    Image.fromarray(np.full((4, 4), 9, np.uint8)).save(tmp_path / "a.png")
    with pytest.raises(FileFormatError, match="16-bit"):
        read_depth(tmp_path / "a.png")


@pytest.mark.parametrize("text", ["0", "-5", "1e9", "65536", "nan", "", "9" * 500, "\u0663"])
def test_a_scale_that_makes_no_sense_is_an_error(tmp_path: Path, text: str) -> None:
    from PIL.PngImagePlugin import PngInfo

    chunks = PngInfo()
    chunks.add_itxt("depth_scale", text)
    Image.fromarray(np.ones((2, 2), np.uint16)).save(tmp_path / "a.png", pnginfo=chunks)
    with pytest.raises(FileFormatError, match="depth_scale"):
        read_depth(tmp_path / "a.png")


def test_a_header_that_promises_much_is_refused_before_memory_is_taken(tmp_path: Path) -> None:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", 60_000, 60_000, 16, 0, 0, 0, 0)
    bomb = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")
    (tmp_path / "bomb.png").write_bytes(bomb)
    with pytest.raises(FileFormatError, match="pixels"):
        read_depth(tmp_path / "bomb.png")


def test_a_cut_file_is_an_error(tmp_path: Path, rng: np.random.Generator) -> None:
    write_depth(tmp_path / "a.png", rng.uniform(1, 90, (40, 60)).astype(np.float32))
    data = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(data[: len(data) // 2])
    with pytest.raises(FileFormatError, match="16-bit grey PNG"):
        read_depth(tmp_path / "a.png")
