"""Files of any detector and of annotators as boxes by frame: what ``farfield score`` reads.

Boxes of KITTI stay in the camera that they were given in; only its axes are turned into ours (x ahead, y left, z up),
and centres are lifted from the bottom face to the middle. Ranges are then distances from the camera.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from farfield.errors import ConfigError, FileFormatError
from farfield.files.boxes_csv import BoxRows, read_boxes_csv, zeros_note
from farfield.files.coordinates import read_coordinates
from farfield.files.kitti import KittiObjects, KittiTracks, read_detections, read_labels, read_tracking
from farfield.files.limits import open_file
from farfield.files.mmdetection3d import read_instances
from farfield.files.nuscenes import read_results_in
from farfield.files.stand_ins import check_itself
from farfield.frame.annotation import Annotation
from farfield.frame.drive import Key
from farfield.geometry.boxes import Boxes
from farfield.geometry.kitti import upright_from_camera
from farfield.metrics.box_side import BoxSide
from farfield.metrics.detections import Detections
from farfield.metrics.kit_folders import (
    ANNOTATED,
    PREDICTED,
    described,
    kit_folder,
    read_kit_text,
    renamed,
    results_folder,
    settle_axes,
)
from farfield.metrics.result import labels_fingerprint
from farfield.metrics.sanity import wild_headings
from farfield.metrics.submissions import SubmittedFrame, argoverse2_frames, waymo_frames
from farfield.vocabulary.counts import count_of

FORMATS = (
    *("boxes-csv", "kitti", "kitti-tracking", "nuscenes", "argoverse2", "waymo", "kradar", "openpcdet"),
    "mmdetection3d",
)


def read(
    predictions: Path | str,
    labels: Path | str,
    *,
    format: str = "boxes-csv",
    reference: str = "",
    axes: str = "",
    class_names: Sequence[str] = (),
) -> Detections:
    """Read two files, or two folders whose files are paired by their stems.

    Args:
        predictions: File or folder of a detector's boxes.
        labels: File or folder of annotated boxes.
        format: ``"boxes-csv"``, ``"kitti"`` (a file a frame), ``"kitti-tracking"`` (a file a sequence),
            ``"nuscenes"`` (result JSON of detections or tracks; its samples are frames of one sequence without a name,
            tracks are numbered in the order in which they appear), ``"argoverse2"`` (feather: frames are stamps of a
            log), ``"waymo"`` (Objects or Submission: frames are stamps of a context), ``"kradar"`` (folders of
            K-Radar's kit, with their conditions), ``"openpcdet"`` (its KITTI texts) or ``"mmdetection3d"`` (its
            inferencer's JSON, or its KITTI texts).
        reference: Coordinates in which boxes stand whose files do not name them.
        axes: Axes of the kit's texts, see :mod:`farfield.metrics.kit_axes`; unless given they are decided.
        class_names: mmdetection3d's classes in the order of their numbers, where its files do not name them.

    Returns:
        Every frame of either side is annotated, the empty ones too. KITTI's formats give the annotations' details
        ``truncation``, ``occlusion`` and ``box_px``, the regions ``dontcare_px``, and ``box_px`` of the predictions.
        Notes say what was assumed.

    Raises:
        ConfigError: If the paths do not pair, predictions lie in sequences or frames that have no labels, or both
            stand in different coordinates.
        FileFormatError: If a file does not have its format.
    """
    if format not in FORMATS:
        raise ConfigError(f"format: expected one of {', '.join(FORMATS)}, got {format!r}")
    _check_choices(format, axes, class_names)
    notes: list[str] = []
    predictions, labels = _folder(predictions, format), _folder(labels, format, ANNOTATED)
    names = tuple(class_names)
    predicted, annotated = BoxSide(scored=True, class_names=names), BoxSide(scored=False, class_names=names)
    read = _READERS[format]
    for predicted_path, label_path in _pairs(predictions, labels, notes):
        stem = label_path.stem if Path(labels).is_dir() or format == "kitti-tracking" else ""
        read(annotated, label_path, stem)
        if predicted_path is not None:
            read(predicted, predicted_path, stem)
    conditions: dict[Key, dict[str, str]] = {}
    if format == "kradar":
        notes.append(settle_axes(annotated, predicted, axes))
        conditions = described(labels, [*annotated.boxes])
        conditions = conditions or described(predictions, [*predicted.boxes])
    notes += list(dict.fromkeys([*predicted.notes, *annotated.notes]))
    _share_sequence(predicted, annotated, notes)
    facts = _seen_from_the_car(predicted, annotated, notes) if format == "nuscenes" else {}
    fingerprint = labels_fingerprint({key: Annotation(boxes=boxes) for key, boxes in annotated.boxes.items()})
    _add_empty_frames(predicted.boxes, annotated.boxes, notes)
    if predicted.without_score:
        notes.append(
            f"{count_of(predicted.without_score, 'prediction has', 'predictions have')} "
            "no score; each counts with score 1"
        )
    if annotated.scored_rows and predicted.without_score:
        notes.append("the labels have scores and the predictions have none: are the two files exchanged?")
    notes += _mappings_beside(Path(predictions), Path(labels))
    for word, side in (("predicted", predicted), ("annotated", annotated)):
        notes += wild_headings(word, *side.headings)
    _name_coordinates(predicted, Path(predictions), reference)
    _name_coordinates(annotated, Path(labels), reference)
    return Detections(
        reference=_agreed(predicted, annotated, notes),
        boxes=predicted.boxes,
        annotations={key: _annotation(boxes, annotated.details.get(key, {})) for key, boxes in annotated.boxes.items()},
        prediction_details={key: _split_details(columns)[0] for key, columns in predicted.details.items()},
        conditions={key: words for key, words in conditions.items() if key in annotated.boxes},
        facts=facts,
        labels_fingerprint=fingerprint,
        notes=tuple(notes),
    ).with_oddities()


def _check_choices(format: str, axes: str, class_names: Sequence[str]) -> None:
    for flag, value, own in (("axes", axes, "kradar"), ("class_names", class_names, "mmdetection3d")):
        if value and format != own:
            raise ConfigError(
                f"--{flag.replace('_', '-')}: expected --format {own}, whose files it is for; got {format}"
            )


def _folder(path: Path | str, format: str, sides: Sequence[str] = PREDICTED) -> Path:
    """Where the files of a side stand, below what was named."""
    path = Path(path)
    if format == "kradar":
        return kit_folder(path, sides)
    return results_folder(path) if format in ("openpcdet", "mmdetection3d") else path


def read_predictions(
    predictions: Path | str,
    *,
    format: str = "boxes-csv",
    reference: str = "",
    axes: str = "",
    class_names: Sequence[str] = (),
) -> Detections:
    """Read a detector's boxes alone, of a file or of the files of a folder, without annotations.

    Args:
        predictions: File or folder.
        format: One of :func:`read`.
        reference: As of :func:`read`, and so are the next two.
        axes: Axes of the kit's texts.
        class_names: mmdetection3d's classes.

    Raises:
        ConfigError: If there is nothing to read, the format is unknown, or the files name other coordinates.
        FileFormatError: If a file does not have its format.
    """
    if format not in FORMATS:
        raise ConfigError(f"format: expected one of {', '.join(FORMATS)}, got {format!r}")
    _check_choices(format, axes, class_names)
    root = _folder(predictions, format)
    predicted, annotated = BoxSide(scored=True, class_names=tuple(class_names)), BoxSide(scored=False)
    if not root.exists():
        raise ConfigError(f"{root}: expected a file or a folder, found nothing there")
    _refuse_pickle(root)
    for stem, path in sorted(_files(root).items()) if root.is_dir() else [(root.stem, root)]:
        _READERS[format](predicted, path, stem if root.is_dir() or format != "boxes-csv" else "")
    if format == "kradar":
        predicted.notes.append(settle_axes(annotated, predicted, axes))
        renamed(predicted, root)
    note = (
        f"{count_of(predicted.without_score, 'prediction has', 'predictions have')} no score; each counts with score 1"
    )
    _name_coordinates(predicted, root, reference)
    return Detections(
        reference=predicted.reference,
        boxes=predicted.boxes,
        annotations={},
        prediction_details={key: _split_details(columns)[0] for key, columns in predicted.details.items()},
        notes=(*dict.fromkeys(predicted.notes), *((note,) if predicted.without_score else ())),
    )


def _annotation(boxes: Boxes, columns: Mapping[str, np.ndarray]) -> Annotation:
    details, unboxed = _split_details(columns)
    return Annotation(boxes=boxes, details=details, unboxed=unboxed)


def _split_details(columns: Mapping[str, np.ndarray]) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Rows of boxes, and what stands beside them."""
    beside = {name: rows for name, rows in columns.items() if name == "dontcare_px"}
    return {name: rows for name, rows in columns.items() if name not in beside}, beside


_FROM_PICKLE = (
    "python -c \"import csv, pickle; w = csv.writer(open('boxes.csv', 'w', newline='')); "
    "w.writerow('frame label x y z l w h yaw_rad score'.split()); "
    "[w.writerow([a['frame_id'], n, *b[:7], s]) for a in pickle.load(open('result.pkl', 'rb')) "
    "for n, b, s in zip(a['name'], a['boxes_lidar'], a['score'])]\""
)
"""Of OpenPCDet's results: a list of frames with name, score, boxes_lidar (centre, length, width, height, heading)."""


def _refuse_pickle(path: Path) -> None:
    """Refuse a pickle, which runs what it likes when it is read.

    Raises:
        FileFormatError: If the name or the first bytes are those of one.
    """
    if not path.is_file():
        return
    with open_file(path, max_bytes=None) as handle:
        head = handle.read(2)
    if path.suffix in (".pkl", ".pickle") or (
        head[:1] == b"\x80" and head[1:2] in (b"\x02", b"\x03", b"\x04", b"\x05")
    ):
        fix = (
            f"Where you trust it, this line makes boxes-csv of OpenPCDet's result.pkl, centres and all: {_FROM_PICKLE}"
        )
        expected = "a file of boxes; a pickle is never opened, since it runs what stands in it"
        raise FileFormatError(path, where="the file", expected=expected, got="a pickle", fix=fix)


def _pairs(predictions: Path, labels: Path, notes: list[str]) -> list[tuple[Path | None, Path]]:
    for path in (predictions, labels):
        _refuse_pickle(path)
        if not path.exists():
            raise ConfigError(f"{path}: expected a file or a folder, found nothing there")
    if predictions.is_dir() != labels.is_dir():
        raise ConfigError(f"expected two files or two folders, got {predictions} and {labels}, one of each kind")
    if not labels.is_dir():
        return [(predictions, labels)]
    by_stem, label_files = _files(predictions), _files(labels)
    strangers = sorted(set(by_stem) - set(label_files))
    if strangers or not set(by_stem) & set(label_files):
        raise ConfigError(
            f"expected files of equal stems in {predictions} and {labels}; "
            + (f"these predictions have no labels: {', '.join(strangers[:5])}" if strangers else "no stem is in both")
        )
    missing = len(label_files) - len(by_stem)
    if missing:
        notes.append(
            f"{missing} of {count_of(len(label_files), 'label file')} have no "
            "file of predictions; they count as nothing found"
        )
    return [(by_stem.get(stem), path) for stem, path in sorted(label_files.items())]


def _files(folder: Path) -> dict[str, Path]:
    path_of: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix not in (".txt", ".csv", ".json") or not path.is_file():
            continue
        if path.stem in path_of:
            raise ConfigError(f"{folder}: expected one file a stem, got {path_of[path.stem].name} and {path.name}")
        path_of[path.stem] = path
    if not path_of:
        raise ConfigError(f"{folder}: expected .txt, .csv or .json files, found none")
    return path_of


def _mappings_beside(*paths: Path) -> list[str]:
    """A note on each mapping.yaml that stands beside the files: it is that of a data set's folder, and not read."""
    folders = dict.fromkeys(path if path.is_dir() else path.resolve().parent for path in paths)
    return [
        f"{folder / name}: a mapping of classes belongs to a data set's folder and is not read with files of boxes; "
        "--options relabel=NAME:CLASS,... says the same"
        for folder in folders
        for name in ("mapping.yaml", "mapping.yml")
        if (folder / name).is_file()
    ]


_IN_THE_WORLD_M = 1000.0  # half of the boxes farther away than this do not stand in a sensor's coordinates


def _seen_from_the_car(predicted: BoxSide, annotated: BoxSide, notes: list[str]) -> dict[str, str]:
    """Move boxes of the world to where the car is the origin, if either side says where it stood.

    Returns:
        That ranges are not known, where it does not and the boxes lie far from the origin.
    """
    ego_m = {**predicted.ego_m, **annotated.ego_m}
    keys = {key for side in (predicted, annotated) for key, boxes in side.boxes.items() if len(boxes)}
    if ego_m and keys <= set(ego_m):
        for side in (predicted, annotated):
            for key, boxes in side.boxes.items():
                if len(boxes):
                    side.boxes[key] = boxes.replace(centre_m=boxes.centre_m - ego_m[key])
        notes.append("boxes stand in the world; ranges are those from the car, by ego_translation")
        return {}
    range_m = [boxes.range_m for boxes in annotated.boxes.values() if len(boxes)]
    if range_m and float(np.median(np.concatenate(range_m))) > _IN_THE_WORLD_M:
        return {"ranges": "not known"}
    return {}


def _share_sequence(predicted: BoxSide, annotated: BoxSide, notes: list[str]) -> None:
    """Where one side names no sequence and the other a single one, that is the sequence of both."""
    sides = {"predictions": predicted, "labels": annotated}
    for (side_name, side), (other_word, other) in zip(sides.items(), reversed(sides.items()), strict=True):
        names = {sequence for sequence, _ in other.boxes}
        if {sequence for sequence, _ in side.boxes} != {""} or len(names) != 1 or names == {""}:
            continue
        (name,) = names
        side.boxes = {(name, frame): boxes for (_, frame), boxes in side.boxes.items()}
        side.details = {(name, frame): columns for (_, frame), columns in side.details.items()}
        notes.append(
            f"{side_name} name no sequence: their frames are taken for those of {name!r}, the {other_word}' only one"
        )


def _name_coordinates(side: BoxSide, path: Path, reference: str) -> None:
    """Take the coordinates that stand beside the files, and those that were given for files which name none."""
    side.stands_in(path, read_coordinates(path) if path.is_dir() else "")
    if reference and side.reference and reference != side.reference:
        raise ConfigError(f"{path}: names {side.reference} as its coordinates, but reference says {reference}")
    side.reference = side.reference or reference


def _agreed(predicted: BoxSide, annotated: BoxSide, notes: list[str]) -> str:
    """The coordinates of both sides."""
    predicted_in, annotated_in = predicted.reference, annotated.reference
    if predicted_in and annotated_in and predicted_in != annotated_in:
        if "camera" in predicted_in or "camera" in annotated_in:
            raise ConfigError(
                f"predictions stand in the coordinates of {predicted_in}, labels in those of {annotated_in}: they "
                "cannot be compared. Name the data set that was predicted on in the place of the labels "
                "(farfield score PREDICTIONS DATASET --format kitti), or predict on the data set of the labels"
            )
        raise ConfigError(
            f"predictions stand in the coordinates of {predicted_in}, labels in those of {annotated_in}: they "
            f"cannot be compared. Write one again (farfield predict ... --reference {annotated_in}, or farfield "
            f"convert DATA --to boxes-csv --reference {predicted_in}), or name the data set in the place of the "
            "labels: it is seen in the predictions' coordinates"
        )
    reference, silent = predicted_in or annotated_in, "labels" if predicted_in else "predictions"
    if bool(predicted_in) != bool(annotated_in) and not reference.startswith(
        "camera "
    ):  # KITTI's boxes stand in the camera anyway
        notes.append(
            f"{silent} do not name their coordinates: they are taken for those of the other side, {reference} "
            "(--reference says it)"
        )
    return reference


def _add_empty_frames(predicted: dict[Key, Boxes], annotated: dict[Key, Boxes], notes: list[str]) -> None:
    """Frames without any annotated box cannot appear in a table of boxes: take them from the predictions."""
    sequences = {sequence for sequence, _ in annotated}
    added = [key for key in predicted if key not in annotated]
    strangers = sorted({sequence for sequence, _ in added} - sequences)
    if strangers:
        raise ConfigError(
            f"predictions: expected sequences that have labels, got {', '.join(map(repr, strangers[:5]))}; "
            f"labels hold {', '.join(map(repr, sorted(sequences)[:5])) or 'none'}"
        )
    if added and len(added) == len(predicted) and any(len(boxes) for boxes in annotated.values()):
        raise ConfigError(
            f"expected predictions and labels to share frames, got none in common: predictions hold {added[0]}, "
            f"labels {next(iter(annotated))}. Frame names must be the same text in both. "
            f"{zeros_note((frame for _, frame in predicted), (frame for _, frame in annotated))}".rstrip()
        )
    zeros = zeros_note([frame for _, frame in added], [frame for _, frame in annotated])
    for key in added:
        annotated[key] = Boxes.empty()
    if added:
        note = (
            f"{count_of(len(added), 'frame has', 'frames have')} predictions "
            "but no line of labels; they count as annotated empty"
        )
        notes.append(f"{note}. {zeros}" if zeros else note)


def _groups(*columns: Shaped[np.ndarray, " n"]) -> list[tuple[tuple[str, ...], np.ndarray]]:
    """Rows of each combination of names, in the order of the file."""
    rows: dict[tuple[str, ...], list[int]] = {}
    for row, names in enumerate(zip(*(column.tolist() for column in columns), strict=True)):
        rows.setdefault(tuple(map(str, names)), []).append(row)
    return [(names, np.array(indices)) for names, indices in rows.items()]


def _read_csv(side: BoxSide, path: Path, stem: str) -> None:
    rows: BoxRows = read_boxes_csv(path)
    side.stands_in(path, rows.stands_in)
    side.turned(rows.yaw_rad)
    boxes = Boxes(
        centre_m=rows.centre_m,
        size_m=rows.size_m,
        yaw_rad=rows.yaw_rad,
        label=rows.label,
        score=side.scores(rows.score, len(rows)),
        track_id=rows.track_id,
        point_count=rows.point_count,
        velocity_m_s=rows.velocity_m_s,
    )
    sequence = np.full(len(rows), stem) if rows.sequence is None else rows.sequence
    for (name, frame), index in _groups(sequence, rows.frame):
        details = None if rows.doppler_m_s is None else {"doppler_m_s": rows.doppler_m_s[index]}
        side.add(path, (name, frame), boxes[index], details)


def _read_kitti(side: BoxSide, path: Path, stem: str) -> None:
    objects = read_labels(path)
    side.add(path, ("", stem), *_split(side, path, objects))


def _read_kitti_tracking(side: BoxSide, path: Path, stem: str) -> None:
    check_itself(path)
    with open_file(path, max_bytes=None) as handle:
        commas = b"," in handle.readline(4096)
    tracks: KittiTracks = read_detections(path) if commas else read_tracking(path)
    dontcare = tracks.objects.type == "DontCare"
    boxes, details = _split(side, path, tracks.objects)
    if not commas:
        boxes = boxes.replace(track_id=tracks.track_id[~dontcare])
    real = dict(_groups(tracks.frame[~dontcare]))
    regions = dict(_groups(tracks.frame[dontcare]))
    none = np.zeros(0, dtype=np.int64)
    for frame in dict.fromkeys(tracks.frame.tolist()):
        key = (str(frame),)
        facts = {name: values[real.get(key, none)] for name, values in details.items() if name != "dontcare_px"}
        facts["dontcare_px"] = details["dontcare_px"][regions.get(key, none)]
        side.add(path, (stem, *key), boxes[real.get(key, none)], facts)


def _read_nuscenes(side: BoxSide, path: Path, stem: str) -> None:
    del stem
    numbers: dict[str, int] = {}
    samples, stands_in = read_results_in(path)
    side.stands_in(path, stands_in)
    for token, sample in samples.items():
        ids = [numbers.setdefault(name, len(numbers)) for name in sample.track]
        boxes = Boxes(
            centre_m=sample.centre_m,
            size_m=sample.size_m,
            yaw_rad=sample.yaw_rad,
            label=list(sample.label),
            score=side.scores(sample.score, len(sample.label)),
            track_id=np.array(ids, dtype=np.int64) if sample.track else None,
            velocity_m_s=sample.velocity_m_s,
        )
        attributes = {"attribute": np.array(sample.attribute, dtype=np.str_)} if any(sample.attribute) else None
        side.add(path, ("", token), boxes, attributes)
        if sample.ego_m is not None:
            side.ego_m["", token] = sample.ego_m


def _read_submission(
    reader: Callable[..., Iterator[SubmittedFrame]], reference: str, side: BoxSide, path: Path, stem: str
) -> None:
    del stem
    side.stands_in(path, reference)
    for frame in reader(path, scored=side.scored):
        boxes = frame.boxes.replace(score=side.scores(frame.boxes.score, len(frame.boxes)))
        side.add(path, frame.key, boxes, dict(frame.details))


def _read_mmdetection3d(side: BoxSide, path: Path, stem: str) -> None:
    """A frame's JSON of the inferencer; its KITTI texts, which stand in the camera, are KITTI's."""
    if path.suffix != ".json":
        _read_kitti(side, path, stem)
        return
    instances = read_instances(path)
    names = side.class_names or instances.classes
    highest = int(instances.class_number.max(initial=-1))
    if highest >= len(names):
        raise FileFormatError(
            path,
            where="labels_3d",
            expected=f"a name for each number, {highest} the highest here",
            got=f"{count_of(len(names), 'name')}",
            fix="Say --class-names Pedestrian,Cyclist,Car: the model's classes in their order, as its configuration "
            "has them (class_names).",
        )
    if side.class_names and instances.classes and side.class_names != instances.classes:
        raise ConfigError(
            f"{path}: names its classes {', '.join(instances.classes)}, but --class-names says "
            f"{', '.join(side.class_names)}"
        )
    side.turned(instances.box[:, 6])
    x, y, z, *sizes, turn = instances.box.T
    if instances.box_type == "Camera":
        length, height, width = sizes
        side.stands_in(path, instances.reference or "camera")
        centre, size, yaw = upright_from_camera(
            np.column_stack([x, y, z]), np.column_stack([height, width, length]), turn
        )
    else:
        side.stands_in(path, instances.reference)
        size, yaw = np.column_stack(sizes), turn
        centre = np.column_stack([x, y, z + sizes[2] / 2])
    velocity = instances.velocity_m_s if instances.box_type == "LiDAR" else None
    boxes = Boxes(
        centre_m=centre,
        size_m=size,
        yaw_rad=yaw,
        label=np.array([names[number] for number in instances.class_number.tolist()], dtype=np.str_),
        score=side.scores(instances.score, len(instances)),
        velocity_m_s=velocity,
    )
    side.add(path, ("", stem), boxes)


def _split(side: BoxSide, path: Path, objects: KittiObjects) -> tuple[Boxes, dict[str, np.ndarray]]:
    """Boxes with their 2D facts; DontCare regions stand beside them."""
    dontcare = objects.type == "DontCare"
    extent_m = np.column_stack([objects.size_m, np.abs(objects.bottom_m)])
    sound = (objects.size_m >= 1e-4).all(axis=1) & (extent_m <= 1e9).all(axis=1)
    for row in np.flatnonzero(~dontcare & ~sound)[:1]:
        values = " ".join(f"{value:g}" for value in [*objects.size_m[row], *objects.bottom_m[row]])
        expected = "positive h w l, and x y z within 1e9 metres"
        raise FileFormatError(path, where=f"line {objects.line[row]}", expected=expected, got=values)
    real = objects[~dontcare]
    side.turned(real.rotation_y_rad)
    details = {
        "truncation": real.truncation,
        "occlusion": real.occlusion,
        "box_px": real.box_px,
        "alpha_rad": real.alpha_rad,
        "dontcare_px": objects.box_px[dontcare],
    }
    return kitti_boxes(real, score=side.scores(real.score, len(real))), details


_READERS: dict[str, Callable[[BoxSide, Path, str], None]] = {
    "boxes-csv": _read_csv,
    "kitti": _read_kitti,
    "kitti-tracking": _read_kitti_tracking,
    "nuscenes": _read_nuscenes,
    "argoverse2": partial(_read_submission, argoverse2_frames, "ego"),
    "waymo": partial(_read_submission, waymo_frames, ""),
    "kradar": read_kit_text,
    "openpcdet": _read_kitti,
    "mmdetection3d": _read_mmdetection3d,
}


def kitti_boxes(objects: KittiObjects, *, score: np.ndarray | None = None) -> Boxes:
    """Boxes of KITTI's objects in our axes, without calibration: :func:`~farfield.geometry.kitti.upright_from_camera`.

    Args:
        objects: n objects with 3D boxes.
        score: Scores, shape (n,), or None.
    """
    centre, size, yaw = upright_from_camera(objects.bottom_m, objects.size_m, objects.rotation_y_rad)
    return Boxes(centre_m=centre, size_m=size, yaw_rad=yaw, label=objects.type, score=score)
