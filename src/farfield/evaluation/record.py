"""An evaluation on disk: what ``farfield evaluate`` and ``farfield demo`` write and ``farfield report`` reads.

Layout of the folder::

    evaluation.json                  results by name, settings, provenance, objects, list of shown frames
    frames/1f0c93ab0000.json         one shown frame: names, time, conditions, labels, cameras
    frames/1f0c93ab0000.ffcloud      its clouds and boxes
    frames/1f0c93ab0000_camera.jpg   its images

The names of the frames begin with a digest of the evaluation, so that another one in the same folder writes beside them
until its evaluation.json, written last, takes over: what an interruption leaves is one evaluation or the other.
Nothing is pickled, and the data set itself is not needed to draw the report again.
"""

import hashlib
import json
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from farfield.datasets.base import Dataset
from farfield.errors import ConfigError, FileFormatError, plain
from farfield.files.atomic import write_text
from farfield.files.clouds import CACHE_SUFFIX, read_cache, write_cache
from farfield.files.images import read_image, write_image
from farfield.files.json_text import read_json
from farfield.files.outputs import check_replaceable
from farfield.frame import Annotation, Cloud, Constant, Frame, Lazy, Sensor
from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera
from farfield.metrics.result_json import check_parts, check_result
from farfield.radar.axes import CUBE_SHAPE

EVALUATION, TIMING, PAGE = "evaluation.json", "timing.json", "report.html"
_FRAME = re.compile(r"(?:[0-9a-f]{8})?\d{4}")
_SUFFIXES = (".json", CACHE_SUFFIX, ".jpg")
_FORMAT = 1


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameView:
    """One frame that a report shows.

    Args:
        frame: The frame, with its clouds in reach.
        predictions: Predicted boxes of the first cloud, or by cloud name where several patterns were run.
        title: A few words above its pictures.
        radar_db: The radar's power from above, see :func:`farfield.evaluation.report_data.power_from_above`, or None.
    """

    frame: Frame
    predictions: Boxes | Mapping[str, Boxes] | None = None
    title: str = ""
    radar_db: Float32[np.ndarray, "y x"] | None = None

    @property
    def by_cloud(self) -> dict[str, Boxes | None]:
        """Predictions by cloud name, in the order of the frame's clouds; only clouds that were asked for."""
        if isinstance(self.predictions, Mapping):
            by_name = self.predictions
            return {name: by_name[name] for name in self.frame.clouds if name in by_name}
        first = next(iter(self.frame.clouds), None)
        return {} if first is None else {first: self.predictions}


def _frames_of_others(folder: Path) -> set[str]:
    """Names of frames that an evaluation left: of the one that stands there, and whole ones of an interrupted one."""
    old: set[str] = set()
    with suppress(OSError, ValueError, FileFormatError):
        content = read_json(folder / EVALUATION)
        named = content.get("frames") if isinstance(content, dict) else None
        old |= {name for name in named or () if isinstance(name, str) and _FRAME.fullmatch(name)}
    clouds = {file.stem.partition("_")[0] for file in (folder / "frames").glob(f"*{CACHE_SUFFIX}")}
    whole = {name for name in clouds if (folder / "frames" / f"{name}.json").is_file()}
    return old | {name for name in whole if _FRAME.fullmatch(name)}


@dataclass(frozen=True, eq=False, kw_only=True)
class Evaluation:
    """Everything that a report shows.

    Args:
        results: Result JSON (what ``farfield score`` writes) by pattern or data set name.
        settings: What the detector and the run were set to.
        provenance: Where it comes from: versions, seed, commit, data fingerprint, ``simulated`` (bool).
        frames: Frames to show.
        objects: Annotated objects by result name, see :func:`farfield.evaluation.report_data.annotated_objects`.
        parts: Figures by condition and sector and rows of all classes, by result name, see
            :func:`farfield.metrics.breakdown.parts_json` and :func:`farfield.metrics.breakdown.by_class`.
        title: Title of the report.
        tables: Table of each result, as ``farfield score`` prints it; not saved.
        lost: Missed objects and false boxes by result name, which stand in a file of their own: see
            :mod:`farfield.evaluation.lost`.
        timing: What the clock measured, by result name: ``frames`` and ``median_ms``; not saved, so that equal
            evaluations are equal files.
    """

    results: Mapping[str, Mapping[str, Any]]
    settings: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    frames: list[FrameView] = field(default_factory=list)
    objects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    parts: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    title: str = "Farfield evaluation"
    tables: Mapping[str, str] = field(default_factory=dict)
    lost: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    timing: Mapping[str, Mapping[str, float | int]] = field(default_factory=dict)

    def save(self, folder: Path | str) -> Path:
        """Write the evaluation into a folder, which is made if needed.

        What was made of another evaluation there, its page and its clocks, goes before this one takes over, and its
        frames after that.

        Returns:
            The path of ``evaluation.json``, which is written last.
        """
        folder = Path(folder)
        content: dict[str, Any] = {
            "format": _FORMAT,
            "title": self.title,
            "results": self.results,
            "settings": self.settings,
            "provenance": self.provenance,
            "objects": self.objects,
            "parts": self.parts,
        }
        shown = [[*view.frame.key, view.title] for view in self.frames]
        mark = hashlib.sha256(json.dumps([content, shown], allow_nan=False, default=str).encode()).hexdigest()[:8]
        names = [f"{mark}{number:04d}" for number in range(len(self.frames))]
        text = json.dumps({**content, "frames": names}, indent=1, allow_nan=False, default=str) + "\n"
        # The frames, under names that no other evaluation's have.
        (folder / "frames").mkdir(parents=True, exist_ok=True)
        for name, view in zip(names, self.frames, strict=True):
            save_frame(folder / "frames", name, view.frame, view.predictions, title=view.title, radar_db=view.radar_db)
        # The evaluation itself, and away with what was made of another one.
        path = folder / EVALUATION
        check_replaceable(path)
        old = _frames_of_others(folder) - set(names)
        if not path.is_file() or path.read_bytes() != text.encode():
            for derived in (TIMING, PAGE):
                (folder / derived).unlink(missing_ok=True)
        write_text(path, text)
        for file in (folder / "frames").iterdir():
            if file.stem.partition("_")[0] in old and file.suffix in _SUFFIXES:
                file.unlink()
        return path

    @classmethod
    def load(cls, path: Path | str) -> "Evaluation":
        """Read an evaluation from its folder or its ``evaluation.json``.

        The file may also be a single result, as ``farfield score --json`` writes it: a report without pictures.

        Raises:
            ConfigError: If there is no such file.
            FileFormatError: If the file is no evaluation.
        """
        location = Path(path)
        path = location / EVALUATION if location.is_dir() else location
        if not path.is_file():
            raise ConfigError(
                f"{location}: expected {EVALUATION}, as `farfield evaluate` writes it, or the JSON of "
                "`farfield score --json`; found none"
            )
        content = _read_json(path)
        if "results" not in content and {"protocol", "settings"} <= set(content):
            check_result(content, path)
            return cls(results={str(content.get("label", "result")): content}, title=f"Scores of {path.stem}")
        for name in ("results", "settings", "provenance"):
            if not isinstance(content.get(name), dict):
                actual = f"{type(content.get(name)).__name__} under {name!r}"
                raise FileFormatError(
                    path,
                    where=f"key {name!r}",
                    expected="an object",
                    got=actual,
                    fix="Give the evaluation.json of `farfield evaluate` or the JSON of `farfield score --json`.",
                )
        for name, result in content["results"].items():
            check_result(result, path, ("results", name))
        check_parts(content, path)
        frames, names = [], content.get("frames") or []
        if not isinstance(names, list):
            raise FileFormatError(path, where="key 'frames'", expected="a list of names", got=repr(names)[:80])
        for name in names:
            if not (isinstance(name, str) and name.isalnum()):
                raise FileFormatError(
                    path, where="key 'frames'", expected="names such as '1f0c93ab0000'", got=repr(name)
                )
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
    content = read_json(path)
    if not isinstance(content, dict):
        actual = type(content).__name__
        raise FileFormatError(path, where="the file", expected="a JSON object", got=actual)
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
        tree = read_json(path)
        subjects = [result["subject"] for result in tree["results"].values()]
    except (FileFormatError, KeyError, TypeError, AttributeError):
        return False
    return all(subject["detector_digest"] == digest and subject["fingerprint"] == fingerprint for subject in subjects)


# One shown frame on disk: a JSON file of names, a cloud cache of numbers, JPEGs of images.

_FRAME_LIMIT_BYTES = 1 << 26
_RADAR_MAP, _MAP_SHAPE = "radar/bird_db", CUBE_SHAPE[1:]
_BOX_ARRAYS = ("centre_m", "size_m", "yaw_rad", "score", "track_id", "point_count", "velocity_m_s")
Predictions = Boxes | Mapping[str, Boxes] | None


def save_frame(
    folder: Path,
    name: str,
    frame: Frame,
    predictions: Predictions,
    *,
    title: str = "",
    radar_db: Float32[np.ndarray, "y x"] | None = None,
) -> None:
    """Write a frame and its predictions as ``NAME.json``, ``NAME.ffcloud`` and a JPEG for each image.

    Args:
        folder: An existing folder.
        name: Stem of the files.
        frame: The frame; its clouds and images are read.
        predictions: Predicted boxes, or by cloud name.
        title: A few words about it.
        radar_db: The radar's power from above, shape (400, 250), or None.
    """
    by_cloud = dict(predictions) if isinstance(predictions, Mapping) else {"": predictions}
    sets = {f"predicted/{cloud}": boxes for cloud, boxes in by_cloud.items() if boxes is not None}
    if frame.boxes is not None:
        sets["annotated"] = frame.boxes
    arrays: dict[str, np.ndarray] = {}
    for cloud_name, cloud in frame.clouds.items():
        arrays[f"cloud/{cloud_name}/points_m"] = cloud.points_m
        if cloud.intensity is not None:
            arrays[f"cloud/{cloud_name}/intensity"] = cloud.intensity
    for set_name, boxes in sets.items():
        present = {part: getattr(boxes, part) for part in _BOX_ARRAYS}
        arrays |= {f"boxes/{set_name}/{part}": array for part, array in present.items() if array is not None}
    arrays |= {} if radar_db is None else {_RADAR_MAP: radar_db}
    for camera, image in frame.images.items():
        write_image(folder / f"{name}_{_plain(camera)}.jpg", image, quality=85)
    write_cache(folder / (name + CACHE_SUFFIX), arrays)
    content = {
        "title": title,
        "sequence": frame.sequence,
        "frame_id": frame.frame_id,
        "time_ns": frame.time_ns,
        "reference": frame.reference,
        "conditions": dict(frame.conditions),
        "sensors": {name: _sensor_json(sensor) for name, sensor in frame.sensors.items()},
        "clouds": list(frame.clouds),
        "images": list(frame.images),
        "labels": {set_name: np.asarray(boxes.label).tolist() for set_name, boxes in sets.items()},
        "cameras": {camera: _camera_json(calibration) for camera, calibration in frame.cameras.items()},
    }
    write_text(folder / f"{name}.json", json.dumps(content, indent=1) + "\n")


def load_frame(folder: Path, name: str) -> tuple[Frame, Predictions, str, Float32[np.ndarray, "y x"] | None]:
    """Read what :func:`save_frame` wrote.

    Returns:
        The frame, the predictions, the title, and the radar's power from above, if it was kept.

    Raises:
        FileFormatError: If a file is damaged or the files contradict each other.
    """
    path = folder / f"{name}.json"
    try:
        content = read_json(path, max_bytes=_FRAME_LIMIT_BYTES)
        arrays = read_cache(folder / (name + CACHE_SUFFIX))
        sets = {part: _boxes(arrays, part, labels) for part, labels in content["labels"].items()}
        clouds = {
            part: Cloud(arrays[f"cloud/{part}/points_m"], arrays.get(f"cloud/{part}/intensity"))
            for part in content["clouds"]
        }
        images = {camera: folder / f"{name}_{_plain(camera)}.jpg" for camera in content["images"]}
        annotated = sets.pop("annotated", None)
        frame = Frame(
            sequence=str(content["sequence"]),
            frame_id=str(content["frame_id"]),
            time_ns=content["time_ns"],
            reference=str(content["reference"]),
            conditions=content["conditions"],
            clouds=clouds,
            images=Lazy({camera: partial(read_image, image) for camera, image in images.items()}),
            cameras={camera: _camera(values) for camera, values in content["cameras"].items()},
            sensors={part: _sensor(values) for part, values in content.get("sensors", {}).items()},
            load_annotation=None if annotated is None else Constant(Annotation(boxes=annotated)),
        )
    except (ValueError, KeyError, TypeError, AttributeError, OSError) as error:
        reason = plain(error)
        raise FileFormatError(
            path, where="the frame", expected="a frame as `save_frame` writes it", got=reason
        ) from error
    predicted = {part.removeprefix("predicted/"): boxes for part, boxes in sets.items()}
    boxes = predicted.get("") if set(predicted) <= {""} else predicted
    return frame, boxes, str(content.get("title", "")), _radar_map(path, arrays.get(_RADAR_MAP))


def _radar_map(path: Path, power_db: np.ndarray | None) -> Float32[np.ndarray, "y x"] | None:
    if power_db is None or (power_db.shape == _MAP_SHAPE and power_db.dtype == np.float32):
        return power_db
    expected, actual = f"a float32 map of shape {_MAP_SHAPE}", f"{power_db.dtype} of shape {power_db.shape}"
    raise FileFormatError(path, where="the radar's power", expected=expected, got=actual)


def _boxes(arrays: Mapping[str, np.ndarray], name: str, labels: list[str]) -> Boxes:
    parts: dict[str, Any] = {part: arrays.get(f"boxes/{name}/{part}") for part in _BOX_ARRAYS}
    return Boxes(label=[str(label) for label in labels], **parts)


def _plain(name: str) -> str:
    return "".join(letter if letter.isalnum() else "-" for letter in name)[:64] or "camera"


def _sensor_json(sensor: Sensor) -> dict[str, Any]:
    pose = sensor.frame_T_sensor
    return {
        "kind": sensor.kind,
        "frame_T_sensor": None if pose is None else pose.tolist(),
        "in_frame": sensor.in_frame,
        "time_ns": sensor.time_ns,
        "holds": list(sensor.holds),
    }


def _sensor(values: Mapping[str, Any]) -> Sensor:
    kind, pose = values["kind"], values["frame_T_sensor"]
    if kind not in ("lidar", "radar", "camera"):
        raise ValueError(f"expected a sensor of kind lidar, radar or camera, got {kind!r}")
    return Sensor(
        kind=kind,
        frame_T_sensor=None if pose is None else np.array(pose, dtype=np.float64).reshape(4, 4),
        in_frame=bool(values["in_frame"]),
        time_ns=values["time_ns"],
        holds=tuple(str(name) for name in values["holds"]),
    )


def _camera_json(camera: Camera) -> dict[str, Any]:
    return {
        "matrix": camera.matrix.tolist(),
        "distortion": camera.distortion.tolist(),
        "camera_T_lidar": camera.camera_T_lidar.tolist(),
        "width_px": camera.width_px,
        "height_px": camera.height_px,
    }


def _camera(values: Mapping[str, Any]) -> Camera:
    return Camera(
        matrix=np.array(values["matrix"], dtype=np.float64).reshape(3, 3),
        distortion=np.array(values["distortion"], dtype=np.float64).reshape(5),
        camera_T_lidar=np.array(values["camera_T_lidar"], dtype=np.float64).reshape(4, 4),
        width_px=int(values["width_px"]),
        height_px=int(values["height_px"]),
    )
