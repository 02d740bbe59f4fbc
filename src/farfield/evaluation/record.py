"""An evaluation on disk: what ``farfield evaluate`` and ``farfield demo`` write and ``farfield report`` reads.

Layout of the folder::

    evaluation.json          results by name, settings, provenance, objects, list of shown frames
    frames/0000.json         one shown frame: names, time, conditions, labels, cameras
    frames/0000.ffcloud      its clouds and boxes
    frames/0000_camera.jpg   its images

Nothing is pickled, and the data set itself is not needed to draw the report again.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from farfield.datasets.base import Dataset
from farfield.errors import ConfigError, FileFormatError, plain
from farfield.evaluation.frame_store import load_frame, save_frame
from farfield.files.atomic import read_bytes, write_text
from farfield.frame import Frame
from farfield.geometry.boxes import Boxes

EVALUATION = "evaluation.json"
_LIMIT_BYTES = 1 << 28
_FORMAT = 1


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameView:
    """One frame that a report shows.

    Args:
        frame: The frame, with its clouds in reach.
        predictions: Predicted boxes of the first cloud, or by cloud name where several patterns were run.
        title: A few words above its pictures.
        radar_db: The radar's power from above, see :func:`farfield.evaluation.sensing.power_from_above`, or None.
    """

    frame: Frame
    predictions: Boxes | Mapping[str, Boxes] | None = None
    title: str = ""
    radar_db: Float32[np.ndarray, "y x"] | None = None

    @property
    def by_cloud(self) -> dict[str, Boxes | None]:
        """Predictions by cloud name, in the order of the frame's clouds; only clouds that were asked for."""
        if isinstance(self.predictions, Mapping):
            given = self.predictions
            return {name: given[name] for name in self.frame.clouds if name in given}
        first = next(iter(self.frame.clouds), None)
        return {} if first is None else {first: self.predictions}


@dataclass(frozen=True, eq=False, kw_only=True)
class Evaluation:
    """Everything that a report shows.

    Args:
        results: Result JSON (what ``farfield score`` writes) by pattern or data set name.
        settings: What the detector and the run were set to.
        provenance: Where it comes from: versions, seed, commit, data fingerprint, ``simulated`` (bool).
        frames: Frames to show.
        objects: Annotated objects by result name, see :func:`farfield.evaluation.objects.annotated_objects`.
        parts: Figures by condition and sector and rows of all classes, by result name, see
            :func:`farfield.metrics.parts.parts_json` and :func:`farfield.metrics.parts.by_class`.
        title: Title of the report.
    """

    results: Mapping[str, Mapping[str, Any]]
    settings: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    frames: list[FrameView] = field(default_factory=list)
    objects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    parts: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    title: str = "Farfield evaluation"

    def save(self, folder: Path | str) -> Path:
        """Write the evaluation into a folder, which is made if needed.

        Returns:
            The path of ``evaluation.json``, which is written last.
        """
        folder = Path(folder)
        (folder / "frames").mkdir(parents=True, exist_ok=True)
        names = [f"{number:04d}" for number in range(len(self.frames))]
        for name, view in zip(names, self.frames, strict=True):
            save_frame(folder / "frames", name, view.frame, view.predictions, title=view.title, radar_db=view.radar_db)
        content = {
            "format": _FORMAT,
            "title": self.title,
            "results": self.results,
            "settings": self.settings,
            "provenance": self.provenance,
            "objects": self.objects,
            "parts": self.parts,
            "frames": names,
        }
        write_text(folder / EVALUATION, json.dumps(content, indent=1, allow_nan=False, default=str) + "\n")
        return folder / EVALUATION

    @classmethod
    def load(cls, path: Path | str) -> "Evaluation":
        """Read an evaluation from its folder or its ``evaluation.json``.

        The file may also be a single result, as ``farfield score --json`` writes it: a report without pictures.

        Raises:
            ConfigError: If there is no such file.
            FileFormatError: If the file is no evaluation.
        """
        given = Path(path)
        path = given / EVALUATION if given.is_dir() else given
        if not path.is_file():
            raise ConfigError(
                f"{given}: expected {EVALUATION}, as `farfield evaluate` writes it, or the JSON of "
                "`farfield score --json`; found none"
            )
        content = _read_json(path)
        if "results" not in content and {"protocol", "settings"} <= set(content):
            return cls(results={str(content.get("label", "result")): content}, title=f"Scores of {path.stem}")
        for name in ("results", "settings", "provenance"):
            if not isinstance(content.get(name), dict):
                found = f"{type(content.get(name)).__name__} under {name!r}"
                raise FileFormatError(
                    path,
                    where=f"key {name!r}",
                    expected="an object",
                    found=found,
                    mend="Give the evaluation.json of `farfield evaluate` or the JSON of `farfield score --json`.",
                )
        frames = []
        for name in content.get("frames", []):
            if not (isinstance(name, str) and name.isalnum()):
                raise FileFormatError(path, where="key 'frames'", expected="names such as '0000'", found=repr(name))
            frame, predictions, title, radar_db = load_frame(path.parent / "frames", name)
            frames.append(FrameView(frame=frame, predictions=predictions, title=title, radar_db=radar_db))
        return cls(
            results=content["results"],
            settings=content["settings"],
            provenance=content["provenance"],
            frames=frames,
            objects=content.get("objects") or {},
            parts=content.get("parts") or {},
            title=str(content.get("title", cls.title)),
        )


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(read_bytes(path, max_bytes=_LIMIT_BYTES))
    except (ValueError, RecursionError) as error:
        raise FileFormatError(path, where="the file", expected="JSON", found=plain(error)) from error
    if not isinstance(content, dict):
        found = type(content).__name__
        raise FileFormatError(path, where="the file", expected="a JSON object", found=found)
    return content


def default_folder(detector: str, digest: str, data: Dataset, *, runs: Path = Path("runs")) -> Path:
    """Where an evaluation goes unless it is said: named by detector and data, another than other evaluations have.

    Args:
        detector: The detector's name.
        digest: What decides its boxes, see :meth:`farfield.detectors.runtime.Detector.digest`.
        data: The data.
        runs: The folder of runs.
    """
    plain = f"evaluation-{detector}-{data.root.resolve().name}"
    print_ = data.fingerprint()
    for number in range(1, 1000):
        folder = runs / (plain if number == 1 else f"{plain}-{number}")
        if _is_of(folder, digest, print_):
            return folder
    return runs / plain


def _is_of(folder: Path, digest: str, fingerprint: str) -> bool:
    """Whether a folder is free, or holds the evaluation of a detector on these data."""
    path = folder / EVALUATION
    if not path.is_file():
        return True
    try:
        tree = json.loads(read_bytes(path, max_bytes=_LIMIT_BYTES))
        subjects = [result["subject"] for result in tree["results"].values()]
    except (ValueError, KeyError, TypeError, AttributeError):
        return False
    return all(each["detector_digest"] == digest and each["fingerprint"] == fingerprint for each in subjects)
