"""The functions most people need. Each imports what it uses when it is called."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

from farfield.errors import DatasetError

if TYPE_CHECKING:
    from farfield.datasets.base import Dataset
    from farfield.detectors.runtime import Detector
    from farfield.frame import Cloud, Frame
    from farfield.geometry.boxes import Boxes

Progress = Callable[[Iterable[int]], Iterable[int]]
Frames = TypeVar("Frames")


def open_dataset(path: Path | str, **options: Any) -> "Dataset":
    """Open a data set, its format recognised; see :func:`farfield.datasets.open_dataset`."""
    from farfield.datasets import open_dataset as open_any

    return open_any(path, **options)


def load_detector(name: Path | str, **options: Any) -> "Detector":
    """Load a detector: a bundled name such as ``"pointpillars-cirrus-sim"``, a run's folder, or a weights file.

    Args:
        name: Which one.
        **options: ``device``, ``precision`` ("auto", "fp32", "bf16"), ``cloud`` (which of a frame's clouds to read).

    Raises:
        FarfieldError: If there is nothing of this name.
        MissingExtraError: If torch is not installed.
    """
    from farfield.detectors import DETECTORS

    _ = DETECTORS["pointpillars"].network_class  # names the missing extra where torch is absent
    from farfield.detectors.runtime import Detector

    return Detector.load(name, **options)


def as_trained(data: Frames, detector: Any) -> Frames:
    """Return the data as the detector was trained to see them, by its provenance.

    The maps through which its training's data were seen are applied: K-Radar's frames in the radar's coordinates, with
    as dense a radar cloud, frames turned, several sweeps; see :func:`farfield.datasets.recipes.replay`. Frames that are
    not a data set's stay as they are.

    Raises:
        ConfigError: If the provenance names maps or settings that are not known.
    """
    from farfield.datasets.base import Dataset
    from farfield.datasets.recipes import recipe_of_provenance, replay

    if not isinstance(data, Dataset):
        return data
    return cast(Frames, replay(data, recipe_of_provenance(getattr(detector, "provenance", None) or {})))


def predict(
    detector: "Callable[[Frame | Cloud], Boxes]", data: "Sequence[Frame] | Dataset", *, progress: Progress = iter
) -> "dict[tuple[str, str], Boxes]":
    """Detect objects in every frame, in as many sweeps as the detector was trained on; boxes by (sequence, frame)."""
    data, found = as_trained(data, detector), {}
    for index in progress(range(len(data))):
        frame = data[index]
        found[frame.key] = detector(frame)
    return found


def evaluate(
    detector: "Callable[[Frame | Cloud], Boxes] | Mapping[tuple[str, str], Boxes]",
    data: "Sequence[Frame] | Dataset",
    *,
    metric: str = "dds",
    range_bins_m: Sequence[float | int] = (0.0, 70.0, 150.0, 250.0),
    progress: Progress = iter,
    **settings: Any,
) -> Any:
    """Score a detector, or predictions made before, on annotated frames.

    Args:
        detector: A detector, or its boxes by (sequence, frame).
        data: Annotated frames.
        metric: ``"dds"``, ``"nuscenes"``, ``"kitti"``, ``"kradar"`` or ``"kradar-compat:VARIANT"``; K-Radar's also
            score by the frames' conditions, and take boxes in the frame that the data are in.
        range_bins_m: Edges of the range bins, metres.
        progress: Wraps the frame numbers, to show progress.
        **settings: Further settings of the protocol.

    Returns:
        The protocol's result; ``print`` shows its table, ``to_json()`` gives everything.

    Raises:
        DatasetError: If no frame is annotated.
    """
    from farfield.metrics import score

    predictions = detector if isinstance(detector, Mapping) else predict(detector, data, progress=progress)
    if not isinstance(detector, Mapping):
        data = as_trained(data, detector)
    frames = [frame for frame in (data[i] for i in range(len(data))) if frame.boxes is not None]
    annotations = {frame.key: frame.boxes for frame in frames if frame.boxes is not None}
    if metric.startswith("kradar") and frames:
        settings.setdefault("boxes_in", "radar" if frames[0].reference == "radar" else "os2-64")
        settings.setdefault("conditions", {frame.key: frame.conditions for frame in frames})
    if not annotations:
        raise DatasetError("evaluate: expected annotated frames, found none with boxes.")
    kept = {key: boxes for key, boxes in predictions.items() if key in annotations}
    edges_m = tuple(float(edge) for edge in range_bins_m)
    return score(kept, annotations, protocol=metric, range_bins_m=edges_m, **settings)


def show(frame: "Frame", predictions: "Boxes | None" = None) -> Any:
    """Draw a frame from above with its annotated and predicted boxes; returns the matplotlib figure."""
    from farfield.reports.figures import show_frame

    return show_frame(frame, predictions)
