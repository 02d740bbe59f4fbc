"""A workload in words, ``35000-frames-kradar`` or ``40h-cirrus``, and the published sizes of the data sets it names."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from farfield.datasets.kradar.store import PUBLISHED_BYTES
from farfield.errors import ConfigError
from farfield.vocabulary.kradar import SEQUENCES, STEREO_CAMERAS

CLOUD, CLOUDS, CAMERA, CAMERAS = "cloud", "clouds", "camera", "cameras"
LABELS, CELLS, TESSERACT = "labels", "cells", "tesseract"
"""What a verb reads of a frame: one LiDAR's cloud or all, one camera's picture or all, labels, cells, the 4D tensor."""

MAX_FRAMES = 10**12
_GRAMMAR = re.compile(
    r"(?:(?P<amount>\d[\d_,]*(?:\.\d+)?)[- ]?(?P<unit>frames?|hours?|h)(?:-(?P<of>[a-z]+))?|(?P<whole>[a-z]+))"
)
_EXAMPLES = "35000-frames-kradar, 40h-cirrus, 1000h or kradar"


@dataclass(frozen=True, kw_only=True)
class DatasetSize:
    """What is published of a data set's size.

    Args:
        title: What it is called.
        frames: Frames of the published set.
        rate_hz: Frames a second while it drives.
        whole_frame_bytes: All its files over all its frames; 0 where nothing is published.
        frame_bytes: Bytes of a part of a frame, where published; of other parts the simulated frames' sizes count.
        items: Points of the clouds and pixels of the pictures of a frame, with which times measured on frames of
            another data set are scaled.
        packed_bytes: Bytes into which a part unpacks, where the published files are packed and simulated ones are not.
        source: Where the figures come from.
    """

    title: str
    frames: int
    rate_hz: float
    whole_frame_bytes: float = 0.0
    frame_bytes: Mapping[str, float] = field(default_factory=dict)
    items: Mapping[str, int]
    packed_bytes: Mapping[str, float] = field(default_factory=dict)
    source: str


_ANNOTATED = sum(sequence.frames for sequence in SEQUENCES.values())
_KRADAR_BYTES = {name: size / _ANNOTATED for name, size in PUBLISHED_BYTES.items()}
_KRADAR_PIXELS, _CIRRUS_POINTS, _CIRRUS_PIXELS = 2560 * 720, 38_255, 1920 * 650

DATASET_SIZES: Mapping[str, DatasetSize] = {
    "kradar": DatasetSize(
        title="K-Radar",
        frames=_ANNOTATED,
        rate_hz=10.0,
        whole_frame_bytes=16e12 / 35_000,
        frame_bytes={
            CLOUD: _KRADAR_BYTES["os2-64"],
            CLOUDS: _KRADAR_BYTES["os2-64"] + _KRADAR_BYTES["os1-128"],
            CAMERA: _KRADAR_BYTES["cam-front"],
            CAMERAS: sum(_KRADAR_BYTES[name] for name in STEREO_CAMERAS),
            LABELS: _KRADAR_BYTES["labels"],
            TESSERACT: _KRADAR_BYTES["tesseract"],
        },
        items={CLOUD: 131_072, CLOUDS: 131_072 + 262_144, CAMERA: _KRADAR_PIXELS, CAMERAS: 4 * _KRADAR_PIXELS},
        packed_bytes={TESSERACT: 64 * 256 * 37 * 107 * 8.0},
        source="K-Radar's readme and supplement: 34,994 annotated frames at 10 Hz, in round numbers 16 TB of 35,000; "
        "tesseracts of the largest sequence (1,195 frames) 360 GB, os1-128 14 GB, os2-64 7 GB, a camera 4.5 GB, labels "
        "0.5 MB. Tensors of 64 x 256 x 37 x 107 doubles are 519 MB: files of 301 MB are packed",
    ),
    "cirrus": DatasetSize(
        title="Cirrus",
        frames=6_285,
        rate_hz=10.0,
        items={CLOUD: _CIRRUS_POINTS, CLOUDS: 2 * _CIRRUS_POINTS, CAMERA: _CIRRUS_PIXELS, CAMERAS: _CIRRUS_PIXELS},
        source="Wang et al., ICRA 2021: 6,285 frames, LiDARs at 10 Hz, pictures of 1920 x 650 pixels; 38,255 points in "
        "a Gaussian cloud by its authors' viewer. No size is published: the simulated frames' own counts",
    ),
}
"""By the words that a workload may name."""

PLAIN = "cirrus"
"""Whose frames count where a workload names no data set."""


@dataclass(frozen=True, kw_only=True)
class Workload:
    """So many frames of a data set.

    Args:
        text: The words that it was read from.
        dataset: One of :data:`DATASET_SIZES`.
        frames: How many.
        named: Whether the words name the data set.
    """

    text: str
    dataset: str
    frames: int
    named: bool = True

    @property
    def size(self) -> DatasetSize:
        """What is published of the data set."""
        return DATASET_SIZES[self.dataset]

    @property
    def driving_h(self) -> float:
        """Hours of driving."""
        return self.frames / self.size.rate_hz / 3600


def parse_workload(text: str) -> Workload:
    """Read a workload: ``AMOUNT-frames-DATASET``, ``AMOUNTh-DATASET``, or ``DATASET`` for all of it.

    Hours count at the data set's published rate. Without a data set the frames are those of Cirrus. Digits may be
    grouped by commas or underscores.

    Raises:
        ConfigError: If the words are none of these, name no such data set, or fewer than one frame, or more than
            :data:`MAX_FRAMES`.

    >>> parse_workload("35,000-frames-kradar").frames, parse_workload("40h-cirrus").frames
    (35000, 1440000)
    >>> parse_workload("kradar").frames
    34994
    """
    match = _GRAMMAR.fullmatch(text.strip().lower())
    if match is None:
        raise ConfigError(f"--for: expected frames or hours of a data set, such as {_EXAMPLES}; got {text!r}")
    named = match["of"] or match["whole"]
    dataset = named or PLAIN
    if dataset not in DATASET_SIZES:
        raise ConfigError(f"--for: expected a data set among {', '.join(DATASET_SIZES)}; got {dataset!r}")
    size = DATASET_SIZES[dataset]
    amount = float((match["amount"] or str(size.frames)).replace(",", "").replace("_", ""))
    hours = (match["unit"] or "").startswith("h")
    frames = amount * 3600 * size.rate_hz if hours else amount
    if not 1 <= frames <= MAX_FRAMES or (not hours and frames != int(frames)):
        raise ConfigError(f"--for: expected 1 to {MAX_FRAMES:,} whole frames, got {text!r}: {frames:,.10g}")
    return Workload(text=text, dataset=dataset, frames=round(frames), named=bool(named))
