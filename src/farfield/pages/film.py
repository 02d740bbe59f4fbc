"""A drive as a film: every sensor, the boxes, the tracks with their trails; made without a browser.

Each picture is a unit of work: it is written whole, kept in a folder beside the film until that stands, and not made
again when an interrupted film is begun anew.
"""

import shutil
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import numpy as np
from PIL import Image

from farfield.datasets.base import Dataset
from farfield.errors import ConfigError
from farfield.files import videos
from farfield.files.animations import write_animation
from farfield.files.atomic import open_atomic
from farfield.frame import Boxes, Drive, Key
from farfield.geometry.poses import invert
from farfield.jobs import HERE, JobJournal, JobOptions, Unit, UnitResult, run
from farfield.pages.film_frame import film_picture, panels_of
from farfield.pages.film_panels import DrawnBoxes
from farfield.vocabulary.scores import SHOWN_SCORE

ANIMATED = (".gif", ".webp")
_VERSION = 1
_USUAL_HZ = 10.0


@dataclass(frozen=True)
class FilmSettings:
    """What a film shows.

    Args:
        reach_m: How far ahead the views from above show.
        rate_hz: Frames a second; 0 takes the drive's own rate, or 10 where its times are not known.
        trail_frames: How many frames back a track's trail reaches.
        score: Predictions below it are left out.
    """

    reach_m: float | int = 100.0
    rate_hz: float | int = 0.0
    trail_frames: int = 20
    score: float | int = SHOWN_SCORE

    def __post_init__(self) -> None:
        if not 5 <= self.reach_m <= 1000 or not 0 <= self.rate_hz <= 60 or self.trail_frames < 0:
            raise ConfigError(
                f"film: expected a reach from 5 to 1000 m, up to 60 frames a second and no negative trail, got {self}"
            )


@dataclass(frozen=True, eq=False)
class FilmWork:
    """Draws the pictures of one drive.

    Args:
        data: The data set.
        drive: The drive.
        folder: Where the pictures go.
        panels: What stands where, by name.
        predictions: Predicted boxes or tracks by (sequence, frame), in the data set's coordinates.
        settings: What the film shows.
    """

    data: Dataset
    drive: Drive
    folder: Path
    panels: tuple[tuple[str, str], ...]
    predictions: Mapping[Key, Boxes] | None = None
    settings: FilmSettings = field(default_factory=FilmSettings)

    def __call__(self, unit: Unit) -> UnitResult:
        """Draw the frame at a place of the drive."""
        place = int(unit.parameters)
        frame = self.data[int(self.drive.indices[place])]
        drawn = [each for each in (self._drawn(place, False), self._drawn(place, True)) if each is not None]
        image = film_picture(frame, self.panels, drawn, reach_m=self.settings.reach_m)
        path = self.folder / f"{place:06d}.png"
        with open_atomic(path) as handle:
            image.save(handle, format="PNG", compress_level=1)
        return UnitResult(files=(path,))

    def _drawn(self, place: int, predicted: bool) -> DrawnBoxes | None:
        boxes = self._boxes(place, predicted)
        if boxes is None:
            return None
        return DrawnBoxes(boxes, predicted, self._trails(place, predicted, boxes))

    def _boxes(self, place: int, predicted: bool) -> Boxes | None:
        if not predicted:
            annotation = self.data.annotation(int(self.drive.indices[place]))
            return None if annotation is None else annotation.boxes
        found = None if self.predictions is None else self.predictions.get(self.drive.keys[place])
        return found if found is None or found.score is None else found[found.score >= self.settings.score]

    def _trails(self, place: int, predicted: bool, now: Boxes) -> dict[int, np.ndarray]:
        """Where the tracks of a frame were lately, in its coordinates; without poses in those of their own time."""
        shown = set() if now.track_id is None else {int(track) for track in now.track_id if track >= 0}
        found: dict[int, list[np.ndarray]] = {track: [] for track in sorted(shown)}
        poses = self.drive.world_T_frame
        for earlier in range(max(0, place - self.settings.trail_frames), place + 1) if shown else ():
            boxes = self._boxes(earlier, predicted)
            if boxes is None or boxes.track_id is None:
                continue
            tracks = boxes.track_id.tolist()
            if poses is not None and earlier != place:
                boxes = boxes.transform(invert(poses[place]) @ poses[earlier])
            for row, track in enumerate(tracks):
                if track in found:
                    found[track].append(boxes.centre_m[row])
        return {track: np.array(places) for track, places in found.items()}


def make_film(
    path: Path | str,
    data: Dataset,
    *,
    drive: str = "",
    predictions: Mapping[Key, Boxes] | None = None,
    settings: FilmSettings = FilmSettings(),
    bulk: JobOptions = HERE,
) -> int:
    """Write the film of a drive; gives the number of its frames.

    Args:
        path: .mp4, .mov, .m4v or .mkv (extra ``video``), .gif or .webp.
        data: The data set.
        drive: Name of the drive; the first one unless given.
        predictions: Boxes to show beside the annotated ones; with identities they have trails.
        settings: What it shows.
        bulk: How the pictures are made.

    Raises:
        ConfigError: If the name has another ending, or there is no such drive.
        MissingExtraError: If a film's suffix needs PyAV and it is not installed.
    """
    path = Path(path)
    if path.suffix.lower() not in ANIMATED:
        videos.check_writing(path)
    found = drive_named(data, drive)
    folder = path.with_name(f".{path.name}.pictures")
    folder.mkdir(parents=True, exist_ok=True)
    work = FilmWork(data, found, folder, panels_of(data, found), predictions, settings)
    units = [
        Unit(f"{place:06d}", sources=tuple(data.files(int(index))), parameters=place)
        for place, index in enumerate(found.indices)
    ]
    setting = repr((_VERSION, found.name, found.keys, work.panels, settings, _predictions_crc(predictions)))
    run(work, units, bulk, journal=JobJournal(folder / ".journal.jsonl", setting=setting))
    _assemble(path, [folder / f"{place:06d}.png" for place in range(len(units))], rate_of(found, settings))
    shutil.rmtree(folder)
    return len(units)


def drive_named(data: Dataset, name: str) -> Drive:
    """A drive by its name; the first for nothing.

    Raises:
        ConfigError: If there is none of this name, or no frame at all.
    """
    drives = data.drives()
    found = next((drive for drive in drives if name in ("", drive.name)), None)
    if not drives:
        raise ConfigError("film: the frames of this data set are of no drive: they do not follow each other in time")
    if found is None:
        known = ", ".join(drive.name for drive in drives[:20])
        raise ConfigError(f"drive: expected one of {known}, got {name!r}")
    return found


def rate_of(drive: Drive, settings: FilmSettings) -> Fraction:
    """Frames a second: as set, else the drive's own, from 1 to 60."""
    rate = settings.rate_hz
    if not rate and drive.times_ns is not None and len(drive.times_ns) > 1:
        step_s = float(np.median(np.diff(drive.times_ns))) / 1e9
        rate = min(60.0, max(1.0, 1 / step_s)) if step_s > 0 else 0.0
    return Fraction(rate or _USUAL_HZ).limit_denominator(100)


def _assemble(path: Path, pictures: list[Path], rate: Fraction) -> None:
    if path.suffix.lower() in ANIMATED:
        whole = pictures[0].with_name(f"whole{path.suffix.lower()}")
        write_animation(whole, pictures, rate_hz=float(rate))
        whole.replace(path)
        return
    videos.write_film(path, _read_pictures(pictures), range(len(pictures)), 1 / rate)


def _read_pictures(pictures: list[Path]) -> Iterator[np.ndarray]:
    for each in pictures:
        with Image.open(each, formats=("PNG",)) as image:
            yield np.asarray(image.convert("RGB"))


def _predictions_crc(predictions: Mapping[Key, Boxes] | None) -> int:
    """Tells predictions apart, so that a film is not finished with others than it was begun with."""
    if predictions is None:
        return 0
    parts = [str(sorted(predictions)).encode()]
    parts += [part.centre_m.tobytes() + part.yaw_rad.tobytes() for _, part in sorted(predictions.items())]
    return zlib.crc32(b"".join(parts))
