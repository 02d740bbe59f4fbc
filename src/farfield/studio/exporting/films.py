"""Films of pictures: GIF for everybody, WebP at a fifth of its size."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from PIL import Image

from farfield.errors import ConfigError, FileFormatError

_MAX_PIXELS = 20_000_000


def write_film(path: Path, pictures: Sequence[Path], *, rate_hz: float = 10.0) -> None:
    """Write an animated GIF or WebP, by the file's ending; all pictures take the size of the first.

    Args:
        path: The file.
        pictures: PNG files in order.
        rate_hz: Pictures a second. GIF counts in hundredths of a second.

    Raises:
        ConfigError: If there is no picture, or one is too large.
        FileFormatError: If one is damaged.
    """
    if not pictures:
        raise ConfigError("film: expected at least one picture, got none")
    images = _images(pictures)
    first = next(images)
    duration_ms = round(1000 / rate_hz)
    if path.suffix == ".gif":
        first = first.quantize(128)
        rest = (image.resize(first.size).quantize(128, palette=None) for image in images)
        first.save(path, "GIF", save_all=True, append_images=rest, duration=duration_ms, loop=0, optimize=False)
    else:
        rest = (image.resize(first.size) for image in images)
        first.save(path, "WEBP", save_all=True, append_images=rest, duration=duration_ms, loop=0, quality=80, method=2)


def _images(pictures: Sequence[Path]) -> Iterator[Image.Image]:
    for path in pictures:
        try:
            with Image.open(path, formats=("PNG",)) as image:
                if image.width * image.height > _MAX_PIXELS:
                    raise ConfigError(f"film: expected pictures of at most {_MAX_PIXELS} pixels, got {image.size}")
                yield image.convert("RGB")
        except (OSError, SyntaxError, ValueError) as error:
            expected, found = "a whole PNG", str(error)[:100]
            raise FileFormatError(path.name, where="the image", expected=expected, found=found) from error
