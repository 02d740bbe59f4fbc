"""Simulated turns in RADIATE's layout: pictures as they come, what belongs to whole sequences at the end."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from farfield.errors import ConfigError
from farfield.files.atomic import write_text

if TYPE_CHECKING:
    from farfield.frame import Frame

_FOLDERS = {"polar": "Navtech_Polar", "cartesian": "Navtech_Cartesian"}
_KEPT = ".frames"
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

    def paths(self, frame: "Frame") -> dict[str, Path]:
        """The file of each part of a frame.

        Raises:
            ConfigError: If the frame lacks the polar picture, which the reader reads its cloud from.
        """
        if "polar" not in frame.radar:
            raise ConfigError("sensors: expected polar among them, RADIATE's cloud is read from it; got cartesian")
        folder = self.root / frame.sequence
        pictures = {name: folder / place / f"{frame.frame_id}.png" for name, place in _FOLDERS.items()}
        found = {name: path for name, path in pictures.items() if name in frame.radar}
        return {**found, "boxes": folder / "annotations" / _KEPT / f"{frame.frame_id}.json"}

    def write(self, frame: "Frame") -> dict[str, Path]:
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
        number = int(frame.frame_id)
        tracks = None if annotation is None else tracks_of(annotation.boxes, 1)
        kept = {
            "time_ns": frame.time_ns,
            "conditions": dict(frame.conditions),
            "objects": [] if tracks is None else json.loads(tracks_text(tracks, 1)),
            "frame": number,
        }
        write_text(paths["boxes"], json.dumps(kept))
        return paths

    def finish(self) -> None:
        """Write time lists, annotations and ``meta.json`` of every sequence, from all turns that are there."""
        for folder in sorted(path for path in self.root.glob("*") if (path / "annotations" / _KEPT).is_dir()):
            turns = [
                json.loads(path.read_text("utf-8")) for path in sorted((folder / "annotations" / _KEPT).glob("*.json"))
            ]
            _finish(folder, turns)


def _finish(folder: Path, turns: list[dict[str, Any]]) -> None:
    from farfield.files.radiate import times_text

    times = times_text({turn["frame"]: turn["time_ns"] for turn in turns})
    for place in _FOLDERS.values():
        if (folder / place).is_dir():
            write_text(folder / f"{place}.txt", times)
    last = max(turn["frame"] for turn in turns)
    objects: dict[tuple[int, str], list[Any]] = {}
    for turn in turns:
        for one in turn["objects"]:
            boxes = objects.setdefault((one["id"], one["class_name"]), [[] for _ in range(last)])
            boxes[turn["frame"] - 1] = one["bboxes"][0]
    entries = [{"id": number, "class_name": name, "bboxes": each} for (number, name), each in sorted(objects.items())]
    write_text(folder / "annotations" / "annotations.json", json.dumps(entries))
    said = turns[0]["conditions"]
    scene = "night" if said["time"] == "night" else _SCENES.get(said["weather"], _ROADS.get(said["road"], said["road"]))
    write_text(folder / "meta.json", json.dumps({"name": folder.name, "type": scene, "set": "simulated"}))
