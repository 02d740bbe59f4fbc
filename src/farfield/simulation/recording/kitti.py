"""Simulated frames in KITTI's object layout: each frame under its own number, and the lists of its parts."""

from pathlib import Path
from typing import TYPE_CHECKING

from farfield.errors import ConfigError
from farfield.files.atomic import write_text

if TYPE_CHECKING:
    from farfield.frame import Frame

_VALIDATION = 5  # of so many sequences one is held out
_OF_A_SEQUENCE = 1000  # frames; the simulator numbers them so


class SimulatedKittiWriter:
    """Write frames of a KITTI preset under the numbers that they bear.

    Args:
        root: Folder in which ``training`` and ``ImageSets`` are made.
    """

    def __init__(self, root: Path) -> None:
        from farfield.datasets.kitti.object import KittiWriter

        self.root, self._writer = root, KittiWriter(root)

    def paths(self, frame: "Frame") -> dict[str, Path]:
        """The file of each part of a frame.

        Raises:
            ConfigError: If the frame has no cloud.
        """
        if "lidar" not in frame.clouds:
            raise ConfigError("sensors: expected lidar among them, KITTI's layout has no frames without; got camera")
        kinds = ["velodyne", "calib", *(["image_2"] if "camera" in frame.images else []), "label_2"]
        return {kind: self._writer.path(kind, int(frame.frame_id)) for kind in kinds}

    def write(self, frame: "Frame") -> dict[str, Path]:
        """Write a frame; returns what ``paths`` does, and raises the same."""
        paths, annotation = self.paths(frame), frame.annotation
        occlusion = None if annotation is None else annotation.details["occlusion"]
        self._writer.write(int(frame.frame_id), frame, cloud="lidar", occlusion=occlusion)
        return paths

    def finish(self) -> None:
        """Write ``ImageSets/train.txt`` and ``val.txt``: the second of every five sequences is held out."""
        names = sorted(path.stem for path in (self.root / "training" / "label_2").glob("*.txt"))
        held_out = [int(name) // _OF_A_SEQUENCE % _VALIDATION == 1 for name in names]
        (self.root / "ImageSets").mkdir(parents=True, exist_ok=True)
        for part, wanted in (("train", False), ("val", True)):
            listed = [name for name, held in zip(names, held_out, strict=True) if held == wanted]
            write_text(self.root / "ImageSets" / f"{part}.txt", "".join(f"{name}\n" for name in listed))
