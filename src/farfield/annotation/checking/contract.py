"""What checks are given and what they say."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from farfield.annotation.checking.scene import Surroundings
from farfield.datasets.labels import BoxLabel, Numbers
from farfield.frame import Key

Severity = Literal["info", "warning", "error"]


@dataclass(frozen=True, kw_only=True)
class LabelIssue:
    """Something that a person should look at.

    Args:
        check: Which check, one of :data:`~farfield.annotation.checking.CHECKS`.
        severity: ``error``: cannot be right; ``warning``: is seldom right; ``info``: worth a look.
        sentence: What is the matter, for people.
        frame: The frame to jump to.
        box: The box, or None where it is one that is missing.
        track: Its track; empty where it has none.
        place: Where it is, x and y in the frame, metres: the view goes there.
        ignored: Why a person lets it stand; None where nobody does.
    """

    check: str
    severity: Severity
    sentence: str
    frame: Key
    box: str | None
    track: str = ""
    place: tuple[float, float] | None = None
    ignored: str | None = None

    @property
    def id(self) -> str:
        """The finding's name, the same as long as the check finds it."""
        where = "" if self.place is None else f"{self.place[0]:.0f},{self.place[1]:.0f}"
        return "/".join((self.check, *self.frame, f"at {where}" if self.box is None else self.box))


class SizeRange(NamedTuple):
    """Sizes of a class: length, width, height, metres.

    Args:
        usual: The median or preset.
        low: What 0.5 % of the set's boxes lie below; None: not known.
        high: What 0.5 % lie above; None: not known.
        types: Usual sizes of kinds within the class.
    """

    usual: tuple[float, float, float]
    low: tuple[float, float, float] | None = None
    high: tuple[float, float, float] | None = None
    types: tuple[tuple[float, float, float], ...] = ()


class SensorView(NamedTuple):
    """What a sensor sees.

    Args:
        sensor: Its name.
        range_m: How far.
        left_rad: Azimuth of the left edge, counter-clockwise from +x.
        right_rad: Azimuth of the right edge; the view goes counter-clockwise from here to the left edge.
    """

    sensor: str
    range_m: float
    left_rad: float = math.pi
    right_rad: float = -math.pi

    def sees(self, x: float, y: float) -> bool:
        """Whether a place is in the view."""
        whole = self.left_rad - self.right_rad >= 2 * math.pi
        inside = (math.atan2(y, x) - self.right_rad) % (2 * math.pi) <= (self.left_rad - self.right_rad) % (2 * math.pi)
        return math.hypot(x, y) <= self.range_m and (whole or inside)


class TrackStep(NamedTuple):
    """A box of a track in one frame.

    Args:
        row: The frame's row in its drive.
        time_s: When.
        box: The box: in the world where the drive has poses, else as the frame has it.
    """

    row: int
    time_s: float
    box: Numbers


class NearbyTrack(NamedTuple):
    """A track near the frame that is checked.

    Args:
        steps: Boxes of the frames around, in the order of time, one a frame.
        frames: In how many frames the track is.
        posed: Whether the boxes stand in the world.
        locked: Whether its size is locked.
    """

    steps: Sequence[TrackStep]
    frames: int
    posed: bool = False
    locked: bool = False


class DetectorBox(NamedTuple):
    """A detector's box.

    Args:
        label: Its class as the data set spells it, or as the detector does.
        box: The box.
        score: Its score.
    """

    label: str
    box: Numbers
    score: float


@dataclass(frozen=True, kw_only=True)
class CheckedFrame:
    """The frame that is checked.

    Args:
        key: The frame.
        row: Its row in its drive.
        around: Its LiDAR points, sorted for quick look-up; None: points are not looked at.
        detections: What a detector found, if one was run.
    """

    key: Key
    row: int = 0
    around: Surroundings | None = None
    detections: Sequence[DetectorBox] = ()


@dataclass(frozen=True, kw_only=True)
class CheckSettings:
    """From where on something is found; what the defaults make of K-Radar's labels v2.1 stands in docs/studio.md.

    Args:
        sizes: Sizes by class; classes that are not in it have none.
        fastest_m_s: Speeds over ground that are not believed, by class; others: 60 m/s.
        extent: ``full``: boxes are whole bodies; ``visible``: what is seen of them (no check of the points around).
        views: What the sensors see; none: boxes may stand anywhere within ``farthest_m``.
        farthest_m: Distance beyond which nothing can be.
    """

    sizes: Mapping[str, SizeRange] = field(default_factory=dict)
    fastest_m_s: Mapping[str, float] = field(default_factory=dict)
    extent: Literal["full", "visible"] = "full"
    views: Sequence[SensorView] = ()
    farthest_m: float = 300.0
    size_ratio: float = 2.0
    track_size: float = 0.05
    track_size_far: float = 0.20
    turn_rad: float = math.radians(20.0)
    flip_rad: float = math.radians(135.0)
    jump_m: float = 1.0
    jump_far_m: float = 2.0
    overlap_iou: float = 0.05
    duplicate_iou: float = 0.3
    longest_gap: int = 5
    shortest_track: int = 3
    ground_m: float = 0.35
    fewest_points: int = 3
    ring_m: float = 0.3
    ring_share: float = 0.2
    detector_score: float = 0.5
    detector_iou: float = 0.5


Boxes = Sequence[BoxLabel]
