"""Boxes that were made elsewhere, with a data set as the truth."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from farfield.datasets import open_dataset, recognise
from farfield.datasets.argoverse2 import Argoverse2
from farfield.datasets.base import Dataset
from farfield.datasets.class_mapping import class_mapping_of
from farfield.datasets.kitti.boxes import objects_from_boxes
from farfield.datasets.kitti.object import VIRTUAL_CAMERA, Kitti
from farfield.datasets.maps.coordinates import Coordinates
from farfield.datasets.memory import in_memory
from farfield.datasets.nuscenes.reader import SchemaDataset
from farfield.datasets.result_files import coordinates_of_text
from farfield.datasets.waymo import Waymo
from farfield.errors import ConfigError
from farfield.evaluation.detecting import check_new_key, label_facts, points_in_boxes, with_point_count
from farfield.files.mmdetection3d import read_instances
from farfield.files.nuscenes import WORLD
from farfield.files.remote_paths import as_path
from farfield.frame import Annotation, Boxes, Constant, Frame, Key
from farfield.geometry.poses import invert
from farfield.metrics.box_files import FORMATS, kitti_boxes, read, read_predictions
from farfield.metrics.detections import PROTOCOLS, Detections, Protocol
from farfield.metrics.kit_folders import kit_folder, read_frames, results_folder
from farfield.metrics.kradar.conditions import read_conditions
from farfield.vocabulary.classes import KITTI_FROM_CIRRUS, normalised_class
from farfield.vocabulary.counts import count_of

Progress = Callable[[Iterable[int]], Iterable[int]]
_SCORED_BESIDE_DATA = tuple(form for form in FORMATS if form != "kitti-tracking")


def detections_from_boxes(
    boxes: Mapping[Key, Boxes],
    data: Dataset | Sequence[Frame],
    *,
    cloud: str | None = None,
    progress: Progress = iter,
) -> Detections:
    """Predictions made elsewhere, with what was annotated in the frames of ``data``.

    Args:
        boxes: Scored boxes by (sequence, frame), in the coordinates of ``data``.
        data: Frames; those without annotation are left out.
        cloud: A cloud whose points in the annotated boxes are counted; without one their own counts stay.
        progress: Wraps the frame numbers, to show progress.

    Raises:
        ConfigError: If there are boxes and none is of an annotated frame.
        DatasetError: If two annotated frames have one name, or nothing is annotated.
    """
    dataset = in_memory(data)
    annotations: dict[Key, Annotation] = {}
    conditions: dict[Key, Mapping[str, str]] = {}
    reference = ""
    keys = set[Key]()
    for index in progress(range(len(dataset))):
        frame = dataset[index]
        keys.add(frame.key)
        annotation = frame.annotation
        if annotation is not None:
            check_new_key(frame.key, conditions)
            point_count = None if cloud is None else points_in_boxes(annotation, frame.cloud(cloud))
            annotations[frame.key] = with_point_count(annotation, point_count)
            conditions[frame.key] = frame.conditions
            reference = frame.reference
    return Detections(
        notes=_unknown_frames(boxes, annotations, keys),
        data=dataset.root.name,
        fingerprint=dataset.fingerprint(),
        reference=reference,
        cloud=cloud,
        drives=dataset.drives(),
        boxes={key: predicted for key, predicted in boxes.items() if key in annotations},
        annotations=annotations,
        conditions=conditions,
        facts=label_facts(annotations),
    )


def _unknown_frames(boxes: Mapping[Key, Boxes], annotated: Collection[Key], keys: Collection[Key]) -> tuple[str, ...]:
    """A note on the predictions of frames that the data do not have."""
    unknown = [key for key in boxes if key not in keys]
    if boxes and annotated and not any(key in annotated for key in boxes):
        raise ConfigError(
            f"expected predictions in annotated frames, got none: predictions hold {next(iter(boxes))}, annotated is "
            f"{next(iter(annotated))}. Sequence and frame must be the same text in both."
        )
    if not unknown:
        return ()
    return (
        f"{len(unknown)} of {count_of(len(boxes), 'frame')} of the "
        f"predictions, such as {unknown[0]}, are not in the data",
    )


def read_detections(
    predictions: Path | str,
    labels: Path | str | Dataset,
    *,
    format: str = "boxes-csv",
    reference: str = "",
    axes: str = "",
    class_names: Sequence[str] = (),
    **options: Any,
) -> Detections:
    """Predictions of files beside the labels of files, or of a data set.

    Args:
        predictions: File, or folder of files, of predicted boxes.
        labels: File, or folder of files of equal stems, of annotated boxes; or a data set, or its folder.
        format: As of :func:`farfield.metrics.box_files.read`. With ``"kitti"`` a data set's boxes are seen in the
            axes of its camera, as ``predict --format kitti`` writes them; with ``"nuscenes"`` in the world, moved to
            the car.
        reference: Coordinates in which boxes stand whose files do not name them.
        axes: Axes of the texts of K-Radar's kit, see :mod:`farfield.metrics.kit_axes`.
        class_names: mmdetection3d's classes in the order of their numbers.
        **options: Those of :func:`farfield.open_dataset`, for a data set's folder.

    Raises:
        ConfigError: If there is nothing to read or to score, the files name other coordinates, or options are given
            where no data set is opened.
        FileFormatError: If a file does not have its format.
    """
    if isinstance(labels, Path | str):
        folder = as_path(labels)
        format_name = recognise(folder) if folder.is_dir() else None
        texts = format_name != "kradar" and any(folder.glob("*.txt"))  # whose sequences have a description.txt
        if format not in _SCORED_BESIDE_DATA or texts or format_name is None:
            if options:
                raise ConfigError(
                    f"{', '.join(options)}: expected a data set's folder in the place of the labels, whose files are "
                    f"read so, got files of boxes: {labels}"
                )
            return read(predictions, labels, format=format, reference=reference, axes=axes, class_names=class_names)
        labels = open_dataset(folder, **options)
        own = {"argoverse2": Argoverse2, "waymo": Waymo}.get(format)
        if own is not None and isinstance(labels.unwrapped, own) and "classes" not in options:
            labels = open_dataset(folder, **options, classes=format)  # the submission's own categories
    reading: dict[str, Any] = {"format": format, "reference": reference, "axes": axes, "class_names": class_names}
    folder = results_folder(as_path(predictions)) if format in ("openpcdet", "mmdetection3d") else as_path(predictions)
    if format in ("kitti", "openpcdet") or (format == "mmdetection3d" and _in_camera_axes(folder)):
        return _in_cameras(folder, labels, reading)
    if format == "mmdetection3d":
        return attach_ground_truth(_by_sequence(folder, labels, reading), labels)
    if format == "kradar" and not read_frames(kit_folder(folder)):
        raise ConfigError(
            f"{predictions}: K-Radar's kit numbers its frames anew, and no file FRAMES beside its texts says which of "
            f"{labels.root} they are. Score the folder against its own annotation: farfield score {predictions} "
            f"{predictions} --format kradar"
        )
    if format == "nuscenes":
        return detections_by_sample(read_predictions(predictions, format=format, reference=reference), labels)
    return attach_ground_truth(read_predictions(predictions, **reading), labels)


def _in_camera_axes(folder: Path) -> bool:
    """Whether mmdetection3d's boxes stand in the camera: of KITTI's texts, or of a model that detects in images."""
    if not folder.is_dir():
        return False
    files = [path for path in sorted(folder.rglob("*")) if path.suffix in (".txt", ".json") and path.is_file()]
    return bool(files) and (files[0].suffix == ".txt" or read_instances(files[0]).box_type == "Camera")


def _folders(predictions: Path, data: Dataset) -> dict[str, Path]:
    """The folder of each sequence: one a sequence below, or the folder itself for the first."""
    sequences = list(dict.fromkeys(data.sequences))
    folders = {name: predictions / name for name in sequences if (predictions / name).is_dir()}
    return folders or {sequences[0]: predictions}


def _by_sequence(predictions: Path, data: Dataset, own: Mapping[str, Any]) -> Detections:
    """A file a frame, in a folder for each of several sequences."""
    parts = {name: read_predictions(folder, **own) for name, folder in _folders(predictions, data).items()}
    references = {part.reference for part in parts.values()}
    if len(references) > 1:
        raise ConfigError(
            f"{predictions}: expected boxes in one set of coordinates, got {', '.join(sorted(references))}"
        )
    return replace(
        next(iter(parts.values())),
        boxes={(name, frame): boxes for name, part in parts.items() for (_, frame), boxes in part.boxes.items()},
        notes=tuple(dict.fromkeys(note for part in parts.values() for note in part.notes)),
    )


def _in_cameras(predictions: Path, data: Dataset, own_reading: Mapping[str, Any]) -> Detections:
    """KITTI's results beside a data set's boxes in the same axes: KITTI's own label files, or boxes brought there.

    Args:
        predictions: Folder of texts, ``FRAME.txt``, or of such folders by sequence.
        data: The data set that was predicted on.
        own_reading: How the predictions are read: format, reference and more.

    Raises:
        ConfigError: If the predictions name other coordinates, or none is of an annotated frame.
    """
    reader = data.unwrapped
    as_text = own_reading["format"] != "mmdetection3d" or any(predictions.glob("*.txt"))
    if isinstance(reader, Kitti) and reader.label_axes == "camera" and not data.maps and as_text:
        return read(predictions, reader.folder / "label_2", format="kitti", reference=own_reading["reference"])
    boxes: dict[Key, Boxes] = {}
    details: dict[Key, Mapping[str, np.ndarray]] = {}
    notes: list[str] = []
    for sequence, folder in _folders(predictions, data).items():
        detections = read_predictions(folder, **own_reading)
        boxes |= {(sequence, frame): predicted for (_, frame), predicted in detections.boxes.items()}
        details |= {(sequence, frame): facts for (_, frame), facts in detections.prediction_details.items()}
        notes += [note for note in detections.notes if note not in notes]
        own = coordinates_of_text(data, data[0])
        if detections.reference not in ("", "camera", own):
            raise ConfigError(
                f"{folder}: the boxes stand in the coordinates of {detections.reference}; those of {data.root} can be "
                f"seen in those of {own}. Name the data set that was predicted on"
            )
    annotated = [_in_camera(data, index) for index in range(len(data)) if data.has_annotation(index)]
    joined = detections_from_boxes(boxes, annotated)
    notes += [note for note in joined.notes if note not in notes]
    return replace(joined, prediction_details=details, notes=tuple(notes)).with_oddities()


def detections_by_sample(predictions: Detections, data: Dataset) -> Detections:
    """NuScenes' results beside the samples of a data set, both seen from where the car stood.

    Samples of scenes of which the results hold none do not count: they are of another part of the data. Those that
    lack in other scenes count as nothing found.

    Args:
        predictions: Boxes by ``("", token)``, in the world or in the frames' coordinates.
        data: The data set; of other formats a sample is ``frame`` or ``sequence/frame``, as ``predict`` names them.

    Raises:
        ConfigError: If no sample is one of the data's, or the data have no poses where boxes stand in the world.
    """
    reader = data.unwrapped
    if isinstance(reader, SchemaDataset) and not data.maps:
        data = reader.as_scored().select(data.origins)
    plain = len(set(data.frame_ids)) == len(data)
    index_of = {frame if plain else f"{sequence}/{frame}": row for row, (sequence, frame) in enumerate(data.keys)}
    tokens = [token for _, token in predictions.boxes]
    strangers = [token for token in tokens if token not in index_of]
    if strangers:
        raise ConfigError(
            f"expected sample tokens of {data.root}, got {count_of(len(strangers), 'other')} of {len(tokens)}, such as "
            f"{strangers[0][:60]!r}. Name the data set (and its version) that was predicted on."
        )
    scenes = {data.sequences[index_of[token]] for token in tokens}
    chosen = [row for row, sequence in enumerate(data.sequences) if sequence in scenes]
    notes = list(predictions.notes)
    if isinstance(reader, SchemaDataset) and reader.dialect.name != "nuscenes":
        notes.append(
            f"samples of {reader.dialect.title} are scored under the names of nuScenes' detection task, and by "
            f"nuscenes-detection within its ranges: the figures are not those of its own task"
        )
    if len(chosen) < len(data):
        notes.append(f"{len(data) - len(chosen)} of {len(data)} samples are of scenes without results: left out")
    if len(chosen) > len(tokens):
        notes.append(f"{len(chosen) - len(tokens)} of {len(chosen)} samples have no entry of results: nothing found")
    boxes: dict[Key, Boxes] = {}
    in_world = predictions.reference in ("", WORLD)
    for (_, token), predicted in predictions.boxes.items():
        row = index_of[token]
        boxes[data.keys[row]] = _seen_from(data[row], predicted) if in_world else predicted
    details = {data.keys[index_of[token]]: rows for (_, token), rows in predictions.prediction_details.items()}
    truth = data.select(chosen) if in_world else in_coordinates(data.select(chosen), predictions.reference)
    joined = detections_from_boxes(boxes, truth)
    names = {} if isinstance(reader, SchemaDataset) else _meant(joined, data)
    if names:
        renamed = {key: predicted.relabel(names) for key, predicted in joined.boxes.items()}
        joined = replace(joined, boxes=renamed)
        pairs = ", ".join(f"{name} is {ours}" for name, ours in names.items())
        notes.append(f"classes of the predictions are called as the data's: {pairs}")
    return replace(joined, prediction_details=details, notes=(*notes, *joined.notes)).with_oddities()


def _seen_from(frame: Frame, boxes: Boxes) -> Boxes:
    """Boxes of the world in a frame's coordinates."""
    if frame.world_T_frame is None:
        raise ConfigError(
            f"frame {frame.key}: expected a pose, since the predicted boxes stand in the world; it has none"
        )
    return boxes.transform(invert(frame.world_T_frame))


def _in_camera(data: Dataset, index: int) -> Frame:
    """A frame with its boxes alone, under KITTI's names in the axes of its front camera, ahead, left and up."""
    frame = data[index]
    boxes = Boxes.empty() if frame.boxes is None else frame.boxes
    camera = VIRTUAL_CAMERA if frame.front_camera is None else frame.cameras[frame.front_camera]
    objects = objects_from_boxes(boxes, camera, classes=KITTI_FROM_CIRRUS)
    names = ("truncation", "occlusion", "box_px", "alpha_rad")
    facts = {name: getattr(objects, name) for name in names}
    details = {} if frame.annotation is None else frame.annotation.details
    if all(name in details for name in facts):  # KITTI's own labels under other names
        facts = {name: details[name] for name in facts}
    annotation = Annotation(boxes=kitti_boxes(objects), details=facts)
    return Frame(sequence=frame.sequence, frame_id=frame.frame_id, load_annotation=Constant(annotation))


def attach_ground_truth(predictions: Detections, data: Dataset) -> Detections:
    """Predictions with what a data set's frames have annotated, seen in the predictions' coordinates.

    Args:
        predictions: Boxes as :func:`farfield.metrics.box_files.read_predictions` gives them. Where they name no
            sequence and the data set has one alone, it is theirs.
        data: The data set.

    Raises:
        ConfigError: If the data set does not know the coordinates in which the predictions stand, or no frame of theirs
            is one of its annotated ones.
        DatasetError: If nothing is annotated.
    """
    notes = list(predictions.notes)
    reference, own = predictions.reference, data[0].reference
    if not reference:
        notes.append(f"predictions do not name their coordinates: they are taken for {own} (--reference says it)")
    elif reference != own:
        notes.append(f"the annotated boxes are seen in the coordinates of {reference}, as the predictions are")
    boxes: Mapping[Key, Boxes] = predictions.boxes
    sequences = set(data.sequences)
    if len(sequences) == 1 and {sequence for sequence, _ in boxes} == {""}:
        (name,) = sequences
        notes.append(f"predictions name no sequence: their frames are taken for those of {name!r}, the data's only one")
        boxes = {(name, frame_id): predicted for (_, frame_id), predicted in boxes.items()}
    detections = detections_from_boxes(boxes, in_coordinates(data, reference))
    names = _meant(detections, data)
    if names:
        renamed = {key: predicted.relabel(names) for key, predicted in detections.boxes.items()}
        detections = replace(detections, boxes=renamed)
        pairs = ", ".join(f"{name} is {ours}" for name, ours in names.items())
        notes.append(f"classes of the predictions are called as the data's: {pairs}")
    return replace(detections, notes=(*notes, *detections.notes)).with_oddities()


def _meant(detections: Detections, data: Dataset) -> dict[str, str]:
    """The data's class of each name in the predictions that the annotation lacks: by their mapping, or usual names."""
    annotated = {str(name) for boxes in detections.annotated.values() for name in np.unique(boxes.label)}
    predicted = {str(name) for boxes in detections.boxes.values() for name in np.unique(boxes.label)}
    classes = class_mapping_of(data)
    meant = {name: classes.get(name, normalised_class(name, {})) for name in sorted(predicted - annotated)}
    return {name: ours for name, ours in meant.items() if ours in annotated}


def in_coordinates(data: Dataset, reference: str) -> Dataset:
    """The data set in the coordinates in which boxes of a file stand.

    Args:
        data: The data set.
        reference: What the file names; empty: nothing, and the data stay as they are.

    Raises:
        ConfigError: If the data set does not know these coordinates.
    """
    own = data[0].reference
    if not reference or reference == own:
        return data
    if reference not in data.references:
        references = " or ".join(data.references or (own,))
        raise ConfigError(
            f"the boxes stand in the coordinates of {reference}; the frames of {data.root} can be seen in those of "
            f"{references}. Write the boxes anew in one of these (farfield predict ... --reference {own})"
        )
    return data.mapped(Coordinates(reference))


def with_conditions(detections: Detections, protocol: Protocol, source: Path | str) -> Detections:
    """Detections with weather, road and time by frame, and a note on the sequences without.

    Args:
        detections: Detections whose annotated frames are looked up.
        protocol: By which they will be scored.
        source: A CSV with the columns sequence, road, time, weather; a K-Radar tree with its description.txt files; or
            the word ``"published"`` for the table of K-Radar's 58 sequences.

    Raises:
        ConfigError: If the protocol does not score by condition, or there is no such source.
    """
    if "conditions" not in protocol.uses:
        usable = [name for name in PROTOCOLS.names() if not PROTOCOLS.broken(name)]
        able = [name for name in usable if "conditions" in PROTOCOLS[name].uses]
        raise ConfigError(f"--conditions: only {' and '.join(able)} score by condition, not {protocol}")
    conditions = read_conditions(str(source), detections.annotations)
    missing = sorted({key[0] for key in detections.annotations if key not in conditions})
    note = f"no conditions for sequences {', '.join(missing[:8])}: their frames count in the whole alone"
    return replace(detections, conditions=conditions, notes=(*detections.notes, *([note] if missing else [])))
