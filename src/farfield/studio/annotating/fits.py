"""Gestures of the page as fits on the frame's original points, with what the track and the class tell beforehand."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from farfield.annotation.fitting import BoxFit, Prior, fit_click, fit_drag, fit_radar_peak, prior_of, refit
from farfield.annotation.fitting.boxes import fit_rectangle
from farfield.annotation.motion import RefitBox, TrackFrame, from_world, to_world
from farfield.annotation.store import Store
from farfield.datasets.edits import track_cell
from farfield.errors import ConfigError
from farfield.frame import Frame, Key
from farfield.geometry.poses import invert
from farfield.studio.annotating.counting import cloud_name
from farfield.studio.annotating.presenting import TrackNumbers
from farfield.studio.messages import requests as asked
from farfield.studio.messages.replies import Candidate, Fitted
from farfield.studio.showing.opened import OpenedDataset
from farfield.studio.showing.radar import product_of
from farfield.studio.showing.rows import our_class
from farfield.vocabulary.sizes import SMALL_KINDS, VEHICLE_KINDS

_NUMBERS = {"click": 2, "drag": 4, "rectangle": 8, "refit": 0, "peak": 2}


class Fitter:
    """Fits for one store.

    Args:
        store: The annotation.
        opened: The open data set.
        numbers: Numbers of tracks.
    """

    def __init__(self, store: Store, opened: OpenedDataset, numbers: TrackNumbers) -> None:
        self.store, self.opened, self.frame, self.numbers = store, opened, opened.frame, numbers

    def fit(self, request: asked.Fit) -> Fitted:
        """Find the box that a gesture means.

        Raises:
            ConfigError: If the gesture lacks numbers.
        """
        if len(request.at) < _NUMBERS[request.kind] or (request.kind == "refit" and request.around is None):
            raise ConfigError(f"fit: a {request.kind} needs {_NUMBERS[request.kind] or 'a box and no'} numbers")
        frame = self.frame(request.frame)
        prior = self.prior(request, frame)
        if request.kind == "peak":
            request = replace(request, at=self._snapped(request, frame))
        try:
            found = _gesture(request, _points(frame), prior)
        except ValueError as error:
            return Fitted(id=request.id, frame=request.frame, box=None, sentence=str(error))
        return Fitted(
            id=request.id,
            frame=request.frame,
            box=_floats(found.box),
            points=found.points,
            candidates=tuple(Candidate(box=_floats(each.box), score=float(each.score)) for each in found.candidates),
            ms=round(found.ms, 2),
            sentence=found.note,
            source="radar" if request.kind == "peak" else "lidar",
        )

    def _snapped(self, request: asked.Fit, frame: Frame) -> tuple[float, ...]:
        """The radar's peak nearest to a press, in the frame's coordinates; the press itself where there is none."""
        product = product_of(frame.radar)
        pose = None if product is None else frame.sensors[product].frame_T_sensor
        if pose is None:
            return request.at
        there = invert(pose) @ np.array([request.at[0], request.at[1], pose[2, 3], 1.0])
        peak = self.opened.radar_power(request.frame).peak_near((float(there[0]), float(there[1])))
        if peak is None:
            return request.at
        here = pose @ np.array([*peak, 0.0, 1.0])
        return float(here[0]), float(here[1])

    def prior(self, request: asked.Fit, frame: Frame) -> Prior:
        """What class, type, track and extent tell."""
        name = request.type_name or request.class_name
        schema = self.store.schema.classes.get(request.class_name)
        size = None if schema is None else schema.types.get(request.type_name, schema.size_m)
        yaw, locked = None, False
        if request.track is not None:
            yaw, known, locked = self._track(request.frame, self.numbers.name(request.track))
            size = known or size
        extent = "visible part" if self.store.extent == "visible" else "whole body"
        known_name = name if name in VEHICLE_KINDS or name in SMALL_KINDS else our_class(request.class_name)
        prior = prior_of(known_name, size_m=size, extent=extent)  # type: ignore[arg-type]
        lane = 0.0 if prior.anchored else None  # most vehicles drive along the sensor's own way
        ego, height = sensor_place(frame, "radar" if request.kind == "peak" else "lidar")
        told = {"yaw_rad": yaw, "lane_rad": lane, "fixed_size": locked, "ego_m": ego, "ego_z_m": height}
        return Prior(**{**vars(prior), **told})

    def _track(self, index: int, name: str) -> tuple[float | None, tuple[float, float, float] | None, bool]:
        """Yaw of a track in a frame, from its nearest keyframe; its size; whether that is locked."""
        store, key = self.store, self.store.keys[index]
        drive, row = store.drives.place(key)
        rows = [(each, store.row(each.key, each.name)) for each in store.tracks.seen(drive, name)]
        known = [(abs(each.row - row), each.key, box) for each, box in rows if box is not None and each.key != key]
        value = store.value(track_cell(drive, name)) or {}
        size = tuple(value["size"]) if value.get("size") else None
        if not known:
            return None, size, bool(value.get("locked"))
        _, nearest, box = min(known, key=lambda each: each[0])
        there, here = self._moment(nearest), self._moment(key)
        posed = there.world_T_frame is not None and here.world_T_frame is not None
        yaw = from_world(to_world(box.label.box, there), here)[6] if posed else box.label.box[6]
        sizes = np.median([each.label.box[3:6] for _, _, each in known], axis=0)
        return float(yaw), size or tuple(map(float, sizes)), bool(value.get("locked"))

    def _moment(self, key: Key) -> TrackFrame:
        return TrackFrame(key, self.store.drives.time_s(key), self.store.drives.pose(key))

    def again(self, key: Key, expected: Sequence[float], reach_m: float) -> RefitBox:
        """Fit an object again where its motion takes it; for propagation."""
        points = _points(self.frame(self.store.index_of[key]))
        prior = Prior(size_m=tuple(expected[3:6]), yaw_rad=float(expected[6]), fixed_size=True)  # type: ignore[arg-type]
        found = refit(points, expected, prior, keep_size=True)
        apart = math.hypot(found.box[0] - expected[0], found.box[1] - expected[1])
        return RefitBox(_floats(found.box) if apart <= reach_m or found.points else None, found.points)


def _gesture(request: asked.Fit, points_m: Float[np.ndarray, "n 3"], prior: Prior) -> BoxFit:
    at = request.at
    if request.kind == "drag":
        return fit_drag(points_m, at[:2], at[2:4], prior)
    if request.kind == "rectangle":
        return fit_rectangle(points_m, np.array(at, dtype=np.float64).reshape(4, 2), prior)
    if request.kind == "refit":
        assert request.around is not None  # checked before
        return refit(points_m, request.around, prior, keep_size=request.keep_size)
    if request.kind == "peak":
        return fit_radar_peak(points_m, at[:2], prior)
    return fit_click(points_m, at[:2], prior)


def _points(frame: Frame) -> Float[np.ndarray, "n 3"]:
    name = cloud_name(frame, "lidar") or cloud_name(frame, "radar")
    return np.zeros((0, 3), dtype=np.float32) if name is None else frame.cloud(name).points_m


def sensor_place(frame: Frame, kind: str) -> tuple[tuple[float, float], float | None]:
    """Where the sensor of a kind stands: x and y, and z where that is known."""
    for sensor in frame.sensors.values():
        if sensor.kind == kind and sensor.frame_T_sensor is not None:
            x, y, z = sensor.frame_T_sensor[:3, 3].tolist()
            return (x, y), z
    return (0.0, 0.0), None


def _floats(box: Sequence[float]) -> tuple[float, float, float, float, float, float, float]:
    x, y, z, length, width, height, yaw = map(float, box)
    return x, y, z, length, width, height, yaw
