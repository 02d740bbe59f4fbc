"""A small data set with drives, poses and one CSV file of labels, for the tests of editing."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from farfield.annotation.schema import AttributeSettings, Schema, schema_of
from farfield.annotation.store import Author, Store
from farfield.datasets.base import Dataset
from farfield.datasets.edits import journal_folder
from farfield.datasets.labels import CsvLabels
from farfield.frame import Cloud, Frame
from farfield.geometry.poses import pose_from_yaw

ANN, EVE = Author("ann", "w1"), Author("eve", "w2")
CAR = [10.0, 2.0, 0.0, 4.5, 1.9, 1.6, 0.25]
SPEED_M_S, TURN_RAD = 10.0, 0.02
HEADER = "sequence,frame,label,x,y,z,l,w,h,yaw_rad,score,track_id\n"


def pose(row: int) -> np.ndarray:
    """Where the vehicle that measures stands: it drives at 10 m/s and turns slowly."""
    return pose_from_yaw(TURN_RAD * row, (SPEED_M_S * row / 10, 0.1 * row, 0.0))


class Drives(Dataset):
    """Frames of two drives, 10 a second, with poses or without; few points."""

    name = "drives"

    def __init__(self, root: Path, frames: int = 20, *, posed: bool = True) -> None:
        self.root, self.posed = root, posed
        self.sequences = ("a",) * frames + ("b",) * frames
        self.frame_ids = tuple(f"{row:04d}" for row in range(frames)) * 2

    def frame(self, index: int) -> Frame:
        row = int(self.frame_ids[index])
        frame = Frame.of(Cloud(np.zeros((1, 3), np.float32), np.zeros(1, np.float32)), None)
        return type(frame)(
            **{
                **{name: getattr(frame, name) for name in ("reference", "sensors", "clouds")},
                "sequence": self.sequences[index],
                "frame_id": self.frame_ids[index],
                "time_ns": row * 100_000_000,
                "world_T_frame": pose(row) if self.posed else None,
            }
        )

    def files(self, index: int) -> Sequence[Path]:
        return ()

    def _times_of(self, indices: np.ndarray) -> np.ndarray:
        return np.array([int(self.frame_ids[index]) * 100_000_000 for index in indices])


def rows_text(rows: Sequence[tuple[object, ...]]) -> str:
    return HEADER + "".join(",".join(map(str, row)) + "\n" for row in rows)


def default_rows(frames: int = 20) -> list[tuple[object, ...]]:
    """Track 3 in drive a and another track 3 in drive b, one box a frame, and a box without a track."""
    found: list[tuple[object, ...]] = []
    for drive in "ab":
        found += [(drive, f"{row:04d}", "car", 10 + row, 2, 0, 4.5, 1.9, 1.6, 0.25, "", 3) for row in range(frames)]
    found.append(("a", "0000", "pedestrian", 5, -3, 0, 0.8, 0.7, 1.75, 0, "", ""))
    return found


def schema(extent: str | None = "full") -> Schema:
    sizes = {"car": (4.6, 1.95, 1.7), "bus": (11.0, 2.6, 3.2), "pedestrian": (0.75, 0.7, 1.75)}
    named = schema_of(sizes, {"moving": (True, False), "note": ()}, extent)  # type: ignore[arg-type]
    counted = {**named.attributes, "count": AttributeSettings(kind="number")}
    return named.model_copy(update={"attributes": counted})


def opened(root: Path, *, frames: int = 20, posed: bool = True, extent: str | None = "full") -> Store:
    """The store of the data set; the label file is made if it is missing."""
    root.mkdir(exist_ok=True)
    file = root / "boxes.csv"
    if not file.exists():
        file.write_text(rows_text(default_rows(frames)))
    return Store(Drives(root, frames, posed=posed), CsvLabels(file), journal_folder(root), schema(extent))


def state_bytes(store: Store) -> bytes:
    """All boxes of all frames as they stand, to compare byte for byte; versions left out."""
    return repr([(key, [(row.label, row.proposal) for row in store.rows(key)]) for key in store.keys]).encode()
