"""nuScenes' scores of tracks as a protocol, for one class of any data set."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from farfield.errors import ConfigError
from farfield.frame.drive import Key
from farfield.geometry.boxes import Boxes
from farfield.metrics.frames import check_frames, flatten, frame_order, has_label, same_owner
from farfield.metrics.options import check_range_bins, json_options
from farfield.metrics.protocol import Protocol
from farfield.metrics.result import Result, table, value_at
from farfield.metrics.tracking.amota import ClassBoxes, PairFollower, average, figures_at
from farfield.metrics.tracking.clear import Figures
from farfield.metrics.tracking.scene import collect_rows

if TYPE_CHECKING:
    from farfield.metrics.detections import Detections

_HEADLINE = ("AMOTA", "AMOTP", "MOTA", "MOTP", "recall", "IDS")
_SHARES = ("AMOTA", "MOTA", "MOTAR", "recall")
_METRES_AND_SECONDS = ("AMOTP", "MOTP", "FAF", "TID", "LGD", "threshold")


@dataclass(frozen=True, kw_only=True)
class NuScenesTrackingSettings:
    """Options of nuScenes' scores of tracks.

    Args:
        label: The class that is scored.
        relabel: Class names that stand for another.
        distance_m: Distance of the centres, seen from above, that pairs are nearer than.
        most_range_m: Boxes at this distance from the sensor or further count nowhere, tracks are filled afterwards:
            nuScenes takes 50 m, 40 m for pedestrians and two-wheelers. None keeps all.
        need_points: Whether annotated boxes that are known to hold no point are left out.
        step_s: Seconds between frames for TID and LGD; nuScenes' annotated frames are 0.5 s apart.
        range_bins_m: Edges of the half-open range bins: annotated boxes and matches count where the annotated box is,
            false ones where they are themselves, at the threshold that is best for the whole.
    """

    label: str = "car"
    relabel: Mapping[str, str] = field(default_factory=dict)
    distance_m: float = 2.0
    most_range_m: float | None = None
    need_points: bool = True
    step_s: float = 0.5
    range_bins_m: tuple[float, ...] = (0.0, 70.0, 150.0, 250.0)

    def __post_init__(self) -> None:
        for name in ("distance_m", "most_range_m", "step_s"):
            if getattr(self, name) is not None and not getattr(self, name) > 0:
                raise ConfigError(f"{name}: expected a positive number, got {getattr(self, name)}")
        check_range_bins(self.range_bins_m)

    @property
    def bins_m(self) -> dict[str, tuple[float, float]]:
        """The half-open range bins as (low, high) by name."""
        return {f"{low:g}-{high:g}": (low, high) for low, high in pairwise(self.range_bins_m)}


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class NuScenesTrackingResult(Result):
    """nuScenes' scores of tracks."""

    def __str__(self) -> str:
        parts = [*self.ranges, "overall"]
        rows = [[name.split("/")[1], *(self._cell(part, name) for part in parts)] for name in self.figures]
        title = f"nuScenes' scores of tracks of {self.label!r}, by range in metres; shares in per cent; '-': not there"
        return f"{title}\n\n{table(['', *parts], rows)}\n\n{self.footer()}"

    def _cell(self, part: str, name: str) -> str:
        value = (self.figures if part == "overall" else self.ranges[part]).get(name)
        if value is None:
            return "-"
        short = name.split("/")[1]
        if short in _SHARES:
            return self.cell(part, name)
        return f"{value:.3f}" if short in _METRES_AND_SECONDS else f"{value:.0f}"


class NuScenesTracking(Protocol):
    """AMOTA, AMOTP and what stands beside them, as nuScenes' development kit has them."""

    name = "nuscenes-tracking"
    Settings = NuScenesTrackingSettings

    def evaluate(self, found: "Detections", settings: NuScenesTrackingSettings) -> NuScenesTrackingResult:
        """Score the tracks of one class.

        Raises:
            ConfigError: If boxes have no track, or a track has two boxes in a frame.
        """
        check_frames(found.boxes, found.annotated)
        follower = gather_sides(found, settings)
        figures: dict[str, float | None] = {}
        ranges: dict[str, dict[str, float | None]] = {name: {} for name in settings.bins_m}
        if len(follower.annotated):
            averaged = average(follower, distance_m=settings.distance_m, step_s=settings.step_s)
            figures = {f"tracking/{name}": value for name, value in averaged.figures.items()}
            figures["tracking/threshold"] = averaged.threshold
            for name, bin_m in settings.bins_m.items():
                of: Figures = dict(figures_at(follower, averaged.found, settings.step_s, bin_m))
                ranges[name] = {f"tracking/{n}": None if v is None or np.isnan(v) else v for n, v in of.items()}
        return NuScenesTrackingResult(
            protocol=str(self),
            label=settings.label,
            settings=json_options(asdict(settings)),
            convention="",
            figures=figures or dict.fromkeys(f"tracking/{name}" for name in _HEADLINE),
            ranges=ranges,
            counts={
                "annotated": len(follower.annotated),
                "predictions": len(follower.predicted),
                "frames": len(found.annotations),
            },
        )

    def headline(self, result: Mapping[str, Any]) -> Mapping[str, float | None]:
        """The rates of the whole."""
        return {f"tracking/{name}": value_at(result, f"tracking/{name}") for name in _HEADLINE}

    def title(self, figure: str) -> str:
        """The rate's own name."""
        return figure.removeprefix("tracking/")

    def inert(self, settings: Mapping[str, Any]) -> tuple[str, ...]:
        """Range bins and the label."""
        del settings
        return ("label", "range_bins_m")


def gather_sides(found: "Detections", settings: NuScenesTrackingSettings) -> PairFollower:
    """Collect one class of all frames: in the world where there are poses, tracks filled over missing frames."""
    keys = sorted(found.annotations, key=frame_order)
    given = [found.annotations[key].boxes for key in keys]
    seen = [found.boxes.get(key, Boxes.empty(scored=True)) for key in keys]
    if settings.need_points:
        given = [boxes if boxes.point_count is None else boxes[boxes.point_count != 0] for boxes in given]
    times = _times(found, keys)
    sides = [
        _side(found, keys, parts, times, settings, what=what)
        for parts, what in ((given, "annotations"), (seen, "predictions"))
    ]
    annotated, predicted = sides
    a, b = same_owner(annotated.frame, predicted.frame, len(keys))
    gap_m = np.hypot(*(annotated.place_m[a] - predicted.place_m[b]).T)
    near = gap_m < settings.distance_m
    return PairFollower(annotated, predicted, np.column_stack([a[near], b[near]]), gap_m[near])


def _times(found: "Detections", keys: list[Key]) -> Int[np.ndarray, " frames"]:
    """Stamps of the frames, or their places where there are none."""
    stamps = {key: number for number, key in enumerate(keys)}
    for drive in found.drives:
        if drive.times_ns is not None:
            stamps |= dict(zip(drive.keys, drive.times_ns.tolist(), strict=True))
    return np.array([stamps[key] for key in keys], dtype=np.int64)


def _side(
    found: "Detections",
    keys: list[Key],
    parts: list[Boxes],
    times: Int[np.ndarray, " frames"],
    settings: NuScenesTrackingSettings,
    *,
    what: str,
) -> ClassBoxes:
    reach = np.inf if settings.most_range_m is None else settings.most_range_m
    parts = [boxes[boxes.range_m < reach] for boxes in parts]
    boxes = flatten(parts, scored=what == "predictions")
    used = has_label(boxes, settings.label, settings.relabel)
    rows = collect_rows(keys, parts, boxes, used, np.zeros(len(boxes), dtype=bool), what=what)
    poses = {
        key: drive.world_T_frame[number]
        for drive in found.drives
        if drive.world_T_frame is not None
        for number, key in enumerate(drive.keys)
    }
    moved = [part.transform(poses[key]) if key in poses else part for key, part in zip(keys, parts, strict=True)]
    place = np.concatenate([np.zeros((0, 2)), *(part.centre_m[:, :2] for part in moved)])[used]
    return _filled(
        ClassBoxes(frame=rows.frame, track=rows.track, place_m=place, range_m=rows.range_m, score=rows.score), times
    )


def _filled(side: ClassBoxes, times: Int[np.ndarray, " frames"]) -> ClassBoxes:
    """Tracks with boxes in the frames between, linear in time; the kit gives the later box the earlier one's weight."""
    order = np.lexsort([side.frame, side.track])
    left, right = order[:-1], order[1:]
    gap = np.flatnonzero((side.track[left] == side.track[right]) & (side.frame[right] - side.frame[left] > 1))
    left, right = left[gap], right[gap]
    each = side.frame[right] - side.frame[left] - 1
    a, b = np.repeat(left, each), np.repeat(right, each)
    frame = side.frame[a] + 1 + np.arange(len(a)) - np.repeat(np.cumsum(each) - each, each)
    share = (times[side.frame[b]] - times[frame]) / (times[side.frame[b]] - times[side.frame[a]])
    seen_first = np.full(int(side.track.max(initial=0)) + 1, len(side))
    np.minimum.at(seen_first, side.track, np.arange(len(side)))
    # In a frame the filled boxes follow the others, in the order in which their tracks begin.
    late = np.r_[np.arange(len(side)), len(side) + seen_first[side.track[a]]]
    order = np.lexsort([late, np.r_[side.frame, frame]])
    return ClassBoxes(
        frame=np.r_[side.frame, frame][order],
        track=np.r_[side.track, side.track[a]][order],
        place_m=np.concatenate([side.place_m, _between(side.place_m[a], side.place_m[b], share[:, None])])[order],
        range_m=np.r_[side.range_m, _between(side.range_m[a], side.range_m[b], share)][order],
        score=np.r_[side.score, _between(side.score[a], side.score[b], share)][order],
    )


def _between(
    a: Float[np.ndarray, "n ..."], b: Float[np.ndarray, "n ..."], share: Float[np.ndarray, "n ..."]
) -> Float[np.ndarray, "n ..."]:
    return np.asarray((1.0 - share) * a + share * b)
