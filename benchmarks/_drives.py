"""Simulated drives of 300 m, ten sweeps a second, in Cirrus' and K-Radar's layout: data without poses, and the truth.

python benchmarks/_drives.py FOLDER        simulates them; run again, it goes on where it stopped
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

STRIDE_S = 0.1


@dataclass(frozen=True)
class Simulated:
    """One drive.

    Args:
        preset: Which rig.
        road: Which road.
        seed: Which world.
        frames: So many sweeps see 300 m.
    """

    preset: str
    road: str
    seed: int
    frames: int

    def frame(self, index: int) -> Any:
        """Frame ``index``, with its true pose; nothing is simulated before it is read."""
        from farfield.simulation import simulate_frame

        cirrus = self.preset == "cirrus-sim"
        return simulate_frame(
            self.preset,
            seed=self.seed,
            sequence=0,
            index=index,
            sensors=("gaussian", "uniform") if cirrus else ("os2-64",),
            road=self.road,
            stride_s=STRIDE_S,
            duration_s=60.0,
            weather="normal",
            uniform_offset_ms=(0.0, 0.0),
        )

    def folder(self, root: Path) -> Path:
        """Where its data set stands."""
        return root / f"{self.preset}-{self.road}"

    def truth(self) -> Float[np.ndarray, "n 4 4"]:
        """Pose of every sweep."""
        return np.stack([self.frame(index).world_T_frame for index in range(self.frames)])


DRIVES = (
    Simulated("cirrus-sim", "highway", 0, 140),
    Simulated("kradar-sim", "highway", 0, 180),
    Simulated("cirrus-sim", "urban", 3, 300),
    Simulated("kradar-sim", "urban", 3, 376),
    Simulated("cirrus-sim", "mountain", 0, 332),
    Simulated("kradar-sim", "mountain", 0, 328),
    Simulated("cirrus-sim", "suburban", 0, 280),
    Simulated("kradar-sim", "suburban", 0, 276),
)


def write(drive: Simulated, root: Path, indices: Sequence[int]) -> None:
    """Write sweeps that are not there; no boxes."""
    from farfield.datasets.cirrus import CirrusWriter
    from farfield.datasets.kradar import KRadarWriter

    folder = drive.folder(root)
    writer = CirrusWriter(folder) if drive.preset == "cirrus-sim" else KRadarWriter(folder)
    for index in indices:
        frame = replace(drive.frame(index), load_annotation=None)
        if not all(path.exists() for path in writer.paths(frame).values()):
            writer.write(frame)
    if isinstance(writer, KRadarWriter):
        writer.finish()


if __name__ == "__main__":
    for first in (0, 1):  # every second sweep first: they do for a try
        for each in DRIVES:
            write(each, Path(sys.argv[1]), range(first, each.frames, 2))
            print(each, "from", first, flush=True)
