"""What a studio is started with: the data set that it opens, and its settings."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from farfield.calibration.initial_guess import InitialGuess
    from farfield.datasets.base import Dataset


@dataclass(frozen=True, kw_only=True)
class CalibrationSettings:
    """What a calibration page works on.

    Args:
        kind: What against what.
        sequence: Which one (default: the first).
        frames: How many frames serve.
        camera: Name of the image (default: the first calibrated one).
        radar: Start of x and y in metres, yaw in radians, and radar frames; the data set's own where None.
        beginning: What a camera without a calibration begins from.
        pairs: Picked pairs to begin with.
        folder: Folder of results.
    """

    kind: Literal["radar-lidar", "lidar-camera"]
    sequence: str | None = None
    frames: int = 20
    camera: str | None = None
    radar: tuple[float | None, float | None, float | None, int] = (None, None, None, 0)
    beginning: "InitialGuess | None" = None
    pairs: Path | None = None
    folder: Path = Path("runs/calibrate")


@dataclass(frozen=True, kw_only=True)
class StudioSettings:
    """Choices of a studio.

    Args:
        mode: Whether boxes can be changed.
        title: What the page calls the data set.
        annotator: Who edits, where a window does not say it.
        protocol: By which predictions are matched with the truth; empty takes the data set's own.
        predictions: Files of predicted boxes to show.
        format: Their format, see :data:`farfield.metrics.box_files.FORMATS`.
        detectors: Detectors to run on what is shown: bundled names, runs' folders or weights files.
        threshold: Least score of a box that a detector gives.
        first: Frame to show first: its number, or sequence/frame.
        classes: ``name:length,width,height`` of the classes to offer (default: the data set's own).
        extent: What the boxes hold, whole bodies or visible parts; None where it is still to be declared.
        edits: Folder of the journal (default: beside the labels).
        out: Folder into which labels are saved (default: beside the journal).
        to: Format of the saved labels (default: the data set's own).
        write: Whether saves go into the data set's own label files.
        save_at_exit: Whether labels are also written when the studio ends, wherever saves go.
        notes: Folder for bookmarks (default: the user's data folder).
        calibration: Of a calibration page.
    """

    mode: Literal["view", "annotate", "calibrate"] = "view"
    title: str = ""
    annotator: str = ""
    protocol: str = ""
    predictions: tuple[Path, ...] = ()
    format: str = "boxes-csv"
    detectors: tuple[str, ...] = ()
    threshold: float = 0.1
    first: str = ""
    classes: tuple[str, ...] = ()
    extent: Literal["full", "visible"] | None = None
    edits: Path | None = None
    out: Path | None = None
    to: str = ""
    write: bool = False
    save_at_exit: bool = False
    notes: Path | None = None
    calibration: CalibrationSettings | None = None


class DatasetOpener:
    """Opens a data set when it is called, or the frames that ship where no path is given.

    Args:
        path: Folder of a data set, or None.
        open_path: Opens the folder, such as ``open_dataset``.
        **options: Of ``open_path``.
    """

    def __init__(self, path: Path | None, open_path: "Callable[..., Dataset]", **options: Any) -> None:
        self.path, self.open_path, self.options = path, open_path, options

    @property
    def title(self) -> str:
        """What the page calls it."""
        return "two simulated frames" if self.path is None else self.path.resolve().name

    def __call__(self) -> "Dataset":
        """Open it.

        Raises:
            FarfieldError: If there is no data set.
        """
        if self.path is None:
            from farfield.studio.samples import open_samples

            return open_samples()
        return self.open_path(self.path, **self.options)
