"""The RADIATE car's turning radar: a picture a turn, four a second, and the boxes that are drawn on it.

Coordinates of a frame are the radar's in the middle of its turn: x forward, y left, z up.
"""

import json
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt8

from farfield.errors import ConfigError
from farfield.files.atomic import write_text
from farfield.files.json_text import plain_json, read_json
from farfield.frame import Annotation, Boxes, Cloud, Frame, Lazy, Sensor
from farfield.geometry.poses import invert, pose_from_yaw
from farfield.radar.turning import cartesian, strongest_cells
from farfield.simulation import labels
from farfield.simulation.presets import RADIATE_SEGMENT_NAME, RADIATE_SENSORS, Preset
from farfield.simulation.radar.points import Scatterers, object_snr_db
from farfield.simulation.radar.scatterers import scatterers
from farfield.simulation.radar.turning import (
    SECTORS,
    TurningRadar,
    in_sector,
    polar_picture,
    sector_yaw_rad,
    strengths,
)
from farfield.simulation.rig import Rig
from farfield.simulation.rigs.drive import HALF_SWEEP_S, SimulatedDrive, SimulatedFrame
from farfield.simulation.world.scene import SceneWindow

_VIEW_M, _HALF_SPAN_S = 110.0, 0.02
_LABEL_M = 100.0
_LEAST_SNR_DB = 13.0
"""Least signal over noise in its best cell of what is drawn: a lone cell of noise passes it once in 5e8."""
TURN_MIDDLE_S = 0.1
"""How long after its own time a turn is at its middle: the first one begins when the sequence has begun."""
RADAR_SHARE = 0.02
"""Share of the picture's cells that the cloud gets, the default of RADIATE's reader."""


class RadiateFrame(SimulatedFrame):
    """One turn of the radar; its reference moment is the turn's middle."""

    def __init__(self, drive: SimulatedDrive, index: int) -> None:
        super().__init__(drive, index)
        self.time_s = drive.time_s(index) - HALF_SWEEP_S + TURN_MIDDLE_S

    @cached_property
    def radar(self) -> TurningRadar:
        """The radar."""
        return TurningRadar()

    @cached_property
    def window(self) -> SceneWindow:
        """The scene in the middle of the turn."""
        return self._window(self.time_s)

    def _window(self, time_s: float) -> SceneWindow:
        return self.drive.scene.window(time_s, half_span_s=_HALF_SPAN_S, reach_m=_VIEW_M, behind_m=_VIEW_M)

    @cached_property
    def sectors(self) -> list[tuple[SceneWindow, Scatterers]]:
        """The scene in the middle of each sector's time, and what its antenna meets, along the sector's middle."""
        seeds = self.drive.seeds("turning", self.index).spawn(SECTORS)
        sectors = []
        for sector, offset_s in enumerate(self.radar.offsets_s):
            window = self._window(self.time_s + float(offset_s))
            world_T_radar = window.world_T_ego_now @ self.drive.mounting.ego_T_lidar
            world_T_sector = world_T_radar @ pose_from_yaw(sector_yaw_rad(sector))
            rng = np.random.default_rng(seeds[sector])
            echoes = scatterers(window, self.radar.echoes, world_T_sector, self.drive.weather, rng)
            sectors.append((window, echoes))
        return sectors

    @cached_property
    def polar(self) -> UInt8[np.ndarray, "576 400"]:
        """The polar picture."""
        parts, powers = [], []
        for sector, (_, echoes) in enumerate(self.sectors):
            within = echoes.take(np.abs(echoes.azimuth_rad) <= np.pi / SECTORS)
            parts.append(in_sector(within, sector))
            powers.append(strengths(within, self.radar))
        rng = self.drive.rng("turning", self.index)
        return polar_picture(Scatterers.join(parts), np.concatenate(powers), self.radar, rng)

    def picture(self, name: str) -> Float32[np.ndarray, "height width"]:
        """The picture "polar", or "cartesian" from above, as numbers in [0, 1]."""
        counts = self.polar if name == "polar" else cartesian(self.polar)
        return counts.astype(np.float32) / np.float32(255)

    def cloud(self, name: str) -> Cloud:
        """The strongest cells; the name is always "radar"."""
        del name
        points, strength = strongest_cells(self.picture("polar"), RADAR_SHARE)
        return Cloud(points, None, {"strength": strength})

    @cached_property
    def boxes(self) -> Boxes:
        """Full boxes of the road users that stand out of the noise, where their sector's time shows them."""
        parts = []
        for sector, (window, echoes) in enumerate(self.sectors):
            full = labels.full_boxes(
                window.actors,
                window.bottom_m,
                window.yaw_rad,
                window.velocity_m_s,
                invert(window.world_T_ego_now @ self.drive.mounting.ego_T_lidar),
            )
            turn_rad = np.arctan2(full.centre_m[:, 1], full.centre_m[:, 0]) - sector_yaw_rad(sector)
            turn_rad = (turn_rad + np.pi) % (2 * np.pi) - np.pi
            within = (np.abs(turn_rad) <= np.pi / SECTORS) & (full.range_m < _LABEL_M)
            snr_db = object_snr_db(echoes, self.radar.echoes, len(window.actors))
            parts.append(full[np.flatnonzero(within & (snr_db >= _LEAST_SNR_DB))])
        # one that passes from a sector into the next is annotated once, in the first
        boxes = Boxes.concatenate(parts)
        assert boxes.track_id is not None
        _, first = np.unique(boxes.track_id, return_index=True)
        return boxes[np.sort(first)]

    @cached_property
    def annotation(self) -> Annotation:
        """Boxes of what stands out of the noise, all around."""
        return Annotation(boxes=self.boxes, moving=labels.moving(self.boxes))


def radiate_frame(drive: SimulatedDrive, index: int, sensors: tuple[str, ...], time_ns: int) -> Frame:
    """A frame without its pose; nothing is simulated before it is read."""
    simulated = RadiateFrame(drive, index)
    picture = Sensor(kind="radar", frame_T_sensor=np.eye(4), in_frame=False, time_ns=time_ns)
    return Frame(
        sequence=drive.segment.name,
        frame_id=f"{index + 1:06d}",
        time_ns=time_ns,
        sensors={
            "radar": Sensor(kind="radar", frame_T_sensor=np.eye(4), time_ns=time_ns),
            **dict.fromkeys(sensors, picture),
        },
        clouds=Lazy({"radar": partial(simulated.cloud, "radar")}),
        radar=Lazy({name: partial(simulated.picture, name) for name in sensors}),
        load_annotation=simulated.load_annotation,
        conditions=simulated.conditions,
        simulated=True,
        reference="radar",
        metadata=simulated.metadata(),
    )


_FOLDERS = {"polar": "Navtech_Polar", "cartesian": "Navtech_Cartesian"}
_TURNS = ".frames"
_SCENES = {"fog": "fog", "rain": "rain", "light_snow": "snow", "heavy_snow": "snow", "sleet": "snow"}
_ROADS = {"highway": "motorway", "suburban": "suburban", "urban": "city"}


class SimulatedRadiateWriter:
    """Write frames of a RADIATE preset.

    A turn's boxes stand in ``annotations/.frames`` until :meth:`finish` makes ``annotations.json`` of them.

    Args:
        root: Folder in which the sequences' folders are made.
    """

    def __init__(self, root: Path) -> None:
        self.root = root

    def paths(self, frame: Frame) -> dict[str, Path]:
        """The file of each part of a frame.

        Raises:
            ConfigError: If the frame lacks the polar picture, which the reader reads its cloud from.
        """
        if "polar" not in frame.radar:
            raise ConfigError("sensors: expected polar among them, RADIATE's cloud is read from it; got cartesian")
        folder = self.root / frame.sequence
        pictures = {
            name: folder / subfolder / f"{frame.frame_id}.png"
            for name, subfolder in _FOLDERS.items()
            if name in frame.radar
        }
        return {**pictures, "boxes": folder / "annotations" / _TURNS / f"{frame.frame_id}.json"}

    def write(self, frame: Frame) -> dict[str, Path]:
        """Write a frame; returns what ``paths`` does, and raises the same."""
        from farfield.datasets.radiate import tracks_of
        from farfield.files.images import write_grey
        from farfield.files.radiate import tracks_text

        paths = self.paths(frame)
        for path in paths.values():
            path.parent.mkdir(parents=True, exist_ok=True)
        for name, path in paths.items():
            if name != "boxes":
                write_grey(path, np.rint(np.asarray(frame.radar[name]) * 255).astype(np.uint8))
        annotation = frame.annotation
        tracks = None if annotation is None else tracks_of(annotation.boxes, 1)
        turn = {
            "time_ns": frame.time_ns,
            "conditions": dict(frame.conditions),
            "objects": [] if tracks is None else plain_json(tracks_text(tracks, 1)),
            "frame": int(frame.frame_id),
        }
        write_text(paths["boxes"], json.dumps(turn))
        return paths

    def finish(self) -> None:
        """Write time lists, annotations and ``meta.json`` of every sequence, from all turns that are there."""
        for folder in sorted(path for path in self.root.glob("*") if (path / "annotations" / _TURNS).is_dir()):
            turns = [read_json(path) for path in sorted((folder / "annotations" / _TURNS).glob("*.json"))]
            _finish_sequence(folder, turns)


def _finish_sequence(folder: Path, turns: list[dict[str, Any]]) -> None:
    from farfield.files.radiate import times_text

    times = times_text({turn["frame"]: turn["time_ns"] for turn in turns})
    for subfolder in _FOLDERS.values():
        if (folder / subfolder).is_dir():
            write_text(folder / f"{subfolder}.txt", times)
    last = max(turn["frame"] for turn in turns)
    objects: dict[tuple[int, str], list[Any]] = {}
    for turn in turns:
        for track in turn["objects"]:
            boxes = objects.setdefault((track["id"], track["class_name"]), [[] for _ in range(last)])
            boxes[turn["frame"] - 1] = track["bboxes"][0]
    entries = [{"id": number, "class_name": name, "bboxes": boxes} for (number, name), boxes in sorted(objects.items())]
    write_text(folder / "annotations" / "annotations.json", json.dumps(entries))
    conditions = turns[0]["conditions"]
    scene = _SCENES.get(conditions["weather"], _ROADS.get(conditions["road"], conditions["road"]))
    scene = "night" if conditions["time"] == "night" else scene
    write_text(folder / "meta.json", json.dumps({"name": folder.name, "type": scene, "set": "simulated"}))


def _writer(root: Path, preset: Preset) -> SimulatedRadiateWriter:  # noqa: ARG001
    return SimulatedRadiateWriter(root)


RIG = Rig(
    sensors=RADIATE_SENSORS, segment_name=RADIATE_SEGMENT_NAME, frame=radiate_frame, writer=_writer, finishes=True
)
