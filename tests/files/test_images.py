"""Images as arrays."""

import io
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from farfield.errors import FileFormatError
from farfield.files.images import read_image, write_image


@pytest.fixture
def picture() -> np.ndarray:
    """A smooth colour gradient, 40 high and 60 wide."""
    v, u = np.mgrid[0:40, 0:60]
    return np.stack([u * 4, v * 6, (u + v) * 2], axis=2).astype(np.uint8)


def test_png_is_exact_and_jpeg_is_close(tmp_path: Path, picture: np.ndarray) -> None:
    for name, error in (("a.png", 0), ("a.PNG", 0), ("a.jpg", 12), ("a.jpeg", 12)):
        write_image(tmp_path / name, picture)
        found = read_image(tmp_path / name)
        assert found.shape == (40, 60, 3)
        assert np.abs(found.astype(int) - picture).max() <= error
        assert found.flags.writeable


def test_quality_governs_the_size(tmp_path: Path, rng: np.random.Generator) -> None:
    noise = rng.integers(0, 255, (64, 64, 3), dtype=np.uint8)
    write_image(tmp_path / "good.jpg", noise, quality=95)
    write_image(tmp_path / "poor.jpg", noise, quality=20)
    assert (tmp_path / "poor.jpg").stat().st_size < (tmp_path / "good.jpg").stat().st_size / 2


@pytest.mark.parametrize("mode", ["L", "RGBA", "LA", "P", "1", "I;16", "CMYK"])
def test_every_mode_becomes_rgb(tmp_path: Path, mode: str) -> None:
    path = tmp_path / ("a.jpg" if mode == "CMYK" else "a.png")
    if mode == "I;16":
        Image.fromarray(np.full((4, 6), 200 * 256 + 7, dtype=np.uint16)).save(path)
    else:
        Image.new("RGB", (6, 4), (200, 200, 200)).convert(mode).save(path)
    found = read_image(path)
    assert found.shape == (4, 6, 3)
    assert found.dtype == np.uint8
    if mode == "1":
        assert set(np.unique(found)) <= {0, 255}
    else:
        assert np.abs(found.astype(int) - 200).max() <= 4  # a palette holds 204, JPEG rounds


@pytest.mark.parametrize("suffix", ["png", "jpg"])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.9])
def test_truncated_images_are_refused(tmp_path: Path, rng: np.random.Generator, suffix: str, share: float) -> None:
    path = tmp_path / f"a.{suffix}"
    write_image(path, rng.integers(0, 255, (64, 64, 3), dtype=np.uint8))
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(FileFormatError, match="expected a whole JPEG or PNG"):
        read_image(path)


def png_claiming(width: int, height: int) -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0")) + chunk(b"IEND", b"")


@pytest.mark.parametrize("size", [(30_000, 30_000), (12_000, 9_000), (2**31 - 1, 2**31 - 1)], ids=str)
def test_a_header_that_claims_a_huge_image_is_not_believed(tmp_path: Path, size: tuple[int, int]) -> None:
    (tmp_path / "bomb.png").write_bytes(png_claiming(*size))
    with pytest.raises(FileFormatError, match=r"bomb.png, the image"):
        read_image(tmp_path / "bomb.png")


def test_the_limit_on_pixels_is_the_caller_s(tmp_path: Path, picture: np.ndarray) -> None:
    write_image(tmp_path / "a.png", picture)
    assert read_image(tmp_path / "a.png", max_pixels=2400).shape == (40, 60, 3)
    with pytest.raises(FileFormatError, match="at most 2399 pixels, found 60 x 40"):
        read_image(tmp_path / "a.png", max_pixels=2399)


def test_other_formats_are_not_opened(tmp_path: Path) -> None:
    """Few decoders, few holes: a GIF under the name of a PNG is refused."""
    encoded = io.BytesIO()
    Image.new("RGB", (4, 4)).save(encoded, format="GIF")
    (tmp_path / "a.png").write_bytes(encoded.getvalue())
    with pytest.raises(FileFormatError, match="cannot identify image"):
        read_image(tmp_path / "a.png")


@pytest.mark.usefixtures("without_shape_checks")
def test_wrong_arguments_write_nothing(tmp_path: Path, picture: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"ending in .jpg, .jpeg, .png, got 'a.bmp'"):
        write_image(tmp_path / "a.bmp", picture)
    for wrong in (picture[:, :, 0], picture.astype(np.float64), picture[:0]):
        with pytest.raises(ValueError, match="expected uint8 of shape"):
            write_image(tmp_path / "a.png", wrong)
    assert list(tmp_path.iterdir()) == []


def test_real_camera_images(shared_real: Path) -> None:
    for path in sorted((shared_real / "cirrus_layout").rglob("*.jpg"))[:1]:
        found = read_image(path)
        assert found.shape[2] == 3
        assert 20 < found.mean() < 235
