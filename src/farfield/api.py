"""The functions most people need. Each imports what it uses when it is called."""

import json
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from farfield.errors import ConfigError, DatasetError
from farfield.vocabulary.scores import SHOWN_SCORE

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Shaped

    from farfield.calibration.boards import BoardCalibration
    from farfield.calibration.jobs import CameraJob, PairsJob, RadarJob
    from farfield.calibration.lidar_lidar import Registration
    from farfield.calibration.solving import CalibrationKind
    from farfield.datasets.base import Dataset
    from farfield.detectors.exporting.writing import OnnxExport
    from farfield.detectors.info import DescribedDetector, DetectorFunction
    from farfield.detectors.network import Network
    from farfield.detectors.onnx.detector import OnnxDetector
    from farfield.detectors.runtime import Detector
    from farfield.evaluation.streaming import SweepStream
    from farfield.experiments.adapting import AdaptationResult
    from farfield.frame import Cloud, Frame
    from farfield.geometry.boxes import Boxes
    from farfield.jobs import JobOptions
    from farfield.metrics.detections import Detections
    from farfield.metrics.result import Result
    from farfield.simulation.recording import RecordingSummary
    from farfield.simulation.recording.raw import RawRecorded
    from farfield.training.report import TrainingReport
    from farfield.training.transfer import TransferReport

Progress = Callable[[Iterable[int]], Iterable[int]]


def _require_torch() -> None:
    """Name the missing extra where torch is absent, before a module that imports torch is imported.

    Raises:
        MissingExtraError: If torch is not installed.
    """
    from farfield.detectors import DETECTORS

    _ = DETECTORS["pointpillars"].network_class


def open_dataset(path: Path | str, **options: Any) -> "Dataset":
    """Open a data set, its format recognised; see :func:`farfield.datasets.open_dataset`."""
    from farfield.datasets import open_dataset as open_any

    return open_any(path, **options)


def load_detector(
    name: Path | str,
    *,
    device: Any = None,
    precision: str = "auto",
    cloud: str | Mapping[str, str] | None = None,
    score_threshold: float | None = None,
    nms_iou: float | None = None,
    max_boxes: int | None = None,
    classes: "Iterable[str] | Mapping[str, str] | None" = None,
) -> "Detector | OnnxDetector":
    """Load a detector: a bundled name such as ``"pointpillars-cirrus-sim"``, a run's folder, a weights file.

    Or one that :func:`export` wrote, ``.onnx``, which needs no torch.

    Args:
        name: Which one; also a URL of a weights file, with the sum of its bytes behind it: ``#sha256=...``.
        device: Where to run, such as ``"cpu"`` or ``"cuda:0"``; by default, and for ``"auto"``, a GPU if there is one.
        precision: ``"fp32"``, ``"bf16"``, ``"fp16"``, or ``"auto"``: what suits the device.
        cloud: Which of a frame's clouds to read.
        score_threshold: Boxes below are not given; lower or higher than the weights' own, which counts unless given:
            a low one, as scores need unsure boxes too. Pictures leave out more unless told, see :func:`show`.
        nms_iou: Boxes that overlap a better one by more are not given; likewise.
        max_boxes: Boxes given in a frame; likewise.
        classes: Classes to give, such as ``["vehicle"]``, or for each of them the name to give it, such as
            ``{"vehicle": "car", "large_vehicle": "car"}`` (default: all).

    Raises:
        FarfieldError: If there is nothing of this name.
        ConfigError: If a limit is not possible, or the detector does not know a class.
        MissingExtraError: If torch, or for an exported detector onnxruntime, is not installed.
    """
    options: dict[str, Any] = {
        "device": device,
        "precision": precision,
        "cloud": cloud,
        "score_threshold": score_threshold,
        "nms_iou": nms_iou,
        "max_boxes": max_boxes,
        "classes": classes,
    }
    from farfield.files.remote_paths import checked_file
    from farfield.files.remote_stores import is_url

    name = checked_file(str(name)) if is_url(str(name)) else name
    if Path(name).suffix.lower() == ".onnx":
        from farfield.detectors.onnx.detector import OnnxDetector

        return OnnxDetector(name, **options)
    _require_torch()
    from farfield.detectors.runtime import Detector

    return Detector.load(name, **options)


def export(
    detector: "Detector | Path | str", out: Path | str, *, licence: str = "", score_threshold: float | None = None
) -> "OnnxExport":
    """Write a trained detector as an ONNX file that runs without torch: what ``farfield export`` does.

    The file is compared with the network on five clouds before it is written; beside it stands a card, ``OUT.md``.

    Args:
        detector: A bundled detector's name, a run's folder, a weights file, or a loaded detector (fp32, on the CPU).
        out: The file, ``.onnx``; :func:`load_detector` takes it.
        licence: Under which the weights may be used, for the card.
        score_threshold: The file's own threshold (default: that of the weights).

    Returns:
        What was written, with the parity of each cloud.

    Raises:
        FarfieldError: If there are no such weights, or file and network do not agree; nothing is left then.
        ConfigError: If the detector is of a kind that is not exported.
        MissingExtraError: If torch, onnx, onnxscript or onnxruntime is not installed.
    """
    _require_torch()
    from farfield.detectors.exporting.writing import export as write
    from farfield.detectors.runtime import Detector

    if not isinstance(detector, Detector):
        detector = Detector.load(detector, device="cpu", precision="fp32", score_threshold=score_threshold)
    return write(detector, Path(out), licence=licence)


def detect(
    detector: "DescribedDetector | DetectorFunction | str | Path",
    data: Any,
    *,
    cloud: str | None = None,
    progress: Progress = iter,
) -> "Detections":
    """Detect objects in every frame, seen as the detector learnt to see them; ``.score(protocol)`` scores them.

    Where the data seem to be in other axes or units than ours, ``.notes`` say so.

    Args:
        detector: A detector, its name or folder, or any function from a frame to scored boxes.
        data: A data set or its folder; a cloud file; an array or table of points; or a list of files or sweeps, see
            :func:`farfield.datasets.door.dataset_of`.
        cloud: Which of the frames' clouds to read; by default the first that suits the detector.
        progress: Wraps the frame numbers, to show progress.

    Raises:
        ConfigError: If the data or the detector are nothing of these, or an array cannot be what it is taken for.
    """
    from farfield.datasets.door import dataset_of
    from farfield.evaluation import detect as detect_all

    data = dataset_of(data)
    return _doubted(detect_all(_detector_of(detector), data, cloud=cloud, progress=progress), data, cloud)


def stream(
    detector: "DescribedDetector | DetectorFunction",
    source: "Dataset | Path | str | Iterable[Frame | Cloud]",
    *,
    rate_hz: float | None = None,
    drop: str | None = None,
    waiting: int = 1,
    cloud: str | None = None,
    idle_s: float | None = None,
) -> "SweepStream":
    """Detect in sweeps as they come: ``for boxes in ff.stream(detector, source)``.

    The next sweep is read and, for an exported detector, voxelised while the network works on this one. What is dropped
    because sweeps come faster than boxes is counted, and a warning at the end says it.

    Args:
        detector: A detector, or any function from a frame to scored boxes.
        source: A data set or bag, or its path; with ``idle_s`` a folder of clouds that fills; or frames or clouds one
            after the other, such as a generator that waits for a sensor.
        rate_hz: Take sweeps at this rate, as a sensor gives them (default: as they come).
        drop: Which sweep is dropped where ``waiting`` others wait: ``"oldest"``, ``"newest"`` or ``"none"``; unless
            given none, but with ``rate_hz`` the oldest.
        waiting: Sweeps that may wait.
        cloud: Which of a frame's clouds to read.
        idle_s: Read the path as a folder that fills, until no file came for so long.

    Returns:
        An iterable of boxes; its ``sweep`` and ``latency_ms`` are those of the last ones, its ``report`` has counts,
        p50 and p99.

    Raises:
        ConfigError: If a choice is not possible.
        DatasetError: If there is no such source.
    """
    from farfield.evaluation.streaming import stream as stream_sweeps

    return stream_sweeps(detector, source, rate_hz=rate_hz, drop=drop, waiting=waiting, cloud=cloud, idle_s=idle_s)


def _detector_of(detector: Any) -> Any:
    """A detector, loaded where it is named.

    Raises:
        ConfigError: If it is neither a name nor a function.
    """
    if isinstance(detector, str | Path):
        return load_detector(detector)
    if not callable(detector):
        raise ConfigError(
            "detector: expected a detector, a bundled one's name, a run's folder, or a function from a frame to scored "
            f"boxes; got {type(detector).__name__}"
        )
    return detector


def _doubted(detections: "Detections", data: "Dataset", cloud: str | None) -> "Detections":
    """Detections whose notes say where the data's axes or units seem to be others than ours, as ``predict`` warns."""
    from farfield.inspection.axes_and_units import first_doubts

    doubts = tuple(map(str, first_doubts(data, cloud=cloud)))
    return replace(detections, notes=(*doubts, *detections.notes)) if doubts else detections


def transfer(
    network: "Network",
    weights: "Path | str | Mapping[str, Any]",
    *,
    rename: Mapping[str, str] | None = None,
    inputs: Literal["match", "average", "fresh"] = "match",
    head: Literal["by-class", "fresh"] = "by-class",
    skip: Iterable[str] = (),
    least_taken: float = 0.1,
) -> "TransferReport":
    """Give a network what fits of trained weights, as ``training.start`` of an experiment does.

    Args:
        network: Such as ``build_detector(config)`` makes; it is changed.
        weights: A bundled detector's name, a run's folder, a weights file, or tensors by name.
        rename: Beginnings of names in the weights, and what they are called in the network.
        inputs: Where the columns that are read differ: ``"match"`` takes them by name (a new one starts at zero),
            ``"average"`` the mean of theirs in each of ours, ``"fresh"`` none.
        head: ``"by-class"`` takes the rows of classes that both know, ``"fresh"`` nothing of the head.
        skip: Parts or patterns that stay fresh.
        least_taken: Taking a smaller share of the parameters is an error.

    Returns:
        What was taken, adapted and by class, what stays fresh and what was not used; ``print`` shows it.

    Raises:
        FarfieldError: If there are no such weights.
        ConfigError: If they are another detector's, hold a number that is not finite, or too little of them fits.
    """
    from farfield.training.config import InitConfig
    from farfield.training.transfer import start_network

    chosen = InitConfig(rename=dict(rename or {}), inputs=inputs, head=head, skip=tuple(skip), least_taken=least_taken)
    return start_network(network, weights if isinstance(weights, Mapping) else str(weights), chosen)


def evaluate(
    detector: "DescribedDetector | DetectorFunction | Mapping[tuple[str, str], Boxes] | str | Path",
    data: Any,
    *,
    protocol: str = "dds",
    cloud: str | None = None,
    progress: Progress = iter,
    metric: str | None = None,
    **settings: Any,
) -> "Result":
    """Score a detector, or predictions made before, on annotated frames: ``detect(detector, data).score(protocol)``.

    Args:
        detector: A detector, its name, or its boxes by (sequence, frame), in the coordinates of ``data``.
        data: Annotated frames, or a data set's folder.
        protocol: ``"dds"``, ``"nuscenes"``, ``"kitti"``, ``"kradar"``, ``"kradar-compat:VARIANT"`` or a registered one.
        cloud: Which of the frames' clouds to read; by default the first that suits the detector.
        progress: Wraps the frame numbers, to show progress.
        metric: The old name of ``protocol``.
        **settings: Settings of the protocol, such as ``range_bins_m``, ``epsilons``, ``region``.

    Returns:
        The protocol's result; ``print`` shows its table and notes, such as of axes or units that seem to be others than
        ours; ``to_json()`` gives everything.

    Raises:
        DatasetError: If no frame is annotated.
        ConfigError: If the protocol or a setting is unknown, or no cloud suits the detector.
    """
    from farfield.datasets.door import dataset_of
    from farfield.evaluation import detect as detect_all
    from farfield.evaluation import detections_from_boxes

    data = dataset_of(data)
    if metric is not None:
        warnings.warn("evaluate: metric= is called protocol= now", DeprecationWarning, stacklevel=2)
        protocol = metric
    if isinstance(detector, Mapping):
        detections = detections_from_boxes(detector, data, cloud=cloud, progress=progress)
    else:
        detections = detect_all(_detector_of(detector), data, cloud=cloud, annotated_only=True, progress=progress)
    if not detections.annotations:
        raise DatasetError("evaluate: expected annotated frames, found none with boxes.")
    detections.check_label(protocol, **settings)
    return _doubted(detections, data, cloud).score(protocol, **settings)


def score(
    predictions: Path | str,
    labels: "Path | str | Dataset",
    *,
    protocol: str = "dds",
    format: str = "boxes-csv",
    reference: str = "",
    conditions: Path | str | None = None,
    axes: str = "",
    class_names: Sequence[str] = (),
    **settings: Any,
) -> "Result":
    """Score the boxes of any detector against annotated boxes, without a model: what ``farfield score`` does.

    Args:
        predictions: File, or folder of files, of predicted boxes.
        labels: File, or folder of files of equal stems, of annotated boxes; or a data set, or its folder, whose
            annotation is then seen in the coordinates of the predictions.
        protocol: As of :func:`evaluate`; also ``"tracking"`` and ``"nuscenes-tracking"``.
        format: Format of both: ``"boxes-csv"``, ``"kitti"``, ``"kitti-tracking"``, ``"nuscenes"``, ``"argoverse2"``,
            ``"waymo"``, ``"kradar"``, ``"openpcdet"`` or ``"mmdetection3d"``.
        reference: Coordinates of boxes whose files do not name them, such as ``"radar"``.
        conditions: For ``"kradar"``: a CSV with the columns sequence, road, time, weather; a K-Radar tree with its
            description.txt files; or ``"published"`` for the table of K-Radar's 58 sequences.
        axes: For ``"kradar"``: axes of the kit's texts; unless given they are decided from the boxes, or refused.
        class_names: For ``"mmdetection3d"``: the model's classes in the order of their numbers.
        **settings: Settings of the protocol, such as ``label`` (the most frequent class unless given),
            ``range_bins_m``, ``region``, ``iou``.

    Returns:
        The protocol's result; ``print`` shows its table, ``to_json()`` gives everything.

    Raises:
        ConfigError: If the protocol, the format or a setting is unknown, or there is nothing to score.
        FileFormatError: If a file does not have its format.
    """
    from farfield.evaluation import read_detections, with_conditions
    from farfield.metrics import PROTOCOLS

    detections = read_detections(
        predictions, labels, format=format, reference=reference, axes=axes, class_names=class_names
    )
    if conditions is not None:
        detections = with_conditions(detections, PROTOCOLS[protocol], conditions)
    return detections.score(protocol, **settings)


def simulate(preset: str, out: Path | str, **options: Any) -> "RecordingSummary | RawRecorded":
    """Write a simulated data set in the layout of Cirrus, K-Radar, KITTI or RADIATE: what ``farfield simulate`` does.

    Called again, it resumes where it stopped. The bytes do not depend on the number of workers.

    Args:
        preset: Such as ``"cirrus-sim-mini"`` or ``"kradar-sim"``.
        out: Folder to write into; made if absent. :func:`open_dataset` opens it.
        **options: Fields of :class:`farfield.simulation.recording.RecordingOptions`, such as ``frames``, ``sensors``,
            ``weather``, ``workers``; ``recording=True`` writes the raw streams of each drive of the Cirrus car. And
            ``progress``, which wraps the numbers of what is left to write, and ``report``, called with each line of
            what is done.

    Raises:
        ConfigError: If there is no such preset, or an option is not possible.
        TypeError: If there is no such option.
    """
    if options.pop("recording", False):
        from farfield.simulation.recording.raw import record_streams

        sweeps = options.pop("frames", None)
        return record_streams(preset, out, sweeps=sweeps, **options)
    from farfield.simulation.recording import record

    return record(preset, out, **options)


def calibrate(
    kind: "CalibrationKind", data: "Path | str | Dataset", **options: Any
) -> "RadarJob | CameraJob | PairsJob | Registration | BoardCalibration":
    """Solve where a sensor stands against the LiDAR, or a camera's intrinsics: what ``farfield calibrate`` does.

    Nothing is written.

    Args:
        kind: What against what, ``"radar-lidar"``, ``"lidar-camera"`` or ``"lidar-lidar"``; ``"board"``: intrinsics
            from pictures of a board.
        data: A data set, or its folder; for ``"board"`` the folder of pictures.
        **options: Fields of :class:`farfield.calibration.solving.CalibrationOptions`, such as ``frames``, ``camera``,
            ``lidars``, ``pairs``, ``x``, ``yaw``, ``corners``.

    Returns:
        What was solved, with residuals and what the data cannot tell; ``to_json()`` gives everything.

    Raises:
        ConfigError: If a choice is not possible, or the data set has no such sensor.
        DatasetError: If there is no such sequence, or no frame has both sensors.
        TypeError: If there is no such option.
    """
    from farfield.calibration.solving import CalibrationOptions, solve

    chosen = CalibrationOptions(**options)
    if isinstance(data, Path | str):
        from farfield.files.remote_paths import as_path

        data = as_path(data) if kind == "board" else open_dataset(data)
    return solve(kind, data, chosen)


def adapt(
    detector: Path | str,
    data: "Path | str | Dataset | Sequence[Path | str]",
    *,
    out: Path | str,
    source: Path | str | None = None,
    labels: "Path | str | Dataset | None" = None,
    learn_from: "Path | str | Dataset | None" = None,
    bulk: "JobOptions | None" = None,
    report: "TrainingReport | None" = None,
    overwrite: bool = False,
    **choices: Any,
) -> "AdaptationResult":
    """Adapt a detector to unlabelled sweeps by self-training, resumable: what ``farfield adapt`` does.

    Args:
        detector: A bundled detector's name, a run's folder or a weights file.
        data: The sweeps: a data set's folder, or one that is open, or the folders of several drives. Annotations are
            not looked at.
        out: Folder of the adaptation; called again with the same arguments, it goes on there. ``load_detector`` takes
            it when it is done.
        source: Labelled frames like those that the detector learnt from; by default they are simulated, from the preset
            that the weights' provenance names, without camera.
        labels: Labelled frames on which to score before and after, at the end: they decide nothing, and those that are
            learnt from do not count.
        learn_from: Labels of a few of your sweeps, which teach beside the pseudo boxes of all others: a data set with
            annotated frames, or a table or folder of labels of frames of ``data``. None may be among ``labels``.
        bulk: Who detects (default: this process).
        report: Is informed of the course.
        overwrite: Begin anew; simulated source frames stay.
        **choices: ``frames``, ``source_frames``, ``clouds``, ``rounds``, ``steps``, ``minutes``, ``donors``,
            ``overrides``, ``whole_bodies``, ``seed``; see :class:`farfield.experiments.adapting.AdaptationOptions`.

    Raises:
        ConfigError: If a choice does not fit, the weights do not say what they learnt from or cannot ignore boxes, no
            cloud suits the detector, the folder holds another adaptation, no labelled frame is left to score on, or one
            is to teach and to score.
        DatasetError: If there are no frames, or labels that are to teach cannot.
        FarfieldError: If there are no such weights, or a round yields no pseudo box.
    """
    _require_torch()
    from farfield.experiments.adapting import adapt as adapt_all

    return adapt_all(
        detector,
        data,
        out=out,
        source=source,
        labels=labels,
        learn_from=learn_from,
        bulk=bulk,
        report=report,
        overwrite=overwrite,
        **choices,
    )


def train(
    experiment: Path | str,
    changes: Mapping[str, Any] | None = None,
    *,
    out: Path | str = "runs",
    report: "TrainingReport | None" = None,
) -> Path:
    """Train a detector from one experiment; called again with the same, it goes on: what ``farfield train`` does.

    Args:
        experiment: A shipped experiment's name, or a YAML file.
        changes: Settings to change by dotted name, such as ``{"training.steps": 500, "data.path": "mine"}``.
        out: Folder of all runs; this one's bears the experiment's name.
        report: Is informed of the course.

    Returns:
        The weights, which :func:`load_detector` takes.

    Raises:
        ConfigError: If there is no such experiment or setting, or the folder holds another run.
        DatasetError: If data are not there, or hold none of the clouds or classes asked for.
        MissingExtraError: If torch is not installed.
    """
    _require_torch()
    from farfield.experiments.catalogue import find
    from farfield.experiments.plan import Plan
    from farfield.experiments.schema import load_experiment

    words = [f"{name}={json.dumps(value, default=str)}" for name, value in (changes or {}).items()]
    settings = load_experiment(find(experiment), words)
    return Plan(settings, Path(out) / settings.name).run(report)


def show(
    frame: "Frame | Cloud | Shaped[np.ndarray, 'n columns']",
    predictions: "Boxes | None" = None,
    *,
    radar: bool = False,
    shown_score: float = SHOWN_SCORE,
) -> Any:
    """Draw a frame from above with its annotated and predicted boxes; returns the matplotlib figure.

    Args:
        frame: The frame; or a cloud or its rows, of which every point is shown.
        predictions: Predicted boxes.
        radar: Draw the radar's power instead of a cloud; see :func:`farfield.figures.radar.radar_map`.
        shown_score: Predicted boxes of a lower score are left out, which the title says; 0 shows all.
    """
    from farfield.evaluation.report_data import shown_predictions
    from farfield.figures.birds_eye import show_frame
    from farfield.figures.radar import radar_map
    from farfield.frame import Frame

    if not isinstance(frame, Frame):
        return show_frame(Frame.of(frame), predictions, window_m="fit", shown_score=shown_score)
    if radar:
        return radar_map(frame, shown_predictions(predictions, shown_score)[0])
    return show_frame(frame, predictions, shown_score=shown_score)
