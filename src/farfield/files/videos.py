"""Films: their frames' own stamps, single frames, and writing one that holds nothing but pictures. Extra ``video``.

FFmpeg decodes, through PyAV, whose wheels bundle a build of it with x264.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8

from farfield.errors import ConfigError, FileFormatError, MissingExtraError
from farfield.files.atomic import open_atomic
from farfield.files.limits import MAX_PIXELS
from farfield.files.stand_ins import check_itself

VIDEOS = (".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v")
WRITTEN = {".mp4": "mp4", ".m4v": "mp4", ".mov": "mov", ".mkv": "matroska"}
_MAX_FRAMES = 10_000_000
_QUALITY = {"crf": "18", "preset": "medium"}
_BITEXACT = {"fflags": "+bitexact"}
_Picture = UInt8[np.ndarray, "height width 3"]


@dataclass(frozen=True, eq=False)
class Film:
    """What a film says of itself.

    Args:
        path: The file.
        width: Pixels, as stored.
        height: Pixels, as stored.
        stamps: Presentation stamp of each frame in units of ``time_base``, rising, shape (n,).
        time_base: Seconds of a unit.
    """

    path: Path
    width: int
    height: int
    stamps: Int[np.ndarray, " n"]
    time_base: Fraction

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def times_s(self) -> Float[np.ndarray, " n"]:
        """When each frame is shown, in seconds of the film's own clock."""
        return np.asarray(self.stamps * float(self.time_base))

    def nearest(self, time_s: float | int) -> int:
        """Number of the frame whose time is nearest."""
        return int(np.abs(self.times_s - time_s).argmin())


def _av(purpose: str = "reading films") -> ModuleType:
    try:
        import av
    except ImportError:
        raise MissingExtraError("PyAV", "video", purpose) from None
    av.logging.set_level(None)
    return av


def check_writing(path: Path | str) -> None:
    """Refuse what :func:`write_film` would refuse, before the pictures are made.

    Raises:
        ConfigError: If the name has another ending than a film's.
        MissingExtraError: If PyAV is not installed.
    """
    _kind_of(path)
    _av("writing films")


def _kind_of(path: Path | str) -> str:
    kind = WRITTEN.get(Path(path).suffix.lower())
    if kind is None:
        raise ConfigError(f"writing films: expected a name ending in {', '.join(WRITTEN)}, got {Path(path).name!r}")
    return kind


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """A film and its first video stream; what goes wrong within is said as a damaged file."""
    av = _av()
    check_itself(path)
    try:
        with av.open(str(path), metadata_errors="replace") as container:
            if not container.streams.video:
                raise FileFormatError(path, where="the file", expected="a film", got="no video stream")
            stream = container.streams.video[0]
            if stream.codec_context is None:
                raise FileFormatError(path, where="the header", expected="a codec that FFmpeg knows", got="another")
            if not 0 < stream.width * stream.height <= MAX_PIXELS:
                actual = f"{stream.width} x {stream.height}"
                raise FileFormatError(path, where="the header", expected=f"1 to {MAX_PIXELS} pixels", got=actual)
            stream.thread_count = 1
            yield container, stream
    except (av.FFmpegError, ValueError, OverflowError, EOFError) as error:
        actual = str(error).split("\n")[0][:200] or type(error).__name__
        raise FileFormatError(path, where="the film", expected="a whole film", got=actual) from error


def read_film(path: Path | str) -> Film:
    """Read what a film says of itself; no frame is decoded.

    Raises:
        FileFormatError: If it is no film, or its frames have no stamps or equal ones.
        MissingExtraError: If PyAV is not installed.
    """
    path = Path(path)
    if not path.is_file():
        raise FileFormatError(path, where="the file", expected="a film", got="no file")
    with _opened(path) as (container, stream):
        stamps: list[int] = []
        for packet in container.demux(stream):
            if packet.size:
                if packet.pts is None or len(stamps) >= _MAX_FRAMES:
                    expected = f"a stamp for each of at most {_MAX_FRAMES} frames"
                    raise FileFormatError(path, where=f"frame {len(stamps)}", expected=expected, got="none")
                stamps.append(packet.pts)
        ordered = np.unique(np.array(stamps, dtype=np.int64))
        if not stamps or len(ordered) < len(stamps):
            actual = f"{len(stamps)} frames with {len(ordered)} stamps"
            raise FileFormatError(path, where="the stamps", expected="a different one for each frame", got=actual)
        return Film(path, stream.width, stream.height, ordered, Fraction(stream.time_base))


def film_frames(film: Film, first: int = 0, last: int | None = None) -> Iterator[_Picture]:
    """Decode the frames from ``first`` up to ``last``, upright, RGB.

    Raises:
        FileFormatError: If one of them cannot be decoded.
    """
    last = len(film) if last is None else min(last, len(film))
    position = first
    with _opened(film.path) as (container, stream):
        if first:
            container.seek(int(film.stamps[first]), stream=stream, backward=True)
        for frame in container.decode(stream):
            if position >= last:
                return
            if frame.pts is None or frame.pts < film.stamps[position]:
                continue
            if frame.pts != film.stamps[position] or (frame.width, frame.height) != (film.width, film.height):
                break
            picture = frame.to_ndarray(format="rgb24")
            yield np.ascontiguousarray(np.rot90(picture, round(frame.rotation / 90) % 4))
            position += 1
    if position < last:
        raise FileFormatError(
            film.path, where=f"frame {position}", expected=f"{len(film)} frames of one size", got="none that decodes"
        )


def film_frame(path: Path | str, time_s: float | int) -> _Picture:
    """The frame of a film that is shown nearest to a time of the film's own clock, counted from its first frame."""
    film = read_film(path)
    number = film.nearest(film.times_s[0] + time_s)
    return next(film_frames(film, number, number + 1))


def write_film(path: Path | str, pictures: Iterator[_Picture], stamps: Sequence[int], time_base: Fraction) -> None:
    """Write pictures as a film, H.264 in whatever the suffix says; equal pictures give equal bytes.

    Every picture keeps its stamp. No sound, no metadata, no order but that of showing: parts can be joined.

    Args:
        path: The file, written all or nothing: .mp4, .mov, .m4v or .mkv.
        pictures: As many as stamps, of one even size.
        stamps: Their stamps, rising.
        time_base: Seconds of a unit of the stamps.

    Raises:
        ConfigError: If a side is odd, which the format does not have, or FFmpeg lacks x264.
    """
    av = _av("writing films")
    if "libx264" not in av.codecs_available:
        raise ConfigError("writing films: expected an FFmpeg with libx264, which PyAV's wheels have; this one has none")
    with _written(av, path) as container:
        stream = container.add_stream("libx264", options={**_QUALITY, "x264-params": "bframes=0:threads=1"})
        stream.codec_context.time_base = stream.time_base = time_base
        stream.pix_fmt, stream.codec_context.thread_count = "yuv420p", 1
        for stamp, picture in zip(stamps, pictures, strict=True):
            if not stream.codec_context.is_open:
                stream.height, stream.width = picture.shape[0] // 2 * 2, picture.shape[1] // 2 * 2
            frame = av.VideoFrame.from_ndarray(picture[: stream.height, : stream.width], format="rgb24")
            frame.pts, frame.time_base = int(stamp), time_base
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


@contextmanager
def _written(av: ModuleType, path: Path | str) -> Iterator[Any]:
    """A container to write into, which appears under its name when it is whole."""
    kind = _kind_of(path)
    with open_atomic(path) as handle, av.open(handle, "w", format=kind, options=dict(_BITEXACT)) as container:
        yield container


def join_films(path: Path | str, parts: Sequence[Path]) -> None:
    """Join parts of a film that :func:`write_film` wrote, without encoding them anew."""
    av = _av("writing films")
    with _written(av, path) as container:
        stream = None
        for part in parts:
            with av.open(str(part)) as source:
                if stream is None:
                    stream = container.add_stream_from_template(source.streams.video[0])
                for packet in source.demux(source.streams.video[0]):
                    if packet.size:
                        packet.stream = stream
                        container.mux(packet)
