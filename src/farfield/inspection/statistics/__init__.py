"""Statistics of a data set in one pass over its frames: what ``farfield compare`` sets side by side.

Counts, not frames, are kept, plus one short row for every annotated box, so that memory does not grow with the clouds.
Two parts of a data set that were counted apart can be merged.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float32, Int

from farfield.frame import Frame
from farfield.geometry.poses import invert, transform_points
from farfield.inspection.statistics.background import BackgroundTally
from farfield.inspection.statistics.objects import ObjectRows
from farfield.inspection.statistics.radar import RadarTally, box_excess, map_statistics, power_map_db
from farfield.vocabulary.conditions import CONDITIONS

# How a sensor's returns spread over elevation and range, and how many of its shots come back.

FOCUS_DEG = -2.0
"""Focus of the Gaussian scan pattern that a fit to real Luminar sweeps supports; its own figure is not published."""
WITHIN_DEG = (2.0, 5.0, 10.0)
FAR_M = 8.0
"""Returns beyond it also count apart: nearer ones see their elevation shifted where several sensors were merged."""
ELEVATION_EDGES_DEG = np.linspace(-30.0, 30.0, 241)
RANGE_EDGES_M = np.linspace(0.0, 400.0, 81)


@dataclass(kw_only=True)
class CloudTally:
    """Counts over the clouds of one sensor or pattern. The sensor is taken to stand at the frame's origin.

    Args:
        focus_deg: Elevation about which the shares are also counted.
    """

    focus_deg: float = FOCUS_DEG
    frames: int = 0
    points: int = 0
    shots: int = 0
    points_of_shots: int = 0
    longest_m: float = 0.0
    elevation: Int[np.ndarray, " b"] = field(default_factory=lambda: np.zeros(len(ELEVATION_EDGES_DEG) - 1, np.int64))
    ranges: Int[np.ndarray, " b"] = field(default_factory=lambda: np.zeros(len(RANGE_EDGES_M) - 1, np.int64))
    far_points: int = 0
    within: Int[np.ndarray, "2 2 w"] = field(default_factory=lambda: np.zeros((2, 2, len(WITHIN_DEG)), np.int64))

    def add(self, points_m: Float32[np.ndarray, "n 3"], *, shots: int | None = None) -> None:
        """Count one cloud.

        Args:
            points_m: Its points; those at the origin, which mark missing returns, do not count.
            shots: How many shots the sensor fired, where that is known.
        """
        x, y, z = points_m.astype(np.float64).T
        range_m = np.sqrt(x * x + y * y + z * z)
        returned = range_m > 0
        range_m = range_m[returned]
        elevation_deg = np.degrees(np.arcsin(np.clip(z[returned] / range_m, -1.0, 1.0)))
        self.frames += 1
        self.points += len(range_m)
        if shots:
            self.shots += int(shots)
            self.points_of_shots += len(range_m)
        self.longest_m = max(self.longest_m, float(range_m.max(initial=0.0)))
        self.elevation += np.histogram(elevation_deg, ELEVATION_EDGES_DEG)[0]
        self.ranges += np.histogram(range_m, RANGE_EDGES_M)[0]
        far = range_m > FAR_M
        self.far_points += int(far.sum())
        for row, centre_deg in enumerate((0.0, self.focus_deg)):
            for column, counted in enumerate((slice(None), far)):
                away_deg = np.abs(elevation_deg[counted] - centre_deg)
                self.within[row, column] += [int((away_deg < limit).sum()) for limit in WITHIN_DEG]

    def merge(self, other: "CloudTally") -> None:
        """Take in the counts over other clouds of the same sensor."""
        self.frames += other.frames
        self.points += other.points
        self.shots += other.shots
        self.points_of_shots += other.points_of_shots
        self.longest_m = max(self.longest_m, other.longest_m)
        self.elevation += other.elevation
        self.ranges += other.ranges
        self.far_points += other.far_points
        self.within += other.within

    def summary(self) -> dict[str, Any]:
        """Points, returned shots, shares by elevation, and both histograms."""
        shares = self.within / np.maximum([[self.points], [self.far_points]], 1)
        names = [f"{limit:g}" for limit in WITHIN_DEG]
        horizon, focus = ([dict(zip(names, part, strict=True)) for part in row] for row in shares.tolist())
        return {
            "frames": self.frames,
            "points_per_frame": self.points / max(self.frames, 1),
            "return_rate": self.points_of_shots / self.shots if self.shots else None,
            "longest_m": self.longest_m,
            "focus_deg": self.focus_deg,
            "share_of_horizon": horizon[0],
            "share_of_focus": focus[0],
            "far_m": FAR_M,
            "far_share_of_horizon": horizon[1],
            "far_share_of_focus": focus[1],
            "elevation": {"edges_deg": ELEVATION_EDGES_DEG.tolist(), "count": self.elevation.tolist()},
            "range": {"edges_m": RANGE_EDGES_M.tolist(), "count": self.ranges.tolist()},
        }


__all__ = ["CloudTally", "ObjectRows", "RadarTally", "Statistics", "gather", "map_statistics", "power_map_db"]


@dataclass(kw_only=True)
class Statistics:
    """What was counted over some frames; :meth:`add` one more, :meth:`merge` another count.

    Args:
        focus_deg: Elevation about which the shares are also counted, where a Gaussian pattern has its focus.
        vehicle_labels: Classes that count as vehicles.
        shots: Shots a frame by cloud, where the frames' own ``Sensor.shots`` does not say.
    """

    focus_deg: float = FOCUS_DEG
    vehicle_labels: tuple[str, ...] = ("vehicle",)
    shots: Mapping[str, int] = field(default_factory=dict)
    frames: int = 0
    sequences: set[str] = field(default_factory=set)
    conditions: dict[str, Counter[str]] = field(default_factory=lambda: {name: Counter() for name in CONDITIONS})
    protocols: Counter[str] = field(default_factory=Counter)
    marked_simulated: Counter[str] = field(default_factory=Counter)
    clouds: dict[str, CloudTally] = field(default_factory=dict)
    background: dict[str, BackgroundTally] = field(default_factory=dict)
    objects: ObjectRows = field(default_factory=ObjectRows)
    radar: RadarTally = field(default_factory=RadarTally)

    def add(self, frame: Frame) -> None:
        """Count one frame; its clouds, boxes and radar are read here."""
        self.frames += 1
        self.sequences.add(frame.sequence)
        for name, counter in self.conditions.items():
            if name in frame.conditions:
                counter[str(frame.conditions[name])] += 1
        simulated = frame.conditions.get("simulated") if frame.simulated is None else frame.simulated
        self.marked_simulated[str(simulated).lower() if simulated is not None else "unmarked"] += 1
        if frame.annotation is not None:
            self.protocols[frame.annotation.extent] += 1
        shots = {**self.shots, **{name: one.shots for name, one in frame.sensors.items() if one.shots is not None}}
        loaded = {name: frame.cloud(name) for name in frame.clouds}
        for name, cloud in loaded.items():
            tally = self.clouds.setdefault(name, CloudTally(focus_deg=self.focus_deg))
            tally.add(cloud.points_m, shots=shots.get(name))
            if cloud.kind == "lidar":
                background = self.background.setdefault(name, BackgroundTally())
                background.add(cloud.points_m, frame.boxes, frame.sequence)
        heard = self.radar.add(frame.radar)
        if frame.boxes is not None:
            excess = None if heard is None else self._excess(frame, *heard)
            weather = frame.conditions.get("weather", "unknown")
            self.objects.add(frame.boxes, loaded, weather=weather, radar_excess=excess)

    @staticmethod
    def _excess(frame: Frame, power_db: np.ndarray, floor_db: float) -> np.ndarray | None:
        """Radar excess at each box, where the frame says where its radar stands."""
        radars = [frame.sensors[name] for name in (*frame.radar, "radar") if name in frame.sensors]
        pose = next((one.frame_T_sensor for one in radars if one.frame_T_sensor is not None), None)
        if pose is None or frame.boxes is None:
            return None
        return box_excess(power_db, transform_points(invert(pose), frame.boxes.centre_m), floor_db)

    def merge(self, other: "Statistics") -> None:
        """Take in what was counted over other frames.

        Raises:
            ValueError: If the two were counted about another focus or with other vehicle classes.
        """
        if (self.focus_deg, self.vehicle_labels) != (other.focus_deg, other.vehicle_labels):
            raise ValueError("merge: expected counts about the same focus and of the same vehicle classes")
        self.frames += other.frames
        self.sequences |= other.sequences
        for name, counter in self.conditions.items():
            counter.update(other.conditions[name])
        self.protocols.update(other.protocols)
        self.marked_simulated.update(other.marked_simulated)
        for name, tally in other.clouds.items():
            self.clouds.setdefault(name, CloudTally(focus_deg=self.focus_deg)).merge(tally)
        for name, background in other.background.items():
            self.background.setdefault(name, BackgroundTally()).merge(background)
        self.objects.merge(other.objects)
        self.radar.merge(other.radar)

    @property
    def simulated(self) -> bool | None:
        """Whether the frames call themselves simulated; None where they say nothing or disagree."""
        marks = set(self.marked_simulated)
        return {frozenset({"true"}): True, frozenset({"false"}): False}.get(frozenset(marks))

    @property
    def missing(self) -> list[str]:
        """What no frame had, in words, so that a comparison can say why it leaves something out."""
        lacks = []
        if not self.clouds:
            lacks.append("no point cloud: no elevation, range or return rate")
        if not self.objects.frames:
            lacks.append("no annotated frame: no points in boxes, distances, classes or sizes")
        elif not self.objects.vehicles(self.vehicle_labels).any():
            lacks.append(f"no box of class {' or '.join(self.vehicle_labels)}: no points in vehicle boxes")
        if not self.radar.frames:
            lacks.append("no radar tensor or polar map: no floor, side lobes, leakage or roll-off")
        unknown = [name for name, counter in self.conditions.items() if not counter]
        if unknown:
            lacks.append(f"no {', '.join(unknown)} recorded with the frames")
        return lacks

    def summary(self) -> dict[str, Any]:
        """Every figure as plain numbers, lists and mappings that JSON takes."""
        return {
            "frames": self.frames,
            "sequences": len(self.sequences),
            "simulated": self.simulated,
            "box_protocol": ", ".join(sorted(self.protocols)) or None,
            "conditions": {
                name: {key: count / counter.total() for key, count in counter.most_common()}
                for name, counter in self.conditions.items()
            },
            "clouds": {
                name: tally.summary()
                | self.objects.points_summary(name, self.vehicle_labels)
                | ({"background": self.background[name].summary()} if name in self.background else {})
                for name, tally in self.clouds.items()
            },
            "pattern_ratio_beyond_50_m": self.objects.pattern_ratio(self.vehicle_labels),
            "boxes": self.objects.summary(self.vehicle_labels),
            "radar": self.radar.summary(),
            "radar_survival": self.objects.radar_summary(self.vehicle_labels),
            "missing": self.missing,
        }

    def arrays(self) -> dict[str, dict[str, np.ndarray]]:
        """Arrays that figures draw: ``range_m`` and ``count`` of every vehicle box by cloud, and the radar's."""
        vehicles = self.objects.vehicles(self.vehicle_labels)
        arrays = {
            f"points/{name}": {"range_m": self.objects.range_m[vehicles], "count": counts[vehicles]}
            for name, counts in self.objects.counts.items()
            if name in self.clouds
        }
        return arrays | ({"radar": self.radar.arrays()} if self.radar.frames else {})


def gather(
    frames: Iterable[Frame],
    *,
    focus_deg: float = FOCUS_DEG,
    vehicle_labels: tuple[str, ...] = ("vehicle",),
    shots: Mapping[str, int] | None = None,
) -> Statistics:
    """Count over frames, one at a time.

    Args:
        frames: Such as a data set, or some of it.
        focus_deg: As in :class:`Statistics`.
        vehicle_labels: As in :class:`Statistics`.
        shots: As in :class:`Statistics`.
    """
    statistics = Statistics(focus_deg=focus_deg, vehicle_labels=vehicle_labels, shots=shots or {})
    for frame in frames:
        statistics.add(frame)
    return statistics
